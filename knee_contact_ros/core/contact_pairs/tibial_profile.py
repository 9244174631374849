"""A measured tibial plateau: a cubic spline y(x) through its points, continued straight at both ends."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from knee_contact_ros.core.arrays import Floats
from knee_contact_ros.core.contact_pairs.least import NOTHING, Sample, least
from knee_contact_ros.core.contact_pairs.tibial_surface import DEEPEST_PART, LAST_STEP, MOST_STEPS, Foot
from knee_contact_ros.core.contact_pairs.touching_balls import PARTS, Pieces, least_roundness
from knee_contact_ros.core.kernel_source import in_kernel, never_inlined

RESOLUTION = 1e-9
"""Difference [m] below which two nearest places count as one, if the bounds cannot separate them"""
GROWTH = 1.25
"""Ratio of the lengths of two neighbouring parts beyond the measured points"""
FAR = 10.0
"""Distance [m] to which these parts go; a circle through a point beyond has no more curvature than 2/FAR"""
LARGEST_PART = 1.0 - 1e-9
"""Largest distance over the radius of a ball for a proof, so that rounding does not matter"""
OUTLINE_POINTS = 201
"""Number of points of an outline, besides the measured ones"""


class _TibialProfile(NamedTuple):
    """Fields of a `TibialProfile`."""

    pieces: Floats
    """Shape (points + 1, 7): base x, c0 to c3 of y = c0 + u (c1 + u (c2 + u c3)) with u = x - base [m], y'' there,
    and a ball.

    The first two have the first point as their base, the others the following ones; the outer two are straight. The
    sixth column is the spline's y'' [1/m], also at the end points; it is linear between two points. A ball of the last
    column's curvature [1/m] that touches from above in the piece lies above all of the surface (`touching_balls`).
    """
    steepest: float
    """Upper bound of the absolute slope"""
    least_bend: float
    """Smallest y'' [1/m], <= 0"""
    largest_bend: float
    """Largest y'' [1/m], >= 0"""
    convex: float
    """Lower bound of the curvature [1/m], <= 0"""
    concave: float
    """Upper bound of the curvature [1/m], >= 0"""


class TibialProfile(_TibialProfile):
    """A plateau through points of the tibia frame, concave or convex anywhere; x anterior, y superior."""

    __slots__ = ()

    def __new__(cls, x: Sequence[float] | Floats, y: Sequence[float] | Floats) -> TibialProfile:
        """Fit a C2 cubic spline y(x) through all points `x`, `y` [m], ordered from posterior to anterior or back.

        A point that repeats the one before it counts once.

        Raises:
            ValueError: fewer than 4 different points, a number that is not finite, or points that turn back in x.
        """
        nodes, heights = _usable(np.asarray(x, float), np.asarray(y, float))
        from scipy.interpolate import CubicSpline  # 0.9 s to import, which a circle need not pay

        inner = CubicSpline(nodes, heights).c[::-1]  # ascending powers; shape (4, segments)
        widths = np.diff(nodes)
        end_slope = inner[1, -1] + widths[-1] * (2.0 * inner[2, -1] + 3.0 * widths[-1] * inner[3, -1])
        bends = np.append(2.0 * inner[2], 2.0 * inner[2, -1] + 6.0 * inner[3, -1] * widths[-1])
        before = [nodes[0], heights[0], inner[1, 0], 0.0, 0.0, bends[0]]
        behind = [nodes[-1], heights[-1], end_slope, 0.0, 0.0, bends[-1]]
        pieces = np.stack([before, *np.column_stack([nodes[:-1], inner.T, bends[:-1]]), behind])
        return super().__new__(cls, np.column_stack([pieces, _balls(pieces)]), *_bounds(inner, widths))

    def foot(self, x: float, y: float) -> Foot:
        """The nearest point of the surface to (x, y) [m], by Newton's method if a ball proves it, else by a search."""
        place = _foot_by_newton(self.pieces, self.convex, x, y)
        if math.isnan(place):
            problem = SquaredDistance(
                pieces=self.pieces, steepest=self.steepest, least_bend=self.least_bend, largest_bend=self.largest_bend,
                x=x, y=y,
            )  # fmt: skip
            place = _foot_by_search(problem)
        height, slope, bend = spline_at(self.pieces, place)
        norm = math.sqrt(1.0 + slope * slope)
        return Foot(((y - height) - slope * (x - place)) / norm, -slope / norm, 1.0 / norm, bend / (norm * norm * norm))

    def bounds(self, x: float, y: float) -> tuple[float, float]:
        """Bounds of the signed distance [m] of (x, y) [m], which are close if one Newton step ends near the foot.

        Balls that touch the surface there, with the radius of the largest curvature on either side, do not cross the
        surface. So the distances of their centres are known, and that of the point differs by its distance from them.
        """
        height, slope, bend = spline_at(self.pieces, x)
        above = y - height
        place = x + above * slope / max(1.0 + slope * slope - above * bend, 0.5)
        height, slope, _ = spline_at(self.pieces, place)
        squared_norm = 1.0 + slope * slope
        norm = math.sqrt(squared_norm)
        dx, dy = x - place, y - height
        along, across = (dx + slope * dy) / norm, (dy - slope * dx) / norm
        lower, upper = _from_ball(self.concave, along, across), _from_ball(self.convex, along, across)
        return max(lower, above * self.least_normal_y()) if above > 0.0 else lower, upper

    def graph(self, x: float) -> tuple[float, float, float]:
        """Return height [m], slope and second derivative [1/m] at x [m]."""
        return spline_at(self.pieces, x)

    def cup(self, x: float) -> float:
        """Return the curvature [1/m] of a ball that touches from above at x [m] and lies above all of the surface."""
        return float(self.pieces[_piece_at(self.pieces, x), 6])

    def curvatures(self) -> tuple[float, float]:
        """Return bounds of the curvature [1/m]."""
        return self.convex, self.concave

    def least_normal_y(self) -> float:
        """Return y of the unit normal at the steepest place."""
        return 1.0 / math.sqrt(1.0 + self.steepest * self.steepest)

    def outline(self, reach: float) -> Floats:
        """Return points along the measured surface, shape (n, 2) [m], to `reach` [m] on both sides at most."""
        first, last = _ends(self.pieces)
        low, high = max(-reach, first), min(reach, last)
        x = np.unique(np.concatenate([np.linspace(low, high, OUTLINE_POINTS), self.pieces[:, 0]]))
        x = x[np.abs(x) <= reach]
        return np.array([(place, spline_at(self.pieces, place)[0]) for place in x.tolist()])


