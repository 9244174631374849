"""Knee mechanisms: the anterior-posterior translation of the femoral reference point that goes with flexion.

Every mechanism becomes a cubic spline of the flexion angle, straight beyond its ends. In the plane a hinge and a
ball-and-socket joint are both a fixed axis. The parallel mechanism is that of Wilson, Feikes & O'Connor 1998
(doi:10.1016/S0021-9290(98)00119-5): contact in both compartments, spheres on planes, and one fibre each of the anterior
cruciate, the posterior cruciate and the medial collateral ligament that keeps its length. A table holds a measured
translation, for example from dynamic MRI or fluoroscopy.

Tibia and femur frame: x anterior, y superior, z lateral, right knee. A point f of the femur lies at p + R f in the
tibia frame, R = R_y(-internal rotation) R_x(abduction) R_z(flexion): flexion about the femur's z axis, rotation about
the tibia's y axis, abduction about the axis between (Grood & Suntay 1983, doi:10.1115/1.3138397).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .compiler import inlined
from .splines import NATURAL, pieces_through
from .types import Floats

MIN_SOLVED_FLEXION = -0.3
"""Smallest flexion [rad] at which the parallel mechanism is solved (-17 deg)"""
MAX_SOLVED_FLEXION = 1.75
"""Largest flexion [rad] at which the parallel mechanism is solved (100 deg): it jams at 109 deg"""
_MAX_TRANSLATION = 0.1
"""Largest translation [m]: a larger one exceeds a tibial plateau, and is most likely in mm"""
GRID_STEP = 0.025
"""Largest step [rad] of the angles at which the parallel mechanism is solved"""
_CLOSED_ERROR = 1e-14
"""Largest error [m] of a closed mechanism, about a hundred rounding errors of 0.1 m"""
_MAX_NEWTON_STEPS = 25
"""Number of Newton's steps after which the mechanism cannot be closed"""
_DIGITS = 12
"""Number of decimal digits [m] to which its translations are rounded"""


@inlined
def translation(pieces: Floats, angle: float) -> tuple[float, float]:
    """Return x [m] and dx/dangle [m/rad] at a flexion angle [rad]; `pieces` as in `Mechanism`."""
    i = 0
    end = len(pieces) - 1
    while i < end:
        middle = (i + end) // 2
        if angle < pieces[middle + 1, 0]:
            end = middle
        else:
            i = middle + 1
    c1, c2, c3 = float(pieces[i, 2]), float(pieces[i, 3]), float(pieces[i, 4])
    u = angle - float(pieces[i, 0])
    return float(pieces[i, 1]) + u * (c1 + u * (c2 + u * c3)), c1 + u * (2.0 * c2 + u * 3.0 * c3)


@dataclass(frozen=True, eq=False)
class Mechanism:
    """Prescribes the place of the femoral reference point along the tibia's x axis, C2 at every flexion angle."""

    name: str
    pieces: Floats
    """Shape (n, 5): start [rad] and c0 to c3 of x = c0 + u (c1 + u (c2 + u c3)) [m] with u = angle - start, in order.

    The first piece also holds before its start, which is that of the second one.
    """

    def __str__(self) -> str:
        return self.name

    def translation(self, angle: float) -> tuple[float, float]:
        """Return x [m], anterior positive, and dx/dangle [m/rad] at a flexion angle [rad]."""
        return translation(self.pieces, angle)

    @property
    def largest_slope(self) -> float:
        """Upper bound of |dx/dangle| [m/rad] over all angles: a slope lies in the hull of its Bézier points."""
        _, _, c1, c2, c3 = self.pieces.T
        width = self._widths
        points = [c1, c1 + c2 * width, c1 + width * (2.0 * c2 + 3.0 * c3 * width)]
        return float(np.abs(points).max())

    @property
    def largest_bend(self) -> float:
        """Upper bound of |d²x/dangle²| [m/rad²] over all angles."""
        _, _, _, c2, c3 = self.pieces.T
        return float(np.abs([2.0 * c2, 2.0 * c2 + 6.0 * c3 * self._widths]).max())

    @property
    def _widths(self) -> Floats:
        return np.diff(self.pieces[:, 0], append=self.pieces[-1, 0])


