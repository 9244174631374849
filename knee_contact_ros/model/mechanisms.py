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

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from knee_contact_ros.model.compiler import inlined
from knee_contact_ros.model.types import Floats

LARGEST = 0.1
"""Largest translation [m]: a larger one exceeds a tibial plateau, and is most likely in mm."""
START, STOP, STEP = -0.3, 1.75, 0.025
"""Range of flexion [rad] in which the parallel mechanism is solved (-17 to 100 deg), and largest step of the grid"""
CLOSED, ITERATIONS = 1e-14, 25
"""Largest error [m] of a closed mechanism, about a hundred rounding errors of 0.1 m; largest number of Newton steps"""


@inlined
def translation(pieces: Floats, angle: float) -> tuple[float, float]:
    """Return x [m] and dx/dangle [m/rad] at a flexion angle [rad]; `pieces` as in `Mechanism`."""
    i, end = 0, len(pieces) - 1
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
        (_, _, c1, c2, c3), width = self.pieces.T, self._widths
        return float(
            np.abs([c1, c1 + c2 * width, c1 + width * (2.0 * c2 + 3.0 * c3 * width)]).max()
        )

    @property
    def largest_bend(self) -> float:
        """Upper bound of |d²x/dangle²| [m/rad²] over all angles."""
        (_, _, _, c2, c3), width = self.pieces.T, self._widths
        return float(np.abs([2.0 * c2, 2.0 * c2 + 6.0 * c3 * width]).max())

    @property
    def _widths(self) -> Floats:
        return np.diff(self.pieces[:, 0], append=self.pieces[-1, 0])


def hinge(x: float = 0.0) -> Mechanism:
    """Return a fixed flexion axis through the reference point, which stays at x [m], anterior positive."""
    return Mechanism("hinge", np.array([[0.0, x, 0.0, 0.0, 0.0]]))


def table(angle: ArrayLike, x: ArrayLike, name: str = "table") -> Mechanism:
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
    width = np.diff(angle)
    if not (width > 0.0).all():
        raise ValueError("the angles of a translation table must increase strictly")
    if (np.abs(x) > LARGEST).any():
        raise ValueError(f"a translation is beyond {LARGEST} m: are the numbers in metres?")
    chord, bends = np.diff(x) / width, np.zeros(angle.size)  # second derivatives, 0 at both ends
    inner = (
        np.diag(2.0 * (width[:-1] + width[1:]))
        + np.diag(width[1:-1], 1)
        + np.diag(width[1:-1], -1)
    )
    bends[1:-1] = np.linalg.solve(inner, 6.0 * np.diff(chord))
    left, right = bends[:-1], bends[1:]
    slope = chord - width * (2.0 * left + right) / 6.0
    last_slope = chord[-1] + width[-1] * left[-1] / 6.0
    cubics = np.column_stack(
        [angle[:-1], x[:-1], slope, left / 2.0, (right - left) / (6.0 * width)]
    )
    ends = np.array(
        [[angle[0], x[0], slope[0], 0.0, 0.0], [angle[-1], x[-1], last_slope, 0.0, 0.0]]
    )
    return Mechanism(name, np.concatenate([ends[:1], cubics, ends[1:]]))


SPHERES: Floats = np.array(
    [(0.0002458, 0.0034071, -0.0232019), (-0.0032853, 0.0021225, 0.0262054)]
)
"""Centres of the medial and of the lateral sphere in the femur frame [m]"""
PLANES: Floats = np.array(
    [(-0.0021344, -0.0286241, -0.0191308), (-0.0027946, -0.0260861, 0.0243679)]
)
"""A point of the plane that each of them touches, in the tibia frame [m]"""
NORMALS: Floats = np.array([(0.0675, 0.9896, -0.1273), (-0.0881, 0.9942, 0.0617)])
"""Normals of the planes towards the spheres, in the tibia frame; of any length"""
ON_FEMUR: Floats = np.array(
    [
        (-0.0067712, 0.0075255, 0.0091575),
        (-0.0026610, -0.0010906, -0.0021857),
        (0.0027608, 0.0057798, -0.0476279),
    ]
)
ON_TIBIA: Floats = np.array(
    [
        (0.0127709, -0.0261454, -0.0000617),
        (-0.0258519, -0.0381449, -0.0035210),
        (0.0021345, -0.1171068, -0.0057872),
    ]
)
"""Attachments of the fibres in both frames [m]: anterior cruciate, posterior cruciate, medial collateral"""
DISTANCES: Floats = np.array([0.03232, 0.02834, 0.04053, 0.04326, 0.12970])
"""Radii of the spheres and lengths of the fibres [m]

All numbers from `SPHERES` on, radii and lengths included, are those of a right knee by Sancisi, Gasparutto,
Parenti-Castelli & Dumas 2017 (doi:10.1007/s11012-016-0532-x), used before in Gasparutto et al. 2015 (J Biomech
48:1141-1146). None was adjusted. With the two frames parallel the fibres would be 40.01, 43.73 and 129.82 mm long, so
the closed mechanism stands 3.1 deg internally rotated at full extension. It jams at 109 deg of flexion.
"""


