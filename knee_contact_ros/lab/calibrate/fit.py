"""Find the parameters that fit best, how well the data determine them, and what makes the answer doubtful.

**Fit.** SciPy's bounded least squares from several starts, in coordinates (logarithms where a value cannot be 0). If a
column's noise is not given, it is estimated from its misfits: fit and noise are computed in turn until both converge,
which gives the maximum of their likelihood.

**Losses.** A residual counts by its square, or less where it is large. Each loss ρ is a function of z = (residual /
noise)², given with its first two derivatives, shape (3, n), as `scipy.optimize.least_squares` takes it. With ψ(r) =
r ρ'(r²), twice the rise of the cost times Σψ'/Σψ² is distributed as χ² where a parameter has its true value (Schrader &
Hettmansperger 1980, Biometrika 67:93-101); for squares that factor is one over the variance.

**Correlated residuals.** n values whose correlation over k samples is ρ(k) determine a mean as well as n / τ
independent ones, τ = 1 + 2 Σ ρ(k) (Bayley & Hammersley 1946, doi:10.2307/2983560). The sum ends where ρ is first 0 or
less: the rest is mostly the estimate's own noise. This holds for effects that change as slowly as the residuals;
faster ones are determined better.

**Intervals** are by profile likelihood: one parameter is held at a value while the others are fitted again, until the
fit is significantly worse. The interval of a level ends where the likelihood ratio to the best fit reaches the level's
quantile: of χ² with one degree of freedom, or of F(1, n - p) where a noise is estimated from the same data
(Bates & Watts 1988, Nonlinear Regression Analysis, Ch. 6; Venzon & Moolgavkar 1988, Applied Statistics 37:87-94). Where
residuals are autocorrelated, n is the equivalent number of independent values. An interval need not be symmetric. If it
has no end within the parameter's range, the data do not bound the parameter there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import brentq, least_squares
from scipy.stats import chi2, f, qmc

from knee_contact_ros.model.types import Floats
from knee_contact_ros.parameters.files import all_values, known_parameters
from knee_contact_ros.parameters.sections import Declaration, NodeSection
from knee_contact_ros.system.errors import UsageError, suggest
from knee_contact_ros.system.progress import OnProgress

Free = Mapping[str, Sequence[float] | None] | Iterable[str]
"""Names of parameters, or a mapping of names to the ends of narrower ranges"""
Values = dict[str, float]
LINEAR = "linear"
BEND = 1.345
"""Residual at the bend of Huber's loss, in units of the noise: 95 % as efficient as squares for normal noise"""
NORMAL_MEDIAN = 0.6744897501960817
"""Median of the absolute value of a standard normal number"""
SURE = 4.0
"""Smallest significant ratio of the correlation with the next sample to its standard deviation"""
STEP, LEAST_STEP = 1e-3, 1e-7
"""Steps of difference quotients, in coordinates: STEP at first; later half of what the data resolve if that is less,
but at least LEAST_STEP. Within STEP an impact may move from before a sample to after it"""
FAR = 1e8
"""Residual where the parameters are not allowed"""
PRECISION, MOST_TRIES = 1e-10, 100
"""Relative change of cost and place, and slope, at which a search ends, and its largest number of evaluations"""
COARSE, COARSE_TRIES = 1e-6, 30
"""The same for the searches from several starts; the best one is continued"""
REACH = math.log(4.0)
"""The largest distance [coordinates] of another start from the first one"""
ROUNDS, STEADY = 30, 1e-3
"""The largest number of rounds of fit and noise; the relative change of a noise at which they end"""
SMALL = 1e-9
"""Smallest noise of a column, relative to its largest value; smallest singular value of a direction, relative to the
largest one; and smallest distance [coordinates] of a search's start from the bounds"""
SCREENED, SEED = 50, 20
"""Number of places around the first start, per parameter; the best of them become the other starts. And their seed,
so that the same fit has the same answer"""
NO_EFFECT = 1e-5
"""Slope of a residual, in spreads of its column over an e-fold change, below which a parameter has no effect: a
thousandth of the effect of the model's own error"""
WIDEST = math.log(1e9)
"""Largest distance [coordinates] from the fit at which the end of an interval is searched"""
BETTER = 1e-2
"""Likelihood ratio by which a place must be better than the fit to replace it"""
HIGH, IN_GROUP = 0.95, 0.3
"""Correlation above which two parameters trade off; the smallest component of a parameter that takes part"""
WIDE, SHOWN = 2.0, 0.1
"""Ratio of an interval's ends above which a value counts as unknown; relative change in a shown trade-off"""
UNLIKELY = 1e-4
"""Probability of the residuals below which the noise given is doubted"""
AT_END = 1e-3
"""Distance [coordinates] within which two places count as one"""