def hinge(x: float = 0.0) -> Mechanism:
    """Return a fixed flexion axis through the reference point, which stays at x [m], anterior positive."""
    return Mechanism("hinge", np.array([[0.0, x, 0.0, 0.0, 0.0]]))


def translation_table(angle: ArrayLike, x: ArrayLike, name: str = "table") -> Mechanism:
    """Return the natural cubic spline through flexion angles [rad] and translations `x` [m], anterior positive.

    A natural spline has no curvature at its ends, so the straight continuation joins it smoothly.

    Raises:
        ValueError: fewer than 2 points, different lengths, a number that is not finite, angles that do not increase
            strictly, or a translation beyond 0.1 m.
    """
    angle, x = np.asarray(angle, float), np.asarray(x, float)
    if angle.ndim != 1 or angle.shape != x.shape:
        raise ValueError("a translation table needs as many translations as angles")
    if angle.size < 2:
        raise ValueError(f"a translation table needs at least 2 points, got {angle.size}")
    if not (np.isfinite(angle).all() and np.isfinite(x).all()):
        raise ValueError("a number in the translation table is not finite")
    if not (np.diff(angle) > 0.0).all():
        raise ValueError("the angles of a translation table must increase strictly")
    if (np.abs(x) > _MAX_TRANSLATION).any():
        raise ValueError(
            f"a translation is beyond {_MAX_TRANSLATION} m: are the numbers in metres?"
        )
    return Mechanism(name, pieces_through(angle, x, NATURAL))


SPHERE_CENTRES: Floats = np.array(
    [(0.0002458, 0.0034071, -0.0232019), (-0.0032853, 0.0021225, 0.0262054)]
)
"""Centres of the medial and of the lateral sphere in the femur frame [m]"""
PLANE_POINTS: Floats = np.array(
    [(-0.0021344, -0.0286241, -0.0191308), (-0.0027946, -0.0260861, 0.0243679)]
)
"""A point of the plane that each of them touches, in the tibia frame [m]"""
PLANE_NORMALS: Floats = np.array([(0.0675, 0.9896, -0.1273), (-0.0881, 0.9942, 0.0617)])
"""Normals of the planes towards the spheres, in the tibia frame; of any length"""
FEMORAL_ATTACHMENTS: Floats = np.array(
    [
        (-0.0067712, 0.0075255, 0.0091575),
        (-0.0026610, -0.0010906, -0.0021857),
        (0.0027608, 0.0057798, -0.0476279),
    ]
)
"""Attachments of the fibres in the femur frame [m]: anterior cruciate, posterior cruciate, medial collateral"""
TIBIAL_ATTACHMENTS: Floats = np.array(
    [
        (0.0127709, -0.0261454, -0.0000617),
        (-0.0258519, -0.0381449, -0.0035210),
        (0.0021345, -0.1171068, -0.0057872),
    ]
)
"""Attachments of the same fibres in the tibia frame [m]"""
MECHANISM_LENGTHS: Floats = np.array([0.03232, 0.02834, 0.04053, 0.04326, 0.12970])
"""Radii of the spheres and lengths of the fibres [m]

All numbers from `SPHERE_CENTRES` on, radii and lengths included, are those of a right knee by Sancisi, Gasparutto,
Parenti-Castelli & Dumas 2017 (doi:10.1007/s11012-016-0532-x), used before in Gasparutto et al. 2015 (J Biomech
48:1141-1146). None was adjusted. With the two frames parallel the fibres would be 40.01, 43.73 and 129.82 mm long, so
the closed mechanism stands 3.1 deg internally rotated at full extension. It jams at 109 deg of flexion.
"""


def rotation(flexion: float, abduction: float, internal_rotation: float) -> Floats:
    """Return R, shape (3, 3), which rotates directions from the femur frame to the tibia frame, from angles [rad]."""
    sf, cf = math.sin(flexion), math.cos(flexion)
    sa, ca = math.sin(abduction), math.cos(abduction)
    si, ci = math.sin(internal_rotation), math.cos(internal_rotation)
    return np.array(
        [
            [ci * cf - si * sa * sf, -ci * sf - si * sa * cf, -si * ca],
            [ca * sf, ca * cf, -sa],
            [si * cf + ci * sa * sf, -si * sf + ci * sa * cf, ci * ca],
        ]
    )