def rotation(flexion: float, abduction: float, internal_rotation: float) -> Floats:
    """Return R, shape (3, 3), which rotates directions from the femur frame to the tibia frame, from angles [rad]."""
    (sf, cf), (sa, ca), (si, ci) = (
        (math.sin(a), math.cos(a)) for a in (flexion, abduction, internal_rotation)
    )
    return np.array(
        [
            [ci * cf - si * sa * sf, -ci * sf - si * sa * cf, -si * ca],
            [ca * sf, ca * cf, -sa],
            [si * cf + ci * sa * sf, -si * sf + ci * sa * cf, ci * ca],
        ]
    )


def parallel_mechanism() -> Mechanism:
    """Return the translation of the medial sphere's centre, 0 at full extension, from `START` to `STOP`."""
    angles, poses = passive_motion()
    turned = [
        rotation(angle, *pose[3:])[0] @ SPHERES[0]
        for angle, pose in zip(angles.tolist(), poses, strict=True)
    ]
    x = poses[:, 0] + turned
    return table(angles, x - x[angles == 0.0][0], "parallel mechanism")


def passive_motion() -> tuple[Floats, Floats]:
    """Solve the parallel mechanism from full extension to `START` and to `STOP`, each pose from the two before it.

    Returns flexion angles [rad], shape (n,), and poses of the femur, shape (n, 5): x, y, z [m], abduction and internal
    rotation of the tibia [rad].
    """
    extension = closed(0.0, np.zeros(5))
    motion = {0.0: extension}
    for end in (START, STOP):
        last = before = extension
        for angle in np.linspace(0.0, end, 1 + math.ceil(abs(end) / STEP))[1:].tolist():
            before, last = last, closed(angle, 2.0 * last - before)
            motion[angle] = last
    angles = sorted(motion)
    return np.array(angles), np.array([motion[angle] for angle in angles])


def closed(flexion: float, pose: Floats) -> Floats:
    """Return the pose, shape (5,), that fulfils the five equations at a flexion angle [rad], by Newton's method."""
    for _ in range(ITERATIONS):
        errors, jacobian = linearised(flexion, pose)
        if np.abs(errors).max() < CLOSED:
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
    arms = np.concatenate([SPHERES, ON_FEMUR]) @ rotation(flexion, abduction, internal_rotation).T
    gaps = arms + pose[:3] - np.concatenate([PLANES, ON_TIBIA])
    lines = gaps / np.sqrt((gaps * gaps).sum(axis=1))[:, None]  # a fibre pulls along itself
    lines[:2] = (
        NORMALS / np.linalg.norm(NORMALS, axis=1)[:, None]
    )  # a contact pushes along its normal
    moments = arms[:, [1, 2, 0]] * lines[:, [2, 0, 1]] - arms[:, [2, 0, 1]] * lines[:, [1, 2, 0]]
    abduction_axis = (math.cos(internal_rotation), 0.0, math.sin(internal_rotation))
    jacobian = np.column_stack([lines, moments @ abduction_axis, -moments[:, 1]])
    return (lines * gaps).sum(axis=1) - DISTANCES, jacobian


MECHANISMS: dict[str, Callable[..., Mechanism]] = {
    "hinge": hinge,
    "ball_and_socket": hinge,
    "parallel_mechanism": parallel_mechanism,
    "table": table,
}
"""Mechanisms by the names that the parameter `translation.mechanism` uses"""
