"""The smallest value of a function on an interval, found by bounds, so that no second dip can be missed.

An interval is done when the bounds of the second derivative tell that the function is convex in it (one dip, Newton) or
concave (the smaller end), or that it cannot get below the best value so far. Otherwise it is halved.
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
    """For the problem's use: what else it found there"""


@kernel_interface
class Problem(Protocol):
    """A function of one place, and bounds of it: a named tuple."""

    def sample(self, place: float) -> Sample:
        """The function at a place."""
        ...

    def bends(self, a: Sample, b: Sample) -> tuple[float, float]:
        """Lower and upper bound of the second derivative between two samples; the upper one is finite."""
        ...


NOTHING = Sample(place=math.nan, value=math.inf, slope=0.0, bend=0.0, normal=(0.0, 1.0))
"""Higher than any sample: the best one so far when there is none"""
NEWTON_DONE = 1e-10
"""A Newton step below this part of the interval is the last: the error that it leaves is about the square of that"""
MOST_STEPS = 100
ROUNDING = 2.0**-52
"""Part of a value that tells no dips apart"""
DONE, ONE_DIP, HALVE = 0, 1, 2
"""What is left to do in an interval"""


@in_kernel
def least(problem: Problem, begin: float, end: float, best: Sample, resolution: float) -> Sample:
    """Return the lowest sample on [begin, end], or `best` if none is lower.

    Dips of one interval that no bound can tell apart are, below `resolution` (in units of the value), taken as one.
    """
    first, last = problem.sample(begin), problem.sample(end)
    best = lower_of(best, lower_of(first, last))
    left = left_to_do(problem, first, last, best.value, resolution)
    if left == HALVE:
        return _least_of_parts(problem, first, last, best, resolution)
    return lower_of(best, dip(problem, first, last)) if left == ONE_DIP else best


@allocating
def _least_of_parts(problem: Problem, first: Sample, last: Sample, best: Sample, resolution: float) -> Sample:
    """The least value in an interval between two samples that must be halved."""
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
    """What is left to do between two samples to find all that is lower than the `best` value."""
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
    """Lower bound between two values, of a function that hangs below its chord by at most sag·4u(1-u), u in [0, 1]."""
    tilt = 1.0 - 0.25 * abs(b - a) / sag if sag > 0.0 else 0.0
    return min(a, b) - (sag * tilt * tilt if tilt > 0.0 else 0.0)


@in_kernel
def lower_of(one: Sample, other: Sample) -> Sample:
    """Return the lower of two samples, the first if they are equal."""
    return one if one.value <= other.value else other


@in_kernel
def dip(problem: Problem, a: Sample, b: Sample) -> Sample:
    """Return the place of slope 0 between a falling and a rising sample, by Newton steps kept in the bracket."""
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
