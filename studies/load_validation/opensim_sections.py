"""Sections of the comparison with OpenSim."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.report import Section, words
from knee_contact_ros.joint_reaction.estimator import LEVELS
from knee_contact_ros.joint_reaction.leg import SHANK_LENGTH
from studies.load_validation.answers import BY_DEFAULT, Answer, fitted_together, score
from studies.load_validation.sections import (
    FORCE_HEADER,
    IN_DETAIL,
    PEAK_HEADER,
    VARIANT_HEADER,
    force_row,
    off,
    peak_row,
    variant_rows,
)
from studies.load_validation.walks import DEFAULTS, MASS, TALL, Floats, Leg, Walk, axial, nets_in

WORDS = words(Path(__file__).with_name("words.txt"))

MODEL_SHANK = 0.425
"""Distance [m] between the centres of knee and ankle of the scaled model, on average over the walk"""
MEASURED = 2.61
"""Largest resultant force [BW] in level walking, as implants in five persons measured it on average"""


def sections(legs: Sequence[Leg], found: Sequence[Answer], pair: Sequence[Walk]) -> list[Section]:
    """Sections behind those of the instrumented knee, whose walks are `pair`."""
    return [
        dynamics_section(legs),
        force_section(legs, found),
        peak_section(found),
        rule_section(legs),
        default_section([*pair, *(leg.walk for leg in legs)]),
    ]


def dynamics_section(legs: Sequence[Leg]) -> Section:
    """Section that compares our moments with OpenSim's."""
    rows, more = [], []
    for leg in legs:
        used = leg.walk.used
        more.append(float((nets_in(leg.walk)[0] - leg.knee)[used & leg.walk.stance].mean()))
        names = ("knee, extension", "ankle, plantarflexion", "knee, frontal")
        for name, ours, theirs in zip(names, nets_in(leg.walk), (leg.knee, leg.ankle, leg.frontal), strict=True):
            rows.append([leg.walk.name, name, off(ours[used], theirs[used])])
    text = WORDS["dynamics"].format(
        MASS=MASS,
        TALL=TALL,
        more_0=more[0],
        more_1=more[1],
        shank=SHANK_LENGTH * TALL,
        MODEL_SHANK=MODEL_SHANK,
    )
    return Section("9. OpenSim: inverse dynamics", text, ("leg", "moment", "ours less OpenSim's, RMS; both"), rows)


def force_section(legs: Sequence[Leg], found: Sequence[Answer]) -> Section:
    """Section on the total force."""
    largest = [_largest(leg.walk, leg.walk.reference) for leg in legs]
    defaults = [
        score(each.walk, each.force).rms for each in found if each.how == BY_DEFAULT and each.level in IN_DETAIL
    ]
    together = fitted_together([leg.walk for leg in legs], IN_DETAIL, DEFAULTS.moment_arm_scale)
    text = WORDS["force_2"].format(
        largest_0=largest[0],
        largest_1=largest[1],
        MEASURED=MEASURED,
        min_defaults=min(defaults),
        max_defaults=max(defaults),
        together_co_contraction=together.co_contraction,
        together_tone=together.tone,
    )
    return Section("10. OpenSim: the total force", text, FORCE_HEADER, [force_row(each) for each in found])


def default_section(walks: Sequence[Walk]) -> Section:
    """Section on the largest forces by the defaults, beside what implants measured."""
    rows = []
    for level in LEVELS:
        largest = [_largest(walk, axial(walk, level, DEFAULTS)) for walk in walks]
        rows.append([f"`{level}`", *(f"{each:.2f} BW" for each in largest), f"{np.mean(largest):.2f} BW"])
    text = (
        "The largest force of a stance by the defaults, on average over the stances: of four walks of two persons, of "
        f"whom one is not the man that the defaults were chosen on. Beside it: {MEASURED} BW, as above."
    )
    header = ("level", *(walk.name for walk in walks), "mean")
    return Section("13. All walks: the largest force by the defaults", text, header, rows)


def _largest(walk: Walk, force: Floats) -> float:
    """Largest force of a stance [BW], on average over the stances."""
    return float(np.mean([np.max(force[first:last]) for first, last in walk.steps()]) / walk.weight)


def peak_section(found: Sequence[Answer]) -> Section:
    """Section on both peaks."""
    text = "As in section 2; one whole stance a leg."
    return Section("11. OpenSim: peaks", text, PEAK_HEADER, [peak_row(each) for each in found])


def rule_section(legs: Sequence[Leg]) -> Section:
    """Section on other rules of the muscles."""
    rows = variant_rows([leg.walk for leg in legs], IN_DETAIL)
    text = "As in section 5, fitted to one leg and judged on the other: right and left."
    return Section("12. OpenSim: other rules", text, VARIANT_HEADER, rows)
