"""Femoral surfaces, and their support functions, by which they touch a plane.

With the femur rotated by an angle θ, the lowest point of its surface lies h(θ) below the reference point,
h(θ) = max over the curve of -(sin θ pₓ + cos θ p_y), and h'(θ) = -x of that point relative to the reference point. So
depth and rate on a plane are exact without a search. While the lowest point glides inside one segment of a spline, a
tabulated polynomial of the angle gives h. Elsewhere h is the best of a few segments in closed form, so that a dent
between noisy points is never mistaken for the contact.
"""

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .compiler import in_kernel, inlined
from .splines import cosines, pieces_through, sines
from .types import Floats, Integers

CELLS = 2048
"""Number of cells of the full turn, each with a polynomial of h"""
DEGREE = 6
"""Degree of these polynomials"""
SHRUNK = 0.5
"""Fraction of a circle's radius that its spline has; see `Circle.cubics`"""
CELL_WIDTH = math.tau / CELLS
_CELLS_PER_RADIAN = CELLS / math.tau
_CLOSE = 1e-16
"""Largest error of h' [m] of a polynomial: the rounding error of 1 m"""
_ARC_POINTS = 501
"""Number of points of a circle's spline, which makes it 1e-12 m close"""
_MIN_LEAP = 1e-6
"""Smallest length [m] of a leap of the lowest point"""
_KINK_RESOLUTION = 1e-13
"""Error [rad] of the angle of a leap"""
CELL_NODES: Floats = 0.5 * cosines((np.arange(DEGREE) + 0.5) * math.pi / DEGREE)
"""Places in a cell of width 1 where h' is interpolated: Chebyshev's, which make the largest error small"""
CELL_CHECKS: Floats = np.linspace(-0.5, 0.5, 2 * DEGREE + 1)
"""Places in a cell of width 1 where the result is checked"""


class KernelTable(NamedTuple):
    """A support function, tabulated for the kernel."""

    cells: Floats
    """Shape (cells, DEGREE + 1): coefficients of h [m] in the place t in a cell, from -1/2 to 1/2; equal cells of the
    full turn; NaN first where the closed form holds"""
    begins: Integers
    """Shape (cells + 1,): where the cells' parts of `starts` begin"""
    starts: Floats
    """Shape (n, 1): segments that may have the lowest point, cell by cell"""
    cubics: Floats
    """As in `Profile`"""
    kinks: Floats
    """Angles in [0, 2π) [rad], increasing, at which h' jumps"""


NOTHING = np.full((1, 1), math.nan)
"""Array of numbers of the kernel that is not used"""
NO_TABLE = KernelTable(NOTHING, np.zeros(1, np.int64), NOTHING, NOTHING, NOTHING[0, :0])
"""Table of a surface that needs none"""


@in_kernel
def lowest_point(
    begins: Integers, starts: Floats, cubics: Floats, angle: float
) -> tuple[float, float, float]:
    """Return support h [m], dh/dangle [m/rad], and the lowest point's place on the curve [m], in closed form.

    On a segment, h is stationary where the tangent is parallel to the plane: a quadratic.
    """
    sine = math.sin(angle)
    cosine = math.cos(angle)
    cells = len(begins) - 1
    cell = int(angle % math.tau * (cells / math.tau)) % cells
    best, slope, place = -math.inf, 0.0, 0.0
    for k in range(int(begins[cell]), int(begins[cell + 1])):
        i = int(starts[k, 0])
        length = float(cubics[i, 0])
        x0, x1 = float(cubics[i, 2]), float(cubics[i, 3])
        x2, x3 = float(cubics[i, 4]), float(cubics[i, 5])
        y0, y1 = float(cubics[i, 6]), float(cubics[i, 7])
        y2, y3 = float(cubics[i, 8]), float(cubics[i, 9])
        # The depth of the segment's points below the reference point is c0 + u (c1 + u (c2 + u c3)).
        c0 = -(sine * x0 + cosine * y0)
        c1 = -(sine * x1 + cosine * y1)
        c2 = -(sine * x2 + cosine * y2)
        c3 = -(sine * x3 + cosine * y3)
        discriminant = c2 * c2 - 3.0 * c3 * c1
        q = -(c2 + math.copysign(math.sqrt(max(discriminant, 0.0)), c2))
        one = c1 / q if q != 0.0 else 0.0
        other = q / (3.0 * c3) if c3 != 0.0 else 0.0
        for u in (0.0, length, one, other):
            h = c0 + u * (c1 + u * (c2 + u * c3))
            if 0.0 <= u <= length and h > best:
                x = x0 + u * (x1 + u * (x2 + u * x3))
                y = y0 + u * (y1 + u * (y2 + u * y3))
                best = h
                slope = sine * y - cosine * x
                place = float(cubics[i, 1]) + u
    return best, slope, place


