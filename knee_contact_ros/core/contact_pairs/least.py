"""The smallest value of a function on an interval, found by bounds, so that no second dip can be missed.

An interval is done when the bounds of the second derivative tell that the function is convex in it (one dip, Newton) or
concave (the smaller end), or that it cannot get below the best value so far. Otherwise it is halved.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple


class Sample(NamedTuple):
    """A function at one place: value, first and second derivative."""

    place: float
    value: float
    slope: float
    bend: float
    normal: tuple[float, float] = (0.0, 1.0)
    """For the caller's use: what else the function found there"""


Function = Callable[[float], Sample]
Bends = Callable[[Sample, Sample], tuple[float, float]]
"""Lower and upper bound of the second derivative between two samples; the upper one is finite"""

NEWTON_DONE = 1e-10
"""A Newton step below this part of the interval is the last: the error that it leaves is about the square of that"""
MOST_STEPS = 100


def least(function: Function, bends: Bends, begin: float, end: float, best: Sample | None, resolution: float) -> Sample:
    """Return the lowest sample on [begin, end], or `best` if none is lower.

    Dips of one interval that no bound can tell apart are, below `resolution` (in units of the value), taken as one.
    """
    first, last = function(begin), function(end)
    best = lower_of(best, lower_of(first, last))
    intervals = [(first, last)]
    while intervals:
        a, b = intervals.pop()
        low, high = bends(a, b)
        if high <= 0.0:
            continue
        sag = 0.125 * high * (b.place - a.place) * (b.place - a.place)
        one_dip = low >= 0.0 or sag <= resolution
        if one_dip and not a.slope < 0.0 < b.slope:
            continue
        if least_between(a.value, b.value, sag) > best.value:
            continue
        if one_dip:
            best = lower_of(best, dip(function, a, b))
            continue
        middle = function(0.5 * (a.place + b.place))
        best = lower_of(best, middle)
        intervals += [(middle, b), (a, middle)] if a.value < b.value else [(a, middle), (middle, b)]
    return best


def least_between(a: float, b: float, sag: float) -> float:
    """Lower bound between two values, of a function that hangs below its chord by at most sag·4u(1-u), u in [0, 1]."""
    tilt = 1.0 - 0.25 * abs(b - a) / sag if sag > 0.0 else 0.0
    return min(a, b) - (sag * tilt * tilt if tilt > 0.0 else 0.0)


def lower_of(one: Sample | None, other: Sample) -> Sample:
    """Return the lower of two samples, the first if they are equal."""
    return one if one is not None and one.value <= other.value else other


def dip(function: Function, a: Sample, b: Sample) -> Sample:
    """Return the place of slope 0 between a falling and a rising sample, by Newton steps kept in the bracket."""
    enough = NEWTON_DONE * (b.place - a.place)
    place = a.place - a.slope * (b.place - a.place) / (b.slope - a.slope)
    for _ in range(MOST_STEPS):
        at = function(place)
        a, b = (at, b) if at.slope < 0.0 else (a, at)
        place = at.place - at.slope / at.bend if at.bend > 0.0 else a.place
        if not a.place < place < b.place:
            if abs(place - at.place) <= enough:
                return at
            place = 0.5 * (a.place + b.place)
        if abs(place - at.place) <= enough:
            return function(place)
    return at
