"""Intervals by profile likelihood: a parameter is held, the others fitted again, until the fit is significantly worse.

The interval of a level ends where the likelihood ratio of the value held to the best one reaches the level's quantile:
of χ² with one degree of freedom, or of F(1, n - p) where a noise is estimated from the same data (Bates & Watts 1988,
Nonlinear Regression Analysis, Ch. 6; Venzon & Moolgavkar 1988, Applied Statistics 37:87-94). Where what is left is
alike from sample to sample, n is the number of independent values that it is worth (`independence`). An interval need
not be symmetric, and it may have no end within the parameter's range: the data do not bound it there.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.stats import chi2, f

from knee_contact_ros.tools.calibration.fit import Minimum, searched

Floats = NDArray[np.float64]
WIDEST = math.log(1e9)
"""Of a search for an end, to one side, in coordinates"""
CLOSE = 1e-3
"""Part of a standard deviation to which an end is found"""
BETTER = 1e-2
"""Likelihood ratio by which a place must be better than the best one to replace it"""
NOTHING = 1e-9
"""Part of the largest singular value that a direction which changes nothing counts as"""
FIRST_STEP, LEAST_STEP, LARGEST_STEP = 0.1, 1e-9, 1.0
"""Where nothing is known of a deviation; and what a first step may be, in coordinates"""


class Interval(NamedTuple):
    """Of a parameter's value, in its unit."""

    low: float
    high: float
    low_open: bool
    """The data do not bound it below: `low` is the end of the range (or as far as was looked)"""
    high_open: bool
    """The same above"""


class BetterError(Exception):
    """A better place than the best one was found on the way."""

    def __init__(self, place: Floats) -> None:
        super().__init__("a better fit")
        self.place = place


def quantile(minimum: Minimum, level: float) -> float:
    """What a likelihood ratio stays below with a probability, where the value held is the true one."""
    return float(chi2.ppf(level, 1) if minimum.knows_noise else f.ppf(level, 1, minimum.freedom))


def covariance(minimum: Minimum) -> Floats:
    """Of the estimates along straight lines, in coordinates, shape (p, p).

    A direction that changes nothing has a variance that is as good as infinite.
    """
    slopes = minimum.problem.jacobian(minimum.place, minimum.noise)
    _, singular, directions = np.linalg.svd(slopes, full_matrices=False)
    told = np.maximum(singular, NOTHING * singular[0]) ** 2
    return np.asarray(directions.T / told @ directions / minimum.calibration(), dtype=np.float64)


def intervals(
    minimum: Minimum, level: float, advance: Callable[[int, int], None], *, go_on: bool = False
) -> list[Interval]:
    """Of each parameter; `advance` is told the ends that are found.

    Raises:
        BetterError: a better fit was found on the way, unless it is to `go_on`.
    """
    limit, spread = quantile(minimum, level), covariance(minimum)
    found = []
    number = len(minimum.place)
    for index, unknown in enumerate(minimum.problem.unknowns):
        sides = []
        for side in (-1.0, 1.0):
            sides.append(_Side(minimum, index, side, limit, spread, go_on).end())
            advance(len(sides) + 2 * index, 2 * number)
        (low, low_open), (high, high_open) = sides
        found.append(Interval(unknown.value(low), unknown.value(high), low_open, high_open))
    return found


class _Side:
    """The search for one end of an interval."""

    def __init__(self, minimum: Minimum, index: int, side: float, limit: float, spread: Floats, go_on: bool) -> None:
        self._go_on = go_on
        self._minimum, self._index, self._side = minimum, index, side
        self._limit = math.sqrt(limit)
        variance = float(spread[index, index])
        usable = 0.0 < variance < math.inf
        self._deviation = math.sqrt(variance) if usable else FIRST_STEP
        self._slopes = spread[:, index] / variance if usable else np.eye(len(spread))[index]
        """Of the other coordinates over the one that is held, along the valley"""
        self._cost, self._factor = minimum.cost(minimum.place), 2.0 * minimum.calibration()
        self._solved = {0.0: minimum.place}
        self._known = {0.0: -self._limit}
        ends = minimum.problem.bounds
        self._room = abs(float(ends[int(side > 0.0)][index] - minimum.place[index]))

    def end(self) -> tuple[float, bool]:
        """The coordinate of the end, and whether it is open."""
        inner, at = 0.0, float(self._minimum.place[self._index])
        furthest = min(self._room, WIDEST)
        outer = min(np.clip(self._limit * self._deviation, LEAST_STEP, LARGEST_STEP), furthest)
        while self._rise(outer) < 0.0:
            if outer >= furthest:
                return at + self._side * outer, True
            # The root of the ratio grows along a straight line as a rule
            further = outer * min(max(1.05 * self._limit / (self._known[outer] + self._limit + 1e-12), 1.2), 3.0)
            inner, outer = outer, min(further, furthest)
        close = CLOSE * self._deviation
        reach = brentq(self._rise, inner, outer, xtol=min(close, 0.01 * outer), rtol=1e-6) if outer > inner else outer
        return at + self._side * reach, False

    def _rise(self, reach: float) -> float:
        """Root of the likelihood ratio so far from the best place, less the limit."""
        if reach not in self._known:
            near = min(self._solved, key=lambda each: abs(each - reach))
            problem, best = self._minimum.problem, self._minimum.place
            start = self._solved[near] + self._side * (reach - near) * self._slopes
            start = np.clip(start, *problem.bounds)
            start[self._index] = best[self._index] + self._side * reach
            place = searched(problem, self._minimum.loss, self._minimum.noise, start, held=[self._index])
            ratio = self._factor * (self._minimum.cost(place) - self._cost)
            if ratio < -BETTER and not self._go_on:
                raise BetterError(place)
            self._solved[reach] = place
            self._known[reach] = math.sqrt(max(ratio, 0.0)) - self._limit
        return self._known[reach]
