"""Find the parameters that fit best, how well the data know them, and what makes the answer doubtful.

**Fit.** SciPy's bounded least squares from several starts, in coordinates (logarithms where a value cannot be 0). The
noise of a column that is not given is that of its own misfits: fit and noise are computed alternately until both
converge, which is the most likely choice of both.

**Losses.** A residual counts by its square, or less where it is large. Each loss ρ is a function of z = (residual /
noise)², given with its first two derivatives, shape (3, n), as `scipy.optimize.least_squares` takes it. With ψ(r) =
r ρ'(r²), twice the rise of the cost times Σψ'/Σψ² is distributed as χ² where a parameter has its true value (Schrader &
Hettmansperger 1980, Biometrika 67:93-101); for squares that factor is one over the variance.

**Correlated residuals.** n values whose correlation over k samples is ρ(k) determine a mean as well as n / τ
independent ones, τ = 1 + 2 Σ ρ(k) (Bayley & Hammersley 1946, doi:10.2307/2983560). The sum ends where ρ is first 0 or
less: the rest is mostly the estimate's own noise. This holds for what changes as slowly as the residuals do; what
changes faster is known better.

**Intervals** are by profile likelihood: a parameter is held, the others are fitted again, until the fit is
significantly worse. The interval of a level ends where the likelihood ratio of the value held to the best one reaches
the level's quantile: of χ² with one degree of freedom, or of F(1, n - p) where a noise is estimated from the same data
(Bates & Watts 1988, Nonlinear Regression Analysis, Ch. 6; Venzon & Moolgavkar 1988, Applied Statistics 37:87-94). Where
residuals are autocorrelated, n is the number of independent values that they are worth. An interval need not be
symmetric, and it may have no end within the parameter's range: the data do not bound it there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq, least_squares
from scipy.stats import chi2, f, qmc

from knee_contact_ros.lab.calibrate.problem import Noise, Problem, Unknown
from knee_contact_ros.model.types import Floats
from knee_contact_ros.system.errors import UsageError

LINEAR = "linear"
BEND = 1.345
"""Residual at the bend of Huber's loss, in units of the noise: 95 % as efficient as squares for normal noise"""
NORMAL_MEDIAN = 0.6744897501960817
"""Median of the absolute value of a standard normal number"""
SURE = 4.0
"""The least ratio of the correlation with the next sample to its own standard deviation, for it to count"""
PRECISION, MOST_TRIES = 1e-10, 100
"""Relative change of cost and place, and slope, at which a search ends, and its largest number of evaluations"""
COARSE, COARSE_TRIES = 1e-6, 30
"""The same of the searches from several starts, the best of which is continued"""
REACH = 4.0
"""The largest factor between another start and the first one; where a coordinate is no logarithm, its logarithm is the
largest difference of the coordinates"""
ROUNDS, STEADY, STEPS_STEADY = 30, 1e-3, 0.5
"""The largest number of rounds of fit and noise; the relative change of a noise, and that of the logarithms of the
difference quotients' steps, at which they end"""
LEAST_NOISE = 1e-9
"""The least noise of a column, relative to its largest value"""
SCREENED = 50
"""Number of places around the first start, for each parameter, of which the best become the other starts"""
INSIDE = 1e-9
"""Distance [coordinates] from the bounds within which a search does not begin"""
SEED = 20
"""Seed of the starts: the same fit has the same answer"""
NO_EFFECT = 1e-5
"""Slope of a residual, in spreads of its column over an e-fold change, below which a parameter has no effect: a
thousandth of what the model's own error could make of it"""
WIDEST = math.log(1e9)
"""The largest distance [coordinates] from the fit at which an end of an interval is searched for"""
CLOSE = 1e-3
"""Precision of an end, relative to the standard deviation"""
BETTER = 1e-2
"""Likelihood ratio by which a place must be better than the fit to replace it"""
NOTHING = 1e-9
"""The least singular value of a direction, relative to the largest one"""
UNKNOWN_DEVIATION, LEAST_REACH, LARGEST_REACH = 0.1, 1e-9, 1.0
"""Standard deviation [coordinates] where it is not known, and range of the first step of a search for an end"""
HIGH = 0.95
"""Correlation above which two parameters trade off"""
IN_GROUP = 0.3
"""The least component that a parameter has in a direction to belong to it"""
WIDE = 2.0
"""Ratio of the ends of an interval from which on a value counts as not known"""
SHOWN = 0.1
"""Relative change of the first parameter in the description of a trade-off"""
UNLIKELY = 1e-4
"""Probability of the residuals below which the noise given is doubted"""
AT_END = 1e-3
"""Distance [coordinates] from the end of a range within which a value counts as lying at the end"""
APART = 1.0
"""The least distance [standard deviations] of another minimum in a coordinate"""


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


