"""Intervals by profile likelihood: a parameter is held, the others fitted again, until the fit is significantly worse.

The interval of a level ends where the likelihood ratio of the value held to the best one reaches the level's quantile:
of χ² with one degree of freedom, or of F(1, n - p) where a noise is estimated from the same data (Bates & Watts 1988,
Nonlinear Regression Analysis, Ch. 6; Venzon & Moolgavkar 1988, Applied Statistics 37:87-94). Where residuals are
autocorrelated, n is the number of independent values that they are worth (`independence.py`). An interval need not be
symmetric, and it may have no end within the parameter's range: the data do not bound it there.
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
"""The largest distance [coordinates] from the fit at which an end is searched for"""
CLOSE = 1e-3
"""Precision of an end, relative to the standard deviation"""
BETTER = 1e-2
"""Likelihood ratio by which a place must be better than the fit to replace it"""
NOTHING = 1e-9
"""The least singular value of a direction, relative to the largest one"""
FIRST_STEP, LEAST_STEP, LARGEST_STEP = 0.1, 1e-9, 1.0
"""Standard deviation [coordinates] where it is not known, and range of the first step of a search"""


class Interval(NamedTuple):
    """Interval of a parameter's value, in the parameter's unit."""

    low: float
    """Lower end"""
    high: float
    """Upper end"""
    low_open: bool
    """Whether the data do not bound the value below: `low` is the end of its range, or where the search ended"""
    high_open: bool
    """Whether the data do not bound the value above: `high` is the end of its range, or where the search ended"""


class BetterError(Exception):
    """A better place than the fit was found during the search for an interval."""

    def __init__(self, place: Floats) -> None:
        super().__init__("a better fit")
        self.place = place


def quantile(minimum: Minimum, level: float) -> float:
    """Give the value that a likelihood ratio does not exceed with a probability, if the value held is the true one."""
    return float(chi2.ppf(level, 1) if minimum.knows_noise else f.ppf(level, 1, minimum.freedom))


def covariance(minimum: Minimum) -> Floats:
    """Compute the covariance of the estimates in the linear approximation, in coordinates, shape (p, p).

    Directions that change no residual get a very large variance.
    """
    slopes = minimum.problem.jacobian(minimum.place, minimum.noise)
    _, singular, directions = np.linalg.svd(slopes, full_matrices=False)
    information = np.maximum(singular, NOTHING * singular[0]) ** 2
    return np.asarray(directions.T / information @ directions / minimum.calibration(), dtype=np.float64)


def intervals(
    minimum: Minimum, level: float, advance: Callable[[int, int], None], *, ignore_better: bool = False
) -> list[Interval]:
    """Compute the interval of each parameter.

    Args:
        minimum: The fit.
        level: Probability of the intervals.
        advance: Called with the number of ends that are found, and the number of all.
        ignore_better: Whether to continue when a better fit is found on the way.

    Raises:
        BetterError: a better fit was found on the way.
    """
    limit, spread = quantile(minimum, level), covariance(minimum)
    results = []
    number = len(minimum.place)
    for index, unknown in enumerate(minimum.problem.unknowns):
        sides = []
        for side in (-1.0, 1.0):
            sides.append(_Side(minimum, index, side, limit, spread, ignore_better).end())
            advance(len(sides) + 2 * index, 2 * number)
        (low, low_open), (high, high_open) = sides
        results.append(Interval(unknown.value(low), unknown.value(high), low_open, high_open))
    return results


class _Side:
    """The search for one end of an interval."""

    def __init__(
        self, minimum: Minimum, index: int, side: float, limit: float, spread: Floats, ignore_better: bool
    ) -> None:
        self._ignore_better = ignore_better
        self._minimum, self._index, self._side = minimum, index, side
        self._limit = math.sqrt(limit)
        variance = float(spread[index, index])
        usable = 0.0 < variance < math.inf
        self._deviation = math.sqrt(variance) if usable else FIRST_STEP
        self._slopes = spread[:, index] / variance if usable else np.eye(len(spread))[index]
        """Slopes of the other coordinates over the one that is held, along the valley of the cost"""
        self._cost, self._factor = minimum.cost(minimum.place), 2.0 * minimum.calibration()
        self._solved = {0.0: minimum.place}
        self._known = {0.0: -self._limit}
        ends = minimum.problem.bounds
        self._room = abs(float(ends[int(side > 0.0)][index] - minimum.place[index]))

    def end(self) -> tuple[float, bool]:
        """Find the coordinate of the end, and whether it is open."""
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
        """Compute the root of the likelihood ratio at a distance from the fit, less its limit."""
        if reach not in self._known:
            near = min(self._solved, key=lambda each: abs(each - reach))
            problem, best = self._minimum.problem, self._minimum.place
            start = self._solved[near] + self._side * (reach - near) * self._slopes
            start = np.clip(start, *problem.bounds)
            start[self._index] = best[self._index] + self._side * reach
            place = searched(problem, self._minimum.loss, self._minimum.noise, start, held=[self._index])
            ratio = self._factor * (self._minimum.cost(place) - self._cost)
            if ratio < -BETTER and not self._ignore_better:
                raise BetterError(place)
            self._solved[reach] = place
            self._known[reach] = math.sqrt(max(ratio, 0.0)) - self._limit
        return self._known[reach]
