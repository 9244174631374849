"""What speaks against a fit, or against its intervals: a sentence for each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from knee_contact_ros.core.types import Status
from knee_contact_ros.tools.calibration.fit import Minimum, searched
from knee_contact_ros.tools.calibration.profile import Interval, quantile

Floats = NDArray[np.float64]
UNLIKELY = 1e-4
"""Probability of residuals below which the noise given is doubted"""
CORRELATED, SURE = 0.2, 4.0
"""Correlation of residuals with the next ones that is told, and by how many of its own standard deviations it must
differ from none"""
AT_END = 1e-3
"""Coordinates from the end of a range within which a value counts as lying there"""
APART = 1.0
"""Standard deviations by which another minimum must differ in a coordinate, at least"""


def doubts(minimum: Minimum, found: Sequence[Interval] | None, level: float, deviations: Floats) -> list[str]:
    """Of a fit with these intervals; `deviations` are those of the coordinates, shape (p,)."""
    return [
        *_at_ends(minimum), *_open(minimum, found), *_others(minimum, level, deviations), *_noise(minimum),
        *_correlated(minimum), *_unusable(minimum), *_leaps(minimum),
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
        total, number = float((scaled**2).sum()), len(scaled)
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
        r = float((misfit[1:] * misfit[:-1]).sum() / max((misfit**2).sum(), np.finfo(float).tiny))
        if r > CORRELATED and r * np.sqrt(len(misfit)) > SURE:
            factor = np.sqrt((1.0 + r) / (1.0 - min(r, 0.99)))
            told.append(
                f"{name}: what is left is alike from sample to sample (correlation {r:.2f}), and no noise: the "
                f"intervals are too narrow, some {factor:.1f} times or more"
            )
    return told


def _unusable(minimum: Minimum) -> list[str]:
    """Ticks that the model itself does not vouch for."""
    status = minimum.problem.answers(minimum.place)["status"]
    told = []
    for bit, what in ((Status.NOT_CONVERGED, "missed their tolerance"), (Status.IMPLAUSIBLE, "are implausibly deep")):
        if count := int(np.count_nonzero(status & bit)):
            told.append(f"{count} of {len(status)} answers {what}")
    return told


def _leaps(minimum: Minimum) -> list[str]:
    """Landings under a law whose force leaps at touch, among samples of the force."""
    forces = minimum.problem.measured.answers.get("contact_force")
    if forces is None:
        return []
    answers = minimum.problem.predicted(minimum.place)
    force, _, _ = minimum.problem.scene.modes.law.layers[0].formula.force_at(0.0, 1.0, 1.0)
    apart = np.asarray(answers["gap"]) > 0.0
    landings = int((apart[:-1] & ~apart[1:] & np.isfinite(forces[1:])).sum())
    if force <= 0.0 or not landings:
        return []
    return [f"contact_force: it leaps at touch under this law, in {landings} landing(s), and a sample falls before or "
            "after it: the misfit jumps, and the intervals are rough; leave these samples empty"]  # fmt: skip
