"""A femoral circle or profile over a curved tibia: the common normal of Eqs. 1 to 6 of the paper, found globally.

The signed depth is the largest depth of a femoral point under the tibial surface, or minus the least distance. Where
the femur's deepest point is not an end of its curve, the normals are parallel there and the vector between the two
points lies along them (Eq. 5).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.core.contact_pairs.base import Closest, Touch
from knee_contact_ros.core.contact_pairs.femoral_curve import Arc, FemoralCurve
from knee_contact_ros.core.contact_pairs.least import Sample, least
from knee_contact_ros.core.contact_pairs.tibial_surface import TibialSurface
from knee_contact_ros.core.geometries.circle import Circle
from knee_contact_ros.core.geometries.profile import Profile

CELL = 2.0**-14
"""Heights within a cell of this size [m] share one search; a power of 2, so that its middle is exact"""
RESOLUTION = 1e-9
"""Two dips of the distance within one segment that the bounds cannot tell apart count as one below this [m]"""
ROUNDING = 1e-14
"""Kept from the bounds, as a part of the distances: they are rounded themselves"""

At = Callable[[float], Closest]


class CurveContact:
    """A femur on a tibial surface that is curved in any way."""

    def __init__(self, femur: Circle | Profile, tibia: TibialSurface) -> None:
        """Prepare the contact of `femur` on `tibia`."""
        self.femur = femur
        self.tibia = tibia
        # One kink is that of an open curve's two ends; a hollow that is narrower than the femur holds it on two edges.
        self.dented = len(femur.kinks) > 1 or tibia.curvatures[1] > 1.0 / femur.support(0.0)[0]
        self._search: Callable[[float, float, float], At] = (
            _CircleSearch(femur, tibia) if isinstance(femur, Circle) else _ProfileSearch(femur, tibia)
        )

    def closest(self, angle: float, x: float, height: float) -> Closest:
        """See `ContactPair`."""
        return self._search(angle, x, _cell(height))(height)

    def touch(self, angle: float, angle_rate: float, x: float, x_rate: float) -> Touch:
        """See `ContactPair`."""
        cells: dict[float, At] = {}

        def touch(height: float) -> tuple[float, float, float]:
            cell = _cell(height)
            if cell not in cells:
                cells[cell] = self._search(angle, x, cell)
            depth, _, turning, normal_x, normal_y = cells[cell](height)
            return depth, turning * angle_rate - normal_x * x_rate, normal_y

        return touch

    def kinks(self, start: float, end: float) -> list[float]:
        """See `ContactPair`: where they lie depends on height and translation, so none is known beforehand."""
        del start, end
        return []

    def outline(self, reach: float) -> NDArray[np.float64]:
        """See `ContactPair`."""
        return self.tibia.outline(reach)


def _cell(height: float) -> float:
    """Middle of the cell of heights that a height belongs to [m]."""
    return CELL * round(height / CELL)


class _CircleSearch:
    """A circle's deepest point lies where the nearest point to its centre is: there is nothing to search."""

    def __init__(self, femur: Circle, tibia: TibialSurface) -> None:
        self._radius = femur.radius
        self._foot = tibia.foot

    def __call__(self, angle: float, x: float, cell: float) -> At:
        """The common normal at this angle [rad] and x [m], as a function of the height [m]."""
        del angle, cell

        def at(height: float) -> Closest:
            distance, normal_x, normal_y, _ = self._foot(x, height)
            return Closest(self._radius - distance, self._radius, 0.0, normal_x, normal_y)

        return at


class _Candidate(NamedTuple):
    """A segment that may hold the deepest point, and the least distance [m] that it may have in the cell's middle."""

    least: float
    arc: Arc


class _ProfileSearch:
    """Bounds over all segments leave a few for a cell of heights, and these are searched at each height."""

    def __init__(self, femur: Profile, tibia: TibialSurface) -> None:
        self._curve = FemoralCurve(femur)
        self._tibia = tibia

    def __call__(self, angle: float, x: float, cell: float) -> At:
        """The common normal at this angle [rad] and x [m], as a function of the height [m] within a cell."""
        candidates = self._candidates(angle, x, cell)

        def at(height: float) -> Closest:
            return self._closest(candidates, x, height, height - cell)

        return at

    def _candidates(self, angle: float, x: float, cell: float) -> list[_Candidate]:
        """The segments that can hold the deepest point, the likeliest first.

        Over a height dy, a distance changes by dy n_y, so one segment gains on another no more than dy (1 - least n_y).
        """
        lower, upper = self._curve.least_distances(self._tibia, angle, x, cell)
        margin = 0.5 * CELL * (1.0 - self._tibia.least_normal_y) + self._rounding(x, cell)
        possible = np.flatnonzero(lower <= upper + margin)
        order = possible[np.argsort(lower[possible], kind="stable")]
        return [_Candidate(float(lower[i]), self._curve.arcs[i].turned(angle)) for i in order.tolist()]

    def _closest(self, candidates: list[_Candidate], x: float, height: float, raised: float) -> Closest:
        """The deepest of the candidates, `raised` [m] above the cell's middle."""
        slack = max(-raised, -raised * self._tibia.least_normal_y) + self._rounding(x, height)
        best: Sample | None = None
        for bound, arc in candidates:
            if best is not None and bound > best.value + slack:
                break
            function, bends = arc.distance(self._tibia, x, height)
            lowest = least(function, bends, 0.0, arc.length, best, RESOLUTION)
            if lowest is not best:
                best, answer = lowest, _common_normal(arc, lowest)
        return answer

    def _rounding(self, x: float, height: float) -> float:
        return ROUNDING * (1.0 + abs(x) + abs(height))


def _common_normal(arc: Arc, sample: Sample) -> Closest:
    """The common normal at the femur's deepest point."""
    x, y = arc.point(sample.place)
    normal_x, normal_y = sample.normal
    turning = normal_x * y - normal_y * x
    return Closest(-sample.value, -(x * normal_x + y * normal_y), turning, normal_x, normal_y)