def _squares(z: Floats) -> Floats:
    return np.stack((z, np.ones_like(z), np.zeros_like(z)))


def _soft_l1(z: Floats) -> Floats:
    """Compute the loss 2 (√(1 + z) - 1): nearly the square of small residuals, and linear in large ones."""
    root = np.sqrt(1.0 + z)
    return np.stack((2.0 * (root - 1.0), 1.0 / root, -0.5 / root**3))


def _huber(z: Floats) -> Floats:
    """Compute Huber's loss (1964): the square of residuals up to `BEND`, and linear in larger ones."""
    size = np.sqrt(np.maximum(z, BEND**2))
    outside = np.stack((2.0 * BEND * size - BEND**2, BEND / size, -0.5 * BEND / size**3))
    return np.where(z <= BEND**2, _squares(z), outside)


LOSSES: dict[str, Callable[[Floats], Floats]] = {
    LINEAR: _squares,
    "soft_l1": _soft_l1,
    "huber": _huber,
}


class Unknown(NamedTuple):
    """A free parameter; its coordinate is the logarithm of the value if it cannot be 0, else the value over `scale`."""

    name: str
    """Name of the parameter"""
    start: float
    """Value from which the fit starts"""
    least: float
    """Lower end of the range, which is allowed"""
    most: float
    """Upper end of the range, which is allowed"""
    unit: str
    """Unit of the parameter; empty if it has none"""
    scale: float
    """Change of the value over that of the coordinate, in the unit; 0 where the coordinate is the logarithm"""

    def coordinate(self, value: float) -> float:
        """Return the coordinate of a value."""
        return value / self.scale if self.scale else math.log(value)

    def value(self, coordinate: float) -> float:
        """Return the value at a coordinate, within the range."""
        value = coordinate * self.scale if self.scale else math.exp(min(coordinate, 700.0))
        return min(max(value, self.least), self.most)


def unknowns_of(
    free: Free, names: Sequence[str], parameters: NodeSection, source: str
) -> tuple[Unknown, ...]:
    """Return the free parameters in the order of their names, each with the given range or else its own.

    Args:
        free: What the user wants to fit.
        names: Names of the parameters that may be free.
        parameters: All parameters, from which the fit starts.
        source: Name of the data, for messages.

    Raises:
        UsageError: no name is given, one is given twice or cannot be free, a range is invalid or not within the
            parameter's own, or it does not contain the start.
    """
    if isinstance(free, Mapping):
        pairs: list[tuple[str, Any]] = list(free.items())
    else:
        words = [str(each).partition("=") for each in ([free] if isinstance(free, str) else free)]
        pairs = [(name, ends.split(":") if equals else None) for name, equals, ends in words]
    known, values = known_parameters(type(parameters)), all_values(parameters)
    found: dict[str, Unknown] = {}
    for name, ends in pairs:
        if name in found:
            raise UsageError(f"--free {name}: it is given twice")
        if name not in names:
            what = f"--free {name or repr(name)}: it is not a parameter that can be fitted to {source}"
            raise UsageError(f"{what}; {suggest(name, names)}")
        found[name] = _unknown(name, ends, known[name], float(values[name]))
    if not found:
        raise UsageError(f"calibrate: no parameter is free; name one, such as --free {names[0]}")
    return tuple(found.values())