class SquaredDistance(NamedTuple):
    """Half the squared distance [m²] from a point as a function of x along a plateau, as a `Problem`."""

    pieces: Floats
    """This field and the three that follow are those of `TibialProfile`."""
    steepest: float
    least_bend: float
    largest_bend: float
    x: float
    """x of the point [m]"""
    y: float
    """y of the point [m]"""

    def sample(self, place: float) -> Sample:
        """Evaluate the function and its derivatives at a place [m]; `normal` has height [m] and y'' [1/m] there."""
        height, slope, bend = spline_at(self.pieces, place)
        dx, dy = place - self.x, height - self.y
        value = 0.5 * (dx * dx + dy * dy)
        return Sample(
            place=place, value=value, slope=dx + dy * slope, bend=1.0 + slope * slope + dy * bend,
            normal=(height, bend),
        )  # fmt: skip

    def bends(self, a: Sample, b: Sample) -> tuple[float, float]:
        """Return bounds of the second derivative between two samples."""
        middle = 0.5 * (a.normal[0] + b.normal[0]) - self.y
        room = 0.5 * self.steepest * (b.place - a.place)
        low, high = _products(middle - room, middle + room, self.least_bend, self.largest_bend)
        if low < -1.0:  # the whole plateau's bends do not tell that there is one dip
            low, high = _products(middle - room, middle + room, *_bends_between(self.pieces, a, b))
        return 1.0 + low, 1.0 + self.steepest * self.steepest + high


