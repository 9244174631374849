"""How well the data determine the fitted parameters, and what makes the answer doubtful.

Intervals are by profile likelihood: one parameter is held at a value while the others are fitted again, until the fit
is significantly worse. The interval of a level ends where the likelihood ratio to the best fit reaches the level's
quantile (Venzon & Moolgavkar 1988, Applied Statistics 37:87-94). MINOS of iminuit finds the ends. Where residuals are
autocorrelated, the equivalent number of independent values counts. An interval need not be symmetric. If it has no end
within the parameter's range, the data do not bound the parameter there.
"""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2

from ...model.types import Floats
from ...system.progress import OnProgress
from .fit import LINEAR, Fit, autocorrelation, samples_per_value

MAX_COORDINATE_STEP = math.log(1e9)
"""Largest distance [coordinates] from the fit at which the end of an interval is searched"""
BETTER = 1e-2
"""Likelihood ratio by which a place must be better than the fit to replace it"""
TRADE_OFF = 0.95
"""Correlation above which two parameters trade off"""
IN_GROUP = 0.3
"""Smallest component of a parameter that takes part in a trade-off"""
SHOWN_CHANGE = 0.1
"""Relative change of the first parameter in a shown trade-off"""
UNLIKELY = 1e-4
"""Probability of the residuals below which the noise given is doubted"""
SAME_PLACE = 1e-3
"""Distance [coordinates] within which two places count as one"""


