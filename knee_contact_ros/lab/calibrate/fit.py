"""The free parameters of a fit: their names, ranges and coordinates.

A problem to be fitted: residuals of given parameters, answers of a model less measurements over their noise.

Loss functions: a residual counts by its square, or less where it is large.

Each loss ρ is a function of z = (residual / noise)², given with its first two derivatives, shape (3, n), as
`scipy.optimize.least_squares` takes it. With ψ(r) = r ρ'(r²), twice the rise of the cost times Σψ'/Σψ² is distributed
as χ² where a parameter has its true value (Schrader & Hettmansperger 1980, Biometrika 67:93-101); for squares that
factor is one over the variance.

The number of independent values that a column of autocorrelated residuals is worth.

n values whose correlation over k samples is ρ(k) determine a mean as well as n / τ independent ones, τ = 1 + 2 Σ ρ(k)
(Bayley & Hammersley 1946, doi:10.2307/2983560). The sum ends where ρ is first 0 or less: the rest is mostly the
estimate's own noise. This holds for what changes as slowly as the residuals do; what changes faster is known better.

Find the parameters that fit best, by SciPy's bounded least squares from several starts, and the noise.

The noise of a column that is not given is that of its own misfits: fit and noise are computed in turns until both
converge, which is the most likely choice of both.

Intervals by profile likelihood: a parameter is held, the others fitted again, until the fit is significantly worse.

The interval of a level ends where the likelihood ratio of the value held to the best one reaches the level's quantile:
of χ² with one degree of freedom, or of F(1, n - p) where a noise is estimated from the same data (Bates & Watts 1988,
Nonlinear Regression Analysis, Ch. 6; Venzon & Moolgavkar 1988, Applied Statistics 37:87-94). Where residuals are
autocorrelated, n is the number of independent values that they are worth (`samples_per_value`). An interval need not be
symmetric, and it may have no end within the parameter's range: the data do not bound it there.

Identifiability: correlations of the estimates, and directions in which parameters change no answer.

Doubts about a fit or its intervals, a sentence for each.
"""

from __future__ import annotations

import difflib
import itertools
import math
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np
from scipy.optimize import brentq, least_squares
from scipy.stats import chi2, f, qmc

from knee_contact_ros.model.types import Floats
from knee_contact_ros.parameters.schema import Declaration
from knee_contact_ros.results import Results
from knee_contact_ros.system.errors import UsageError

Ends = tuple[float, float]
Free = Mapping[str, Sequence[float] | None] | Iterable[str]
"""Names of parameters, or a mapping of names to the ends of narrower ranges"""
UNIT = re.compile(r"\[([^\]]+)\]")
"""The unit with which a parameter's description begins, if it has one"""


class Unknown(NamedTuple):
    """A free parameter; its coordinate is the logarithm of a value that cannot be 0, else the value over `scale`."""

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

    @property
    def bounds(self) -> Ends:
        """Lower and upper end of the coordinate."""
        return self.coordinate(self.least), self.coordinate(self.most)

    def coordinate(self, value: float) -> float:
        """Give the coordinate of a value."""
        return value / self.scale if self.scale else math.log(value)

    def value(self, coordinate: float) -> float:
        """Give the value at a coordinate, within the range."""
        if self.scale:
            return min(max(coordinate * self.scale, self.least), self.most)
        return min(max(math.exp(min(coordinate, 700.0)), self.least), self.most)


class Fittable(NamedTuple):
    """The parameters that may be free in a problem."""

    names: Sequence[str]
    """Names of these parameters"""
    known: Mapping[str, Declaration]
    """Declarations of all parameters, by name"""
    values: Mapping[str, Any]
    """Values of all parameters, by name, from which a fit starts"""
    example: str
    """One of the names"""
    why_not: Callable[[str], str]
    """Gives the reason why another name cannot be free; empty if there is no such parameter"""


def unknowns_of(free: Free, fittable: Fittable) -> tuple[Unknown, ...]:
    """Give the free parameters in the order of their names, with the ranges that are given, or else with their own.

    Raises:
        UsageError: no name is given, one is given twice or cannot be free, a range is no range or is not within the
            parameter's own, or the value to start from is outside of it.
    """
    ranges = _ranges(free)
    if not ranges:
        raise UsageError(f"calibrate: no parameter is free; as --free {fittable.example}")
    for name in ranges:
        _check_name(name, fittable)
    known, values = fittable.known, fittable.values
    return tuple(_unknown(name, ends, known[name], float(values[name])) for name, ends in ranges.items())