LOSSES: dict[str, Callable[[Floats], Floats]] = {LINEAR: _squares, "soft_l1": _soft_l1, "huber": _huber}


def correlations(misfit: Floats) -> Floats:
    """Compute the correlations of values with those k samples later, shape (n,); 1 at k = 0."""
    spectrum = np.fft.rfft(misfit, 2 * len(misfit))
    products = np.fft.irfft(np.abs(spectrum) ** 2)[: len(misfit)]
    normed: Floats = products / max(float(products[0]), np.finfo(float).tiny)
    return normed


def alike(misfit: Floats) -> float:
    """Give the correlation with the next sample if it is significantly above 0, else 0."""
    if len(misfit) < 2:
        return 0.0
    next_one = float(correlations(misfit)[1])
    return next_one if next_one * np.sqrt(len(misfit)) > SURE else 0.0


def samples_per_value(misfit: Floats) -> float:
    """Give τ, 1 or more; 1 where the correlation is not significant."""
    if not alike(misfit):
        return 1.0
    known = correlations(misfit)
    ends = np.flatnonzero(known <= 0.0)
    return float(1.0 + 2.0 * known[1 : ends[0] if len(ends) else None].sum())


def independent_part(misfits: Mapping[str, Floats]) -> float:
    """Give 1 / τ of the column with the largest τ, which decides for all columns."""
    return 1.0 / max(map(samples_per_value, misfits.values()))


