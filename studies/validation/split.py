"""The medial part of a given total: forms of the share and the frontal moment, fitted to the other person."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from knee_contact_ros.joint_reaction.compartments import MeasuredShare
from studies.validation.data import Floats, Walk
from studies.validation.shares import (
    Curve,
    Trial,
    constant,
    fit_curve,
    fit_table,
    share_csv,
    spacing,
)
from studies.validation.total import weights

Share = Callable[[Walk], Floats]
"""Medial force [body weights] of a walk, shape (n,)"""
SMOOTHING = 3e-3
"""Penalty of the tables: what cross-validation over the trials chose for both persons"""
SPACING = 0.07
"""Default distance of the compartments [m]"""
CALLED = {
    "half": "share of 1/2 (`fixed_share`)",
    "constant": "best constant share",
    "line": "share a line in load and flexion",
    "curve": "share rising with the load and saturating (shipped form)",
    "table": "table over load and flexion (smoothing by cross-validation)",
    "external": "`moment_balance`, 70 mm, moment without muscles",
    "moment": "`moment_balance`, 70 mm",
    "spaced": "`moment_balance`, fitted spacing",
}
"""Forms of the split, and their names on the page"""


def loads(walk: Walk) -> tuple[Floats, Floats, Floats]:
    """Total force, moment and external moment, relative to the body weight, shape (n,) each."""
    weight = walk.person.body_weight
    return walk.total / weight, walk.frontal / weight, walk.external / weight


def _by_line(trials: Sequence[Trial], parts: Sequence[float], walk: Walk) -> Floats:
    rows = [
        np.sqrt(part / len(each.load))
        * np.stack((each.load, each.load**2, each.load * each.flexion), axis=1)
        for each, part in zip(trials, parts, strict=True)
    ]
    wanted = [
        np.sqrt(part / len(each.load)) * each.medial
        for each, part in zip(trials, parts, strict=True)
    ]
    found = np.linalg.lstsq(np.concatenate(rows), np.concatenate(wanted), rcond=None)[0]
    load, _, _ = loads(walk)
    return np.asarray(
        np.clip(np.stack((np.ones(len(load)), load, walk.flexion), axis=1) @ found, 0.0, 1.0)
        * load
    )


def rules(known: Sequence[Walk]) -> dict[str, Share]:
    """Rules for the medial force, fitted to walks."""
    trials, parts = [walk.trial for walk in known], weights(known)
    share, curve, table, apart = (
        constant(trials),
        fit_curve(trials, parts),
        fit_table(trials, SMOOTHING),
        spacing(trials),
    )
    measured = MeasuredShare(table, 1.0)

    def by_moment(distance: float, which: int, walk: Walk) -> Floats:
        numbers = loads(walk)
        return np.asarray(0.5 * numbers[0] - numbers[which] / distance)

    return {
        "half": lambda walk: 0.5 * loads(walk)[0],
        "constant": lambda walk: share * loads(walk)[0],
        "line": partial(_by_line, trials, parts),
        "curve": lambda walk: curve.at(loads(walk)[0]) * loads(walk)[0],
        "table": lambda walk: (
            np.asarray(measured.share_at(loads(walk)[0], walk.flexion)) * loads(walk)[0]
        ),
        "external": partial(by_moment, SPACING, 2),
        "moment": partial(by_moment, SPACING, 1),
        "spaced": partial(by_moment, apart, 1),
    }


def rms(walk: Walk, medial: Floats, with_moment: bool) -> float:
    """RMS error [body weights] of a medial force; where a moment counts, of the samples whose moment is used."""
    error = medial - walk.medial / walk.person.body_weight
    return float(np.sqrt(np.mean(error[walk.used if with_moment else slice(None)] ** 2)))


def missed(
    walks: Sequence[Walk], others: Callable[[Walk, Walk], bool]
) -> dict[str, dict[str, float]]:
    """RMS errors by form and person, mean of the person's walks.

    Every walk is judged by rules fitted to the walks for which `others(walk, each)`; without any it is left out.
    """
    found: dict[str, dict[str, list[float]]] = {form: {} for form in CALLED}
    for walk in walks:
        known = [each for each in walks if others(walk, each)]
        for form, rule in rules(known).items() if known else ():
            error = rms(walk, rule(walk), form in ("external", "moment", "spaced"))
            found[form].setdefault(walk.person.name, []).append(error)
    return {
        form: {name: float(np.mean(each)) for name, each in of.items()}
        for form, of in found.items()
    }


def other_person(walk: Walk, each: Walk) -> bool:
    """Whether a walk is of another person."""
    return each.person.name != walk.person.name


def other_trial(walk: Walk, each: Walk) -> bool:
    """Whether a walk is another one of the same person."""
    return each.person.name == walk.person.name and each is not walk


def shipped(walks: Sequence[Walk]) -> tuple[Curve, str]:
    """The shipped curve, fitted to all persons with the same weight, and the text of its file."""
    curve = fit_curve([walk.trial for walk in walks], weights(walks))
    errors = missed(walks, other_person)["curve"]
    told = ", ".join(f"{name} {error:.2f} BW" for name, error in errors.items())
    notes = [
        f"The curve {curve.share:.3f} x / sqrt(1 + x^2), x = load / {curve.load:.3f} BW, no slope along flexion,",
        "which acts in opposite ways in the two knees. n = 2: two men with instrumented total knee replacements who",
        "walked on the level, JW (right knee, 654.3 N, overground and treadmill) and PS (left knee, 735.75 N,",
        "overground), fourth and fifth Grand Challenge Competition to Predict In Vivo Knee Loads (Fregly et al. 2012,",
        f"J Orthop Res 30:503). RMS error of the medial force where the curve is fitted to the other one: {told}.",
        "Another knee divides its load otherwise. Made by python -m studies.validation; the measurements are not here.",
    ]
    return curve, share_csv(curve.table, notes)


def write_shipped(walks: Sequence[Walk], path: Path) -> None:
    """Write the shipped curve."""
    path.write_text(shipped(walks)[1], encoding="utf-8")
