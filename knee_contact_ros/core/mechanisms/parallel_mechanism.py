"""The parallel mechanism: femoral spheres on tibial planes, guided by isometric ligament fibres.

Wilson, Feikes & O'Connor 1998 (doi:10.1016/S0021-9290(98)00119-5) explained passive knee flexion as a spatial mechanism
with one degree of freedom: contact in both compartments, and one fibre each of the anterior cruciate, the posterior
cruciate and the medial collateral ligament that keeps its length. Everything else follows from the flexion angle.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.core.mechanisms.closure import Closure, Condyle, ConstrainedKnee, Fibre, SpatialPose
from knee_contact_ros.core.mechanisms.table import Table

SANCISI_2017 = ConstrainedKnee(
    medial=Condyle(
        centre=(0.0002458, 0.0034071, -0.0232019),
        radius=0.03232,
        contact=(-0.0021344, -0.0286241, -0.0191308),
        normal=(0.0675, 0.9896, -0.1273),
    ),
    lateral=Condyle(
        centre=(-0.0032853, 0.0021225, 0.0262054),
        radius=0.02834,
        contact=(-0.0027946, -0.0260861, 0.0243679),
        normal=(-0.0881, 0.9942, 0.0617),
    ),
    fibres=(
        Fibre(femur=(-0.0067712, 0.0075255, 0.0091575), tibia=(0.0127709, -0.0261454, -0.0000617), length=0.04053),
        Fibre(femur=(-0.0026610, -0.0010906, -0.0021857), tibia=(-0.0258519, -0.0381449, -0.0035210), length=0.04326),
        Fibre(femur=(0.0027608, 0.0057798, -0.0476279), tibia=(0.0021345, -0.1171068, -0.0057872), length=0.12970),
    ),
)
"""A right knee; fibres: anterior cruciate, posterior cruciate, medial collateral.

All numbers, lengths and radii included, are those of Sancisi, Gasparutto, Parenti-Castelli & Dumas 2017
(doi:10.1007/s11012-016-0532-x), used before in Gasparutto et al. 2015 (J Biomech 48:1141-1146). None was adjusted. With
the two frames parallel the fibres would be 40.01, 43.73 and 129.82 mm long, so the closed mechanism stands 3.1 deg
internally rotated at full extension. It jams at 109 deg of flexion.
"""

START, STOP = -0.3, 1.75
"""Range of flexion [rad] that is solved: -17 to 100 deg."""
STEP = 0.025
"""Largest step of the grid [rad]."""
LARGEST_JUMP = 0.02
"""Largest distance of a pose from the linear continuation of the two before it [m and rad].

The default knee stays below 0.001. A larger one means that Newton's method has found another assembly of the parts.
"""


class ParallelMechanism:
    """Translation of the centre of the medial sphere, which is the reference point of a circular condyle.

    A model uses its `table`.
    """

    def __init__(self, knee: ConstrainedKnee = SANCISI_2017, start: float = START, stop: float = STOP) -> None:
        """Solve the mechanism from full extension to `start` < 0 and `stop` > 0 [rad]; the table is straight beyond.

        Raises:
            ValueError: the geometry is impossible, or cannot be assembled or moved over the whole range.
        """
        if not start < 0.0 < stop:
            raise ValueError("the parallel mechanism's range of flexion must contain full extension inside it")
        self._closure = Closure(knee)
        extension = self._closure.solve(0.0, SpatialPose(0.0, 0.0, 0.0, 0.0, 0.0))
        flexed, extended = self._follow(extension, stop), self._follow(extension, start)
        poses = dict(sorted({**extended, **flexed}.items()))
        self._angles = np.array(list(poses))
        self._poses = tuple(poses.values())
        anterior = np.array([_anterior(knee, angle, pose) for angle, pose in poses.items()])
        self.table = Table(self._angles, anterior - _anterior(knee, 0.0, extension))
        """The translation as a `Mechanism`; x is 0 at full extension"""

    def pose(self, angle: float) -> SpatialPose:
        """Solve for the whole pose of the femur at a flexion angle [rad] inside the range, to the last digit.

        Raises:
            ValueError: the angle is outside the range.
        """
        if not self._angles[0] <= angle <= self._angles[-1]:
            raise ValueError("the flexion angle lies outside the parallel mechanism's range")
        nearest = int(np.abs(self._angles - angle).argmin())
        return self._closure.solve(angle, self._poses[nearest])

    def _follow(self, extension: SpatialPose, end: float) -> dict[float, SpatialPose]:
        """Return poses by flexion angle from full extension to `end` [rad], each solved from the two before it."""
        angles: NDArray[np.float64] = np.linspace(0.0, end, 1 + int(np.ceil(abs(end) / STEP)))
        poses = [extension]
        for angle in angles[1:].tolist():
            last, before = np.array(poses[-1]), np.array(poses[-2:][0])
            guess = 2.0 * last - before
            pose = self._closure.solve(angle, SpatialPose(*guess.tolist()))
            if len(poses) > 1 and np.abs(np.array(pose) - guess).max() > LARGEST_JUMP:
                raise ValueError(f"the parallel mechanism jams before {np.degrees(angle):.1f} deg of flexion")
            poses.append(pose)
        return dict(zip(angles.tolist(), poses, strict=True))


def _anterior(knee: ConstrainedKnee, angle: float, pose: SpatialPose) -> float:
    """Return x of the medial sphere's centre in the tibia frame [m]."""
    return pose.x + float(pose.rotation(angle)[0] @ np.array(knee.medial.centre))
