"""A femoral condyle as a cubic spline through measured points, its support function in closed form.

On one spline segment, h is stationary where the tangent is parallel to the plane: a quadratic in the segment's
parameter. The largest value over the segments and their ends is the support of the whole curve, so that a dent between
noisy points is never taken for the contact. The segments that can have the largest value are tabulated once over the
angle, and so is the support itself where there are no dents.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from knee_contact_ros.core.arrays import Floats, Integers
from knee_contact_ros.core.geometries.kinks import find_kinks, next_kink
from knee_contact_ros.core.geometries.support_table import CELLS, support_table, tabulated
from knee_contact_ros.core.kernel_source import in_kernel, never_inlined


class Curve(NamedTuple):
    """The segments of a profile, and the candidates for the lowest point at each angle."""

    cubics: Floats
    """Shape (n, 10): a segment x(u) = x0 + u (x1 + u (x2 + u x3)), y(u) likewise, in each row.

    The columns are the length of the parameter u [m], the place of the segment on the curve as a sum of chords [m], x0
    to x3 and y0 to y3.
    """
    first: Integers
    """Shape (CELLS + 1,): indices at which the cells' parts of `candidates` begin; each ends where the next one
    begins"""
    candidates: Integers
    """Indices of segments that may have the lowest point, cell by cell"""


class _Profile(NamedTuple):
    """Fields of a `Profile`."""

    curve: Curve
    table: Floats
    """Polynomials of the support; see `support_table`"""
    kinks: Floats
    """Angles in [0, 2π) [rad], increasing, at which dh/dangle jumps"""
    turn_between_points: float
    """Mean change of direction [rad] between two points"""
    largest_reach: float
    """Upper bound of the distance of the curve from the reference point [m]"""


class Profile(_Profile):
    """An open curve through points of the femur frame: x anterior, y superior, origin at the reference point."""

    __slots__ = ()

    def __new__(cls, x: Sequence[float] | Floats, y: Sequence[float] | Floats) -> Profile:
        """Fit a C2 cubic spline over the chord length through all points `x`, `y` [m], ordered along the curve.

        A point that repeats the one before it counts once.

        Raises:
            ValueError: fewer than 4 different points, or a number that is not finite.
        """
        points = _usable(np.stack([np.asarray(x, float), np.asarray(y, float)]))
        cubics = _fitted(points)
        curve = Curve(cubics, *_candidates(cubics))
        kinks = find_kinks(cubics, lambda angle: lowest_point(curve, angle))
        directions = np.unwrap(np.arctan2(*np.diff(points)[::-1]))
        table = support_table(cubics, curve.first, curve.candidates)
        turn, reach = float(np.abs(np.diff(directions)).mean()), float(np.hypot(*_control_points(cubics)).max())
        return super().__new__(cls, curve, table, np.array(kinks), turn, reach)

    def support(self, angle: float) -> tuple[float, float]:
        """Return h [m] and dh/dangle [m/rad] at an angle [rad], positive in flexion."""
        depth, slope = tabulated(self.table, angle)
        return (depth, slope) if not math.isnan(depth) else _support(self.curve, angle)

    def next_kink(self, start: float, end: float) -> float:
        """Return the first kink [rad] strictly between two angles [rad]; see `Support.next_kink`."""
        return next_kink(self.kinks, start, end)

    def knot_spacing(self) -> float:
        """Return the mean change of direction [rad] between two points of the spline."""
        return self.turn_between_points

    def largest_radius(self) -> float:
        """Return an upper bound of the distance of the curve from the reference point [m]."""
        return self.largest_reach

    def lowest(self, angle: float) -> tuple[float, float, float, float]:
        """Depth h, x and y in the femur frame, and place on the curve of the lowest point at an angle [rad]; [m]."""
        return lowest_point(self.curve, angle)

    def outline(self, points_per_segment: int = 4) -> Floats:
        """Return points along the curve, shape (n, 2) [m] in the femur frame, for drawing."""
        part = np.linspace(0.0, 1.0, points_per_segment, endpoint=False)
        length, _, *coefficients = self.curve.cubics.T[:, :, None]
        u = part * length
        axes = [c0 + u * (c1 + u * (c2 + u * c3)) for c0, c1, c2, c3 in (coefficients[:4], coefficients[4:])]
        return np.stack([axis.ravel() for axis in axes], axis=1)


def _control_points(cubics: Floats) -> Floats:
    """Return the Bézier points x and y [m] of every segment, which lies in their hull; shape (2, 4, segments)."""
    length, _, *coefficients = cubics.T
    return np.array([
        [c0, c0 + c1 * length / 3.0, c0 + length * (2.0 * c1 + c2 * length) / 3.0,
         c0 + length * (c1 + length * (c2 + length * c3))]
        for c0, c1, c2, c3 in (coefficients[:4], coefficients[4:])
    ])  # fmt: skip


@never_inlined
def _support(curve: Curve, angle: float) -> tuple[float, float]:
    """Return support h [m] and dh/dangle [m/rad] in closed form."""
    depth, x, y, _ = lowest_point(curve, angle)
    return depth, math.sin(angle) * y - math.cos(angle) * x


@never_inlined
def lowest_point(curve: Curve, angle: float) -> tuple[float, float, float, float]:
    """Return depth h, x and y in the femur frame, and place on the curve of the lowest point at an angle [rad]; [m]."""
    sine, cosine = math.sin(angle), math.cos(angle)
    cell = int(angle % math.tau * (CELLS / math.tau)) % CELLS
    first, end = int(curve.first[cell]), int(curve.first[cell + 1])
    best = _lowest(curve.cubics, int(curve.candidates[first]), sine, cosine)
    for i in range(first + 1, end):
        found = _lowest(curve.cubics, int(curve.candidates[i]), sine, cosine)
        if found > best:  # noqa: PLR1730 - the kernel has no max() of tuples; of equal depths the larger x wins
            best = found
    return best


@in_kernel
def _lowest(cubics: Floats, i: int, sine: float, cosine: float) -> tuple[float, float, float, float]:
    """Return depth, x, y and place on the curve [m] of the lowest point of one segment."""
    length, start = float(cubics[i, 0]), float(cubics[i, 1])
    x0, x1, x2, x3 = float(cubics[i, 2]), float(cubics[i, 3]), float(cubics[i, 4]), float(cubics[i, 5])
    y0, y1, y2, y3 = float(cubics[i, 6]), float(cubics[i, 7]), float(cubics[i, 8]), float(cubics[i, 9])
    c0, c1 = -(sine * x0 + cosine * y0), -(sine * x1 + cosine * y1)
    c2, c3 = -(sine * x2 + cosine * y2), -(sine * x3 + cosine * y3)
    best, where = c0, 0.0
    one, other = _stationary(c1, 2.0 * c2, 3.0 * c3)
    for u in (length, one, other):
        if 0.0 < u <= length:
            depth = c0 + u * (c1 + u * (c2 + u * c3))
            if depth > best:
                best, where = depth, u
    x = x0 + where * (x1 + where * (x2 + where * x3))
    y = y0 + where * (y1 + where * (y2 + where * y3))
    return best, x, y, start + where


@in_kernel
def _stationary(constant: float, linear: float, square: float) -> tuple[float, float]:
    """Return the real roots of constant + linear u + square u² = 0, without cancellation; NaN for a missing one."""
    discriminant = linear * linear - 4.0 * square * constant
    if discriminant < 0.0:
        return math.nan, math.nan
    q = -0.5 * (linear + math.copysign(math.sqrt(discriminant), linear))
    return constant / q if q != 0.0 else math.nan, q / square if square != 0.0 else math.nan


def _usable(points: Floats) -> Floats:
    """Return the different ones of points of shape (2, n).

    Raises:
        ValueError: see `Profile`.
    """
    if not np.isfinite(points).all():
        raise ValueError("a profile point is not finite")
    repeated = np.all(points[:, 1:] == points[:, :-1], axis=0)
    points = np.delete(points, np.flatnonzero(repeated), axis=1)
    if points.shape[1] < 4:
        raise ValueError(f"a profile needs at least 4 different points, got {points.shape[1]}")
    return points


def _fitted(points: Floats) -> Floats:
    """Return the segments through points of shape (2, n + 1), as in `Curve.cubics`."""
    from scipy.interpolate import CubicSpline  # 0.9 s to import, which a circle need not pay

    chords = np.hypot(*np.diff(points))
    spline = CubicSpline(np.concatenate([[0.0], np.cumsum(chords)]), points, axis=1)
    coefficients = spline.c[::-1]  # ascending powers; shape (4, segments, 2)
    rows = np.column_stack([chords, spline.x[:-1], coefficients[:, :, 0].T, coefficients[:, :, 1].T])
    return np.ascontiguousarray(rows)


def _candidates(cubics: Floats) -> tuple[Integers, Integers]:
    """Return `Curve.first` and `Curve.candidates`: the segments that may have the lowest point in each cell of angles.

    Between the middle of a cell and its ends, the support of one segment gains on that of another at most half the
    width times the distance between them (h' = -x). A segment that is further behind in the middle cannot be the
    lowest.
    """
    half_width = math.pi / CELLS
    angles = (2.0 * np.arange(CELLS, dtype=np.float64) + 1.0) * half_width
    depths = _depths(cubics, angles)
    best = np.argmax(depths, axis=1)
    centres, radii = _bounding_circles(cubics)
    distances = np.hypot(*np.moveaxis(centres[:, None] - centres[None, :], 2, 0)) + radii[:, None] + radii[None, :]
    behind = depths[np.arange(CELLS), best][:, None] - depths
    cells, segments = np.nonzero(behind <= half_width * distances[best])
    return np.searchsorted(cells, np.arange(CELLS + 1)).astype(np.int64), segments.astype(np.int64)


def _depths(cubics: Floats, angles: Floats) -> Floats:
    """Return the support of every segment [m] at angles [rad], shape (angles, segments)."""
    length, x, y = cubics[:, 0], cubics[:, 2:6].T[:, None, :], cubics[:, 6:].T[:, None, :]
    c0, c1, c2, c3 = -(np.sin(angles)[:, None] * x + np.cos(angles)[:, None] * y)
    with np.errstate(divide="ignore", invalid="ignore"):
        root = np.sqrt(4.0 * c2 * c2 - 12.0 * c3 * c1)
        q = -(c2 + np.copysign(0.5 * root, c2))
        roots = (c1 / q, q / (3.0 * c3))
    ends = (np.zeros_like(c0), np.broadcast_to(length, c0.shape))
    inside = [np.clip(np.nan_to_num(u, nan=0.0), 0.0, length) for u in (*ends, *roots)]
    return np.asarray(np.max([c0 + u * (c1 + u * (c2 + u * c3)) for u in inside], axis=0))


def _bounding_circles(cubics: Floats) -> tuple[Floats, Floats]:
    """Return centres (segments, 2) and radii (segments,) [m] of circles around the segments' Bézier points."""
    points = np.ascontiguousarray(np.moveaxis(_control_points(cubics), 2, 0))
    centres = points.mean(axis=2)
    return centres, np.asarray(np.hypot(*np.moveaxis(points - centres[:, :, None], 1, 0)).max(axis=1))