@never_inlined
def _foot_by_newton(pieces: Floats, convex: float, x: float, y: float) -> float:
    """Return the place [m] of the nearest point to (x, y) [m] by Newton's method; NaN where that is not proven.

    A point above is nearest to where a ball around it touches, if the ball that touches there from above and lies above
    all of the surface is larger; a point below if the surface bends away from it by less than a ball around it.
    """
    place = x
    for _ in range(MOST_STEPS):
        height, slope, bend = spline_at(pieces, place)
        dy = height - y
        rise = 1.0 + slope * slope + dy * bend
        if not rise > 0.0:
            break
        step = (x - place - dy * slope) / rise
        place += step
        if abs(step) < LAST_STEP:
            i = _piece_at(pieces, place)
            height, slope, _ = spline_at(pieces, place)
            distance = ((y - height) - slope * (x - place)) / math.sqrt(1.0 + slope * slope)
            inside = distance * pieces[i, 6] < LARGEST_PART if distance > 0.0 else convex * distance < DEEPEST_PART
            return place if inside and 0 < i < len(pieces) - 1 else math.nan
    return math.nan


@never_inlined
def _foot_by_search(problem: SquaredDistance) -> float:
    """Return the place [m] of the nearest point, which is no further to the side than the distance along y."""
    x, y = problem.x, problem.y
    reach = abs(y - spline_at(problem.pieces, x)[0])
    first, last = _ends(problem.pieces)
    best = _nearest(problem, max(first, x - reach), min(last, x + reach), reach, NOTHING)
    best = _nearest(problem, x - reach, min(first, x + reach), reach, best)
    best = _nearest(problem, max(last, x - reach), x + reach, reach, best)
    return best.place if best.value < math.inf else x


@in_kernel
def _nearest(problem: SquaredDistance, begin: float, end: float, reach: float, best: Sample) -> Sample:
    """Return the nearest place from `begin` to `end` [m], or `best` if none is nearer or they are in reverse order."""
    return least(problem, begin, end, best, RESOLUTION * reach) if begin <= end else best


@in_kernel
def spline_at(pieces: Floats, x: float) -> tuple[float, float, float]:
    """Return height [m], slope and second derivative [1/m] at x [m]."""
    i = _piece_at(pieces, x)
    c0, c1, c2, c3 = float(pieces[i, 1]), float(pieces[i, 2]), float(pieces[i, 3]), float(pieces[i, 4])
    u = x - float(pieces[i, 0])
    return c0 + u * (c1 + u * (c2 + u * c3)), c1 + u * (2.0 * c2 + u * 3.0 * c3), 2.0 * c2 + 6.0 * c3 * u


@in_kernel
def _piece_at(pieces: Floats, x: float) -> int:
    """Return the index of the piece at a place [m]."""
    first, last = _ends(pieces)
    if not x >= first:
        return 0
    end = len(pieces) - 1
    if x >= last:
        return end
    i = min(1 + int((x - first) / (last - first) * (end - 1)), end - 1)  # as if they were equally long
    while x < pieces[i, 0]:
        i -= 1
    while x >= pieces[i + 1, 0]:
        i += 1
    return i


@in_kernel
def _ends(pieces: Floats) -> tuple[float, float]:
    """Return the smallest and the largest measured x [m]."""
    return float(pieces[0, 0]), float(pieces[len(pieces) - 1, 0])


@in_kernel
def _from_ball(curvature: float, along: float, across: float) -> float:
    """The signed distance [m] from a circle of a point `along` its tangent and `across` it [m] from the touch."""
    squared = along * along + across * across
    x, y = curvature * along, 1.0 - curvature * across  # from the centre, in radii
    return (2.0 * across - curvature * squared) / (1.0 + math.sqrt(x * x + y * y))


@in_kernel
def _products(a: float, b: float, c: float, d: float) -> tuple[float, float]:
    """Return the smallest and the largest product of a number from a to b with one from c to d."""
    return min(a * c, a * d, b * c, b * d), max(a * c, a * d, b * c, b * d)


