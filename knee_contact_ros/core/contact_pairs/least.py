"""The least value of a function on an interval, found with bounds, so that no second minimum can be missed.

An interval is finished when the bounds of the second derivative prove that the function is convex in it (one minimum,
by Newton's method) or concave (the smaller end), or that it cannot get below the best value so far. Otherwise it is
halved.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

from knee_contact_ros.core.kernel_source import allocating, in_kernel, kernel_interface


class Sample(NamedTuple):
    """A function at one place: value, first and second derivative."""

    place: float
    value: float
    slope: float
    bend: float
    normal: tuple[float, float]
    """Other results of the problem at that place, for its own use"""


@kernel_interface
class Problem(Protocol):
    """A function of one variable, with bounds of its second derivative: a named tuple."""

    def sample(self, place: float) -> Sample:
        """Evaluate the function at a place."""
        ...

    def bends(self, a: Sample, b: Sample) -> tuple[float, float]:
        """Return a lower and an upper bound of the second derivative between two samples; the upper one is finite."""
        ...


NOTHING = Sample(place=math.nan, value=math.inf, slope=0.0, bend=0.0, normal=(0.0, 1.0))
"""A sample higher than any other: the best one before there is one"""
NEWTON_DONE = 1e-10
"""Length of Newton's last step, as a part of the interval: the error that it leaves is about the square of that"""
MOST_STEPS = 100
"""Largest number of Newton's steps"""
ROUNDING = 2.0**-52
"""Part of a value below which two minima are not different"""
DONE, ONE_DIP, HALVE = 0, 1, 2
"""What is left to do in an interval: nothing, find its one minimum, or halve it"""


@in_kernel
def least(problem: Problem, begin: float, end: float, best: Sample, resolution: float) -> Sample:
    """Return the lowest sample on [begin, end], or `best` if none is lower.

    Minima of one interval that the bounds cannot separate, and that differ by less than `resolution` (in units of the
    value), are taken as one.
    """
    first, last = problem.sample(begin), problem.sample(end)
    best = lower_of(best, lower_of(first, last))
    left = left_to_do(problem, first, last, best.value, resolution)
    if left == HALVE:
        return _least_of_parts(problem, first, last, best, resolution)
    return lower_of(best, dip(problem, first, last)) if left == ONE_DIP else best


@allocating
def _least_of_parts(problem: Problem, first: Sample, last: Sample, best: Sample, resolution: float) -> Sample:
    """Return the lowest sample of an interval that must be halved, or `best` if none is lower."""
    intervals = [(first, last)]
    while len(intervals) > 0:
        a, b = intervals.pop()
        left = left_to_do(problem, a, b, best.value, resolution)
        if left == ONE_DIP:
            best = lower_of(best, dip(problem, a, b))
        elif left == HALVE:
            middle = problem.sample(0.5 * (a.place + b.place))
            best = lower_of(best, middle)
            if a.value < b.value:  # the lower half comes next
                intervals.append((middle, b))
                intervals.append((a, middle))
            else:
                intervals.append((a, middle))
                intervals.append((middle, b))
    return best


@in_kernel
def left_to_do(problem: Problem, a: Sample, b: Sample, best: float, resolution: float) -> int:
    """Return what is left to do between two samples to find every value lower than `best`."""
    low, high = problem.bends(a, b)
    if high <= 0.0:
        return DONE
    sag = 0.125 * high * (b.place - a.place) * (b.place - a.place)
    one_dip = low >= 0.0 or sag <= max(resolution, ROUNDING * abs(best))
    if one_dip and not a.slope < 0.0 < b.slope:
        return DONE
    if not -math.inf < least_between(a.value, b.value, sag) <= best < math.inf:  # also where numbers have overflown
        return DONE
    if one_dip:
        return ONE_DIP
    return HALVE if a.place < 0.5 * (a.place + b.place) < b.place else DONE


@in_kernel
def least_between(a: float, b: float, sag: float) -> float:
    """A lower bound of a function between two values that is below its chord by at most sag·4u(1-u), u in [0, 1]."""
    tilt = 1.0 - 0.25 * abs(b - a) / sag if sag > 0.0 else 0.0
    return min(a, b) - (sag * tilt * tilt if tilt > 0.0 else 0.0)


@in_kernel
def lower_of(one: Sample, other: Sample) -> Sample:
    """Return the lower one of two samples, the first if they are equal."""
    return one if one.value <= other.value else other


@in_kernel
def dip(problem: Problem, a: Sample, b: Sample) -> Sample:
    """Return the sample of slope 0 between a falling and a rising one, by Newton's method inside a bracket."""
    enough = NEWTON_DONE * (b.place - a.place)
    place = a.place - a.slope * (b.place - a.place) / (b.slope - a.slope)
    at = a
    for _ in range(MOST_STEPS):
        at = problem.sample(place)
        a, b = (at, b) if at.slope < 0.0 else (a, at)
        place = at.place - at.slope / at.bend if at.bend > 0.0 else a.place
        if not a.place < place < b.place:
            if abs(place - at.place) <= enough:
                return at
            place = 0.5 * (a.place + b.place)
        if abs(place - at.place) <= enough:
            return problem.sample(place)
    return at