@dataclass(frozen=True)
class Minimum:
    """The best fit that was found."""

    problem: Problem
    loss: str
    place: Floats
    """Coordinates of the parameters, shape (p,)"""
    noise: Noise
    given: frozenset[str]
    """Columns whose noise was given"""
    ends: tuple[Floats, ...] = ()
    """Place at which the search from each start ended"""
    independent: float = 1.0
    """Part of the measurements that counts: less than 1 where residuals are correlated from sample to sample"""

    @property
    def freedom(self) -> float:
        """Degrees of freedom: independent measurements less parameters, 1 or more."""
        return max(self.independent * self.problem.measured.number - len(self.place), 1.0)

    @property
    def knows_noise(self) -> bool:
        """Whether the noise of every column was given."""
        return self.given >= self.problem.measured.answers.keys()

    def cost(self, place: Floats) -> float:
        """Give half the sum of losses at a place."""
        return float(0.5 * LOSSES[self.loss](self.problem.residuals(place, self.noise) ** 2)[0].sum())

    @cached_property
    def calibration(self) -> float:
        """Factor that turns a rise of twice the cost into a likelihood ratio."""
        number = self.problem.measured.number
        if self.loss == LINEAR:
            return self.independent if self.knows_noise else self.freedom / (number - len(self.place))
        residuals = self.problem.residuals(self.place, self.noise)
        _, first, second = LOSSES[self.loss](residuals**2)
        slopes, sizes = first + 2.0 * residuals**2 * second, (residuals * first) ** 2
        return float(slopes.sum() / max(sizes.sum(), 1e-300)) * self.freedom / number

    @cached_property
    def slopes(self) -> Floats:
        """Slopes of the residuals over the coordinates, shape (residuals, p)."""
        return self.problem.jacobian(self.place, self.noise)

    @cached_property
    def covariance(self) -> Floats:
        """Covariance of the estimates in the linear approximation, in coordinates, shape (p, p).

        Directions that change no residual get a very large variance.
        """
        _, singular, directions = np.linalg.svd(self.slopes, full_matrices=False)
        information = np.maximum(singular, NOTHING * singular[0]) ** 2
        return np.asarray(directions.T / information @ directions / self.calibration, dtype=np.float64)

    @property
    def correlation(self) -> Floats:
        """Correlations of the estimates in the linear approximation, shape (p, p)."""
        deviations = np.sqrt(np.maximum(np.diag(self.covariance), np.finfo(float).tiny))
        matrix: Floats = np.clip(self.covariance / np.outer(deviations, deviations), -1.0, 1.0)
        return matrix

    def quantile(self, level: float) -> float:
        """Value that a likelihood ratio does not exceed with a probability, if the value held is the true one."""
        return float(chi2.ppf(level, 1) if self.knows_noise else f.ppf(level, 1, self.freedom))

    def searched(
        self, start: Floats, held: Sequence[int] = (), *, precision: float = PRECISION, tries: int = MOST_TRIES
    ) -> Floats:
        """Search for the place of the least cost from a start; the coordinates with indices `held` stay."""
        moving = [index for index in range(len(start)) if index not in held]
        if not moving:
            return start
        low, high = (ends[moving] for ends in self.problem.bounds)
        inside = np.minimum(INSIDE, 0.25 * (high - low))

        def whole(part: Floats) -> Floats:
            place = start.copy()
            place[moving] = part
            return place

        result = least_squares(
            lambda part: self.problem.residuals(whole(part), self.noise),
            np.clip(start[moving], low + inside, high - inside),
            jac=lambda part: self.problem.jacobian(whole(part), self.noise, moving), bounds=(low, high), method="trf",
            loss=LINEAR if self.loss == LINEAR else LOSSES[self.loss], x_scale="jac",
            ftol=precision, xtol=precision, gtol=precision, max_nfev=tries,
        )  # fmt: skip
        return whole(result.x)

    def settled(self) -> Minimum:
        """Search and estimate the noise alternately, until both converge."""
        minimum = self
        for _ in range(ROUNDS):
            minimum = replace(minimum, place=minimum.searched(minimum.place))
            problem, misfits, noise = minimum.problem, minimum.problem.misfits(minimum.place), dict(minimum.noise)
            for name in misfits.keys() - self.given:
                least = LEAST_NOISE * float(np.nanmax(np.abs(problem.measured.answers[name])))
                noise[name] = max(self._noise_of(misfits[name]), least, np.finfo(float).tiny)
            finer = problem.with_steps_for(minimum.place, noise)
            steady = all(abs(noise[name] / minimum.noise[name] - 1.0) < STEADY for name in noise)
            steady &= bool((np.abs(np.log(finer.steps / problem.steps)) < STEPS_STEADY).all())
            minimum = replace(minimum, problem=finer, noise=noise)
            if steady:
                break
        return replace(minimum, independent=independent_part(minimum.problem.misfits(minimum.place)))

    def _noise_of(self, misfits: Floats) -> float:
        """Estimate a column's noise from its misfits; for a robust loss by their median, which outliers leave."""
        part_free = 1.0 - len(self.place) / self.problem.measured.number
        if self.loss == LINEAR:
            return float(np.sqrt(np.mean(misfits**2) / part_free))
        return float(np.median(np.abs(misfits)) / NORMAL_MEDIAN / np.sqrt(part_free))


def fitted(problem: Problem, loss: str, given: Noise, starts: int, advance: Callable[[int, int], None]) -> Minimum:
    """Find the best fit.

    Args:
        problem: Model and measurements.
        loss: Name of the loss, a key of `LOSSES`.
        given: Noise of the columns for which it is known.
        starts: Number of starts.
        advance: Called with the number of starts that are done, and the number of all.

    Raises:
        UsageError: a free parameter changes nothing that was measured.
    """
    measured = problem.measured.answers
    noise = {name: given.get(name) or _spread(column) for name, column in measured.items()}
    first = Minimum(problem, loss, problem.start, noise, frozenset(given))
    for unknown, slope in zip(problem.unknowns, np.abs(first.slopes).max(axis=0), strict=True):
        if slope < NO_EFFECT:
            raise UsageError(f"--free {unknown.name}: around {unknown.start:g} it changes no measured value "
            f"({', '.join(measured)}); leave it fixed, or measure something that it changes")  # fmt: skip
    ends = []
    for done, start in enumerate(_starts(first, starts), start=1):
        ends.append(first.searched(start, precision=COARSE, tries=COARSE_TRIES))
        advance(done, starts)
    return replace(first, place=min(ends, key=first.cost), ends=tuple(ends)).settled()


def _starts(first: Minimum, number: int) -> list[Floats]:
    """Give the parameters' own start, and the best of many places that are spread evenly around it."""
    if number == 1:
        return [first.place]
    low, high = first.problem.bounds
    reach = np.log(REACH)
    least, most = np.maximum(first.place - reach, low), np.minimum(first.place + reach, high)
    drawn = qmc.LatinHypercube(len(low), seed=SEED).random(max(SCREENED * len(low), number - 1))
    places = least + drawn * (most - least)
    best = np.argsort([first.cost(place) for place in places], kind="stable")
    return [first.place, *places[best[: number - 1]]]


