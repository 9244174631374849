"""A measured tibial plateau: a cubic spline y(x) through its points, straight on from both ends."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.core.contact_pairs.least import Bends, Function, Sample, least
from knee_contact_ros.core.contact_pairs.tibial_surface import Floats, Foot

RESOLUTION = 1e-9
"""Two nearest places that the bounds cannot tell apart are taken as one when they differ by less than this [m]"""
OUTLINE_POINTS = 201
"""Of a drawing, besides the measured ones"""


class TibialProfile:
    """A plateau through points of the tibia frame, concave or convex anywhere; x anterior, y superior."""

    def __init__(self, x: Sequence[float] | NDArray[np.float64], y: Sequence[float] | NDArray[np.float64]) -> None:
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
        before = [heights[0], inner[1, 0], 0.0, 0.0]
        behind = [heights[-1], end_slope, 0.0, 0.0]
        self._pieces = np.column_stack([before, inner, behind])
        """Coefficients over the distance from the piece's base, shape (4, pieces); the outer two are straight"""
        self._bases = np.concatenate([nodes[:1], nodes])
        self._nodes = nodes
        # The same as Python numbers, which are quicker one at a time.
        self._piece_list = list(zip(self._bases.tolist(), *self._pieces.tolist(), strict=True))
        self._node_list: list[float] = nodes.tolist()
        self._bound(inner, widths)

    def _bound(self, inner: Floats, widths: Floats) -> None:
        """Bounds of slope, second derivative and curvature; the second derivative is linear in a segment."""
        _, c1, c2, c3 = inner
        slopes = np.abs([c1, c1 + c2 * widths, c1 + widths * (2.0 * c2 + 3.0 * c3 * widths)])  # Bezier control points
        self._steepest = float(slopes.max())
        bends = np.stack([2.0 * c2, 2.0 * c2 + 6.0 * c3 * widths])
        self._node_bends: list[float] = [*bends[0].tolist(), float(bends[1, -1])]
        flattest = np.maximum(slopes[0] - np.abs(bends).max(axis=0) * widths, 0.0)
        curvatures = bends / (1.0 + flattest**2) ** 1.5
        self._curvatures = min(0.0, float(curvatures.min())), max(0.0, float(curvatures.max()))

    @property
    def curvatures(self) -> tuple[float, float]:
        """Bounds of the curvature [1/m]."""
        return self._curvatures

    @property
    def least_normal_y(self) -> float:
        """Vertical part of the normal of the steepest place."""
        return 1.0 / math.hypot(1.0, self._steepest)

    def foot(self, x: float, y: float) -> Foot:
        """The nearest point of the surface to (x, y) [m]; it cannot be further to the side than the one below."""
        reach = abs(y - self._at(x)[0])
        function, bends = self._squared_distance(x, y)
        first, last = self._node_list[0], self._node_list[-1]
        best: Sample | None = None
        for least_x, largest_x in ((first, last), (-math.inf, first), (last, math.inf)):
            begin, end = max(least_x, x - reach), min(largest_x, x + reach)
            if begin <= end:
                best = least(function, bends, begin, end, best, RESOLUTION * reach)
        place = best.place if best is not None else x
        height, slope, bend = self._at(place)
        norm = math.hypot(1.0, slope)
        return Foot(((y - height) - slope * (x - place)) / norm, -slope / norm, 1.0 / norm, bend / (norm * norm * norm))

    def distances(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Bounds of the signed distances [m] of many points, close where one Newton step comes close to the foot.

        Balls that touch the surface there, with the radius of the largest curvature on either side, lie on their side
        altogether. So the distances of their centres are known, and that of the point differs by its way to them.
        """
        height, slope, bend = self._over(x)
        above = y - height
        place = x + above * slope / np.maximum(1.0 + slope * slope - above * bend, 0.5)
        height, slope, _ = self._over(place)
        norm = np.hypot(1.0, slope)
        aside, over = x - place, y - height
        along, across = (aside + slope * over) / norm, (over - slope * aside) / norm
        squared = along * along + across * across
        lower, upper = (
            (2.0 * across - k * squared) / (1.0 + np.hypot(k * along, 1.0 - k * across)) for k in self._curvatures[::-1]
        )
        return np.maximum(lower, np.where(above > 0.0, above, -np.inf) * self.least_normal_y), upper

    def outline(self, reach: float) -> Floats:
        """Points along the measured surface, shape (n, 2) [m], to `reach` [m] on both sides at most."""
        low, high = max(-reach, self._node_list[0]), min(reach, self._node_list[-1])
        x = np.unique(np.concatenate([np.linspace(low, high, OUTLINE_POINTS), self._nodes]))
        x = x[np.abs(x) <= reach]
        return np.stack([x, self._over(x)[0]], axis=1)

    def _squared_distance(self, x: float, y: float) -> tuple[Function, Bends]:
        """Half the squared distance from (x, y) as a function of the place on the surface, and bounds of its bend."""

        def function(place: float) -> Sample:
            height, slope, bend = self._at(place)
            aside, over = place - x, height - y
            return Sample(
                place, 0.5 * (aside * aside + over * over), aside + over * slope, 1.0 + slope * slope + over * bend
            )

        def bends(a: Sample, b: Sample) -> tuple[float, float]:
            least_bend, largest_bend = self._bends_between(a.place, b.place)
            middle = 0.5 * (self._at(a.place)[0] + self._at(b.place)[0]) - y
            room = 0.5 * self._steepest * (b.place - a.place)
            products = [over * bend for over in (middle - room, middle + room) for bend in (least_bend, largest_bend)]
            return 1.0 + min(products), 1.0 + self._steepest * self._steepest + max(products)

        return function, bends

    def _at(self, x: float) -> tuple[float, float, float]:
        """Height [m], slope and second derivative [1/m] at x [m]."""
        base, c0, c1, c2, c3 = self._piece_list[bisect_right(self._node_list, x)]
        u = x - base
        return c0 + u * (c1 + u * (c2 + u * c3)), c1 + u * (2.0 * c2 + u * 3.0 * c3), 2.0 * c2 + 6.0 * c3 * u

    def _over(self, x: Floats) -> tuple[Floats, Floats, Floats]:
        """The same for many x."""
        piece = np.searchsorted(self._nodes, x, side="right")
        c0, c1, c2, c3 = self._pieces[:, piece]
        u = x - self._bases[piece]
        return c0 + u * (c1 + u * (c2 + u * c3)), c1 + u * (2.0 * c2 + u * 3.0 * c3), 2.0 * c2 + 6.0 * c3 * u

    def _bends_between(self, begin: float, end: float) -> tuple[float, float]:
        """Smallest and largest second derivative [1/m] on an interval that no end of the profile divides."""
        if end <= self._node_list[0] or begin >= self._node_list[-1]:
            return 0.0, 0.0
        inside = self._node_bends[bisect_right(self._node_list, begin) : bisect_right(self._node_list, end)]
        bends = (self._at(begin)[2], self._at(end)[2], *inside)
        return min(bends), max(bends)


def _usable(x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Different points in ascending x; refuses what is no plateau."""
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
    return x, y