class Interval(NamedTuple):
    """Interval of a parameter's value, in the parameter's unit.

    Example:
        >>> from knee_contact_ros.lab.calibrate.intervals import Interval
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
        """Whether the data determine the value: both ends are known, and less than a factor of 2 apart."""
        small, large = sorted((abs(self.low), abs(self.high)))
        return (
            self.low * self.high > 0.0
            and large < 2.0 * small
            and not (self.low_open or self.high_open)
        )


class Intervals(NamedTuple):
    """Intervals of all parameters."""

    intervals: list[Interval]
    better: Floats | None
    """Best place found meanwhile, if it is better than the fit"""
    failed: bool
    """Whether an end was not found: the cost is not smooth; the interval is open there"""


def find_intervals(fit: Fit, level: float, advance: OnProgress) -> Intervals:
    """Compute the interval of each parameter.

    Args:
        fit: The fit.
        level: Probability of the intervals.
        advance: Called with the number of finished parameters and the number of all.
    """
    from iminuit import Minuit

    best_place = fit.place
    best_cost = fit_cost = fit.cost(fit.place)

    def cost(place: Floats) -> float:
        nonlocal best_place, best_cost
        value = fit.cost(place)
        if value < best_cost:
            best_place = place.copy()
            best_cost = value
        return value

    low, high = fit.bounds
    low = np.maximum(low, fit.place - MAX_COORDINATE_STEP)
    high = np.minimum(high, fit.place + MAX_COORDINATE_STEP)
    minuit = Minuit(cost, fit.place)
    minuit.limits = list(zip(low, high, strict=True))
    minuit.errors = np.clip(np.sqrt(np.diag(fit.covariance)), SAME_PLACE, 1.0)
    minuit.errordef = 0.5 * fit.quantile(level) / fit.likelihood_scale
    # Where two parameters trade off, MINOS needs the second derivatives that HESSE finds after MIGRAD.
    minuit.strategy = 1
    minuit.migrad()
    minuit.hesse()
    found = []
    failed = not minuit.valid
    for index, unknown in enumerate(fit.problem.unknowns):
        ends = [low[index], high[index]]
        opened = [True, True]
        if minuit.valid:
            minuit.minos(index, cl=1)
            error = minuit.merrors[index]
            valid = error.lower_valid, error.upper_valid
            at_limit = error.at_lower_limit, error.at_upper_limit
            for side, distance in enumerate((error.lower, error.upper)):
                if valid[side] and not at_limit[side]:
                    ends[side] = minuit.values[index] + distance
                    opened[side] = False
                elif abs(fit.place[index] - ends[side]) > SAME_PLACE:
                    failed |= not at_limit[side]
        low_value, high_value = map(unknown.value, ends)
        found.append(Interval(low_value, high_value, *opened))
        advance(len(found), len(fit.place))
    gain = 2.0 * fit.likelihood_scale * (fit_cost - best_cost)
    return Intervals(found, best_place if gain > BETTER else None, failed)


def doubts(fit: Fit, intervals: Sequence[Interval], level: float) -> Iterator[str]:
    """Return all doubts about a fit, and about its intervals of a level if computed, a sentence each."""
    unknowns = fit.problem.unknowns
    yield from _trade_offs(fit, intervals)
    for unknown, place, least, most in zip(unknowns, fit.place, *fit.bounds, strict=True):
        if min(place - least, most - place) < SAME_PLACE:
            end = unknown.least if place - least < most - place else unknown.most
            yield f"{unknown.name}: the fit lies at the end of its range, {end:.6g}: the best value may lie beyond it"
    for unknown, interval in zip(unknowns, intervals, strict=False):
        opened = {"below": interval.low_open, "above": interval.high_open}
        if sides := [side for side, is_open in opened.items() if is_open]:
            yield f"{unknown.name} is not bounded by the data {' or '.join(sides)}"
    distance = np.maximum(np.sqrt(np.diag(fit.covariance)), SAME_PLACE)
    for candidate in fit.search_ends:
        if (np.abs(candidate - fit.place) <= distance).all():
            continue
        other = fit.search(candidate)  # the coarse search may have ended in the valley of the fit
        same = (np.abs(other - fit.place) <= distance).all()
        if not same and fit.likelihood_ratio(other) < fit.quantile(level):
            values = [f"{name} {value:.6g}" for name, value in fit.values(other).items()]
            yield f"another fit is as good within the level: {', '.join(values)}"
            break
    for name, misfit in fit.problem.misfits(fit.values()).items():
        yield from _residual_doubts(fit, name, misfit)


def _residual_doubts(fit: Fit, name: str, misfit: Floats) -> Iterator[str]:
    """Report given noise that disagrees with the residuals, and correlated residuals."""
    number = fit.independent * len(misfit)
    total = fit.independent * float(((misfit / fit.noise[name]) ** 2).sum())
    if fit.loss == LINEAR and name in fit.given:
        ratio = f"{name}: the residuals are {np.sqrt(total / number):.3g} times the given noise"
        if chi2.sf(total, number) < UNLIKELY:
            yield f"{ratio}: the model does not describe it, or the noise is larger; the intervals are too narrow"
        elif chi2.cdf(total, number) < UNLIKELY:
            yield f"{ratio}; the intervals are too wide"
    samples = samples_per_value(misfit)
    if samples > 1.0:
        yield (
            f"{name}: the residuals are correlated from sample to sample (by {autocorrelation(misfit)[1]:.2f}): "
            f"{len(misfit)} samples count as {round(len(misfit) / samples)}, and the intervals are wider for it; "
            "they do not include the error of the model itself"
        )


def _trade_offs(fit: Fit, intervals: Sequence[Interval]) -> Iterator[str]:
    """Describe each group of parameters that trade off, in a sentence that shows how they change together.

    In such a direction the slopes, scaled to one size for all parameters, nearly vanish; for two parameters their
    correlation exceeds `TRADE_OFF`.
    """
    unknowns = fit.problem.unknowns
    sizes = np.linalg.norm(fit.slopes, axis=0)
    sizes[sizes == 0.0] = 1.0
    _, singular, directions = np.linalg.svd(fit.slopes / sizes, full_matrices=False)
    for direction in directions[singular < math.sqrt(1.0 - TRADE_OFF)]:
        group = np.flatnonzero(np.abs(direction) > IN_GROUP).tolist()
        steps = direction / sizes
        first = SHOWN_CHANGE if unknowns[group[0]].scale else math.log1p(SHOWN_CHANGE)
        steps *= first / steps[group[0]]
        changes = []
        for index in group:
            unknown = unknowns[index]
            step = float(steps[index])
            if unknown.scale:
                size = f"{abs(step * unknown.scale):.3g} {unknown.unit}".strip()
            else:
                size = f"{abs(100 * math.expm1(step)):.3g} %"
            changes.append(f"{unknown.name} {size} {'up' if step > 0.0 else 'down'}")
        names = " and ".join(unknowns[index].name for index in group)
        advice = (
            "these data cannot tell them apart: hold one of them, or measure over a wider range"
        )
        if intervals and all(intervals[index].is_narrow for index in group):
            advice = "take them from one fit, never one of them alone"
        yield f"{names} trade off: {' with '.join(changes)} gives nearly the same answers; {advice}"
