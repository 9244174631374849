"""Kinks of a profile's support, where its lowest point leaps over a dent from one bump to the next.

While the lowest point glides along a bump, the curve bends to the same side all along. If the curve between the lowest
points of two angles bends to the other side somewhere, the lowest point has leapt; bisection finds the angle.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable
from itertools import pairwise

from knee_contact_ros.core.arrays import Floats
from knee_contact_ros.core.kernel_source import in_kernel

CELLS = 2048
"""Number of angles at which the lowest point is computed first"""
RESOLUTION = 1e-13
"""Error of the angle of a kink [rad]"""
LEAP = 1e-6
"""Least length [m] of a leap of the lowest point"""
FLAT = 1e-6
"""Curvature [1/m] that counts as none: a straight piece bends to either side by rounding"""


Lowest = Callable[[float], tuple[float, float, float, float]]
"""A function from an angle [rad] to the lowest point: depth, x, y and place on the curve [m]."""


@in_kernel
def next_kink(kinks: Floats, start: float, end: float) -> float:
    """The first of the `kinks`, or of their repetitions by whole turns, strictly between two angles [rad], or NaN.

    `kinks` increase from 0 to 2π; `start` may be the larger of the two angles, and the first kink is the one next to
    it.
    """
    count, forwards = len(kinks), start < end
    way = 1 if forwards else -1
    for turn in range(math.floor(start / math.tau), math.floor(end / math.tau) + way, way):
        for i in range(count):
            kink = float(kinks[i if forwards else count - 1 - i]) + turn * math.tau
            if start < kink < end or end < kink < start:
                return kink
    return math.nan


def find_kinks(cubics: Floats, lowest: Lowest) -> tuple[float, ...]:
    """Return the angles in [0, 2π) [rad] at which the lowest point of a curve leaps; `cubics` as in `Curve`."""
    edges = [math.tau * i / CELLS for i in range(CELLS + 1)]
    places = [lowest(angle)[3] for angle in edges]
    forwards = sum(math.copysign(1.0, b - a) for a, b in pairwise(places) if a != b) > 0.0
    glides = _Glides(cubics.tolist(), forwards)
    found = []
    for (a, b), (from_place, to_place) in zip(pairwise(edges), pairwise(places), strict=True):
        found += _leaps(glides, lowest, (a, from_place), (b, to_place))
    return tuple(angle for angle in found if angle < math.tau)


class _Glides:
    """Tells whether the lowest point can glide from one place of the curve to another."""

    def __init__(self, cubics: list[list[float]], forwards: bool) -> None:
        self.forwards = forwards
        self.bends = [
            (start, length, (2.0 * (x1 * y2 - y1 * x2), 6.0 * (x1 * y3 - y1 * x3), 6.0 * (x2 * y3 - y2 * x3)))
            for length, start, _, x1, x2, x3, _, y1, y2, y3 in cubics
        ]
        """Start and length of every segment [m], and coefficients of p' x p'' along it: the highest terms cancel"""
        self.starts = [start for start, _, _ in self.bends]

    def possible(self, a: float, b: float) -> bool:
        """Whether the lowest point can glide from place a to place b [m] as the angle grows."""
        if abs(b - a) <= LEAP:
            return True
        if (b > a) != self.forwards:
            return False
        # The direction that is down turns clockwise in the femur as the angle grows: so the curve bends to the right.
        sign, (low, high) = (-1.0 if self.forwards else 1.0), sorted((a, b))
        first = max(bisect_right(self.starts, low) - 2, 0)  # one more, as the sum of start and length is rounded
        for start, length, bend in self.bends[first : bisect_right(self.starts, high)]:
            begin, end = max(low - start, 0.0), min(high - start, length)
            if begin < end and sign * _least(bend, begin, end, sign) < -FLAT:
                return False
        return True


def _leaps(glides: _Glides, lowest: Lowest, a: tuple[float, float], b: tuple[float, float]) -> list[float]:
    """Angles at which the lowest point leaps between a and b, which are an angle [rad] and its place [m] each."""
    if glides.possible(a[1], b[1]):
        return []
    middle = 0.5 * (a[0] + b[0])
    if b[0] - a[0] <= RESOLUTION or not a[0] < middle < b[0]:
        (_, ax, ay, _), (_, bx, by, _) = lowest(a[0]), lowest(b[0])
        return [middle] if math.hypot(bx - ax, by - ay) > LEAP else []
    between = (middle, lowest(middle)[3])
    return _leaps(glides, lowest, a, between) + _leaps(glides, lowest, between, b)


def _least(bend: tuple[float, float, float], begin: float, end: float, sign: float) -> float:
    """Return the value of the quadratic `bend` on an interval that is the least after multiplication by `sign`."""
    c0, c1, c2 = bend
    places = [begin, end]
    if c2 != 0.0 and begin < -0.5 * c1 / c2 < end:
        places.append(-0.5 * c1 / c2)
    return min((c0 + u * (c1 + u * c2) for u in places), key=lambda value: sign * value)