def _unknown(name: str, ends: Any, declared: Declaration, start: float) -> Unknown:
    _, _, least, most, words = declared
    try:
        low, high = (least, most) if ends is None else map(float, ends)
    except (TypeError, ValueError):
        low = high = math.nan
    if not least <= low < high <= most:
        given = ":".join(map(str, ends)) if isinstance(ends, Sequence) else repr(ends)
        raise UsageError(
            f"--free {name}: range {given} is not allowed; two increasing numbers within {least:g} to "
            f"{most:g}, as {least:g}:{most:g}"
        )
    if not low <= start <= high:
        raise UsageError(
            f"--free {name}: it starts from {start:g}, outside of {low:g} to {high:g}; give another value "
            "or range"
        )
    excluded = words.split("; ")  # ends of the range that are not allowed themselves
    logarithmic = low > 0.0 or (low == 0.0 and f"> {least:g}" in excluded)
    if low == least and f"> {least:g}" in excluded:
        low = float(np.nextafter(low, high))
    if high == most and f"< {most:g}" in excluded:
        high = float(np.nextafter(high, low))
    scale = (
        0.0 if logarithmic else abs(start) or abs(float(declared.default)) or 0.1 * (high - low)
    )
    return Unknown(name, start, low, high, declared.unit, scale)


@dataclass(frozen=True)
class Data:
    """Measurements to which a model is fitted: from a table or from a bag."""

    source: str
    """Name of the file, bag or table, for messages"""
    digest: str
    """SHA-256 of the file or bag; empty for a table in memory"""
    answers: dict[str, Floats]
    """Measured columns by name, shape (n,) each; NaN where nothing was measured"""

    @property
    def number(self) -> int:
        """Number of measured values."""
        return sum(int(np.isfinite(column).sum()) for column in self.answers.values())


@dataclass(frozen=True)
class Problem:
    """A model with free parameters, and the measurements to fit; subclasses are the models."""

    measured: Data
    unknowns: tuple[Unknown, ...]

    def answers(self, values: Values) -> Any:
        """Compute the model's answers by the names of the measured columns, shape (n,) each.

        Raises:
            UsageError: the parameters are not allowed.
        """
        raise NotImplementedError

    def predicted(self, values: Values) -> Any:
        """Compute the answers in full, as `calibrate` returns them."""
        raise NotImplementedError

    def conclusions(
        self, values: Values, refit: Callable[[Problem], Values]
    ) -> tuple[list[str], dict[str, Any], list[str]]:
        """Return remarks on a fit, parameters that follow from it, and doubts; `refit` fits another such problem."""
        raise NotImplementedError

    def misfits(self, values: Values) -> dict[str, Floats]:
        """Compute answers minus measurements in their units, by column, where something was measured."""
        answers = self.answers(values)
        return {
            name: (answers[name] - column)[np.isfinite(column)]
            for name, column in self.measured.answers.items()
        }


def correlations(misfit: Floats) -> Floats:
    """Compute the correlations of values with those k samples later, shape (n,); 1 at k = 0."""
    spectrum = np.fft.rfft(misfit, 2 * len(misfit))
    products = np.fft.irfft(np.abs(spectrum) ** 2)[: len(misfit)]
    normed: Floats = products / max(float(products[0]), np.finfo(float).tiny)
    return normed


def samples_per_value(misfit: Floats) -> float:
    """Return τ, 1 or more; 1 where the correlation with the next sample is not significant."""
    if len(misfit) < 2 or (known := correlations(misfit))[1] * math.sqrt(len(misfit)) <= SURE:
        return 1.0
    ends = np.flatnonzero(known <= 0.0)
    return float(1.0 + 2.0 * known[1 : ends[0] if len(ends) else None].sum())


