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
from ..parameters.schema import Parameters
from ..parameters.sections import rotation_numbers
from ..system.errors import UsageError
from .frames import rotation_pose
from .messages import JointState, RefusedSampleError, encode_joint_state, refusal
from .topics import NANOSECONDS

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

_KEPT = 2000
"""Largest number of samples of each kind that are kept, enough for a second"""


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


class OrientationJoin:
    """Joins orientations of thigh and shank to joint states at the stamps of the shank, and measures the standing pose.

    The thigh's orientation is interpolated between its two neighbours, at most `pairing.max_gap` apart.
    """

    def __init__(self, parameters: Parameters) -> None:
        """Begin without samples."""
        self._joint = parameters.knee.joint_name
        self._max_gap = round(parameters.pairing.max_gap * NANOSECONDS)
        self._topic = parameters.inputs()[0].topic
        thigh = parameters.thigh()
        self._of_thigh = f"orientation of the thigh ({thigh.topic if thigh else ''})"
        self._thighs: deque[tuple[int, Floats]] = deque(maxlen=_KEPT)
        self._shanks: deque[tuple[int, str, Floats]] = deque(maxlen=_KEPT)
        self._turned: deque[tuple[int, Any]] = deque(maxlen=_KEPT)
        self.retune(parameters)

    def retune(self, parameters: Parameters) -> None:
        """Continue with another standing pose."""
        pose = rotation_pose(rotation_numbers(parameters.orientations.standing))
        self._standing = None if pose is None else Rotation.from_matrix(pose[:3, :3])
        self.knee = KneeRotation()

    def add_thigh(self, stamp: int, _frame: str, numbers: list[float]) -> list[bytes]:
        """Take an orientation of the thigh at a stamp [ns]; return the joint states that it makes possible."""
        if self._thighs and stamp <= self._thighs[-1][0]:
            if self._thighs[-1][0] - stamp <= self._max_gap:
                return []  # late
            self._thighs.clear()
            self._shanks.clear()
        self._thighs.append((stamp, self._quaternion(numbers)))
        return self._joint_states()

    def add_shank(self, stamp: int, frame: str, numbers: list[float]) -> list[bytes]:
        """Take an orientation of the shank in the same way."""
        self._shanks.append((stamp, frame, self._quaternion(numbers)))
        return self._joint_states()

    def measured_standing(self) -> str:
        """Return the mean turn of the shank's sensor against the thigh's in the last second, as a parameter.

        Raises:
            UsageError: there are too few samples, or they are not of a standing leg.
        """
        last = self._turned[-1][0] if self._turned else 0
        recent = [(at, one) for at, one in self._turned if abs(last - at) <= NANOSECONDS]
        if len(recent) < 10 or last - recent[0][0] < 0.8 * NANOSECONDS:
            raise UsageError(f"{len(recent)} orientations came in the last second; 10 are needed")
        mean, fault = standing_pose(Rotation.concatenate([one for _, one in recent]))
        if fault:
            raise UsageError(f"{fault} for a second")
        return " ".join(f"{number:.7g}" for number in mean.as_quat())

    def _quaternion(self, numbers: list[float]) -> Floats:
        found = np.array(numbers)
        try:
            rotations(found[None])
        except ValueError as error:
            text = f"{self._topic}: {str(error).partition(': ')[2]}"
            raise RefusedSampleError("no_orientation", text) from None
        return found

    def _joint_states(self) -> list[bytes]:
        """Return what can be told of the shank's samples by now, a refusal of those without a thigh."""
        made = []
        newest = max((stamp for stamp, _, _ in self._shanks), default=0)
        while self._shanks:
            stamp, frame, shank = self._shanks[0]
            try:
                thigh = self._thigh_at(stamp, newest)
                if thigh is None:
                    break
                made.append(self._joint_state(stamp, frame, thigh, shank))
            except RefusedSampleError as refused:
                made.append(refusal(refused))
            self._shanks.popleft()
        return made

    def _joint_state(self, stamp: int, frame: str, thigh: Floats, shank: Floats) -> bytes:
        turned = Rotation.from_quat(thigh[None]).inv() * Rotation.from_quat(shank[None])
        self._turned.append((stamp, turned))
        if self._standing is None:
            text = "the zero is not known: call ~/zero in standing, or set orientations.standing"
            raise RefusedSampleError("no_standing_pose", f"{self._topic}: {text}")
        angle = float(self.knee.flexion(turned, self._standing)[0])
        return encode_joint_state(JointState(stamp, frame, (self._joint,), (angle,), (), ()))

    def _thigh_at(self, stamp: int, newest: int) -> Floats | None:
        """Return the thigh's orientation at a stamp [ns]; None if it may still come.

        Raises:
            RefusedSampleError: there is none near enough.
        """
        thighs = self._thighs
        while len(thighs) > 1 and thighs[1][0] <= stamp:
            thighs.popleft()
        first, one = thighs[0] if thighs else (stamp, None)
        if one is not None and first == stamp:
            return one
        if one is not None and len(thighs) > 1 and first < stamp:
            last, other = thighs[1]
            if last - first <= self._max_gap:
                turned = other * np.copysign(1.0, one @ other)
                return one + (stamp - first) / (last - first) * (turned - one)
        elif first <= stamp and newest - stamp <= self._max_gap:
            return None
        gap = self._max_gap / NANOSECONDS
        text = f"{self._topic}: no {self._of_thigh} within {gap:g} s (pairing.max_gap)"
        raise RefusedSampleError("no_thigh", text)
