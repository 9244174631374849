"""Find the parameters that fit best.

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
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import chi2, f, qmc

from ...model.types import Floats
from ...system.errors import UsageError
from ...system.progress import OnProgress
from .unknowns import Unknown

ParameterValues = dict[str, float]
LINEAR = "linear"
HUBER_BEND = 1.345
"""Residual at the bend of Huber's loss, in units of the noise: 95 % as efficient as squares for normal noise"""
NORMAL_MEDIAN = 0.6744897501960817
"""Median of the absolute value of a standard normal number"""
CORRELATION_SIGMAS = 4.0
"""Smallest significant ratio of the correlation with the next sample to its standard deviation"""
FIRST_STEP = 1e-3
"""Step of difference quotients, in coordinates, before the data's resolution is known. Tuned: within it an impact may
move from before a sample to after it; `studies.calibration` would notice a smaller one"""
MIN_STEP = 1e-7
"""Smallest step of difference quotients, in coordinates: below it the answers' rounding errors show"""
REFUSED_RESIDUAL = 1e8
"""Residual where the parameters are not allowed"""
START_REACH = math.log(4.0)
"""Largest distance [coordinates] of another start from the first one"""
MAX_ROUNDS = 30
"""Largest number of rounds of fit and noise"""
STEADY_NOISE = 1e-3
"""Relative change of a noise below which the rounds of fit and noise end"""
SMALL = 1e-9
"""Smallest noise of a column, relative to its largest value; smallest singular value of a direction, relative to the
largest one; and smallest distance [coordinates] of a search's start from the bounds"""
SCREENED = 50
"""Number of places around the first start, per parameter; the best of them become the other starts"""
NO_EFFECT = 1e-5
"""Slope of a residual, in spreads of its column over an e-fold change, below which a parameter has no effect: a
thousandth of the effect of the model's own error"""


def _squares(z: Floats) -> Floats:
    return np.stack((z, np.ones_like(z), np.zeros_like(z)))


def _soft_l1(z: Floats) -> Floats:
    """Compute the loss 2 (√(1 + z) - 1): nearly the square of small residuals, and linear in large ones."""
    root = np.sqrt(1.0 + z)
    return np.stack((2.0 * (root - 1.0), 1.0 / root, -0.5 / root**3))


def _huber(z: Floats) -> Floats:
    """Compute Huber's loss (1964): the square of residuals up to `HUBER_BEND`, and linear in larger ones."""
    bend = HUBER_BEND
    size = np.sqrt(np.maximum(z, bend**2))
    outside = np.stack((2.0 * bend * size - bend**2, bend / size, -0.5 * bend / size**3))
    return np.where(z <= bend**2, _squares(z), outside)


LOSSES: dict[str, Callable[[Floats], Floats]] = {
    LINEAR: _squares,
    "soft_l1": _soft_l1,
    "huber": _huber,
}
"""Losses by name"""


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


class Conclusions(NamedTuple):
    """What follows from a fit."""

    remarks: list[str]
    """Remarks, a line each"""
    parameters: dict[str, Any]
    """Further parameters for the file, by name"""
    doubts: list[str]
    """Doubts, a sentence each"""


@dataclass(frozen=True)
class FitProblem:
    """A model with free parameters, and the measurements to fit; subclasses are the models."""

    measured: Data
    unknowns: tuple[Unknown, ...]

    def answers(self, values: ParameterValues) -> Any:
        """Compute the model's answers by the names of the measured columns, shape (n,) each.

        Raises:
            UsageError: the parameters are not allowed.
        """
        raise NotImplementedError

    def predicted(self, values: ParameterValues) -> Any:
        """Compute the answers in full, as `calibrate` returns them."""
        raise NotImplementedError

    def conclusions(
        self, values: ParameterValues, refit: Callable[[FitProblem], ParameterValues]
    ) -> Conclusions:
        """Return what follows from a fit; `refit` fits another such problem."""
        raise NotImplementedError

    def misfits(self, values: ParameterValues) -> dict[str, Floats]:
        """Compute answers minus measurements in their units, by column, where something was measured."""
        answers = self.answers(values)
        return {
            name: (answers[name] - column)[np.isfinite(column)]
            for name, column in self.measured.answers.items()
        }


def autocorrelation(misfit: Floats) -> Floats:
    """Compute the correlations of values with those k samples later, shape (n,); 1 at k = 0."""
    spectrum = np.fft.rfft(misfit, 2 * len(misfit))
    products = np.fft.irfft(np.abs(spectrum) ** 2)[: len(misfit)]
    normed: Floats = products / max(float(products[0]), np.finfo(float).tiny)
    return normed