def parallel_mechanism() -> Mechanism:
    """Return the translation of the medial sphere's centre, 0 at full extension."""
    angles, poses = passive_motion()
    turned = [
        rotation(angle, *pose[3:])[0] @ SPHERE_CENTRES[0]
        for angle, pose in zip(angles.tolist(), poses, strict=True)
    ]
    x = poses[:, 0] + turned
    # Newton's method leaves some 1e-16 m, which differ between processors.
    x = np.round(x - x[angles == 0.0][0], _DIGITS)
    return translation_table(angles, x, "parallel mechanism")


def passive_motion() -> tuple[Floats, Floats]:
    """Solve the parallel mechanism from full extension to both ends of its range, each pose from the two before it.

    Returns flexion angles [rad], shape (n,), and poses of the femur, shape (n, 5): x, y, z [m], abduction and internal
    rotation of the tibia [rad].
    """
    extension = closed_pose(0.0, np.zeros(5))
    motion = {0.0: extension}
    for end in (MIN_SOLVED_FLEXION, MAX_SOLVED_FLEXION):
        last = before = extension
        for angle in np.linspace(0.0, end, 1 + math.ceil(abs(end) / GRID_STEP))[1:].tolist():
            pose = closed_pose(angle, 2.0 * last - before)
            before = last
            last = motion[angle] = pose
    angles = sorted(motion)
    return np.array(angles), np.array([motion[angle] for angle in angles])


def closed_pose(flexion: float, pose: Floats) -> Floats:
    """Return the pose, shape (5,), that fulfils the five equations at a flexion angle [rad], by Newton's method.

    Raises:
        ValueError: there is no such pose near the given one.
    """
    for _ in range(_MAX_NEWTON_STEPS):
        errors, jacobian = linearised(flexion, pose)
        if np.abs(errors).max() < _CLOSED_ERROR:
            return pose
        pose = pose - np.linalg.solve(jacobian, errors)
    raise ValueError(
        f"the parallel mechanism cannot be assembled at {math.degrees(flexion):.1f} deg of flexion"
    )


def linearised(flexion: float, pose: Floats) -> tuple[Floats, Floats]:
    """Return the errors [m] of the equations, shape (5,), and their derivatives by the pose, shape (5, 5).

    Each row is a line along which a contact pushes or a fibre pulls: its direction, and its moments about the axes of
    abduction and of internal rotation.
    """
    abduction, internal_rotation = pose[3:].tolist()
    arms = (
        np.concatenate([SPHERE_CENTRES, FEMORAL_ATTACHMENTS])
        @ rotation(flexion, abduction, internal_rotation).T
    )
    gaps = arms + pose[:3] - np.concatenate([PLANE_POINTS, TIBIAL_ATTACHMENTS])
    # A fibre pulls along itself, a contact pushes along its normal.
    lines = gaps / np.sqrt((gaps * gaps).sum(axis=1))[:, None]
    lines[:2] = PLANE_NORMALS / np.linalg.norm(PLANE_NORMALS, axis=1)[:, None]
    moments = arms[:, [1, 2, 0]] * lines[:, [2, 0, 1]] - arms[:, [2, 0, 1]] * lines[:, [1, 2, 0]]
    abduction_axis = (math.cos(internal_rotation), 0.0, math.sin(internal_rotation))
    jacobian = np.column_stack([lines, moments @ abduction_axis, -moments[:, 1]])
    return (lines * gaps).sum(axis=1) - MECHANISM_LENGTHS, jacobian


MECHANISMS: dict[str, Callable[..., Mechanism]] = {
    "hinge": hinge,
    "ball_and_socket": hinge,
    "parallel_mechanism": parallel_mechanism,
    "table": translation_table,
}
"""Mechanisms by the names that the parameter `translation.mechanism` uses"""