@dataclass(frozen=True)
class Fit:
    """A place, the coordinates of the p free parameters, shape (p,), and how well it fits."""

    problem: Problem
    loss: str
    given: frozenset[str]
    """Columns whose noise was given"""
    noise: Values
    """Standard deviation of each measured column, in its unit"""
    place: Floats
    steps: Floats
    """Steps of difference quotients, in coordinates, shape (p,)"""
    ends: tuple[Floats, ...] = ()
    """Place at which the search from each start ended"""
    independent: float = 1.0
    """Fraction of the measurements that counts: below 1 where residuals are correlated from sample to sample"""

    @classmethod
    def begun(cls, problem: Problem, loss: str, given: Mapping[str, float]) -> Fit:
        """Begin at the start, with the given noise, or a guess of its order of magnitude."""
        noise = {}
        for name, column in problem.measured.answers.items():
            known = column[np.isfinite(column)]
            spread, largest = float(np.std(known)), float(np.abs(known).max())
            # equal values differ by rounding, not by noise
            noise[name] = given.get(name) or (
                spread if spread > SMALL * largest else largest or 1.0
            )
        start = np.array([unknown.coordinate(unknown.start) for unknown in problem.unknowns])
        return cls(problem, loss, frozenset(given), noise, start, np.full(len(start), STEP))

    @property
    def bounds(self) -> tuple[Floats, Floats]:
        """Lower and upper ends of the coordinates, shape (p,) each."""
        ends = [
            (each.coordinate(each.least), each.coordinate(each.most))
            for each in self.problem.unknowns
        ]
        low, high = np.array(ends).T
        return low, high

    def values(self, place: Floats | None = None) -> Values:
        """Return the values of the parameters at a place, or at that of the fit, by name."""
        coordinates = (self.place if place is None else place).tolist()
        return {
            each.name: each.value(at)
            for each, at in zip(self.problem.unknowns, coordinates, strict=True)
        }

    def residuals(self, place: Floats) -> Floats:
        """Compute all misfits in units of the noise, column by column; `FAR` if the parameters are not allowed."""
        try:
            return scaled(self.problem.misfits(self.values(place)), self.noise)
        except UsageError:
            return np.full(self.problem.measured.number, FAR)

    def jacobian(self, place: Floats, which: Iterable[int] | None = None) -> Floats:
        """Compute the slopes of the residuals over all coordinates, or some of them, by central differences."""
        low, high = self.bounds
        columns = []
        for index in range(len(place)) if which is None else which:
            ends = np.tile(place, (2, 1))
            ends[:, index] = np.clip(
                place[index] + self.steps[index] * np.array([-1.0, 1.0]), low[index], high[index]
            )
            residuals = [self.residuals(end) for end in ends]
            for side in (0, 1):
                if abs(residuals[side][0]) >= FAR:  # there is no model
                    ends[side], residuals[side] = place, self.residuals(place)
            width = ends[1, index] - ends[0, index]
            columns.append(
                (residuals[1] - residuals[0]) / width if width else np.zeros_like(residuals[0])
            )
        return np.stack(columns, axis=1)

    def cost(self, place: Floats) -> float:
        """Return half the sum of losses at a place."""
        return float(0.5 * LOSSES[self.loss](self.residuals(place) ** 2)[0].sum())

    @property
    def freedom(self) -> float:
        """Degrees of freedom: independent measurements minus parameters, 1 or more."""
        return max(self.independent * self.problem.measured.number - len(self.place), 1.0)

    @property
    def knows_noise(self) -> bool:
        """Whether the noise of every column was given."""
        return self.given >= self.noise.keys()

    @cached_property
    def calibration(self) -> float:
        """Factor from the rise of twice the cost to a likelihood ratio."""
        number = self.problem.measured.number
        if self.loss == LINEAR:
            return (
                self.independent if self.knows_noise else self.freedom / (number - len(self.place))
            )
        residuals = self.residuals(self.place)
        _, first, second = LOSSES[self.loss](residuals**2)
        slopes, sizes = first + 2.0 * residuals**2 * second, (residuals * first) ** 2
        return float(slopes.sum() / max(sizes.sum(), 1e-300)) * self.freedom / number

    @cached_property
    def slopes(self) -> Floats:
        """Slopes of the residuals over the coordinates, shape (residuals, p)."""
        return self.jacobian(self.place)

    @cached_property
    def covariance(self) -> Floats:
        """Covariance of the estimates in the linear approximation, in coordinates, shape (p, p).

        Directions that change no residual get a very large variance.
        """
        _, singular, directions = np.linalg.svd(self.slopes, full_matrices=False)
        information = np.maximum(singular, SMALL * singular[0]) ** 2
        return np.asarray(
            directions.T / information @ directions / self.calibration, dtype=np.float64
        )

    @property
    def correlation(self) -> Floats:
        """Correlations of the estimates in the linear approximation, shape (p, p)."""
        deviations = np.sqrt(np.maximum(np.diag(self.covariance), np.finfo(float).tiny))
        matrix: Floats = np.clip(self.covariance / np.outer(deviations, deviations), -1.0, 1.0)
        return matrix

    def quantile(self, level: float) -> float:
        """Quantile of the likelihood ratio for a probability, if the held value is the true one."""
        return float(chi2.ppf(level, 1) if self.knows_noise else f.ppf(level, 1, self.freedom))

    @cached_property
    def least_cost(self) -> float:
        """Cost of the fit itself."""
        return self.cost(self.place)

    def ratio(self, place: Floats) -> float:
        """Return the likelihood ratio of the fit to a place."""
        return 2.0 * self.calibration * (self.cost(place) - self.least_cost)

    def searched(
        self,
        start: Floats,
        held: Sequence[int] = (),
        *,
        precision: float = PRECISION,
        tries: int = MOST_TRIES,
    ) -> Floats:
        """Search for the place of least cost from a start; the coordinates with indices `held` stay fixed."""
        moving = [index for index in range(len(start)) if index not in held]
        if not moving:
            return start
        low, high = (ends[moving] for ends in self.bounds)
        inside = np.minimum(SMALL, 0.25 * (high - low))

        def whole(part: Floats) -> Floats:
            place = start.copy()
            place[moving] = part
            return place

        result = least_squares(
            lambda part: self.residuals(whole(part)),
            np.clip(start[moving], low + inside, high - inside),
            jac=lambda part: self.jacobian(whole(part), moving),
            bounds=(low, high),
            x_scale="jac",
            loss=LINEAR if self.loss == LINEAR else LOSSES[self.loss],
            ftol=precision,
            xtol=precision,
            gtol=precision,
            max_nfev=tries,
        )
        return whole(result.x)

    def settled(self) -> Fit:
        """Search and estimate the noise alternately, until both converge."""
        fit, number = self, self.problem.measured.number
        for _ in range(ROUNDS):
            fit = replace(fit, place=fit.searched(fit.place))
            misfits, noise = self.problem.misfits(fit.values()), dict(fit.noise)
            part_free = 1.0 - len(fit.place) / number
            for name in misfits.keys() - self.given:
                least = SMALL * float(np.nanmax(np.abs(self.problem.measured.answers[name])))
                size = np.sqrt(np.mean(misfits[name] ** 2))
                if self.loss != LINEAR:  # outliers leave the median
                    size = np.median(np.abs(misfits[name])) / NORMAL_MEDIAN
                noise[name] = max(float(size / math.sqrt(part_free)), least, np.finfo(float).tiny)
            new = replace(fit, noise=noise)
            resolved = 0.5 / np.maximum(np.linalg.norm(new.slopes, axis=0), 1.0)
            new = replace(new, steps=np.clip(resolved, LEAST_STEP, STEP))
            steady = all(abs(noise[name] / fit.noise[name] - 1.0) < STEADY for name in noise)
            steady &= bool((np.abs(np.log(new.steps / fit.steps)) < 0.5).all())
            fit = replace(new, independent=1.0 / max(map(samples_per_value, misfits.values())))
            if steady:
                break
        return fit