def samples_per_value(misfit: Floats) -> float:
    """Return τ, 1 or more; 1 where the correlation with the next sample is not significant."""
    if len(misfit) < 2:
        return 1.0
    correlations = autocorrelation(misfit)
    if correlations[1] * math.sqrt(len(misfit)) <= CORRELATION_SIGMAS:
        return 1.0
    ends = np.flatnonzero(correlations <= 0.0)
    return float(1.0 + 2.0 * correlations[1 : ends[0] if len(ends) else None].sum())


@dataclass(frozen=True)
class Fit:
    """A place, the coordinates of the p free parameters, shape (p,), and how well it fits."""

    problem: FitProblem
    loss: str
    given: frozenset[str]
    """Columns whose noise was given"""
    noise: ParameterValues
    """Standard deviation of each measured column, in its unit"""
    place: Floats
    steps: Floats
    """Steps of difference quotients, in coordinates, shape (p,)"""
    search_ends: tuple[Floats, ...] = ()
    """Place at which the search from each start ended"""
    independent: float = 1.0
    """Fraction of the measurements that counts: below 1 where residuals are correlated from sample to sample"""

    @classmethod
    def at_start(cls, problem: FitProblem, loss: str, given: Mapping[str, float]) -> Fit:
        """Begin at the start, with the given noise, or a guess of its order of magnitude."""
        noise = {}
        for name, column in problem.measured.answers.items():
            known = column[np.isfinite(column)]
            spread = float(np.std(known))
            largest = float(np.abs(known).max())
            # Equal values differ by rounding, not by noise.
            guess = spread if spread > SMALL * largest else largest or 1.0
            noise[name] = given.get(name) or guess
        start = np.array([unknown.coordinate(unknown.start) for unknown in problem.unknowns])
        steps = np.full(len(start), FIRST_STEP)
        return cls(problem, loss, frozenset(given), noise, start, steps)

    @property
    def bounds(self) -> tuple[Floats, Floats]:
        """Lower and upper ends of the coordinates, shape (p,) each."""
        unknowns = self.problem.unknowns
        low = np.array([each.coordinate(each.least) for each in unknowns])
        high = np.array([each.coordinate(each.most) for each in unknowns])
        return low, high

    def values(self, place: Floats | None = None) -> ParameterValues:
        """Return the values of the parameters at a place, or at that of the fit, by name."""
        coordinates = (self.place if place is None else place).tolist()
        return {
            each.name: each.value(at)
            for each, at in zip(self.problem.unknowns, coordinates, strict=True)
        }

    def residuals(self, place: Floats) -> Floats:
        """Compute all misfits in units of the noise, column by column; large if the parameters are not allowed."""
        try:
            return scale_misfits(self.problem.misfits(self.values(place)), self.noise)
        except UsageError:
            return np.full(self.problem.measured.number, REFUSED_RESIDUAL)

    def jacobian(self, place: Floats) -> Floats:
        """Compute the slopes of the residuals over all coordinates by central differences, shape (residuals, p)."""
        low, high = self.bounds
        columns = []
        for index, step in enumerate(self.steps):
            ends = np.tile(place, (2, 1))
            ends[:, index] = np.clip(place[index] + [-step, step], low[index], high[index])
            residuals = [self.residuals(end) for end in ends]
            for side in (0, 1):
                # Where there is no model, the difference is one-sided.
                if abs(residuals[side][0]) >= REFUSED_RESIDUAL:
                    ends[side] = place
                    residuals[side] = self.residuals(place)
            width = ends[1, index] - ends[0, index]
            rise = residuals[1] - residuals[0]
            columns.append(rise / width if width else np.zeros_like(rise))
        return np.stack(columns, axis=1)

    def cost(self, place: Floats) -> float:
        """Return half the sum of losses at a place."""
        return float(0.5 * LOSSES[self.loss](self.residuals(place) ** 2)[0].sum())

    @property
    def freedom(self) -> float:
        """Degrees of freedom: independent measurements minus parameters, 1 or more."""
        return max(self.independent * self.problem.measured.number - len(self.place), 1.0)

    @property
    def all_noise_given(self) -> bool:
        """Whether the noise of every column was given."""
        return self.given >= self.noise.keys()

    @cached_property
    def likelihood_scale(self) -> float:
        """Factor from the rise of twice the cost to a likelihood ratio."""
        number = self.problem.measured.number
        if self.loss != LINEAR:
            residuals = self.residuals(self.place)
            _, first, second = LOSSES[self.loss](residuals**2)
            slopes = first + 2.0 * residuals**2 * second
            sizes = (residuals * first) ** 2
            return float(slopes.sum() / max(sizes.sum(), 1e-300)) * self.freedom / number
        if self.all_noise_given:
            return self.independent
        return self.freedom / (number - len(self.place))

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
            directions.T / information @ directions / self.likelihood_scale, dtype=np.float64
        )

    @property
    def correlation(self) -> Floats:
        """Correlations of the estimates in the linear approximation, shape (p, p)."""
        deviations = np.sqrt(np.maximum(np.diag(self.covariance), np.finfo(float).tiny))
        matrix: Floats = np.clip(self.covariance / np.outer(deviations, deviations), -1.0, 1.0)
        return matrix

    def quantile(self, level: float) -> float:
        """Quantile of the likelihood ratio for a probability, if the held value is the true one.

        Of χ² with one degree of freedom, or of F(1, n - p) where a noise is estimated from the same data (Bates & Watts
        1988, Nonlinear Regression Analysis, Ch. 6).
        """
        return float(chi2.ppf(level, 1) if self.all_noise_given else f.ppf(level, 1, self.freedom))

    def likelihood_ratio(self, place: Floats) -> float:
        """Return the likelihood ratio of the fit to a place."""
        return 2.0 * self.likelihood_scale * (self.cost(place) - self.cost(self.place))

    def search(self, start: Floats, *, precision: float = 1e-10, tries: int = 100) -> Floats:
        """Search for the place of least cost from a start.

        It ends at a `precision` of cost, place (both relative) and slope, or after so many `tries`.
        """
        low, high = self.bounds
        inside = np.minimum(SMALL, 0.25 * (high - low))
        return np.asarray(
            least_squares(
                self.residuals,
                np.clip(start, low + inside, high - inside),
                jac=self.jacobian,
                bounds=(low, high),
                x_scale="jac",
                loss=LINEAR if self.loss == LINEAR else LOSSES[self.loss],
                ftol=precision,
                xtol=precision,
                gtol=precision,
                max_nfev=tries,
            ).x
        )

    def converged(self) -> Fit:
        """Search and estimate the noise alternately, until both converge."""
        fit = self
        degrees = 1.0 - len(self.place) / self.problem.measured.number
        for _ in range(MAX_ROUNDS):
            fit = replace(fit, place=fit.search(fit.place))
            misfits = self.problem.misfits(fit.values())
            noise = dict(fit.noise)
            for name in misfits.keys() - self.given:
                size = float(np.sqrt(np.mean(misfits[name] ** 2)))
                if self.loss != LINEAR:  # outliers leave the median
                    size = float(np.median(np.abs(misfits[name]))) / NORMAL_MEDIAN
                largest = float(np.nanmax(np.abs(self.problem.measured.answers[name])))
                noise[name] = max(size / math.sqrt(degrees), SMALL * largest, np.finfo(float).tiny)
            new = replace(fit, noise=noise)
            # Half of what the data resolve: an impact must not move across a sample within a step.
            resolved = 0.5 / np.maximum(np.linalg.norm(new.slopes, axis=0), 1.0)
            new = replace(new, steps=np.clip(resolved, MIN_STEP, FIRST_STEP))
            steady = all(abs(noise[name] / fit.noise[name] - 1.0) < STEADY_NOISE for name in noise)
            steady &= bool((np.abs(np.log(new.steps / fit.steps)) < 0.5).all())
            fit = replace(new, independent=1.0 / max(map(samples_per_value, misfits.values())))
            if steady:
                break
        return fit


