"""Sections of docs/explanation/validation.md."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from statistics import fmean

from benchmarks.report import Section, words
from knee_contact_ros.joint_reaction.estimator import LOAD_LEVELS
from studies.validation.change import right
from studies.validation.data import Walk, of
from studies.validation.movements import scores
from studies.validation.split import CALLED, missed, other_person, other_trial, shipped
from studies.validation.total import (
    DEFAULT,
    FREE,
    OTHER_PERSON,
    OWN,
    Estimate,
    by_person,
    by_sensors,
    covered,
    deviation_of,
    fitted,
    line,
    peaks,
    rms,
)

TITLE = "Validation"
COMMAND = "python -m studies.validation --data FOLDER"
WORDS = words(Path(__file__).with_name("words.txt"))
PERCENT = 100.0


def both(values: dict[str, float], form: str = ".2f") -> list[str]:
    """Cells with the value of each person, and their mean."""
    return [*(f"{value:{form}}" for value in values.values()), f"{fmean(values.values()):{form}}"]


def chosen(found: Sequence[Estimate], level: str, how: str) -> list[Estimate]:
    """Estimates at a level with constants of a kind."""
    return [each for each in found if (each.level, each.how) == (level, how)]


def lines(walks: Sequence[Walk]) -> dict[str, float]:
    """RMS error [BW] of a line in the ground force that is fitted to the other person, by person."""
    names = dict.fromkeys(walk.person.name for walk in walks)
    return {
        name: fmean(
            rms(walk, line([other for other in walks if other.person.name != name])(walk))
            for walk in of(list(walks), name)
        )
        for name in names
    }


def totals(found: Sequence[Estimate], how: str) -> dict[str, dict[str, float]]:
    """RMS errors [BW] of the total force by level and person."""
    return {
        level: by_person(chosen(found, level, how), lambda each: rms(each.walk, each.force))
        for level in LOAD_LEVELS
    }


def total_section(found: Sequence[Estimate], walks: Sequence[Walk]) -> Section:
    """Section on the total force and its peaks."""
    rows = []
    for how in (OTHER_PERSON, OWN):
        for level, errors in totals(found, how).items():
            each = chosen(found, level, how)
            ends = [
                by_person(each, lambda one, h=half: float(peaks(one.walk, one.force)[:, h].mean()))  # type: ignore[misc]
                for half in (0, 1)
            ]
            told = [
                " / ".join(f"{PERCENT * value:+.0f}" for value in end.values()) + " %"
                for end in ends
            ]
            rows.append([f"`{level}`", how, *both(errors), *told])
    rows.append(["line a + k F", OTHER_PERSON, *both(lines(walks)), "", ""])
    together = fitted(walks, list(LOAD_LEVELS), DEFAULT.moment_arm_scale)
    values = ", ".join(f"{name} {value:g}" for name, value in zip(FREE, together, strict=True))
    header = (
        "level",
        "constants",
        "JW",
        "PS",
        "mean",
        "first peak, JW / PS",
        "second peak, JW / PS",
    )
    sensed = []
    for level in LOAD_LEVELS:
        own = [
            by_sensors(one.walk, level, one.values)
            for one in chosen(found, level, OTHER_PERSON)
            if one.walk.sensors
        ]
        sensed.append(fmean(own) if own else float("nan"))
    text = WORDS["total"].format(
        values=values, sensed=", ".join(f"{error:.2f}" for error in sensed)
    )
    return Section("The total force", text, header, rows)


def deviation_section(found: Sequence[Estimate]) -> Section:
    """Section on the standard deviations that are told."""
    rows = []
    for how in (OTHER_PERSON, OWN):
        for level in LOAD_LEVELS:
            error, each = LOAD_LEVELS[level], chosen(found, level, how)
            told = error.uncalibrated if how == OTHER_PERSON else error.calibrated
            cells = []
            for stance in (True, False):
                parts = [
                    fmean(
                        by_person(
                            each,
                            lambda one, s=stance, w=which, deviation=told: covered(
                                one, deviation, s
                            )[w],  # type: ignore[misc]
                        ).values()
                    )
                    for which in (0, 1)
                ]
                cells.append(" / ".join(f"{PERCENT * part:.0f}" for part in parts) + " %")
            crossed = []
            for name in dict.fromkeys(one.walk.person.name for one in each):
                mine = [one for one in each if one.walk.person.name == name]
                theirs = deviation_of([one for one in each if one.walk.person.name != name])
                part = fmean(
                    covered(one, theirs, stance)[1] for one in mine for stance in (True, False)
                )
                crossed.append(f"{PERCENT * part:.0f}")
            rows.append(
                [
                    f"`{level}`",
                    how,
                    f"{told.floor:g}, {told.part:g}",
                    *cells,
                    " / ".join(crossed) + " %",
                ]
            )
    header = (
        "level",
        "constants",
        "floor [BW], part",
        "stance, within 1 / 2",
        "swing, within 1 / 2",
        "within 2, chosen on the other",
    )
    return Section("How sure an estimate is", WORDS["deviation"], header, rows)


def split_section(walks: Sequence[Walk]) -> Section:
    """Section on the medial part."""
    other, own = missed(walks, other_person), missed(walks, other_trial)
    rows = [[name, *both(other[form]), *both(own[form])[:2]] for form, name in CALLED.items()]
    curve, _ = shipped(walks)
    text = WORDS["split"].format(share=curve.share, load=curve.load)
    header = ("split", "JW", "PS", "mean", "own trials: JW", "own trials: PS")
    return Section("The medial force, the total given", text, header, rows)


def change_section(walks: Sequence[Walk]) -> Section:
    """Section on assistance."""
    rows = [
        [f"`{level}`", f"{PERCENT * one:.0f} % of {n}", f"{PERCENT * two:.0f} % of {m}"]
        for level, (one, two, n, m) in right(walks).items()
    ]
    return Section(
        "Does assistance relieve the knee?",
        WORDS["change"],
        ("level", "first peak", "second peak"),
        rows,
    )


def movement_section() -> Section:
    """Section on the marked movements."""
    parts, f1 = scores()
    rows = [[name, f"{PERCENT * part:.0f} %"] for name, part in parts.items()]
    return Section(
        "Other movements", WORDS["movements"].format(f1=f1), ("movement", "marked"), rows
    )


def sections(walks: Sequence[Walk], found: Sequence[Estimate]) -> list[Section]:
    """All sections with their numbers."""
    missed_of = {
        form: fmean(errors.values()) for form, errors in missed(walks, other_person).items()
    }
    told = {
        name: "{:.2f} to {:.2f}".format(
            *(
                pick(fmean(each.values()) for each in totals(found, how).values())
                for pick in (min, max)
            )
        )
        for name, how in (("total", OTHER_PERSON), ("own", OWN))
    } | {form: f"{missed_of[form]:.2f}" for form in ("moment", "curve")}
    return [
        Section("", WORDS["introduction"].format(**told), (), ()),
        total_section(found, walks),
        split_section(walks),
        deviation_section(found),
        change_section(walks),
        movement_section(),
        Section("What limits these figures", WORDS["limits"], (), ()),
        Section("Other studies", WORDS["others"], (), ()),
    ]