@in_kernel
def _bends_between(pieces: Floats, a: Sample, b: Sample) -> tuple[float, float]:
    """Return the range of the second derivative [1/m] between two samples with no end of the profile in between."""
    first, last = _ends(pieces)
    if b.place <= first or a.place >= last:
        return 0.0, 0.0
    low, high = min(a.normal[1], b.normal[1]), max(a.normal[1], b.normal[1])
    for i in range(_piece_at(pieces, a.place) + 1, _piece_at(pieces, b.place) + 1):
        bend = float(pieces[i, 5])
        if bend < low:
            low = bend
        elif bend > high:
            high = bend
    return low, high


def _bounds(inner: Floats, widths: Floats) -> tuple[float, float, float, float, float]:
    """Bounds of slope, second derivative and curvature as in `TibialProfile`; `inner` has shape (4, segments)."""
    _, c1, c2, c3 = inner
    slopes = np.abs([c1, c1 + c2 * widths, c1 + widths * (2.0 * c2 + 3.0 * c3 * widths)])  # Bezier control points
    bends = np.stack([2.0 * c2, 2.0 * c2 + 6.0 * c3 * widths])
    flattest = np.maximum(slopes[0] - np.abs(bends).max(axis=0) * widths, 0.0)
    curvatures = bends / (1.0 + flattest**2) ** 1.5
    return float(slopes.max()), *_range_with_0(bends), *_range_with_0(curvatures)


def _balls(pieces: Floats) -> Floats:
    """The last column of `TibialProfile.pieces` from the others, by `least_roundness` of the reversed surface."""
    nodes = pieces[1:, 0]
    inner = nodes[:-1, None] + np.diff(nodes)[:, None] * np.arange(PARTS) / PARTS
    shortest = float(np.diff(nodes).min()) / PARTS
    outward = np.cumsum(shortest * GROWTH ** np.arange(1 + math.ceil(math.log(FAR / shortest, GROWTH))))
    edges = np.concatenate([nodes[0] - outward[::-1], inner.ravel(), nodes[-1:], nodes[-1] + outward])
    x, half = 0.5 * (edges[1:] + edges[:-1]), 0.5 * np.diff(edges)
    base, c0, c1, c2, c3 = pieces[np.searchsorted(nodes, x, side="right"), :5].T
    u = x - base
    slope, bend, change = c1 + u * (2.0 * c2 + 3.0 * u * c3), 2.0 * c2 + 6.0 * u * c3, 6.0 * half * np.abs(c3)
    turn = half * (np.abs(bend) + change)
    norm = np.sqrt(1.0 + slope * slope)
    flattest, steepest = (
        (1.0 + np.maximum(np.abs(slope) - turn, 0.0) ** 2) ** 1.5,
        (1.0 + (np.abs(slope) + turn) ** 2) ** 1.5,
    )
    low, high = -bend - change, change - bend
    bounds = least_roundness(
        Pieces(
            places=np.column_stack([x, -(c0 + u * (c1 + u * (c2 + u * c3)))]),
            tangents=np.column_stack([1.0 / norm, -slope / norm]),
            reach=half * steepest ** (1.0 / 3.0),
            low=low / np.where(low < 0.0, flattest, steepest),
            high=high / np.where(high > 0.0, flattest, steepest),
        )
    )
    measured = bounds[len(outward) : -len(outward)].reshape(-1, PARTS).min(axis=1)
    return np.concatenate([[np.inf], np.maximum(-measured, 2.5 / FAR), [np.inf]])


def _range_with_0(values: Floats) -> tuple[float, float]:
    """Return the smallest and the largest of the values and 0."""
    return min(0.0, float(values.min())), max(0.0, float(values.max()))


def _usable(x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Return the different points in ascending x.

    Raises:
        ValueError: see `TibialProfile`.
    """
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise ValueError("a tibial profile point is not finite")
    repeated = 1 + np.flatnonzero((np.diff(x) == 0.0) & (np.diff(y) == 0.0))
    x, y = np.delete(x, repeated), np.delete(y, repeated)
    if x.size < 4:
        raise ValueError(f"a tibial profile needs at least 4 different points, got {x.size}")
    if x[0] > x[-1]:
        x, y = x[::-1], y[::-1]
    if not (np.diff(x) > 0.0).all():
        raise ValueError("a tibial profile must not turn back in x")
    return np.ascontiguousarray(x), np.ascontiguousarray(y)
