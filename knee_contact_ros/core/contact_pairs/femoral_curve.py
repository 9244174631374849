"""A femoral profile in one pose over a tibial surface: its signed distance along the curve, with bounds."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from knee_contact_ros.core.arrays import Floats
from knee_contact_ros.core.contact_pairs.base import Closest
from knee_contact_ros.core.contact_pairs.least import Sample, least_between
from knee_contact_ros.core.contact_pairs.tibial_surface import TibialSurface, level_curvatures
from knee_contact_ros.core.contact_pairs.touching_balls import PARTS, SHARP, Pieces, least_roundness
from knee_contact_ros.core.geometries.profile import Profile
from knee_contact_ros.core.kernel_source import in_kernel

ANGLES = 512
"""Number of angles for which the lowest point is stored"""
Cubic = tuple[float, float, float, float]
"""Coefficients of a cubic, from the constant one to the highest"""


class FemoralCurve(NamedTuple):
    """All segments of a profile, with a binary tree of blocks of them.

    Block 1 is the whole curve, and blocks 2k and 2k + 1 are the halves of block k, down to single segments.
    """

    cubics: Floats
    """Shape (segments + 1, 10), see `Curve`; the last row has the last point of the curve as x0 and y0"""
    blocks: Floats
    """Shape (2 x width, 3): length of the parameter u [m], and upper bounds of the lengths of p' and of p'' [1/m].

    The width is the least power of 2 that has room for all segments; they are the blocks from there on.
    """
    sense: float
    """1.0 if the bone lies to the left of the curve, -1.0 if to the right"""
    balls: Floats
    """Shape (segments,): a ball of this curvature [1/m] that touches the curve in the segment, on the side of the bone,
    contains all of the curve; there is no such ball if it is not > 0 (`touching_balls`)"""
    lowest: Floats
    """Shape (angles, 4): segment, parameter u [m], x and y [m] of the lowest point, in the middle of equal cells of the
    full turn"""


def femoral_curve(profile: Profile) -> FemoralCurve:
    """Return the segments of `profile` with their bounds."""
    cubics = profile.curve.cubics
    count, u = len(cubics), cubics[:, 0]
    axes = cubics[:, 2:6].T, cubics[:, 6:].T
    end = np.zeros((1, 10))
    end[0, [2, 6]] = [np.polyval(axis[::-1, -1], u[-1]) for axis in axes]
    controls = [(c1, c1 + u * c2, c1 + u * (2.0 * c2 + 3.0 * u * c3)) for _, c1, c2, c3 in axes]
    bends = [(2.0 * c2, 2.0 * c2 + 6.0 * u * c3) for _, c1, c2, c3 in axes]  # the second derivative is linear in u
    width = 1 << (count - 1).bit_length()
    blocks = np.zeros((2 * width, 3))
    blocks[width : width + count, 0] = u
    blocks[width : width + count, 1] = np.hypot(*np.array(controls)).max(axis=0)
    blocks[width : width + count, 2] = np.hypot(*np.array(bends)).max(axis=0)
    for k in range(width - 1, 0, -1):
        blocks[k] = np.maximum(blocks[2 * k], blocks[2 * k + 1])
        blocks[k, 0] = blocks[2 * k, 0] + blocks[2 * k + 1, 0]
    sense, balls = _balls(cubics, blocks[width : width + count, 1:])
    return FemoralCurve(np.concatenate([cubics, end]), blocks, sense, balls, _lowest(profile))


def _balls(cubics: Floats, bounds: Floats) -> tuple[float, Floats]:
    """`FemoralCurve.sense` and `balls`; `bounds` has upper bounds of the lengths of p' and p'' of every segment."""
    u = cubics[:, 0, None] * (np.arange(PARTS) + 0.5) / PARTS
    half = 0.5 * cubics[:, 0, None] / PARTS
    (x0, x1, x2, x3), (y0, y1, y2, y3) = cubics[:, 2:6].T[:, :, None], cubics[:, 6:].T[:, :, None]
    places = np.stack([x0 + u * (x1 + u * (x2 + u * x3)), y0 + u * (y1 + u * (y2 + u * y3))], axis=2)
    slopes = np.stack([x1 + u * (2.0 * x2 + 3.0 * u * x3), y1 + u * (2.0 * y2 + 3.0 * u * y3)], axis=2)
    speeds = np.hypot(slopes[..., 0], slopes[..., 1])
    cross0, cross1, cross2 = 2.0 * (x1 * y2 - y1 * x2), 6.0 * (x1 * y3 - y1 * x3), 6.0 * (x2 * y3 - y2 * x3)  # p' x p''
    cross, over = cross0 + u * (cross1 + u * cross2), half * (np.abs(cross1 + 2.0 * u * cross2) + half * np.abs(cross2))
    way = half * bounds[:, 1:]
    slowest, fastest = speeds - way, np.minimum(speeds + way, bounds[:, :1])
    low, high = _least_curvature(cross - over, slowest, fastest), -_least_curvature(-cross - over, slowest, fastest)
    sense = 1.0 if float(np.sum(cross * half)) > 0.0 else -1.0
    pieces = Pieces(
        places=places.reshape(-1, 2), tangents=sense * (slopes / speeds[..., None]).reshape(-1, 2),
        reach=(half * fastest).ravel(), low=(low if sense > 0.0 else -high).ravel(),
        high=(high if sense > 0.0 else -low).ravel(),
    )  # fmt: skip
    return sense, least_roundness(pieces).reshape(-1, PARTS).min(axis=1)


