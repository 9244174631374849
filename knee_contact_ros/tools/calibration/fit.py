"""The parameters that fit best: SciPy's bounded least squares from several starts, and the noise that is left.

A column whose noise is not given has that of its own misfits: fit and noise are found in turns until both stay, which
is the most likely choice of both.
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
from knee_contact_ros.tools.calibration.problem import FAR, Noise, Problem

Floats = NDArray[np.float64]
PRECISION = 1e-10
"""Part of cost and place, and the slope, at which a search ends"""
MOST_TRIES = 100
"""Of places in a search"""
COARSE, COARSE_TRIES = 1e-6, 30
"""The same of the searches from several starts, of which the best one is gone on with"""
REACH = 4.0
"""By which factor other starts differ from the first one, at most; e-fold or `scale` steps are its logarithm"""
TURNS, STEADY = 30, 1e-3
"""Of finding fit and noise, at most; and the part by which a noise may change in the last one"""
STEPS_STEADY = 0.5
"""The same of the steps of difference quotients, as a logarithm"""
LEAST_NOISE = 1e-9
"""Part of the largest value of a column"""
SCREENED = 50
"""Places around the first start that are looked at for each parameter; the best of them are the other starts"""
INSIDE = 1e-9
"""By how much [coordinates] a search begins within its bounds"""
SEED = 20
"""Of the starts: the same fit has the same answer"""


@dataclass(frozen=True)
class Minimum:
    """The best place that was found."""

    problem: Problem
    loss: str
    place: Floats
    """Coordinates, shape (p,)"""
    noise: Noise
    given: frozenset[str]
    """Columns whose noise was given"""
    ends: tuple[tuple[Floats, float], ...]
    """Where each start ended, and the cost there"""
    independent: float = 1.0
    """Part of the measurements that counts: less than 1 where what is left is alike from sample to sample"""

    @property
    def residuals(self) -> Floats:
        """At the place, in units of the noise."""
        return self.problem.residuals(self.place, self.noise)

    @property
    def freedom(self) -> float:
        """Independent measurements less parameters, 1 or more."""
        return max(self.independent * self.problem.measured.number - len(self.place), 1.0)

    @property
    def knows_noise(self) -> bool:
        """Whether the noise of every column was given."""
        return self.given >= self.problem.measured.answers.keys()

    def cost(self, place: Floats) -> float:
        """Half the sum of losses at a place."""
        return cost(LOSSES[self.loss], self.problem.residuals(place, self.noise))

    def calibration(self) -> float:
        """What a rise of twice the cost is to be multiplied with, to be a likelihood ratio."""
        number = self.problem.measured.number
        if self.loss != LINEAR:
            return calibration(LOSSES[self.loss], self.residuals) * self.freedom / number
        return self.independent if self.knows_noise else self.freedom / (number - len(self.place))


def fitted(problem: Problem, loss: str, given: Noise, starts: int, advance: Callable[[int, int], None]) -> Minimum:
    """The best fit; `given` is the noise of columns that is known, `advance` is told the starts that are done.

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
    """Search from there on, with the noise found anew, until both stay."""
    problem, loss = minimum.problem, minimum.loss
    place, noise = minimum.place, dict(minimum.noise)
    part_free = 1.0 - len(minimum.place) / problem.measured.number
    for _ in range(TURNS):
        place = searched(problem, loss, noise, place)
        misfits, steady = problem.misfits(place), True
        for name in misfits.keys() - minimum.given:
            least = LEAST_NOISE * float(np.nanmax(np.abs(problem.measured.answers[name])))
            found = max(noise_of(loss, misfits[name], part_free), least, np.finfo(float).tiny)
            steady &= abs(found / noise[name] - 1.0) < STEADY
            noise[name] = found
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
    """The place of the least cost around a start; coordinates `held` stay."""
    moving = np.array([index for index in range(len(start)) if index not in held], dtype=int)
    if not len(moving):
        return start
    low, high = (ends[moving] for ends in problem.bounds)
    inside = np.minimum(INSIDE, 0.25 * (high - low))

    def whole(part: Floats) -> Floats:
        place = start.copy()
        place[moving] = part
        return place

    found = least_squares(
        lambda part: problem.residuals(whole(part), noise), np.clip(start[moving], low + inside, high - inside),
        jac=lambda part: problem.jacobian(whole(part), noise, moving), bounds=(low, high), method="trf",
        loss=loss if loss == "linear" else LOSSES[loss], x_scale="jac",
        ftol=precision, xtol=precision, gtol=precision, max_nfev=tries,
    )  # fmt: skip
    return whole(found.x)


def _starts(problem: Problem, loss: str, noise: Noise, number: int) -> list[Floats]:
    """The given start, and the best of places that are spread evenly around it within the bounds."""
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
    """A first size of a column's noise: something of the right order. Equal values spread by roundings, by no noise."""
    known = column[np.isfinite(column)]
    spread, largest = float(np.std(known)), float(np.abs(known).max())
    return spread if spread > LEAST_NOISE * largest else largest or 1.0


def _check_effects(problem: Problem, noise: Noise) -> None:
    """Refuse a parameter that nothing measured depends on.

    Raises:
        UsageError: see there.
    """
    slopes = np.abs(problem.jacobian(problem.start, noise)).max(axis=0)
    columns = ", ".join(problem.measured.answers)
    for unknown, slope in zip(problem.unknowns, slopes, strict=True):
        if slope < NO_EFFECT:
            raise UsageError(f"--free {unknown.name}: around {unknown.start:g} it changes nothing of what was measured "
                             f"({columns}); leave it fixed, or measure what it changes")  # fmt: skip


NO_EFFECT = 1e-5
"""Slope of a residual, in spreads of its column over an e-fold change, below which there is none: a thousandth of what
the model's own error can make of it would be as large"""
assert FAR > 1.0  # noqa: S101