@inlined
def support_at(
    cells: Floats, begins: Integers, starts: Floats, cubics: Floats, angle: float
) -> tuple[float, float]:
    """Return support h [m] and dh/dangle [m/rad] at an angle [rad], positive in flexion."""
    part = angle * _CELLS_PER_RADIAN
    part -= CELLS * math.floor(part * (1.0 / CELLS))
    i = min(int(part), CELLS - 1)
    t = part - i - 0.5
    c0, c1, c2, c3 = float(cells[i, 0]), float(cells[i, 1]), float(cells[i, 2]), float(cells[i, 3])
    if math.isnan(c0):
        h, slope, _ = lowest_point(begins, starts, cubics, angle)
        return h, slope
    c4, c5, c6 = float(cells[i, 4]), float(cells[i, 5]), float(cells[i, 6])
    h = c0 + t * (c1 + t * (c2 + t * (c3 + t * (c4 + t * (c5 + t * c6)))))
    slope = c1 + t * (2.0 * c2 + t * (3.0 * c3 + t * (4.0 * c4 + t * (5.0 * c5 + t * (6.0 * c6)))))
    return h, slope * _CELLS_PER_RADIAN


@in_kernel
def has_knot(cells: Floats, angle: float) -> bool:
    """Whether the lowest point may be no longer in one segment near an angle [rad]."""
    part = angle * _CELLS_PER_RADIAN
    return math.isnan(
        cells[min(int(part - CELLS * math.floor(part * (1.0 / CELLS))), CELLS - 1), 0]
    )


@dataclass(frozen=True)
class Circle:
    """A circle about the reference point (the paper's sphere, 34 mm): its depth does not depend on the angle."""

    radius: float
    """Radius of the circle [m]"""
    knot_spacing = math.inf
    """Mean turn [rad] between two points where the surface is not smooth; infinite if it is"""

    def __str__(self) -> str:
        return "circle"

    @property
    def largest_radius(self) -> float:
        """Upper bound of the distance [m] of the surface's points from the reference point."""
        return self.radius

    def outline(self) -> Floats:
        """Return points around the circle, shape (n, 2) [m], for drawing."""
        angles = np.linspace(0.0, math.tau, 181)
        return self.radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)

    def support(self, _angle: float) -> tuple[float, float]:
        """Return h [m] and dh/dangle = 0 [m/rad], which do not depend on the angle [rad]."""
        return self.radius, 0.0

    @cached_property
    def cubics(self) -> Floats:
        """The lower part of a smaller circle, `SHRUNK`, as a spline that is 1e-12 m close; see `Profile`.

        Its gap is wider by the difference, so surfaces never overlap, where the nearest points would be ambiguous.
        """
        turn = np.linspace(-0.5 * math.pi - 1.4, -0.5 * math.pi + 1.4, _ARC_POINTS)
        radius = SHRUNK * self.radius
        return Profile(radius * cosines(turn), radius * sines(turn)).cubics

    @property
    def on_plane(self) -> KernelTable:
        """The support function for the kernel, which needs the radius alone."""
        return NO_TABLE