def _least_curvature(cross: Floats, slowest: Floats, fastest: Floats) -> Floats:
    """Return a lower bound of the curvature [1/m] from one of p' x p'' and bounds of the length of p'."""
    with np.errstate(divide="ignore", invalid="ignore"):
        bound = cross / np.where(cross > 0.0, fastest, slowest) ** 3
    return np.asarray(np.where(slowest > 0.0, np.maximum(bound, -SHARP), -SHARP))


def _lowest(profile: Profile) -> Floats:
    """Return `FemoralCurve.lowest`."""
    angles = (np.arange(ANGLES) + 0.5) * (math.tau / ANGLES)
    starts = profile.curve.cubics[:, 1]
    _, x, y, places = np.array([profile.lowest(angle) for angle in angles.tolist()]).T
    segments = np.searchsorted(starts, places, side="right") - 1
    return np.column_stack([segments, places - starts[segments], x, y])


@in_kernel
def least_distance(curve: FemoralCurve, block: int, tibia: TibialSurface, begin: float, end: float) -> float:
    """Return a lower bound of the signed distance of a block [m], from the distances of its ends [m]."""
    length = float(curve.blocks[block, 0])
    speed, bend = float(curve.blocks[block, 1]), float(curve.blocks[block, 2])
    convex, _ = level_curvatures(tibia.curvatures(), min(begin, end) - 0.5 * speed * length, 0.0)
    sag = 0.125 * length * length * (bend - convex * speed * speed)
    return least_between(begin, end, sag)


class Arc(NamedTuple):
    """One cubic segment of the curve in the directions of the tibia, relative to the reference point."""

    length: float
    """Length of the parameter u [m]"""
    x: Cubic
    """x(u) [m]"""
    y: Cubic
    """y(u) [m]"""
    speed: float
    """Upper bound of the length of the first derivative p'"""
    bend: float
    """Largest length of the second derivative p'' [1/m]; it is linear in u"""


@in_kernel
def turned_arc(curve: FemoralCurve, i: int, sine: float, cosine: float) -> Arc:
    """Return segment i with the femur turned by the angle with this sine and cosine."""
    cubics, block = curve.cubics, len(curve.blocks) // 2 + i
    x0, x1, x2, x3 = float(cubics[i, 2]), float(cubics[i, 3]), float(cubics[i, 4]), float(cubics[i, 5])
    y0, y1, y2, y3 = float(cubics[i, 6]), float(cubics[i, 7]), float(cubics[i, 8]), float(cubics[i, 9])
    return Arc(
        length=float(cubics[i, 0]),
        x=(cosine * x0 - sine * y0, cosine * x1 - sine * y1, cosine * x2 - sine * y2, cosine * x3 - sine * y3),
        y=(sine * x0 + cosine * y0, sine * x1 + cosine * y1, sine * x2 + cosine * y2, sine * x3 + cosine * y3),
        speed=float(curve.blocks[block, 1]), bend=float(curve.blocks[block, 2]),
    )  # fmt: skip


