"""Femoral surfaces, and their support functions, by which they touch a plane.

With the femur rotated by an angle θ, the lowest point of its surface lies h(θ) below the reference point,
h(θ) = max over the curve of -(sin θ pₓ + cos θ p_y), and h'(θ) = -x of that point relative to the reference point. So
depth and rate on a plane are exact without a search. While the lowest point glides inside one segment of a spline, a
tabulated polynomial of the angle gives h. Elsewhere h is the best of a few segments in closed form, so that a dent
between noisy points is never mistaken for the contact.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from knee_contact_ros.model.compiler import in_kernel, inlined
from knee_contact_ros.model.types import Floats, Integers

CELLS, DEGREE = 2048, 6
"""Number of cells of the full turn, and degree of their polynomials of h"""
CLOSE = 1e-16
"""Largest error of h' [m] of a polynomial"""
ARC_POINTS, SHRUNK = 501, 0.5
"""Number of points of a circle's spline, and the fraction of its radius that the spline has"""
PER_RADIAN = CELLS / math.tau
"""Cells of the full turn in a radian"""
LEAP, RESOLUTION = 1e-6, 1e-13
"""Smallest length [m] of a leap of the lowest point; error of its angle [rad]"""
NODES: Floats = 0.5 * np.cos((np.arange(DEGREE) + 0.5) * math.pi / DEGREE)
TRIED: Floats = np.linspace(-0.5, 0.5, 2 * DEGREE + 1)
"""Places in a cell of width 1: where h' is interpolated, and where the result is checked"""
NOTHING, NOWHERE = np.full((1, 1), math.nan), np.zeros(1, np.int64)
"""Arrays of the kernel that are not used"""


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


@in_kernel
def lowest_point(
    begins: Integers, starts: Floats, cubics: Floats, angle: float
) -> tuple[float, float, float]:
    """Return support h [m], dh/dangle [m/rad], and the lowest point's place on the curve [m], in closed form.

    On a segment, h is stationary where the tangent is parallel to the plane: a quadratic.
    """
    sine, cosine, cells = math.sin(angle), math.cos(angle), len(begins) - 1
    cell = int(angle % math.tau * (cells / math.tau)) % cells
    best, slope, place = -math.inf, 0.0, 0.0
    for k in range(int(begins[cell]), int(begins[cell + 1])):
        i = int(starts[k, 0])
        length, x1, x2, x3 = (
            float(cubics[i, 0]),
            float(cubics[i, 3]),
            float(cubics[i, 4]),
            float(cubics[i, 5]),
        )
        x0, y0, y1, y2, y3 = (
            float(cubics[i, 2]),
            float(cubics[i, 6]),
            float(cubics[i, 7]),
            float(cubics[i, 8]),
            float(cubics[i, 9]),
        )
        c0, c1 = -(sine * x0 + cosine * y0), -(sine * x1 + cosine * y1)
        c2, c3 = -(sine * x2 + cosine * y2), -(sine * x3 + cosine * y3)
        discriminant = c2 * c2 - 3.0 * c3 * c1
        q = -(c2 + math.copysign(math.sqrt(max(discriminant, 0.0)), c2))
        one = c1 / q if q != 0.0 else 0.0
        other = q / (3.0 * c3) if c3 != 0.0 else 0.0
        for u in (0.0, length, one, other):
            h = c0 + u * (c1 + u * (c2 + u * c3))
            if 0.0 <= u <= length and h > best:
                x, y = x0 + u * (x1 + u * (x2 + u * x3)), y0 + u * (y1 + u * (y2 + u * y3))
                best, slope, place = h, sine * y - cosine * x, float(cubics[i, 1]) + u
    return best, slope, place


