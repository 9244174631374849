"""Doubts about a fit or its intervals, a sentence for each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from knee_contact_ros.tools.calibration.fit import Minimum, searched
from knee_contact_ros.tools.calibration.independence import alike, samples_per_value
from knee_contact_ros.tools.calibration.profile import Interval, quantile

Floats = NDArray[np.float64]
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