def _spread(column: Floats) -> float:
    """Make a first guess of a column's noise, of the right order; equal values differ by rounding, not by noise."""
    known = column[np.isfinite(column)]
    spread, largest = float(np.std(known)), float(np.abs(known).max())
    return spread if spread > LEAST_NOISE * largest else largest or 1.0


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

    def __str__(self) -> str:
        if self.low_open:
            return "not bounded" if self.high_open else f"below {self.high:.6g}"
        return f"above {self.low:.6g}" if self.high_open else f"{self.low:.6g} to {self.high:.6g}"


def intervals(
    minimum: Minimum, level: float, advance: Callable[[int, int], None]
) -> tuple[list[Interval], Floats | None]:
    """Compute the interval of each parameter.

    Args:
        minimum: The fit.
        level: Probability of the intervals.
        advance: Called with the number of ends that are found, and the number of all.

    Returns:
        The intervals; and the best place that was found on the way, if it is better than the fit.
    """
    found, better = [], list[Floats]()
    for index, unknown in enumerate(minimum.problem.unknowns):
        ends = []
        for side in (-1.0, 1.0):
            ends.append(_end(minimum, index, side, math.sqrt(minimum.quantile(level)), better))
            advance(len(ends) + 2 * index, 2 * len(minimum.place))
        (low, low_open), (high, high_open) = ends
        found.append(Interval(unknown.value(low), unknown.value(high), low_open, high_open))
    return found, min(better, key=minimum.cost, default=None)


def _end(minimum: Minimum, index: int, side: float, limit: float, better: list[Floats]) -> tuple[float, bool]:
    """Find the coordinate of an end of an interval, and whether it is open.

    `side` is -1 for the lower end and 1 for the upper one, `limit` the root of the likelihood ratio at the end. Places
    that are better than the fit are added to `better`.
    """
    best, bounds, spread = minimum.place, minimum.problem.bounds, minimum.covariance
    at, cost = float(best[index]), minimum.cost(best)
    variance = float(spread[index, index])
    usable = 0.0 < variance < math.inf
    deviation = math.sqrt(variance) if usable else UNKNOWN_DEVIATION
    slopes = spread[:, index] / variance if usable else np.eye(len(spread))[index]  # along the valley of the cost
    solved, known = {0.0: best}, {0.0: -limit}

    def rise(reach: float) -> float:
        """Compute the root of the likelihood ratio at a distance from the fit, less its limit."""
        if reach not in known:
            near = min(solved, key=lambda each: abs(each - reach))
            start = np.clip(solved[near] + side * (reach - near) * slopes, *bounds)
            start[index] = at + side * reach
            solved[reach] = minimum.searched(start, held=[index])
            ratio = 2.0 * minimum.calibration * (minimum.cost(solved[reach]) - cost)
            if ratio < -BETTER:
                better.append(solved[reach])
            known[reach] = math.sqrt(max(ratio, 0.0)) - limit
        return known[reach]

    furthest = min(abs(float(bounds[int(side > 0.0)][index] - at)), WIDEST)
    inner, outer = 0.0, min(np.clip(limit * deviation, LEAST_REACH, LARGEST_REACH), furthest)
    while rise(outer) < 0.0:
        if outer >= furthest:
            return at + side * outer, True
        # The root of the ratio grows along a straight line as a rule
        further = outer * min(max(1.05 * limit / (known[outer] + limit + 1e-12), 1.2), 3.0)
        inner, outer = outer, min(further, furthest)
    close = min(CLOSE * deviation, 0.01 * outer)
    return at + side * (brentq(rise, inner, outer, xtol=close, rtol=1e-6) if outer > inner else outer), False