def scaled(misfits: Mapping[str, Floats], noise: Mapping[str, float]) -> Floats:
    """Divide misfits by the noise, and join them, one column after another."""
    return np.concatenate([misfits[name] / noise[name] for name in misfits])


def fitted(
    problem: Problem,
    loss: str,
    given: Mapping[str, float],
    starts: int,
    advance: OnProgress,
) -> Fit:
    """Find the best fit.

    Args:
        problem: Model and measurements.
        loss: Name of the loss, a key of `LOSSES`.
        given: Noise of the columns for which it is known.
        starts: Number of starts: the parameters' own, and the best of many places spread evenly around it.
        advance: Called with the number of finished starts and the number of all.

    Raises:
        UsageError: a free parameter changes nothing that was measured.
    """
    first = Fit.begun(problem, loss, given)
    for unknown, slope in zip(problem.unknowns, np.abs(first.slopes).max(axis=0), strict=True):
        if slope < NO_EFFECT:
            raise UsageError(
                f"--free {unknown.name}: around {unknown.start:g} it changes no measured value "
                f"({', '.join(first.noise)}); leave it fixed, or measure something that it changes"
            )
    places = [first.place]
    if starts > 1:
        low, high = first.bounds
        least, most = np.maximum(first.place - REACH, low), np.minimum(first.place + REACH, high)
        drawn = qmc.LatinHypercube(len(low), seed=SEED).random(
            max(SCREENED * len(low), starts - 1)
        )
        places += sorted(least + drawn * (most - least), key=first.cost)[: starts - 1]
    ends = []
    for done, start in enumerate(places, start=1):
        ends.append(first.searched(start, precision=COARSE, tries=COARSE_TRIES))
        advance(done, starts)
    return replace(first, place=min(ends, key=first.cost), ends=tuple(ends)).settled()


