"""Knee flexion from the orientations of thigh and shank, as two inertial sensors tell them.

The sensors sit on the segments in any way: a standing pose is the zero. The flexion axis is the direction in which the
rotations from it vary most; they point along it on average, as a knee bends far and hardly overstretches.
"""

import math
from collections import deque
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ..model.types import Floats

_LEAST_BEND = math.radians(15.0)
"""Rotation [rad] from the standing pose from which on the axis is known"""
_STRAIGHT = math.radians(25.0)
"""Flexion [rad] below which a knee hardly rotates about other axes"""
_MOST_ASIDE = math.radians(12.0)
"""Mean rotation [rad] of such a knee about other axes that is no knee's"""
_JUDGED = 300
"""Number of such samples over which it is the mean, and a third of it from which it is judged"""
_STILL = math.radians(3.0)
"""Largest standard deviation [rad] of a standing pose"""


def standing_pose(turned: Any) -> tuple[Any, str]:
    """Return the mean of rotations of the shank against the thigh in standing, and what speaks against it."""
    mean = turned.mean()
    moved = float(np.sqrt(np.mean((mean.inv() * turned).magnitude() ** 2)))
    if moved <= _STILL:
        return mean, ""
    return (
        mean,
        f"the knee turns by {math.degrees(moved):.1f} deg RMS, and a standing one is still",
    )


class KneeRotation:
    """Flexion angles from rotations of the shank against the thigh, which also tell the flexion axis."""

    def __init__(self) -> None:
        """Begin without an axis: until the knee bends, all of its rotation counts as flexion."""
        self._largest = 0.0
        self._count = 0
        self._sum = np.zeros(3)
        self._products = np.zeros((3, 3))
        self._aside: deque[float] = deque(maxlen=_JUDGED)

    def flexion(self, turned: Any, standing: Any) -> Floats:
        """Flexion [rad], shape (n,), of n rotations of the shank against the thigh; `standing` is the one of 0."""
        vectors = (turned * standing.inv()).as_rotvec()
        sizes = np.linalg.norm(vectors, axis=1)
        self._largest = max(self._largest, float(sizes.max()))
        self._count += len(vectors)
        self._sum += vectors.sum(axis=0)
        self._products += vectors.T @ vectors
        if self._largest < _LEAST_BEND:
            return np.asarray(sizes)
        spread = self._products - np.outer(self._sum, self._sum) / self._count
        axis = np.linalg.eigh(spread)[1][:, -1]
        axis = -axis if axis @ self._sum < 0.0 else axis
        angles = vectors @ axis
        aside = np.linalg.norm(vectors - angles[:, None] * axis, axis=1)
        self._aside.extend(aside[np.abs(angles) < _STRAIGHT][-_JUDGED:].tolist())
        return np.asarray(angles)

    @property
    def doubt(self) -> str:
        """Sentence about a straight knee that turns about other axes; empty if it hardly does, or little is known."""
        if len(self._aside) < _JUDGED // 3 or sum(self._aside) < _MOST_ASIDE * len(self._aside):
            return ""
        mean = math.degrees(sum(self._aside) / len(self._aside))
        return (
            f"the straight knee is turned by {mean:.0f} deg about other axes than flexion on average: have the "
            "headings of the two sensors drifted apart, has one slipped, or was the standing pose another?"
        )


def rotations(quaternions: Floats) -> Any:
    """Return SciPy's rotations of quaternions x, y, z, w, shape (n, 4).

    Raises:
        ValueError: one is not finite, or far from unit length.
    """
    length = np.linalg.norm(quaternions, axis=1)
    wrong = ~(np.abs(length - 1.0) < 0.1)
    if wrong.any():
        row = int(np.argmax(wrong))
        numbers = ", ".join(f"{number:.4g}" for number in quaternions[row])
        raise ValueError(f"row {row + 1}: {numbers} is no quaternion of unit length")
    return Rotation.from_quat(quaternions)