@dataclass(frozen=True, eq=False)
class Profile:
    """An open curve through points of the femur frame: x anterior, y superior, origin at the reference point.

    A C2 cubic spline over the chord length goes through all points, in their order; a point that repeats the one before
    it counts once.

    Raises:
        ValueError: fewer than 4 different points, or a number that is not finite.
    """

    x: ArrayLike
    """[m]"""
    y: ArrayLike
    """[m]"""
    cubics: Floats = field(init=False, repr=False)
    """Shape (n, 10): a segment x(u) = x0 + u (x1 + u (x2 + u x3)), y(u) likewise, in each row.

    The columns are the length of the parameter u [m], the place of the segment on the curve as a sum of chords [m], x0
    to x3 and y0 to y3.
    """

    def __post_init__(self) -> None:
        points = distinct_points(self.x, self.y, "profile")
        chords = np.sqrt((np.diff(points) ** 2).sum(axis=0))
        places = np.concatenate([[0.0], np.cumsum(chords)])
        x, y = (pieces_through(places, axis)[1:-1, 1:] for axis in points)
        object.__setattr__(self, "cubics", np.column_stack([chords, places[:-1], x, y]))

    def __str__(self) -> str:
        return "profile"

    @property
    def knot_spacing(self) -> float:
        """Mean change of direction [rad] between two points of the spline; changes to and fro, as in dents, cancel."""
        chords = np.diff(np.column_stack([self.cubics[:, [2, 6]].T, self._hull[:, 3, -1]]))
        directions = np.unwrap([math.atan2(y, x) for x, y in chords.T])
        return abs(float(directions[-1] - directions[0])) / (len(directions) - 1)

    @property
    def largest_radius(self) -> float:
        """Upper bound of the distance [m] of the curve from the reference point."""
        return float(np.sqrt((self._hull**2).sum(axis=0).max()))

    @cached_property
    def _hull(self) -> Floats:
        """Bézier points x and y [m] of every segment, which lies in their hull; shape (2, 4, segments)."""
        length = self.cubics[:, 0]
        c0, c1, c2, c3 = self.cubics[:, 2:].T.reshape(2, 4, -1).swapaxes(0, 1)
        second = c0 + c1 * length / 3.0
        third = c0 + length * (2.0 * c1 + c2 * length) / 3.0
        end = c0 + length * (c1 + length * (c2 + length * c3))
        return np.stack([c0, second, third, end], axis=1)

    def outline(self, points_per_segment: int = 4) -> Floats:
        """Return points along the curve, shape (n, 2) [m] in the femur frame, for drawing."""
        return np.stack(curve_points(self.cubics, points_per_segment), axis=1)[:-1]

    def support(self, angle: float) -> tuple[float, float]:
        """Return h [m] and dh/dangle [m/rad] at an angle [rad], positive in flexion, in closed form."""
        h, slope, _ = lowest_point(*self.on_plane[1:4], angle)
        return h, slope

    @cached_property
    def on_plane(self) -> KernelTable:
        """The support function for the kernel."""
        cells, segments = self._candidates()
        first = np.searchsorted(cells, np.arange(CELLS + 1)).astype(np.int64)
        h, u, _ = self._lowest(segments, cells, CELL_CHECKS)
        # Cells in which the lowest point stays inside one segment have a polynomial.
        is_best = h >= np.maximum.reduceat(h, first[:-1])[cells]
        is_inside = (u > 0.0) & (u < self.cubics[segments, :1])
        alone = np.flatnonzero((is_best & is_inside).all(axis=1))
        alone = alone[np.unique(cells[alone], return_index=True)[1]]
        where, only = cells[alone], segments[alone]
        middle = self._lowest(only, where, np.zeros(1))[0][:, 0]
        at_nodes = self._lowest(only, where, CELL_NODES)[2]
        checked = self._lowest(only, where, CELL_CHECKS)[2]
        found, error = cell_polynomials(middle, at_nodes, checked)
        polynomials = np.full((CELLS, DEGREE + 1), math.nan)
        polynomials[where[error <= _CLOSE]] = found[error <= _CLOSE]
        # The place of the lowest point at both edges of each cell
        order = np.lexsort((-h[:, 0], cells)), np.lexsort((-h[:, -1], cells))
        places = [(self.cubics[segments, 1] + u[:, k])[order[k][first[:-1]]] for k in (0, -1)]
        starts = segments[:, None].astype(np.float64)
        table = KernelTable(polynomials, first, starts, self.cubics, NO_TABLE.kinks)
        return table._replace(kinks=np.array(self._kinks(table, np.stack(places))))

    def _candidates(self) -> tuple[Integers, Integers]:
        """Return cells and the segments that may have the lowest point in them, in the order of cells.

        Between the middle of a cell and its ends, one segment's support can gain on another's at most half the width
        times the distance between them (h' = -x). A segment whose bound is further behind in the middle cannot be the
        lowest.
        """
        half_width = math.pi / CELLS
        hull_x, hull_y = self._hull
        angles = (2.0 * np.arange(CELLS)[:, None] + 1.0) * half_width
        sine, cosine = sines(angles), cosines(angles)
        depths = [-(sine * x + cosine * y) for x, y in zip(hull_x, hull_y, strict=True)]
        ends = np.maximum(depths[0], depths[3])
        upper = np.maximum(ends, np.maximum(depths[1], depths[2]))
        best = ends.argmax(axis=1)
        centre = np.stack([hull_x.mean(axis=0), hull_y.mean(axis=0)])
        radius = np.hypot(*(self._hull - centre[:, None])).max(axis=0)
        distances = np.hypot(*(centre[:, :, None] - centre[:, None, :])) + radius[:, None] + radius
        behind = ends[np.arange(CELLS), best][:, None] - upper
        cells, segments = np.nonzero(behind <= half_width * distances[best])
        return cells.astype(np.int64), segments.astype(np.int64)

    def _lowest(
        self, segments: Integers, cells: Integers, t: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Return h [m], the parameter u [m] and h' [m/rad] of segments at places t of cells; shape (segments, t)."""
        length, _, x0, x1, x2, x3, y0, y1, y2, y3 = self.cubics[segments].T[:, :, None]
        angle = (cells[:, None] + 0.5 + t) * (math.tau / CELLS)
        sine, cosine = sines(angle), cosines(angle)
        c0 = -(sine * x0 + cosine * y0)
        c1 = -(sine * x1 + cosine * y1)
        c2 = -(sine * x2 + cosine * y2)
        c3 = -(sine * x3 + cosine * y3)
        with np.errstate(divide="ignore", invalid="ignore"):
            q = -(c2 + np.copysign(np.sqrt(c2 * c2 - 3.0 * c3 * c1), c2))
            roots = [
                np.clip(np.nan_to_num(root, nan=0.0), 0.0, length)
                for root in (c1 / q, q / (3.0 * c3))
            ]
        places = np.stack([0.0 * angle, length + 0.0 * angle, *roots])
        depths = c0 + places * (c1 + places * (c2 + places * c3))
        best = depths.argmax(axis=0)[None]
        h = np.take_along_axis(depths, best, 0)[0]
        u = np.take_along_axis(places, best, 0)[0]
        x = x0 + u * (x1 + u * (x2 + u * x3))
        y = y0 + u * (y1 + u * (y2 + u * y3))
        return h, u, sine * y - cosine * x

    def _kinks(self, table: KernelTable, edges: Floats) -> list[float]:
        """Return the angles [rad] of `KernelTable.kinks`; `edges` has the places [m] at both edges of each cell.

        While the lowest point glides, the curve bends to the same side all along. If it does not between the lowest
        points of two angles, bisection checks whether the lowest point leaps.
        """
        found: list[float] = []

        def search(a: float, b: float, from_place: float, to_place: float) -> None:
            middle = 0.5 * (a + b)
            if abs(to_place - from_place) <= _MIN_LEAP or self._bends_on(from_place, to_place):
                return
            if b - a <= _KINK_RESOLUTION or not a < middle < b:
                # Level pieces rock to and fro by rounding: that is one kink.
                if not found or middle - found[-1] > 10.0 * _KINK_RESOLUTION:
                    found.append(middle)
                return
            between = lowest_point(*table[1:4], middle)[2]
            search(a, middle, from_place, between)
            search(middle, b, between, to_place)

        width = math.tau / CELLS
        for cell in range(CELLS):
            a = cell * width
            left, right = float(edges[0, cell]), float(edges[1, cell])
            search(a, a, float(edges[1, cell - 1]), left)
            if math.isnan(table.cells[cell, 0]):
                search(a, (cell + 1) * width, left, right)
        return [kink for kink in found if kink < math.tau]

    def _bends_on(self, a: float, b: float) -> bool:
        """Whether the lowest point can glide from place a to place b [m] as the angle grows."""
        sign = -1.0 if b > a else 1.0  # the direction that is down turns clockwise
        low, high = sorted((a, b))
        starts = self.cubics[:, 1]
        i, end = np.searchsorted(starts, (low, high), side="right")
        length, start, _, x1, x2, x3, _, y1, y2, y3 = self.cubics[max(int(i) - 2, 0) : int(end)].T
        # The bend p' x p'' along u is a parabola, least at an end or at its extreme.
        bend = (
            2.0 * (x1 * y2 - y1 * x2),
            6.0 * (x1 * y3 - y1 * x3),
            6.0 * (x2 * y3 - y2 * x3),
        )
        begin, until = np.maximum(low - start, 0.0), np.minimum(high - start, length)
        with np.errstate(divide="ignore", invalid="ignore"):
            extreme = np.clip(np.nan_to_num(-0.5 * bend[1] / bend[2], nan=0.0), begin, until)
        least = np.min(
            [sign * (bend[0] + u * (bend[1] + u * bend[2])) for u in (begin, until, extreme)],
            axis=0,
        )
        return bool((least[begin < until] > 0.0).all())


def distinct_points(x: ArrayLike, y: ArrayLike, name: str) -> Floats:
    """Return points of a measured curve, shape (2, n) [m], without those that repeat the one before.

    Raises:
        ValueError: fewer than 4 different points, or a number that is not finite.
    """
    points = np.stack([np.asarray(x, float), np.asarray(y, float)])
    if not np.isfinite(points).all():
        raise ValueError(f"a {name} point is not finite")
    repeated = np.all(points[:, 1:] == points[:, :-1], axis=0)
    points = np.delete(points, np.flatnonzero(repeated), axis=1)
    if points.shape[1] < 4:
        raise ValueError(f"a {name} needs at least 4 different points, got {points.shape[1]}")
    return points


def curve_points(cubics: Floats, parts: int) -> tuple[Floats, Floats]:
    """Return points x, y [m] of a curve, `Profile.cubics`: `parts` in every segment, and the last one's end."""
    segments, part = np.divmod(np.arange(parts * len(cubics) + 1), parts)
    segments[-1] = len(cubics) - 1
    part[-1] = parts
    length, _, x0, x1, x2, x3, y0, y1, y2, y3 = cubics[segments].T
    u = length * part / parts
    return x0 + u * (x1 + u * (x2 + u * x3)), y0 + u * (y1 + u * (y2 + u * y3))


def cell_polynomials(middle: Floats, at_nodes: Floats, checked: Floats) -> tuple[Floats, Floats]:
    """Return coefficients of h [m] of cells, shape (n, DEGREE + 1), and their largest errors of h' [m], shape (n,).

    `middle` is h in the middle, `at_nodes` and `checked` h' at the places `CELL_NODES` and `CELL_CHECKS` of each cell.
    """
    # Newton's divided differences, and then the powers of the place one after the other
    differences = list(at_nodes.T)
    for order in range(1, DEGREE):
        for i in range(DEGREE - 1, order - 1, -1):
            apart = CELL_NODES[i] - CELL_NODES[i - order]
            differences[i] = (differences[i] - differences[i - 1]) / apart
    slopes = np.zeros_like(at_nodes)
    for node, difference in zip(CELL_NODES[::-1], differences[::-1], strict=True):
        higher = np.roll(slopes, 1, axis=1)
        slopes = higher - node * slopes
        slopes[:, 0] += difference
    error = np.abs(np.polynomial.polynomial.polyval(CELL_CHECKS, slopes.T) - checked).max(axis=1)
    return np.column_stack([middle, slopes * (math.tau / CELLS / np.arange(1, DEGREE + 1))]), error