def trades(minimum: Minimum, bounds: Sequence[Interval] | None) -> Iterator[str]:
    """Describe each group of parameters that trade off, in a sentence with how they change together.

    Such a direction is one in which the slopes, scaled to one size for all parameters, nearly vanish: for two
    parameters, where their correlation exceeds `HIGH`.

    Args:
        minimum: The fit.
        bounds: Intervals of the parameters; None if they were not computed.
    """
    unknowns, sizes = minimum.problem.unknowns, np.linalg.norm(minimum.slopes, axis=0)
    sizes[sizes == 0.0] = 1.0
    _, singular, directions = np.linalg.svd(minimum.slopes / sizes, full_matrices=False)
    for direction in directions[singular < math.sqrt(1.0 - HIGH)]:
        group = np.flatnonzero(np.abs(direction) > IN_GROUP).tolist()
        steps = direction / sizes
        steps *= (SHOWN if unknowns[group[0]].scale else math.log1p(SHOWN)) / steps[group[0]]
        changes = " with ".join(_change(unknowns[index], float(steps[index])) for index in group)
        names = " and ".join(unknowns[index].name for index in group)
        known = bounds is not None and all(_is_known(bounds[index]) for index in group)
        yield f"{names} trade off: {changes} gives nearly the same answers; " + (
            "take them from one fit, never one of them alone" if known
            else "these data cannot tell them apart: hold one of them, or measure over a wider range"
        )  # fmt: skip


def _change(unknown: Unknown, step: float) -> str:
    """Write a step of a coordinate as a change of the value."""
    size = (
        f"{abs(step * unknown.scale):.3g} {unknown.unit}" if unknown.scale else f"{abs(100 * math.expm1(step)):.3g} %"
    )
    return f"{unknown.name} {size.strip()} {'up' if step > 0.0 else 'down'}"


def _is_known(interval: Interval) -> bool:
    low, high, low_open, high_open = interval
    near = low * high > 0.0 and max(abs(low), abs(high)) < WIDE * min(abs(low), abs(high))
    return near and not low_open and not high_open


def doubts(minimum: Minimum, bounds: Sequence[Interval] | None, level: float) -> Iterator[str]:
    """Give all doubts about a fit and its intervals of a level, if there are any, a sentence each."""
    problem = minimum.problem
    for unknown, place, least, most in zip(problem.unknowns, minimum.place, *problem.bounds, strict=True):
        if min(place - least, most - place) < AT_END:
            end = unknown.least if place - least < most - place else unknown.most
            yield f"{unknown.name}: the fit lies at the end of its range, {end:.6g}: the data ask for more"
    for unknown, (_, _, *ends) in zip(problem.unknowns, bounds or (), strict=False):
        if any(ends):
            sides = [side for side, is_open in zip(("below", "above"), ends, strict=True) if is_open]
            yield f"{unknown.name} is not bounded by the data {' or '.join(sides)}"
    yield from _other_fit(minimum, level)
    misfits = problem.misfits(minimum.place)
    if minimum.loss == LINEAR:
        for name in sorted(minimum.given & misfits.keys()):
            yield from _noise_doubts(name, misfits[name] / minimum.noise[name], minimum.independent)
    for name, misfit in misfits.items():
        if correlation := alike(misfit):
            worth = round(len(misfit) / samples_per_value(misfit))
            yield (f"{name}: what is left is alike from sample to sample (correlation {correlation:.2f}): "
                   f"{len(misfit)} samples count as {worth}, and the intervals are wider for it; they do not know the "
                   "model's own error")  # fmt: skip
    yield from problem.doubts(minimum.place)


def _other_fit(minimum: Minimum, level: float) -> Iterator[str]:
    """Report another minimum, if the data do not reject one at the level of the intervals."""
    distance = np.maximum(APART * np.sqrt(np.diag(minimum.covariance)), AT_END)
    for end in minimum.ends:
        if (np.abs(end - minimum.place) > distance).any():
            there = minimum.searched(end)  # else it may lie in the same valley
            ratio = 2.0 * minimum.calibration * (minimum.cost(there) - minimum.cost(minimum.place))
            if (np.abs(there - minimum.place) > distance).any() and ratio < minimum.quantile(level):
                values = [f"{name} {value:.6g}" for name, value in minimum.problem.values(there).items()]
                yield f"another fit is as good within the level: {', '.join(values)}"
                return


def _noise_doubts(name: str, residuals: Floats, part: float) -> Iterator[str]:
    """Report noise that was given and does not agree with a column's residuals, of which a part is independent."""
    total, number = part * float((residuals**2).sum()), part * len(residuals)
    left = f"{name}: what is left is {np.sqrt(total / number):.3g} times the noise given"
    if chi2.sf(total, number) < UNLIKELY:
        yield (f"{left}: the model does not describe it, or the noise is larger; the intervals are too narrow")
    elif chi2.cdf(total, number) < UNLIKELY:
        yield f"{left}; the intervals are too wide"