def scale_misfits(misfits: Mapping[str, Floats], noise: Mapping[str, float]) -> Floats:
    """Divide misfits by the noise, and join them, one column after another."""
    return np.concatenate([misfits[name] / noise[name] for name in misfits])


def find_fit(
    problem: FitProblem,
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
    first = Fit.at_start(problem, loss, given)
    for unknown, slope in zip(problem.unknowns, np.abs(first.slopes).max(axis=0), strict=True):
        if slope < NO_EFFECT:
            raise UsageError(
                f"--free {unknown.name}: around {unknown.start:g} it changes no measured value "
                f"({', '.join(first.noise)}); leave it fixed, or measure something that it changes"
            )
    places = [first.place]
    if starts > 1:
        low, high = first.bounds
        least = np.maximum(first.place - START_REACH, low)
        most = np.minimum(first.place + START_REACH, high)
        # A seed, so that the same fit has the same answer.
        spread = qmc.LatinHypercube(len(low), seed=20)
        drawn = spread.random(max(SCREENED * len(low), starts - 1))
        places += sorted(least + drawn * (most - least), key=first.cost)[: starts - 1]
    ends = []
    for done, start in enumerate(places, start=1):
        # A coarse search is enough to compare the starts; the best one is continued.
        ends.append(first.search(start, precision=1e-6, tries=30))
        advance(done, starts)
    return replace(first, place=min(ends, key=first.cost), search_ends=tuple(ends)).converged()
