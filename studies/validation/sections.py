"""Sections of docs/explanation/validation.md."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from statistics import fmean

from benchmarks.report import Section, words
from knee_contact_ros.joint_reaction.estimator import LOAD_LEVELS, AxialDeviation
from knee_contact_ros.lab.calibrate.walk import CLOCK, DEVIATIONS, MASS, ZERO
from studies.validation.change import right
from studies.validation.data import SENSOR_LEVELS, WALKING, Walk, level_walks, with_medial
from studies.validation.minutes import FAULTS, told, worth
from studies.validation.movements import scores
from studies.validation.split import CALLED, missed, other_person, other_trial, shipped
from studies.validation.total import (
    CURVE,
    DEFAULT,
    FREE,
    OTHERS,
    OWN,
    SENSORS,
    WAYS,
    Estimate,
    by_sensors,
    by_session,
    clocks,
    covered,
    deviation_of,
    errors_of,
    fitted,
    line,
    on_time,
    peak_errors,
    person_mean,
    same_signs,
)

TITLE = "Validation of the estimated load"
COMMAND = "python -m studies.validation --data FOLDER"
WORDS = words(Path(__file__).with_name("words.txt"))
PERCENT = 100.0


def chosen(found: Sequence[Estimate], level: str, how: str) -> list[Estimate]:
    """Estimates of level walking at a level with constants of a kind."""
    return [
        each
        for each in found
        if (each.level, each.how, each.walk.movement) == (level, how, WALKING)
    ]


def cells(sessions: dict[str, float]) -> list[str]:
    """Cells with the value of each session, and the mean of the persons."""
    return [*(f"{value:.2f}" for value in sessions.values()), f"{person_mean(sessions):.2f}"]


def line_errors(walks: Sequence[Walk]) -> dict[str, float]:
    """RMS error [BW] of a line in the ground force that is fitted to the other persons, by session."""
    lines = [
        Estimate(
            walk, "", "", (), line([each for each in walks if other_person(walk, each)])(walk)
        )
        for walk in walks
    ]
    return errors_of(lines)


def total_section(found: Sequence[Estimate], walks: Sequence[Walk]) -> Section:
    """Section on the total force and its peaks."""
    keys = list(dict.fromkeys(walk.key for walk in walks))
    rows = [
        ["line a + k F", "others", *cells(line_errors(walks)), "", ""],
        ["", CURVE, *cells(errors_of(chosen(found, "", CURVE))), "", ""],
    ]
    for how in WAYS:
        for level in LOAD_LEVELS:
            each = chosen(found, level, how)
            ends = [mean_peak_error(each, half) for half in (0, 1)]
            rows.append(
                [
                    f"`{level}`",
                    how,
                    *cells(errors_of(each)),
                    *(f"{PERCENT * end:+.0f} %" for end in ends),
                ]
            )
    late = clocks(walks)
    together = fitted(on_time(walks, late), SENSOR_LEVELS, DEFAULT.moment_arm_scale)
    on_clock = {walk.name: walk for walk in on_time(walks, late)}

    def timed(level: str, how: str) -> float:
        """Error [BW] against implants on the sensors' clock."""
        set_right = [
            one._replace(walk=on_clock[one.walk.name]) for one in chosen(found, level, how)
        ]
        return person_mean(errors_of(set_right))

    text = WORDS["total"].format(
        timed=span([timed(each, OTHERS) for each in LOAD_LEVELS]),
        curve=span([timed("", CURVE)]),
        values=", ".join(f"{name} {value:g}" for name, value in zip(FREE, together, strict=True)),
        late=", ".join(f"{key} {1000.0 * delay:+.0f} ms" for key, delay in late.items()),
        sensed=", ".join(f"{error:.2f}" for error in sensor_errors(found)),
    )
    header = ("level", "constants", *keys, "mean", "first peak", "second peak")
    return Section("The total force", text, header, rows)


def mean_peak_error(found: Sequence[Estimate], half: int) -> float:
    """Mean error of the first (0) or second (1) peaks, as a part of the measured ones."""
    return person_mean(
        by_session(found, lambda one: float(peak_errors(one.walk, one.force)[:, half].mean()))
    )


def sensor_errors(found: Sequence[Estimate]) -> list[float]:
    """RMS errors [BW] from the sensors' bags, with our own inverse dynamics, by level."""
    return [
        fmean(
            by_sensors(one.walk, level, one.values)
            for one in chosen(found, level, OTHERS)
            if one.walk.sensors
        )
        for level in SENSOR_LEVELS
    ]


def difference_section(found: Sequence[Estimate]) -> Section:
    """Section on differences between the strides of a person."""
    rows = []
    for how in (SENSORS, OTHERS):
        for level in SENSOR_LEVELS:
            signs = same_signs(chosen(found, level, how))
            told = [
                f"{PERCENT * right / max(asked, 1):.0f} % of {asked}" for right, asked in signs
            ]
            rows.append([f"`{level}`", how, *told])
    header = ("level", "constants", "first peak", "second peak")
    return Section("Differences between strides", WORDS["differences"], header, rows)


