"""The common normal by Newton's method on Eq. 5, where two balls prove that it is that of the deepest point.

With Δ = d n from the tibial point Q to the femoral point P, and the bone of the femur on the side of n: the ball that
touches the tibia at Q and has the curvature b lies above it, and that at P with the curvature a holds the femur. Where
1/a <= 1/b - d, the ball around the same centre with the radius 1/b - d holds the femur, too; its points are above the
tibia by d at least, because the centre is by 1/b. So no femoral point is deeper than P, wherever Newton began.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from knee_contact_ros.core.contact_pairs.base import Closest, Pose
from knee_contact_ros.core.contact_pairs.femoral_curve import (
    FemoralCurve,
    bend_on,
    common_normal,
    place_on,
    slope_on,
    turned_arc,
)
from knee_contact_ros.core.contact_pairs.tibial_surface import DEEPEST_PART, LAST_STEP, MOST_STEPS, TibialSurface
from knee_contact_ros.core.kernel_source import in_kernel, never_inlined

ROUNDS = 2
"""Number of rounds to find a start"""
FARTHEST = 0.05
"""Length [m] of a step above which Newton's method is given up"""


class Certain(NamedTuple):
    """Result of Newton's method."""

    proven: bool
    """Whether it is proven that the contact is the deepest one"""
    contact: Closest
    """The common normal; meaningless if it is not proven"""


@never_inlined
def certain_contact(curve: FemoralCurve, tibia: TibialSurface, pose: Pose, height: float) -> Certain:
    """Find the common normal in a pose at a height [m] by Newton's method."""
    i, u, place = _start(curve, tibia, pose)
    length = FARTHEST
    for _ in range(MOST_STEPS):
        arc = turned_arc(curve, i, pose.sine, pose.cosine)
        x, y = place_on(arc, u)
        (x_slope, y_slope), (x_bend, y_bend) = slope_on(arc, u), bend_on(arc, u)
        rise, slope, bend = tibia.graph(place)
        dx, dy = pose.x + x - place, height + y - rise
        # Both P'·N and (P - Q)·T shall be 0, with N = (-slope, 1) and T = (1, slope).
        parallel, beside = y_slope - slope * x_slope, dx + slope * dy
        parallel_u, parallel_place = y_bend - slope * x_bend, -bend * x_slope
        beside_u, beside_place = x_slope + slope * y_slope, dy * bend - 1.0 - slope * slope
        scale = parallel_u * beside_place - parallel_place * beside_u
        if scale == 0.0:
            break
        step = (parallel_place * beside - parallel * beside_place) / scale
        step_place = (parallel * beside_u - parallel_u * beside) / scale
        length = abs(step) + abs(step_place)
        if not length < FARTHEST:
            break
        i, u = _carried_on(curve, i, u + step)
        place += step_place
        if length < LAST_STEP or not 0.0 <= u <= curve.cubics[i, 0]:
            break
    return _judged(curve, tibia, pose, height, i, u, place, length < LAST_STEP)


@in_kernel
def _judged(
    curve: FemoralCurve, tibia: TibialSurface, pose: Pose, height: float, i: int, u: float, place: float, found: bool
) -> Certain:
    """Return the common normal at a place u [m] of segment i and one of the tibia [m], and whether it is proven.

    It is not where it was not `found`, as Newton's method did not converge.
    """
    arc = turned_arc(curve, i, pose.sine, pose.cosine)
    x, y = place_on(arc, u)
    x_slope, y_slope = slope_on(arc, u)
    rise, slope, _ = tibia.graph(place)
    dx, dy = pose.x + x - place, height + y - rise
    norm = math.sqrt(1.0 + slope * slope)
    distance, normal_x, normal_y = (dy - slope * dx) / norm, -slope / norm, 1.0 / norm
    outer, inner = float(curve.balls[i]), tibia.cup(place)
    room, (convex, _) = 1.0 - inner * distance, tibia.curvatures()
    holds = room > 0.0 and inner < outer * room and convex * distance < DEEPEST_PART
    upright = curve.sense * (x_slope + slope * y_slope) > 0.0
    contact = common_normal(arc, u, distance, (normal_x, normal_y))
    return Certain(found and 0.0 <= u <= arc.length and holds and upright, contact)


@in_kernel
def _carried_on(curve: FemoralCurve, i: int, u: float) -> tuple[int, float]:
    """Return segment and parameter u [m] of a place that may lie beyond the ends of segment i."""
    while u < 0.0 and i > 0:
        i -= 1
        u += float(curve.cubics[i, 0])
    while u > curve.cubics[i, 0] and i < len(curve.balls) - 1:
        u -= float(curve.cubics[i, 0])
        i += 1
    return i, u


@in_kernel
def _start(curve: FemoralCurve, tibia: TibialSurface, pose: Pose) -> tuple[int, float, float]:
    """Return where Newton's method begins: femoral segment, place in it [m], and place [m] on the tibia.

    The femur would touch a plane with the slope of the tibia near there.
    """
    cells, slope, row, place = len(curve.lowest), 0.0, 0, pose.x
    for _ in range(ROUNDS):
        row = int((pose.angle - slope) % math.tau * (cells / math.tau)) % cells
        place = pose.x + pose.cosine * float(curve.lowest[row, 2]) - pose.sine * float(curve.lowest[row, 3])
        _, slope, _ = tibia.graph(place)
    return int(curve.lowest[row, 0]), float(curve.lowest[row, 1]), place