class Interval(NamedTuple):
    """Interval of a parameter's value, in the parameter's unit.

    Example:
        >>> from knee_contact_ros.lab.calibrate.fit import Interval
        >>> Interval(low=2e7, high=1e15, low_open=False, high_open=True).is_narrow
        False
    """

    low: float
    """Lower end"""
    high: float
    """Upper end"""
    low_open: bool
    """Whether the data do not bound the value from below; `low` is then the end of its range or of the search"""
    high_open: bool
    """Whether the data do not bound the value from above; `high` is then the end of its range or of the search"""

    def __str__(self) -> str:
        if self.low_open:
            return "not bounded" if self.high_open else f"below {self.high:.6g}"
        return f"above {self.low:.6g}" if self.high_open else f"{self.low:.6g} to {self.high:.6g}"

    @property
    def is_narrow(self) -> bool:
        """Whether the data determine the value."""
        small, large = sorted((abs(self.low), abs(self.high)))
        return (
            self.low * self.high > 0.0
            and large < WIDE * small
            and not (self.low_open or self.high_open)
        )


def intervals(fit: Fit, level: float, advance: OnProgress) -> tuple[list[Interval], Floats | None]:
    """Compute the interval of each parameter.

    Args:
        fit: The fit.
        level: Probability of the intervals.
        advance: Called with the number of finished parameters and the number of all.

    Returns:
        The intervals; and the best place found meanwhile, if it is better than the fit.
    """
    found, better = [], list[Floats]()
    for index, unknown in enumerate(fit.problem.unknowns):
        limit = math.sqrt(fit.quantile(level))
        (low, low_open), (high, high_open) = (
            _end(fit, index, side, limit, better) for side in (-1.0, 1.0)
        )
        found.append(Interval(unknown.value(low), unknown.value(high), low_open, high_open))
        advance(len(found), len(fit.place))
    return found, min(better, key=fit.cost, default=None)


def _end(
    fit: Fit, index: int, side: float, limit: float, better: list[Floats]
) -> tuple[float, bool]:
    """Find the coordinate of an end of an interval, and whether it is open.

    `side` is -1 for the lower end and 1 for the upper one; `limit` is the root of the likelihood ratio there. Places
    that fit better are added to `better`.
    """
    best, bounds, spread = fit.place, fit.bounds, fit.covariance
    at, variance = float(best[index]), float(spread[index, index])
    usable = 0.0 < variance < math.inf
    deviation = math.sqrt(variance) if usable else 0.1
    slopes = (
        spread[:, index] / variance if usable else np.eye(len(spread))[index]
    )  # along the valley of the cost
    solved = {0.0: best}

    @cache
    def rise(reach: float) -> float:
        """Compute the root of the likelihood ratio at a distance from the fit, minus its limit."""
        if reach == 0.0:
            return -limit
        near = min(solved, key=lambda each: abs(each - reach))
        start = np.clip(solved[near] + side * (reach - near) * slopes, *bounds)
        start[index] = at + side * reach
        solved[reach] = fit.searched(start, held=[index])
        ratio = fit.ratio(solved[reach])
        if ratio < -BETTER:
            better.append(solved[reach])
        return math.sqrt(max(ratio, 0.0)) - limit

    furthest = min(abs(float(bounds[int(side > 0.0)][index] - at)), WIDEST)
    inner, outer = 0.0, min(float(np.clip(limit * deviation, SMALL, 1.0)), furthest)
    while outer == 0.0 or rise(outer) < 0.0:
        if outer >= furthest:
            return at + side * outer, True
        inner, outer = outer, min(1.5 * outer, furthest)
    close = min(1e-3 * deviation, 0.01 * outer)
    return at + side * brentq(rise, inner, outer, xtol=close, rtol=1e-6), False