@in_kernel
def place_on(arc: Arc, u: float) -> tuple[float, float]:
    """Return the point at a parameter u [m], relative to the reference point [m]."""
    x0, x1, x2, x3 = arc.x
    y0, y1, y2, y3 = arc.y
    return x0 + u * (x1 + u * (x2 + u * x3)), y0 + u * (y1 + u * (y2 + u * y3))


@in_kernel
def slope_on(arc: Arc, u: float) -> tuple[float, float]:
    """Return the first derivative p' at a parameter u [m]."""
    _, x1, x2, x3 = arc.x
    _, y1, y2, y3 = arc.y
    return x1 + u * (2.0 * x2 + 3.0 * u * x3), y1 + u * (2.0 * y2 + 3.0 * u * y3)


@in_kernel
def bend_on(arc: Arc, u: float) -> tuple[float, float]:
    """Return the second derivative p'' [1/m] at a parameter u [m]."""
    _, _, x2, x3 = arc.x
    _, _, y2, y3 = arc.y
    return 2.0 * x2 + 6.0 * u * x3, 2.0 * y2 + 6.0 * u * y3


@in_kernel
def common_normal(arc: Arc, u: float, distance: float, normal: tuple[float, float]) -> Closest:
    """Return the common normal at a parameter u [m] with its signed distance [m] and unit normal."""
    (x, y), (normal_x, normal_y) = place_on(arc, u), normal
    return Closest(
        depth=-distance, extent=-(x * normal_x + y * normal_y), turning=normal_x * y - normal_y * x, normal_x=normal_x,
        normal_y=normal_y,
    )  # fmt: skip


class ArcDistance(NamedTuple):
    """Signed distance [m] of an arc above a surface as a function of u, as a `Problem`.

    By the envelope theorem its slope is p'·n. The normal n turns with the curvature k of the line of equal distance, so
    the second derivative is p''·n - k (p'·t)².
    """

    arc: Arc
    tibia: TibialSurface
    x: float
    """x of the femur's reference point [m]"""
    height: float
    """Height of the femur's reference point [m]"""

    def sample(self, place: float) -> Sample:
        """Evaluate distance, slope and second derivative at a parameter [m]; `normal` is that of the surface."""
        x, y = place_on(self.arc, place)
        distance, n_x, n_y, curvature = self.tibia.foot(self.x + x, self.height + y)
        (x_slope, y_slope), (x_bend, y_bend) = slope_on(self.arc, place), bend_on(self.arc, place)
        along, room = x_slope * n_y - y_slope * n_x, 1.0 - curvature * distance
        turning = curvature / room * along * along if room > 0.0 else 0.0
        slope, bend = x_slope * n_x + y_slope * n_y, x_bend * n_x + y_bend * n_y
        return Sample(place=place, value=distance, slope=slope, bend=bend - turning, normal=(n_x, n_y))

    def bends(self, a: Sample, b: Sample) -> tuple[float, float]:
        """Return bounds of the second derivative [1/m] between two samples."""
        arc = self.arc
        way = arc.speed * (b.place - a.place)
        middle = 0.5 * (a.value + b.value)
        convex, concave = level_curvatures(self.tibia.curvatures(), middle - 0.5 * way, middle + 0.5 * way)
        first, last = bend_along(arc, a.place, a.normal), bend_along(arc, b.place, a.normal)
        turned = arc.bend * min(max(-convex, concave) * way, 2.0)  # n turns by no more than curvature times way
        squared = arc.speed * arc.speed
        low = max(min(first, last) - turned, -arc.bend) - concave * squared
        return low, min(max(first, last) + turned, arc.bend) - convex * squared


@in_kernel
def bend_along(arc: Arc, u: float, direction: tuple[float, float]) -> float:
    """Return the component of the second derivative p'' [1/m] in a direction."""
    x_bend, y_bend = bend_on(arc, u)
    return x_bend * direction[0] + y_bend * direction[1]