@inlined
def support_at(
    cells: Floats, begins: Integers, starts: Floats, cubics: Floats, angle: float
) -> tuple[float, float]:
    """Return support h [m] and dh/dangle [m/rad] at an angle [rad], positive in flexion."""
    part = angle * PER_RADIAN
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
    return h, slope * PER_RADIAN


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
        turn = np.linspace(-0.5 * math.pi - 1.4, -0.5 * math.pi + 1.4, ARC_POINTS)
        return Profile(
            SHRUNK * self.radius * np.cos(turn), SHRUNK * self.radius * np.sin(turn)
        ).cubics

    @property
    def on_plane(self) -> KernelTable:
        """The support function for the kernel."""
        cells = np.array([[float(self.radius)] + DEGREE * [0.0]])
        return KernelTable(cells, NOWHERE, NOTHING, NOTHING, NOTHING[0, :0])


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
        points = np.stack([np.asarray(self.x, float), np.asarray(self.y, float)])
        if not np.isfinite(points).all():
            raise ValueError("a profile point is not finite")
        repeated = np.all(points[:, 1:] == points[:, :-1], axis=0)
        points = np.delete(points, np.flatnonzero(repeated), axis=1)
        if points.shape[1] < 4:
            raise ValueError(f"a profile needs at least 4 different points, got {points.shape[1]}")
        from scipy.interpolate import CubicSpline  # 0.9 s to import, which a circle need not pay

        chords = np.hypot(*np.diff(points))
        spline = CubicSpline(np.concatenate([[0.0], np.cumsum(chords)]), points, axis=1)
        axes = np.moveaxis(spline.c[::-1], 2, 0)  # ascending powers; shape (2, 4, segments)
        object.__setattr__(
            self, "cubics", np.column_stack([chords, spline.x[:-1], *axes.reshape(8, -1)])
        )

    def __str__(self) -> str:
        return "profile"

    @property
    def knot_spacing(self) -> float:
        """Mean change of direction [rad] between two points of the spline; changes to and fro, as in dents, cancel."""
        chords = np.diff(np.column_stack([self.cubics[:, [2, 6]].T, self._hull[:, 3, -1]]))
        return abs(float(np.diff(np.unwrap(np.arctan2(chords[1], chords[0]))).mean()))

    @property
    def largest_radius(self) -> float:
        """Upper bound of the distance [m] of the curve from the reference point."""
        return float(np.hypot(*self._hull).max())

    @cached_property
    def _hull(self) -> Floats:
        """Bézier points x and y [m] of every segment, which lies in their hull; shape (2, 4, segments)."""
        length, (c0, c1, c2, c3) = (
            self.cubics[:, 0],
            self.cubics[:, 2:].T.reshape(2, 4, -1).swapaxes(0, 1),
        )
        end = c0 + length * (c1 + length * (c2 + length * c3))
        return np.stack(
            [c0, c0 + c1 * length / 3.0, c0 + length * (2.0 * c1 + c2 * length) / 3.0, end], axis=1
        )

    def outline(self, points_per_segment: int = 4) -> Floats:
        """Return points along the curve, shape (n, 2) [m] in the femur frame, for drawing."""
        part = np.linspace(0.0, 1.0, points_per_segment, endpoint=False)
        length, _, *coefficients = self.cubics.T[:, :, None]
        u = part * length
        axes = [
            c0 + u * (c1 + u * (c2 + u * c3))
            for c0, c1, c2, c3 in (coefficients[:4], coefficients[4:])
        ]
        return np.stack([axis.ravel() for axis in axes], axis=1)

    def support(self, angle: float) -> tuple[float, float]:
        """Return h [m] and dh/dangle [m/rad] at an angle [rad], positive in flexion, in closed form."""
        h, slope, _ = lowest_point(*self.on_plane[1:4], angle)
        return h, slope

    @cached_property
    def on_plane(self) -> KernelTable:
        """The support function for the kernel."""
        cells, segments = self._candidates()
        first = np.searchsorted(cells, np.arange(CELLS + 1)).astype(np.int64)
        h, u, _ = self._lowest(segments, cells, TRIED)
        is_best = h >= np.maximum.reduceat(h, first[:-1])[cells]
        alone = np.flatnonzero((is_best & (u > 0.0) & (u < self.cubics[segments, :1])).all(axis=1))
        _, alone = alone, alone[np.unique(cells[alone], return_index=True)[1]]
        polynomials = np.full((CELLS, DEGREE + 1), math.nan)
        where, only = cells[alone], segments[alone]
        middle = self._lowest(only, where, np.zeros(1))[0][:, 0]
        found, error = cell_polynomials(
            middle, *(self._lowest(only, where, t)[2] for t in (NODES, TRIED))
        )
        polynomials[where[error <= CLOSE]] = found[error <= CLOSE]
        # The place of the lowest point at both edges of each cell
        order = np.lexsort((-h[:, 0], cells)), np.lexsort((-h[:, -1], cells))
        places = [(self.cubics[segments, 1] + u[:, k])[order[k][first[:-1]]] for k in (0, -1)]
        starts = segments[:, None].astype(np.float64)
        kinks = self._kinks(first, starts, np.isnan(polynomials[:, 0]), np.stack(places))
        return KernelTable(polynomials, first, starts, self.cubics, np.array(kinks))

    def _candidates(self) -> tuple[Integers, Integers]:
        """Return cells and the segments that may have the lowest point in them, in the order of cells.

        Between the middle of a cell and its ends, one segment's support can gain on another's at most half the width
        times the distance between them (h' = -x). A segment whose bound is further behind in the middle cannot be the
        lowest.
        """
        half_width, (hull_x, hull_y) = math.pi / CELLS, self._hull
        angles = (2.0 * np.arange(CELLS)[:, None] + 1.0) * half_width
        sine, cosine = np.sin(angles), np.cos(angles)
        depths = [-(sine * x + cosine * y) for x, y in zip(hull_x, hull_y, strict=True)]
        ends = np.maximum(depths[0], depths[3])
        upper, best = np.maximum(ends, np.maximum(depths[1], depths[2])), ends.argmax(axis=1)
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
        sine, cosine = np.sin(angle), np.cos(angle)
        c0, c1 = -(sine * x0 + cosine * y0), -(sine * x1 + cosine * y1)
        c2, c3 = -(sine * x2 + cosine * y2), -(sine * x3 + cosine * y3)
        with np.errstate(divide="ignore", invalid="ignore"):
            q = -(c2 + np.copysign(np.sqrt(c2 * c2 - 3.0 * c3 * c1), c2))
            roots = [
                np.clip(np.nan_to_num(root, nan=0.0), 0.0, length)
                for root in (c1 / q, q / (3.0 * c3))
            ]
        places = np.stack([0.0 * angle, length + 0.0 * angle, *roots])
        depths = c0 + places * (c1 + places * (c2 + places * c3))
        best = depths.argmax(axis=0)[None]
        h, u = np.take_along_axis(depths, best, 0)[0], np.take_along_axis(places, best, 0)[0]
        x, y = x0 + u * (x1 + u * (x2 + u * x3)), y0 + u * (y1 + u * (y2 + u * y3))
        return h, u, sine * y - cosine * x

    def _kinks(
        self, begins: Integers, starts: Floats, open_cells: NDArray[Any], edges: Floats
    ) -> list[float]:
        """Return the angles [rad] of `KernelTable.kinks`; `edges` has the places [m] at both edges of each cell.

        While the lowest point glides, the curve bends to the same side all along. If it does not between the lowest
        points of two angles, bisection checks whether the lowest point leaps.
        """
        found: list[float] = []

        def search(a: float, b: float, from_place: float, to_place: float) -> None:
            middle = 0.5 * (a + b)
            if abs(to_place - from_place) <= LEAP or self._bends_on(from_place, to_place):
                return
            if b - a <= RESOLUTION or not a < middle < b:
                if (
                    not found or middle - found[-1] > 10.0 * RESOLUTION
                ):  # else level pieces rock to and fro by rounding
                    found.append(middle)
                return
            between = lowest_point(begins, starts, self.cubics, middle)[2]
            search(a, middle, from_place, between)
            search(middle, b, between, to_place)

        width = math.tau / CELLS
        for cell in range(CELLS):
            a, b, left, right = (
                cell * width,
                (cell + 1) * width,
                float(edges[0, cell]),
                float(edges[1, cell]),
            )
            search(a, a, float(edges[1, cell - 1]), left)
            if open_cells[cell]:
                search(a, b, left, right)
        return [kink for kink in found if kink < math.tau]

    def _bends_on(self, a: float, b: float) -> bool:
        """Whether the lowest point can glide from place a to place b [m] as the angle grows."""
        sign, (low, high) = (
            (-1.0 if b > a else 1.0),
            sorted((a, b)),
        )  # the direction that is down turns clockwise
        starts = self.cubics[:, 1]
        i, end = np.searchsorted(starts, (low, high), side="right")
        length, start, _, x1, x2, x3, _, y1, y2, y3 = self.cubics[max(int(i) - 2, 0) : int(end)].T
        bend = (
            2.0 * (x1 * y2 - y1 * x2),
            6.0 * (x1 * y3 - y1 * x3),
            6.0 * (x2 * y3 - y2 * x3),
        )  # p' x p'' along u
        begin, until = np.maximum(low - start, 0.0), np.minimum(high - start, length)
        with np.errstate(divide="ignore", invalid="ignore"):
            extreme = np.clip(np.nan_to_num(-0.5 * bend[1] / bend[2], nan=0.0), begin, until)
        least = np.min(
            [sign * (bend[0] + u * (bend[1] + u * bend[2])) for u in (begin, until, extreme)],
            axis=0,
        )
        return bool((least[begin < until] > 0.0).all())


def cell_polynomials(middle: Floats, at_nodes: Floats, tried: Floats) -> tuple[Floats, Floats]:
    """Return coefficients of h [m] of cells, shape (n, DEGREE + 1), and their largest errors of h' [m], shape (n,).

    `middle` is h in the middle, `at_nodes` and `tried` h' at the places `NODES` and `TRIED` of each cell.
    """
    slopes = at_nodes @ np.linalg.inv(np.vander(NODES, increasing=True)).T
    error = np.abs(slopes @ np.vander(TRIED, DEGREE, increasing=True).T - tried).max(axis=1)
    return np.column_stack([middle, slopes * (math.tau / CELLS / np.arange(1, DEGREE + 1))]), error
