"""Find the parameters that fit best, by SciPy's bounded least squares from several starts, and the noise.

The noise of a column that is not given is that of its own misfits: fit and noise are computed in turns until both
converge, which is the most likely choice of both.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import qmc

from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.tools.calibration.independence import independent_part
from knee_contact_ros.tools.calibration.losses import LINEAR, LOSSES, calibration, cost, noise_of
from knee_contact_ros.tools.calibration.problem import Noise, Problem

Floats = NDArray[np.float64]
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
        return cost(LOSSES[self.loss], self.problem.residuals(place, self.noise))

    def calibration(self) -> float:
        """Give the factor that turns a rise of twice the cost into a likelihood ratio."""
        number = self.problem.measured.number
        if self.loss != LINEAR:
            return calibration(LOSSES[self.loss], self.residuals) * self.freedom / number
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
        ends.append((place, cost(LOSSES[loss], problem.residuals(place, noise))))
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
    costs = [cost(LOSSES[loss], problem.residuals(place, noise)) for place in places]
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