def nested(values: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Group parameters named `section.name` by their sections."""
    sections: dict[str, dict[str, Any]] = {}
    for name, value in values.items():
        section, inner = name.split(".")
        sections.setdefault(section, {})[inner] = value
    return sections


def _ranges(free: Free) -> dict[str, Ends | None]:
    """Give the range of each free parameter, by name; None for its own."""
    if isinstance(free, str):
        free = [free]
    if isinstance(free, Mapping):
        return {str(name): None if ends is None else _ends(str(name), ends) for name, ends in free.items()}
    ranges: dict[str, Ends | None] = {}
    for each in free:
        name, equals, ends = str(each).partition("=")
        if name in ranges:
            raise UsageError(f"--free {name}: it is given twice")
        ranges[name] = _ends(name, ends.split(":")) if equals else None
    return ranges


def _ends(name: str, given: Sequence[float | str]) -> Ends:
    try:
        low, high = (float(each) for each in given)
    except (TypeError, ValueError):
        low = high = math.nan
    if not low < high:
        text = ":".join(map(str, given)) if isinstance(given, Sequence) else repr(given)
        raise UsageError(f"--free {name}: range {text!r} is not allowed; two numbers that grow, as 1000:20000")
    return low, high


def _check_name(name: str, fittable: Fittable) -> None:
    if name in fittable.names:
        return
    if reason := fittable.why_not(name):
        raise UsageError(f"--free {name}: {reason}")
    near = difflib.get_close_matches(name, fittable.names, n=1, cutoff=0.6)
    hint = f"did you mean {near[0]}?" if near else f"allowed are {', '.join(fittable.names)}"
    raise UsageError(f"--free {name or repr(name)}: it is no parameter that can be fitted; {hint}")


def _unknown(name: str, ends: Ends | None, declared: Declaration, start: float) -> Unknown:
    least, most, words = declared.limits
    low, high = ends or (least, most)
    if not least <= low < high <= most:
        raise UsageError(f"--free {name}: range {low:g}:{high:g} is not allowed; it must lie in {least:g} to {most:g}")
    if not low <= start <= high:
        raise UsageError(f"--free {name}: it starts from {start:g}, outside of {low:g} to {high:g}; give another value "
                         "or range")  # fmt: skip
    logarithmic = low > 0.0 or (low == 0.0 and f"> {least:g}" in words.split("; "))
    if low == least and f"> {least:g}" in words.split("; "):
        low = float(np.nextafter(low, high))
    if high == most and f"< {most:g}" in words.split("; "):
        high = float(np.nextafter(high, low))
    scale = abs(start) or abs(float(declared.default)) or 0.1 * (high - low)
    unit = UNIT.match(declared.description)
    return Unknown(name, start, low, high, unit[1] if unit else "", 0.0 if logarithmic else scale)


P = TypeVar("P", bound="Problem")
Noise = Mapping[str, float]
"""Standard deviation of each measured column, in its unit"""
STEP, LEAST_STEP, PART = 1e-3, 1e-7, 0.5
"""Steps of difference quotients, in coordinates: STEP at first; later the part PART of what the data resolve, at least
LEAST_STEP, where that is less, since within STEP an impact may come before a sample or after it"""
FAR = 1e8
"""Residual where parameters do not make a model"""


class Data(Protocol):
    """The measurements to which a model is fitted."""

    @property
    def source(self) -> str:
        """Name of the file, bag or table, for messages."""

    @property
    def digest(self) -> str:
        """SHA-256 of the file or bag; empty for a table in memory."""

    @property
    def answers(self) -> dict[str, Floats]:
        """Measured columns by name, shape (n,) each; not a number where nothing was measured."""

    @property
    def number(self) -> int:
        """Number of measured values."""


@dataclass(frozen=True)
class Problem(ABC):
    """A model with free parameters, and measurements to which it is fitted.

    A place is a choice of the p free parameters: their coordinates, shape (p,), see `Unknown`.
    """

    measured: Data
    unknowns: tuple[Unknown, ...]
    """The free parameters"""
    steps: Floats
    """Steps of difference quotients, in coordinates, shape (p,)"""

    @abstractmethod
    def answers(self, place: Floats) -> Any:
        """Compute the model's answers at a place, by the names of the measured columns, shape (n,) each.

        Raises:
            UsageError: the parameters do not make a model.
        """

    @abstractmethod
    def predicted(self, place: Floats) -> Results | dict[str, Floats]:
        """Compute the answers at a place, with all that the caller of `calibrate` gets.

        Raises:
            UsageError: the parameters do not make a model, or inputs are too large for a knee.
        """

    @abstractmethod
    def doubts(self, place: Floats) -> list[str]:
        """Report what is doubtful in the answers at a place, a sentence each."""

    def remarks(self, place: Floats) -> list[str]:  # noqa: ARG002
        """Give further remarks on a fit, a line each."""
        return []

    def also(self, place: Floats) -> dict[str, Any]:  # noqa: ARG002
        """Give parameters that follow from a fit, beside the fitted ones."""
        return {}

    @property
    def start(self) -> Floats:
        """The place from which a fit starts."""
        return np.array([unknown.coordinate(unknown.start) for unknown in self.unknowns])

    @property
    def bounds(self) -> tuple[Floats, Floats]:
        """Lower and upper ends of the coordinates, shape (p,) each."""
        low, high = zip(*(unknown.bounds for unknown in self.unknowns), strict=True)
        return np.array(low), np.array(high)

    def values(self, place: Floats) -> dict[str, float]:
        """Give the values of the parameters at a place, by name."""
        return {unknown.name: unknown.value(float(each)) for unknown, each in zip(self.unknowns, place, strict=True)}

    def misfits(self, place: Floats) -> dict[str, Floats]:
        """Compute answers less measurements in their units, by column, where something was measured.

        Raises:
            UsageError: see `answers`.
        """
        answers, measured = self.answers(place), self.measured.answers
        return {name: (answers[name] - column)[np.isfinite(column)] for name, column in measured.items()}

    def residuals(self, place: Floats, noise: Noise) -> Floats:
        """Compute all misfits in units of the noise, one column after another; `FAR` if there is no model."""
        try:
            return self.scaled(self.misfits(place), noise)
        except UsageError:
            return np.full(self.measured.number, FAR)

    def scaled(self, misfits: Mapping[str, Floats], noise: Noise) -> Floats:
        """Divide misfits by the noise, and join them, one column after another."""
        return np.concatenate([misfits[name] / noise[name] for name in misfits])

    def jacobian(self, place: Floats, noise: Noise, which: Floats | None = None) -> Floats:
        """Compute the slopes of the residuals over coordinates by central differences.

        Args:
            place: Where to compute them.
            noise: The noise of the columns.
            which: Indices of the coordinates; None: all.

        Returns:
            Slopes of shape (residuals, coordinates).
        """
        low, high = self.bounds
        columns = []
        for each in range(len(place)) if which is None else which:
            index, sides = int(each), []
            step = float(self.steps[index])
            for end in (max(place[index] - step, low[index]), min(place[index] + step, high[index])):
                moved = place.copy()
                moved[index] = end
                sides.append((end, self.residuals(moved, noise)))
            (before, below), (behind, above) = [
                side if abs(side[1][0]) < FAR else (place[index], self.residuals(place, noise)) for side in sides
            ]
            columns.append((above - below) / (behind - before) if behind > before else np.zeros_like(above))
        return np.stack(columns, axis=1)

    def with_steps_for(self: P, place: Floats, noise: Noise) -> P:
        """Give the same problem with steps that fit what the data resolve around a place."""
        sizes = np.linalg.norm(self.jacobian(place, noise), axis=0)
        return replace(self, steps=np.clip(PART / np.maximum(sizes, 1.0), LEAST_STEP, STEP))


Loss = Callable[[Floats], Floats]
LINEAR = "linear"
BEND = 1.345
"""Residual at the bend of Huber's loss, in units of the noise: 95 % as efficient as squares for normal noise"""
NORMAL_MEDIAN = 0.6744897501960817
"""Median of the absolute value of a standard normal number"""


def squares(z: Floats) -> Floats:
    """Compute the loss of least squares, z."""
    return np.stack((z, np.ones_like(z), np.zeros_like(z)))


def soft_l1(z: Floats) -> Floats:
    """Compute the loss 2 (√(1 + z) - 1): nearly the square of small residuals, and linear in large ones."""
    root = np.sqrt(1.0 + z)
    return np.stack((2.0 * (root - 1.0), 1.0 / root, -0.5 / root**3))


def huber(z: Floats) -> Floats:
    """Compute Huber's loss (1964): the square of residuals up to `BEND`, and linear in larger ones."""
    size = np.sqrt(np.maximum(z, BEND**2))
    inside = z <= BEND**2
    value = np.where(inside, z, 2.0 * BEND * size - BEND**2)
    return np.stack((value, np.where(inside, 1.0, BEND / size), np.where(inside, 0.0, -0.5 * BEND / size**3)))


LOSSES: dict[str, Loss] = {LINEAR: squares, "soft_l1": soft_l1, "huber": huber}


def cost_of(loss: Loss, residuals: Floats) -> float:
    """Compute half the sum of ρ over residuals in units of their noise."""
    return float(0.5 * loss(residuals**2)[0].sum())


def calibration_of(loss: Loss, residuals: Floats) -> float:
    """Compute Σψ'/Σψ² for residuals in units of their noise; 1 for squares of residuals whose mean square is 1."""
    _, first, second = loss(residuals**2)
    return float((first + 2.0 * residuals**2 * second).sum() / max(((residuals * first) ** 2).sum(), 1e-300))


def noise_of(name: str, misfits: Floats, part_free: float) -> float:
    """Estimate the standard deviation of a column's noise from its misfits.

    A robust loss takes their median size, which outliers do not change.

    Args:
        name: Name of the loss.
        misfits: Answers less measurements, in the column's unit.
        part_free: Degrees of freedom over the number of measurements.
    """
    if name == LINEAR:
        return float(np.sqrt(np.mean(misfits**2) / part_free))
    return float(np.median(np.abs(misfits)) / NORMAL_MEDIAN / np.sqrt(part_free))


SURE = 4.0
"""The least ratio of the correlation with the next sample to its own standard deviation, for it to count"""


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


PRECISION = 1e-10
"""Relative change of cost and place, and slope, at which a search ends"""
MOST_TRIES = 100
"""The largest number of evaluations of a search"""
COARSE, COARSE_TRIES = 1e-6, 30
"""Precision and largest number of evaluations of the searches from several starts, the best of which is continued"""
REACH = 4.0
"""The largest factor between another start and the first one; where a coordinate is no logarithm, its logarithm is the
largest difference of the coordinates"""
TURNS, STEADY = 30, 1e-3
"""The largest number of turns of fit and noise, and the relative change of a noise at which they end"""
STEPS_STEADY = 0.5
"""Change of the logarithms of the difference quotients' steps at which the turns end"""
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
    ends: tuple[tuple[Floats, float], ...]
    """Place at which the search from each start ended, and the cost there"""
    independent: float = 1.0
    """Part of the measurements that counts: less than 1 where residuals are correlated from sample to sample"""

    @property
    def residuals(self) -> Floats:
        """Residuals at the place, in units of the noise."""
        return self.problem.residuals(self.place, self.noise)

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
        return cost_of(LOSSES[self.loss], self.problem.residuals(place, self.noise))

    def calibration(self) -> float:
        """Give the factor that turns a rise of twice the cost into a likelihood ratio."""
        number = self.problem.measured.number
        if self.loss != LINEAR:
            return calibration_of(LOSSES[self.loss], self.residuals) * self.freedom / number
        return self.independent if self.knows_noise else self.freedom / (number - len(self.place))


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
    _check_effects(problem, noise)
    ends = []
    for done, start in enumerate(_starts(problem, loss, noise, starts), start=1):
        place = searched(problem, loss, noise, start, precision=COARSE, tries=COARSE_TRIES)
        ends.append((place, cost_of(LOSSES[loss], problem.residuals(place, noise))))
        advance(done, starts)
    best = min(ends, key=lambda end: end[1])[0]
    return settled(Minimum(problem, loss, best, noise, frozenset(given), tuple(ends)))


def settled(minimum: Minimum) -> Minimum:
    """Continue the search in turns with estimates of the noise, until both converge."""
    problem, loss = minimum.problem, minimum.loss
    place, noise = minimum.place, dict(minimum.noise)
    part_free = 1.0 - len(minimum.place) / problem.measured.number
    for _ in range(TURNS):
        place = searched(problem, loss, noise, place)
        misfits, steady = problem.misfits(place), True
        for name in misfits.keys() - minimum.given:
            least = LEAST_NOISE * float(np.nanmax(np.abs(problem.measured.answers[name])))
            estimate = max(noise_of(loss, misfits[name], part_free), least, np.finfo(float).tiny)
            steady &= abs(estimate / noise[name] - 1.0) < STEADY
            noise[name] = estimate
        finer = problem.with_steps_for(place, noise)
        steady &= bool((np.abs(np.log(finer.steps / problem.steps)) < STEPS_STEADY).all())
        problem = finer
        if steady:
            break
    independent = independent_part(problem.misfits(place))
    return replace(minimum, problem=problem, place=place, noise=noise, independent=independent)


def searched(
    problem: Problem, loss: str, noise: Noise, start: Floats, held: Sequence[int] = (),
    *, precision: float = PRECISION, tries: int = MOST_TRIES,
) -> Floats:  # fmt: skip
    """Search for the place of the least cost from a start; the coordinates with indices `held` stay."""
    moving = np.array([index for index in range(len(start)) if index not in held], dtype=int)
    if not len(moving):
        return start
    low, high = (ends[moving] for ends in problem.bounds)
    inside = np.minimum(INSIDE, 0.25 * (high - low))

    def whole(part: Floats) -> Floats:
        place = start.copy()
        place[moving] = part
        return place

    result = least_squares(
        lambda part: problem.residuals(whole(part), noise), np.clip(start[moving], low + inside, high - inside),
        jac=lambda part: problem.jacobian(whole(part), noise, moving), bounds=(low, high), method="trf",
        loss=loss if loss == "linear" else LOSSES[loss], x_scale="jac",
        ftol=precision, xtol=precision, gtol=precision, max_nfev=tries,
    )  # fmt: skip
    return whole(result.x)


def _starts(problem: Problem, loss: str, noise: Noise, number: int) -> list[Floats]:
    """Give the parameters' own start, and the best of many places that are spread evenly around it."""
    if number == 1:
        return [problem.start]
    low, high = problem.bounds
    reach = np.log(REACH)
    least, most = np.maximum(problem.start - reach, low), np.minimum(problem.start + reach, high)
    drawn = qmc.LatinHypercube(len(low), seed=SEED).random(max(SCREENED * len(low), number - 1))
    places = least + drawn * (most - least)
    costs = [cost_of(LOSSES[loss], problem.residuals(place, noise)) for place in places]
    return [problem.start, *places[np.argsort(costs, kind="stable")[: number - 1]]]


def _spread(column: Floats) -> float:
    """Make a first guess of a column's noise, of the right order; equal values differ by rounding, not by noise."""
    known = column[np.isfinite(column)]
    spread, largest = float(np.std(known)), float(np.abs(known).max())
    return spread if spread > LEAST_NOISE * largest else largest or 1.0


def _check_effects(problem: Problem, noise: Noise) -> None:
    """Refuse a free parameter on which nothing depends that was measured."""
    slopes = np.abs(problem.jacobian(problem.start, noise)).max(axis=0)
    columns = ", ".join(problem.measured.answers)
    for unknown, slope in zip(problem.unknowns, slopes, strict=True):
        if slope < NO_EFFECT:
            raise UsageError(f"--free {unknown.name}: around {unknown.start:g} it changes nothing of what was measured "
                             f"({columns}); leave it fixed, or measure what it changes")  # fmt: skip


WIDEST = math.log(1e9)
"""The largest distance [coordinates] from the fit at which an end is searched for"""
CLOSE = 1e-3
"""Precision of an end, relative to the standard deviation"""
BETTER = 1e-2
"""Likelihood ratio by which a place must be better than the fit to replace it"""
NOTHING = 1e-9
"""The least singular value of a direction, relative to the largest one"""
FIRST_STEP, LEAST_SIDE_STEP, LARGEST_STEP = 0.1, 1e-9, 1.0
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
        outer = min(np.clip(self._limit * self._deviation, LEAST_SIDE_STEP, LARGEST_STEP), furthest)
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


HIGH = 0.95
"""Correlation above which two parameters trade off"""
GROUP_PART = 0.3
"""The least component that a parameter has in a direction to belong to it"""
WIDE = 2.0
"""Ratio of the ends of an interval from which on a value counts as not known"""
SHOWN = 0.1
"""Relative change of the first parameter in the description of a trade-off"""


def correlation(minimum: Minimum) -> Floats:
    """Compute the correlation matrix of the estimates in the linear approximation, shape (p, p)."""
    spread = covariance(minimum)
    deviations = np.sqrt(np.maximum(np.diag(spread), np.finfo(float).tiny))
    matrix: Floats = np.clip(spread / np.outer(deviations, deviations), -1.0, 1.0)
    return matrix


def trades(minimum: Minimum, intervals: Sequence[Interval] | None) -> list[str]:
    """Describe each pair, or larger group, of parameters that trade off, in a sentence.

    Args:
        minimum: The fit.
        intervals: Intervals of the parameters; None if they were not computed.
    """
    unknowns = minimum.problem.unknowns
    matrix, spread = correlation(minimum), covariance(minimum)
    sentences, paired = [], set()
    for one, other in itertools.combinations(range(len(unknowns)), 2):
        r = float(matrix[one, other])
        if abs(r) > HIGH:
            paired |= {one, other}
            slope = float(spread[one, other] / spread[one, one])
            sentences.append(_pair(unknowns[one], unknowns[other], r, slope, _wide(intervals, (one, other))))
    slopes = minimum.problem.jacobian(minimum.place, minimum.noise)
    sizes = np.linalg.norm(slopes, axis=0)
    _, singular, directions = np.linalg.svd(slopes / np.where(sizes > 0.0, sizes, 1.0), full_matrices=False)
    null_directions = directions[singular < math.sqrt(1.0 - HIGH)]
    group = {int(index) for index in np.flatnonzero(np.linalg.norm(null_directions, axis=0) > GROUP_PART)}
    if len(group) > 2 and not group <= paired:
        names = [unknowns[index].name for index in sorted(group)]
        sentences.append(
            f"{', '.join(names[:-1])} and {names[-1]} trade off: changed together, they leave nearly the same answers; "
            f"{_what_to_do(_wide(intervals, sorted(group)))}"
        )
    return sentences


def _pair(one: Unknown, other: Unknown, r: float, slope: float, wide: bool) -> str:
    if one.scale:
        step, first = SHOWN, f"{one.name} {SHOWN * one.scale:.3g} {one.unit} up".replace("  ", " ")
    else:
        step, first = math.log1p(SHOWN), f"{one.name} {100.0 * SHOWN:.0f} % up"
    other_step = slope * step
    if other.scale:
        second = f"{other.name} {abs(other_step * other.scale):.3g} {other.unit}".strip()
    else:
        second = f"{other.name} {abs(100.0 * math.expm1(other_step)):.3g} %"
    way = "up" if other_step > 0.0 else "down"
    return (f"{one.name} and {other.name} trade off (correlation {r:.4f}): {first} with {second} {way} leaves nearly "
            f"the same answers; {_what_to_do(wide)}")  # fmt: skip


def _what_to_do(wide: bool) -> str:
    if wide:
        return "these data cannot tell them apart: hold one of them, or measure over a wider range"
    return "take them from one fit, never one of them alone"


def _wide(intervals: Sequence[Interval] | None, indices: Sequence[int]) -> bool:
    """Whether one of these parameters is hardly known; without intervals all count so."""
    return intervals is None or not all(_is_known(intervals[index]) for index in indices)


def _is_known(interval: Interval) -> bool:
    low, high, low_open, high_open = interval
    near = low * high > 0.0 and max(abs(low), abs(high)) < WIDE * min(abs(low), abs(high))
    return near and not low_open and not high_open


UNLIKELY = 1e-4
"""Probability of the residuals below which the noise given is doubted"""
AT_END = 1e-3
"""Distance [coordinates] from the end of a range within which a value counts as lying at the end"""
APART = 1.0
"""The least distance [standard deviations] of another minimum in a coordinate"""


def doubts(minimum: Minimum, intervals: Sequence[Interval] | None, level: float, deviations: Floats) -> list[str]:
    """Collect all doubts about a fit.

    Args:
        minimum: The fit.
        intervals: Intervals of the parameters; None if they were not computed.
        level: Probability of the intervals.
        deviations: Standard deviations of the coordinates, shape (p,).
    """
    return [
        *_at_ends(minimum), *_open(minimum, intervals), *_others(minimum, level, deviations), *_noise(minimum),
        *_correlated(minimum), *minimum.problem.doubts(minimum.place),
    ]  # fmt: skip


def _at_ends(minimum: Minimum) -> list[str]:
    """Report parameters that lie at the ends of their ranges."""
    low, high = minimum.problem.bounds
    sentences = []
    for unknown, place, least, most in zip(minimum.problem.unknowns, minimum.place, low, high, strict=True):
        if min(place - least, most - place) < AT_END:
            end = unknown.least if place - least < most - place else unknown.most
            sentences.append(f"{unknown.name}: the fit lies at the end of its range, {end:.6g}: the data ask for more")
    return sentences


def _open(minimum: Minimum, intervals: Sequence[Interval] | None) -> list[str]:
    """Report parameters whose intervals have an open end."""
    sentences = []
    for unknown, interval in zip(minimum.problem.unknowns, intervals or (), strict=False):
        sides = [side for side, is_open in (("below", interval.low_open), ("above", interval.high_open)) if is_open]
        if sides:
            sentences.append(f"{unknown.name} is not bounded by the data {' or '.join(sides)}")
    return sentences


def _others(minimum: Minimum, level: float, deviations: Floats) -> list[str]:
    """Report another minimum, if the data do not reject one at the level of the intervals."""
    best = minimum.cost(minimum.place)
    limit = quantile(minimum, level)
    for place, _ in minimum.ends:
        if not _far(place, minimum, deviations):
            continue
        there = searched(minimum.problem, minimum.loss, minimum.noise, place)  # else it may lie in the same valley
        ratio = 2.0 * minimum.calibration() * (minimum.cost(there) - best)
        if _far(there, minimum, deviations) and ratio < limit:
            values = minimum.problem.values(there)
            return ["another fit is as good within the level: "
                    + ", ".join(f"{name} {value:.6g}" for name, value in values.items())]  # fmt: skip
    return []


def _far(place: Floats, minimum: Minimum, deviations: Floats) -> bool:
    return bool((np.abs(place - minimum.place) > np.maximum(APART * deviations, AT_END)).any())


def _noise(minimum: Minimum) -> list[str]:
    """Report noise that was given and does not agree with the residuals."""
    sentences = []
    misfits = minimum.problem.misfits(minimum.place)
    for name in sorted(minimum.given & misfits.keys()) if minimum.loss == "linear" else ():
        scaled = misfits[name] / minimum.noise[name]
        part = minimum.independent
        total, number = part * float((scaled**2).sum()), part * len(scaled)
        if chi2.sf(total, number) < UNLIKELY:
            sentences.append(
                f"{name}: what is left is {np.sqrt(total / number):.3g} times the noise given: the model does not "
                "describe it, or the noise is larger; the intervals are too narrow"
            )
        elif chi2.cdf(total, number) < UNLIKELY:
            sentences.append(
                f"{name}: what is left is {np.sqrt(total / number):.3g} times the noise given; the intervals are too "
                "wide"
            )
    return sentences


def _correlated(minimum: Minimum) -> list[str]:
    """Report residuals that are correlated from sample to sample."""
    sentences = []
    for name, misfit in minimum.problem.misfits(minimum.place).items():
        if correlation := alike(misfit):
            worth = round(len(misfit) / samples_per_value(misfit))
            sentences.append(
                f"{name}: what is left is alike from sample to sample (correlation {correlation:.2f}): {len(misfit)} "
                f"samples count as {worth}, and the intervals are wider for it; they do not know the model's own error"
            )
    return sentences