def doubts(fit: Fit, bounds: Sequence[Interval], level: float) -> Iterator[str]:
    """Return all doubts about a fit, and about its intervals of a level if computed, a sentence each."""
    yield from _trades(fit, bounds)
    for unknown, place, least, most in zip(
        fit.problem.unknowns, fit.place, *fit.bounds, strict=True
    ):
        if min(place - least, most - place) < AT_END:
            end = unknown.least if place - least < most - place else unknown.most
            yield f"{unknown.name}: the fit lies at the end of its range, {end:.6g}: the best value may lie beyond it"
    for unknown, interval in zip(fit.problem.unknowns, bounds, strict=False):
        if sides := [
            side for side, is_open in zip(("below", "above"), interval[2:], strict=True) if is_open
        ]:
            yield f"{unknown.name} is not bounded by the data {' or '.join(sides)}"
    distance = np.maximum(np.sqrt(np.diag(fit.covariance)), AT_END)
    for other in fit.ends:
        if (np.abs(other - fit.place) > distance).any():
            there = fit.searched(other)  # else it may lie in the same valley
            if (np.abs(there - fit.place) > distance).any() and fit.ratio(there) < fit.quantile(
                level
            ):
                values = [f"{name} {value:.6g}" for name, value in fit.values(there).items()]
                yield f"another fit is as good within the level: {', '.join(values)}"
                break
    yield from _left(fit)


def _left(fit: Fit) -> Iterator[str]:
    """Report given noise that disagrees with the residuals, and correlated residuals."""
    for name, misfit in fit.problem.misfits(fit.values()).items():
        number = fit.independent * len(misfit)
        total = fit.independent * float(((misfit / fit.noise[name]) ** 2).sum())
        if fit.loss == LINEAR and name in fit.given:
            left = f"{name}: the residuals are {np.sqrt(total / number):.3g} times the given noise"
            if chi2.sf(total, number) < UNLIKELY:
                yield f"{left}: the model does not describe it, or the noise is larger; the intervals are too narrow"
            elif chi2.cdf(total, number) < UNLIKELY:
                yield f"{left}; the intervals are too wide"
        if (worth := samples_per_value(misfit)) > 1.0:
            yield (
                f"{name}: the residuals are correlated from sample to sample (by {correlations(misfit)[1]:.2f}): "
                f"{len(misfit)} samples count as {round(len(misfit) / worth)}, and the intervals are wider for it; "
                "they do not include the error of the model itself"
            )


def _trades(fit: Fit, bounds: Sequence[Interval]) -> Iterator[str]:
    """Describe each group of parameters that trade off, in a sentence that shows how they change together.

    In such a direction the slopes, scaled to one size for all parameters, nearly vanish; for two parameters their
    correlation exceeds `HIGH`.
    """
    unknowns, sizes = fit.problem.unknowns, np.linalg.norm(fit.slopes, axis=0)
    sizes[sizes == 0.0] = 1.0
    _, singular, directions = np.linalg.svd(fit.slopes / sizes, full_matrices=False)
    for direction in directions[singular < math.sqrt(1.0 - HIGH)]:
        group = np.flatnonzero(np.abs(direction) > IN_GROUP).tolist()
        steps = direction / sizes
        steps *= (SHOWN if unknowns[group[0]].scale else math.log1p(SHOWN)) / steps[group[0]]
        changes = []
        for unknown, step in ((unknowns[index], float(steps[index])) for index in group):
            size = f"{abs(step * unknown.scale):.3g} {unknown.unit}".strip()
            size = size if unknown.scale else f"{abs(100 * math.expm1(step)):.3g} %"
            changes.append(f"{unknown.name} {size} {'up' if step > 0.0 else 'down'}")
        names = " and ".join(unknowns[index].name for index in group)
        known = bool(bounds) and all(bounds[index].is_narrow for index in group)
        yield f"{names} trade off: {' with '.join(changes)} gives nearly the same answers; " + (
            "take them from one fit, never one of them alone"
            if known
            else "these data cannot tell them apart: hold one of them, or measure over a wider range"
        )
