"""Rows of the page's tables."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from knee_contact_ros.joint_reaction.estimator import Deviation
from studies.load_validation.answers import Answer
from studies.load_validation.fitting import fitted
from studies.load_validation.scores import HALVES, Peak, covered, peaks, rms, score
from studies.load_validation.variants import VARIANTS, Variant, force_by
from studies.load_validation.walks import Floats, Walk

MS, PERCENT = 1e3, 100.0
FORCE_HEADER = (
    "walk", "level", "constants", "arms / co-contraction / tone", "RMS error", "r", "mean error", "RMS in stance",
    "RMS in swing",
)  # fmt: skip
PEAK_HEADER = (
    "walk",
    "level",
    "constants",
    "stances",
    "first peak",
    "second peak",
    "first, median shift",
    "second, median shift",
)
COVER_HEADER = ("walk", "level", "constants", "one number: in stance", "in swing", "told: in stance", "in swing")
VARIANT_HEADER = ("rule", "level", "RMS error [BW]", "r", "first peak [%]", "second peak [%]")


def force_row(answer: Answer) -> list[str]:
    """Row with the errors of the total force."""
    found = score(answer.walk, answer.force)
    return [
        answer.walk.name, name_of(answer), answer.how, answer.told(),
        f"{found.rms * answer.walk.weight:.0f} N, {found.rms:.2f} BW", f"{found.r:.3f}", f"{found.mean:+.2f} BW",
        f"{found.stance:.2f} BW", f"{found.swing:.2f} BW",
    ]  # fmt: skip


def name_of(answer: Answer) -> str:
    """Name of a level as it is spelled, or of a regression in words."""
    return f"`{answer.level}`" if "_" in answer.level else answer.level


def halves(found: Sequence[Peak]) -> list[list[Peak]]:
    """Peaks of the first and of the second halves."""
    return [[peak for peak in found if peak.half == half] for half in HALVES]


def mean_error(found: Sequence[Peak]) -> float:
    """Mean error of peaks, as a part of the measured ones."""
    return float(np.mean([peak.error for peak in found]))


def spread(found: Sequence[Peak]) -> str:
    """Mean and standard deviation of the errors of peaks, in percent."""
    errors = PERCENT * np.array([peak.error for peak in found])
    return f"{errors.mean():+.0f} %" if len(errors) == 1 else f"{errors.mean():+.0f} ± {errors.std():.0f} %"


def peak_row(answer: Answer) -> list[str]:
    """Row with the errors of both peaks, in size and time."""
    both = halves(peaks(answer.walk, answer.force))
    shifts = [f"{MS * np.median([peak.late for peak in half]):+.0f} ms" for half in both]
    sizes = [spread(half) for half in both]
    return [answer.walk.name, name_of(answer), answer.how, str(len(both[0])), *sizes, *shifts]


def one_number(answers: Sequence[Answer], answer: Answer) -> float:
    """RMS error [BW] of answers of a kind, the larger one of both walks."""
    same = [each for each in answers if (each.level, each.how) == (answer.level, answer.how)]
    return max(score(each.walk, each.force).rms for each in same)


def deviations(answer: Answer, deviation: Deviation) -> Floats:
    """Standard deviations [N] of an answer, shape (n,)."""
    found: Floats = np.array([deviation.at(force, answer.walk.weight) for force in answer.force.tolist()])
    return found


def cover_row(answers: Sequence[Answer], answer: Answer) -> list[str]:
    """Row with the parts of samples within one and two standard deviations."""
    cells, walk = [], answer.walk
    for deviation in (Deviation(one_number(answers, answer), 0.0), answer.deviation):
        for within in (walk.stance, ~walk.stance):
            parts = covered(walk, answer.force, deviations(answer, deviation), within)
            cells.append(" and ".join(f"{PERCENT * part:.0f}" for part in parts) + " %")
    return [walk.name, name_of(answer), answer.how, *cells]


def likeliest(answers: Sequence[Answer]) -> Deviation:
    """Deviation that makes the errors of walks likeliest, with equal weight for each walk, in steps of 0.05."""
    steps = np.arange(1, 21) * 0.05

    def surprise(deviation: Deviation) -> float:
        parts = []
        for answer in answers:
            off = deviations(answer, deviation)
            error = (answer.force - answer.walk.reference) / off
            parts.append(np.mean((0.5 * error**2 + np.log(off / answer.walk.weight))[answer.walk.used]))
        return float(np.sum(parts))

    pairs = [Deviation(floor, part) for floor in steps.tolist() for part in (0.0, *steps.tolist())]
    found = min(pairs, key=surprise)
    return Deviation(round(found.floor, 2), round(found.part, 2))


def variant_rows(pair: Sequence[Walk], levels: Sequence[str]) -> list[list[str]]:
    """Rows of every rule at every level that it concerns, fitted to one walk and judged on the other, both ways."""
    return [
        _variant_row(variant, level, pair)
        for variant in VARIANTS
        for level in levels
        if level == "ankle_moment" or not variant.of_the_calf
    ]


def _variant_row(variant: Variant, level: str, pair: Sequence[Walk]) -> list[str]:
    rule, cells = partial(force_by, variant), []
    for walk, other in zip(pair, reversed(pair), strict=True):
        force = rule(walk, level, fitted(other, level, rule, variant.most_scale))
        found = score(walk, force)
        sizes = [f"{PERCENT * mean_error(half):+.0f}" for half in halves(peaks(walk, force))]
        cells.append((f"{found.rms:.2f}", f"{found.r:.3f}", *sizes))
    return [variant.name, f"`{level}`", *(" and ".join(both) for both in zip(*cells, strict=True))]


def off(ours: Floats, theirs: Floats) -> str:
    """RMS of a difference of moments, and the largest values of both."""
    highest = f"{ours.max():.0f} and {theirs.max():.0f}"
    lowest = f"{ours.min():.0f} and {theirs.min():.0f}"
    return f"{rms(ours - theirs):.1f} N m; largest {highest}, least {lowest} N m"