def covered_text(found: Sequence[Estimate], told: AxialDeviation, stance: bool) -> str:
    """Parts of the samples within one and two standard deviations, in percent."""
    parts = [
        person_mean(by_session(found, lambda one, n=number: covered(one, told, stance)[n]))  # type: ignore[misc]
        for number in (0, 1)
    ]
    return " / ".join(f"{PERCENT * part:.0f}" for part in parts) + " %"


def deviation_section(found: Sequence[Estimate]) -> Section:
    """Section on the standard deviations that are told."""
    rows = []
    for how in (OTHERS, OWN):
        for level in LOAD_LEVELS:
            each = chosen(found, level, how)
            error = LOAD_LEVELS[level]
            told = error.uncalibrated if how == OTHERS else error.calibrated
            parts = [covered_text(each, told, stance) for stance in (True, False)]
            least = deviation_of(each)
            rows.append(
                [
                    f"`{level}`",
                    how,
                    f"{told.floor:g}, {told.part:g}",
                    *parts,
                    f"{least.floor:g}, {least.part:g}",
                ]
            )
    header = (
        "level",
        "constants",
        "floor [BW], part",
        "stance, within 1 / 2",
        "swing, within 1 / 2",
        "smallest that covers",
    )
    return Section("How sure an estimate is", WORDS["deviation"], header, rows)


def both(values: dict[str, float]) -> list[str]:
    """Cells with the value of each person, and their mean."""
    return [*(f"{value:.2f}" for value in values.values()), f"{fmean(values.values()):.2f}"]


def minutes_section(found: Sequence[Estimate], walks: Sequence[Walk]) -> Section:
    """Section on what a walk tells without an implant."""
    errors = worth(walks, on_time(walks, clocks(walks)), found)
    rows = [
        [fault.name, *(f"{with_it:.2f}, {after:.2f}" for with_it, after in errors[fault].values())]
        for fault in FAULTS
    ]
    header = ("fault", *(f"`{level}`" for level in SENSOR_LEVELS))
    sessions = told(walks).values()
    text = WORDS["minutes"].format(
        zero=max(abs(math.degrees(each.offset)) for each in sessions),
        clock=max(abs(1000.0 * each.delay) for each in sessions),
        weight=max(abs(PERCENT * (each.weight - 1.0)) for each in sessions),
        zero_deviation=math.degrees(DEVIATIONS[ZERO]),
        clock_deviation=1000.0 * DEVIATIONS[CLOCK],
        weight_deviation=PERCENT * DEVIATIONS[MASS],
    )
    return Section("Calibration in minutes", text, header, rows)


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


def other_movements(found: Sequence[Estimate]) -> str:
    """Errors [BW] in measured movements other than plain walking, a sentence; empty if there are none."""
    others = dict.fromkeys(e.walk.movement for e in found if e.walk.movement != WALKING)
    told = []
    for movement in others:
        mine = [each for each in found if each.walk.movement == movement]
        ways = {how: [e for e in mine if e.how == how] for how in (CURVE, SENSORS, OTHERS)}
        means = ", ".join(
            f"{how} {person_mean(errors_of(each)):.2f}" for how, each in ways.items()
        )
        told.append(f"{movement}: {means}")
    return "; ".join(told)


def span(values: Sequence[float]) -> str:
    """Smallest and largest value as a text; one number where they look the same."""
    return " to ".join(dict.fromkeys(f"{pick(values):.2f}" for pick in (min, max)))


def sections(walks: Sequence[Walk], found: Sequence[Estimate]) -> list[Section]:
    """All sections with their numbers."""
    level, medial = level_walks(list(walks)), with_medial(list(walks))
    missed_of = {form: fmean(each.values()) for form, each in missed(medial, other_person).items()}
    told = {
        name: span([person_mean(errors_of(chosen(found, each, how))) for each in LOAD_LEVELS])
        for name, how in (("total", OTHERS), ("alone", SENSORS), ("own", OWN))
    } | {form: f"{missed_of[form]:.2f}" for form in ("moment", "curve")}
    told["mean"] = f"{person_mean(errors_of(chosen(found, '', CURVE))):.2f}"
    told["number"] = str(len({walk.person.name for walk in level}))
    measured = other_movements(found)
    parts = [
        Section("", WORDS["introduction"].format(**told), (), ()),
        total_section(found, level),
        difference_section(found),
        minutes_section([each for each in found if each.walk.movement == WALKING], level),
        split_section(medial),
        deviation_section(found),
        change_section(medial),
        movement_section(),
        Section("What limits these figures", WORDS["limits"], (), ()),
        Section("Other studies", WORDS["others"], (), ()),
    ]
    if measured:
        parts.insert(4, Section("Measured movements beside plain walking [BW]", measured, (), ()))
    return parts
