"""What speaks against a fit, or against its intervals: a sentence for each."""

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
"""Probability of residuals below which the noise given is doubted"""
AT_END = 1e-3
"""Coordinates from the end of a range within which a value counts as lying there"""
APART = 1.0
"""Standard deviations by which another minimum must differ in a coordinate, at least"""


def doubts(minimum: Minimum, found: Sequence[Interval] | None, level: float, deviations: Floats) -> list[str]:
    """Of a fit with these intervals; `deviations` are those of the coordinates, shape (p,)."""
    return [
        *_at_ends(minimum), *_open(minimum, found), *_others(minimum, level, deviations), *_noise(minimum),
        *_correlated(minimum), *minimum.problem.doubts(minimum.place),
    ]  # fmt: skip


def _at_ends(minimum: Minimum) -> list[str]:
    low, high = minimum.problem.bounds
    told = []
    for unknown, place, least, most in zip(minimum.problem.unknowns, minimum.place, low, high, strict=True):
        if min(place - least, most - place) < AT_END:
            end = unknown.least if place - least < most - place else unknown.most
            told.append(f"{unknown.name}: the fit lies at the end of its range, {end:.6g}: the data ask for more")
    return told


def _open(minimum: Minimum, found: Sequence[Interval] | None) -> list[str]:
    told = []
    for unknown, each in zip(minimum.problem.unknowns, found or (), strict=False):
        ways = [way for way, is_open in (("below", each.low_open), ("above", each.high_open)) if is_open]
        if ways:
            told.append(f"{unknown.name} is not bounded by the data {' or '.join(ways)}")
    return told


def _others(minimum: Minimum, level: float, deviations: Floats) -> list[str]:
    """Another minimum that the data do not refute."""
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
    """Noise that was given, and is not what was left."""
    told = []
    misfits = minimum.problem.misfits(minimum.place)
    for name in sorted(minimum.given & misfits.keys()) if minimum.loss == "linear" else ():
        scaled = misfits[name] / minimum.noise[name]
        part = minimum.independent  # of the samples are worth something
        total, number = part * float((scaled**2).sum()), part * len(scaled)
        if chi2.sf(total, number) < UNLIKELY:
            told.append(f"{name}: what is left is {np.sqrt(total / number):.3g} times the noise given: the model does "
                        "not describe it, or the noise is larger; the intervals are too narrow")  # fmt: skip
        elif chi2.cdf(total, number) < UNLIKELY:
            told.append(f"{name}: what is left is {np.sqrt(total / number):.3g} times the noise given; the intervals "
                        "are too wide")  # fmt: skip
    return told


def _correlated(minimum: Minimum) -> list[str]:
    """Residuals that are alike from sample to sample."""
    told = []
    for name, misfit in minimum.problem.misfits(minimum.place).items():
        if correlation := alike(misfit):
            worth = round(len(misfit) / samples_per_value(misfit))
            told.append(
                f"{name}: what is left is alike from sample to sample (correlation {correlation:.2f}): {len(misfit)} "
                f"samples count as {worth}, and the intervals are wider for it; they do not know the model's own error"
            )
    return told
