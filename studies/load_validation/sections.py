"""Sections of docs/load-validation.md about the implanted knee."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.report import Section, words
from knee_contact_ros.joint_reaction.estimator import LEVELS, Deviation
from studies.load_validation.answers import (
    BY_DEFAULT,
    FITTED,
    HALVES,
    LANDING,
    MOST,
    VARIANTS,
    Answer,
    Peak,
    Variant,
    answers,
    covered,
    fitted,
    fitted_together,
    force_by,
    lines,
    peaks,
    rms,
    score,
)
from studies.load_validation.walks import (
    DEFAULTS,
    HEIGHT,
    LARGEST_ANKLE,
    LARGEST_KNEE,
    MARGIN,
    ON_THE_PLATE_UNTIL,
    PUBLISHED,
    Floats,
    Walk,
    axial,
    largest_moments,
    moments_of,
)
from studies.validation.data import BODY_WEIGHT, ON_PLATE

WORDS = words(Path(__file__).with_name("words.txt"))

ROWS = (
    ("Grand Challenge 2010 to 2012, four winners (Kinney et al. 2013, doi:10.1115/1.4023255)",
     "motion, ground reaction, some with EMG; blinded",
     "medial 229 to 312 N, lateral 238 to 326 N, r² at most 0.91 and 0.70"),
    ("parametric numerical model, third Grand Challenge (PMC3627216)", "motion, ground reaction; blinded",
     "total 281 N in normal walking (peaks 3 and 9 % off), 470 N in medial thrust gait (4 and 15 % off)"),
    ("recurrent network (Derungs et al. 2026, doi:10.3390/bioengineering13020173)",
     "motion, EMG and ground reaction; the tested person left out", "total 0.16 BW in walking at best"),
)  # fmt: skip


def field_section(found: Sequence[Answer]) -> Section:
    """Section with the table of published scores and of ours."""
    rows = [list(row) for row in ROWS]
    for level in ("knee_moment", "ankle_moment", "ground_force"):
        mine = [each for each in found if (each.level, each.how) == (level, FITTED)]
        scores = [score(each.walk, each.force).rms for each in mine]
        newtons = " and ".join(f"{each * mine[0].walk.weight:.0f}" for each in scores)
        bodies = " and ".join(f"{each:.2f}" for each in scores)
        given = "ground reaction and knee angle" if level == "ground_force" else "net moments of inverse dynamics"
        rows.append([f"ours, `{level}`", f"{given}; fitted to another trial", f"total {newtons} N, {bodies} BW"])
    text = WORDS["field"]
    return Section("7. The field", text, ("source", "given", "RMS error"), rows)


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


TITLE = "A load from sensors, against an instrumented knee"
COMMAND = "python -m studies.load_validation --data FOLDER --opensim MODEL_FOLDER"
GOAL_RMS, GOAL_R, GOAL_PEAK = 0.35, 0.9, 0.15
"""Goals: RMS error [BW], correlation [1], and error as a part of the measured peak"""
IN_DETAIL = ("knee_moment", "ankle_moment")


def sections(pair: Sequence[Walk]) -> list[Section]:
    """Sections on the instrumented knee."""
    found, yardstick = answers(pair), lines(pair)
    return [
        Section("", introduction(pair), (), ()),
        Section("In short", in_short(found), (), ()),
        force_section(found, yardstick),
        peak_section(found, yardstick),
        limit_section(pair),
        deviation_section(pair, found),
        rule_section(pair),
        Section("6. Constants of nobody in particular", by_default(pair), (), ()),
        field_section(found),
        Section("8. What these data cannot show", limits(), (), ()),
    ]


def introduction(pair: Sequence[Walk]) -> str:
    """Section that introduces the person, the inputs, and what was left out."""
    overground, treadmill = pair
    knee, ankle = (max(each) for each in zip(*(largest_moments(walk) for walk in pair), strict=True))
    return WORDS["introduction"].format(
        BODY_WEIGHT=BODY_WEIGHT,
        HEIGHT=HEIGHT,
        ON_THE_PLATE_UNTIL=ON_THE_PLATE_UNTIL,
        overground_used=int(overground.used.sum()),
        overground_samples=len(overground.time),
        overground_steps=len(overground.steps()),
        LARGEST_KNEE=LARGEST_KNEE,
        LARGEST_ANKLE=LARGEST_ANKLE,
        knee=knee,
        ankle=ankle,
        MARGIN=MARGIN,
        treadmill_left_out=int((~treadmill.used).sum()),
        treadmill_samples=len(treadmill.time),
        treadmill_steps=len(treadmill.steps()),
    )


def in_short(found: Sequence[Answer]) -> str:
    """Section that says whether the goals were reached."""
    rows = []
    for level in LEVELS:
        mine = [each for each in found if (each.level, each.how) == (level, FITTED)]
        scores = [score(each.walk, each.force) for each in mine]
        off = [[mean_error(half) for half in halves(peaks(each.walk, each.force))] for each in mine]
        largest = [max(abs(walk[place]) for walk in off) for place in range(len(HALVES))]
        verdicts = (
            max(each.rms for each in scores) <= GOAL_RMS, min(each.r for each in scores) >= GOAL_R,
            largest[0] <= GOAL_PEAK, largest[1] <= GOAL_PEAK,
        )  # fmt: skip
        yes = [word(verdict) for verdict in verdicts]
        rows.append(
            WORDS["in_short"].format(
                level=level,
                rms=shown([each.rms for each in scores]),
                rms_verdict=yes[0],
                r=shown([each.r for each in scores]),
                r_verdict=yes[1],
                first=shown([PERCENT * walk[0] for walk in off], "+.0f"),
                first_verdict=yes[2],
                second=shown([PERCENT * walk[1] for walk in off], "+.0f"),
                second_verdict=yes[3],
            )
        )
    return (
        f"Asked for was, on a trial that was not fitted: total force within {GOAL_RMS} BW RMS with r of {GOAL_R} or "
        f"more, and both peaks within {PERCENT * GOAL_PEAK:.0f} % on average. Overground and treadmill:\n\n"
        + "\n".join(rows)
        + "\n\n"
        + conclusion(found)
    )


def conclusion(found: Sequence[Answer]) -> str:
    """Conclusion of the page."""
    knee, ankle = (
        np.mean([score(each.walk, each.force).rms for each in found if (each.level, each.how) == (level, FITTED)])
        for level in IN_DETAIL
    )
    return WORDS["conclusion"].format(ankle=ankle, knee=knee)


def word(verdict: bool) -> str:
    """Word for a verdict, for a list."""
    return "reached" if verdict else "**missed**"


def shown(numbers: Sequence[float], how: str = ".2f") -> str:
    """Format numbers of both trials."""
    return " and ".join(format(number, how) for number in numbers)


def force_section(found: Sequence[Answer], yardstick: Sequence[Answer]) -> Section:
    """Section on the force: RMS, r, mean, stance and swing."""
    rows = [force_row(each) for walk in dict.fromkeys(each.walk.name for each in found)
            for each in (*found, *yardstick) if each.walk.name == walk]  # fmt: skip
    text = WORDS["force"].format(ON_PLATE=ON_PLATE, largest_arms=MOST.moment_arm_scale)
    return Section("1. The total force", text, FORCE_HEADER, rows)


def peak_section(found: Sequence[Answer], yardstick: Sequence[Answer]) -> Section:
    """Section on both peaks, in size and time."""
    rows = [peak_row(each) for walk in dict.fromkeys(each.walk.name for each in found)
            for each in (*found, *yardstick) if each.walk.name == walk]  # fmt: skip
    text = WORDS["peak"].format(landing=PERCENT * LANDING)
    return Section("2. Peaks", text, PEAK_HEADER, rows)


def limit_section(pair: Sequence[Walk]) -> Section:
    """Section on force and moments at the measured peaks."""
    rows, ratios = [], []
    for walk in pair:
        moments = moments_of(walk)
        for name, half in zip(HALVES, halves(peaks(walk, walk.reference)), strict=True):
            at = np.array([peak.place for peak in half])
            force, ground = walk.reference[at].mean() / walk.weight, walk.vertical[at].mean() / walk.weight
            ratios.append(force / ground)
            rows.append([
                walk.name, name, f"{force:.2f} BW", f"{ground:.2f} BW", f"{force / ground:.2f}",
                f"{moments.extension[at].mean():+.0f} N m", f"{moments.plantarflexion[at].mean():+.0f} N m",
            ])  # fmt: skip
    text = WORDS["limit"].format(overground_ratio=ratios[0], treadmill_ratio=ratios[2])
    header = ("walk", "peak", "measured force", "ground force", "ratio", "extension moment", "plantarflexion moment")
    return Section("3. Why the first peak is off", text, header, rows)


def deviation_section(pair: Sequence[Walk], found: Sequence[Answer]) -> Section:
    """Section on what one number for the deviation hides, and two numbers show."""
    rows = [cover_row(found, each) for each in found]
    told, single, best = [], [], []
    for level, way in LEVELS.items():
        mine = [[each for each in found if (each.level, each.how) == (level, how)] for how in (FITTED, BY_DEFAULT)]
        told.append(f"`{level}` {two(way.error.calibrated)}, not calibrated {two(way.error.uncalibrated)}")
        single.append(f"`{level}` " + " and ".join(f"{one_number(found, each[0]):.2f}" for each in mine))
        best.append(f"`{level}` {two(likeliest(mine[0]))}")
    arms = [Answer(walk, level, BY_DEFAULT, PUBLISHED, axial(walk, level, PUBLISHED)) for level in IN_DETAIL
            for walk in pair]  # fmt: skip
    largest = max(score(each.walk, each.force).rms for each in arms)
    held = min(covered(each.walk, each.force, deviations(each, each.deviation), each.walk.stance)[1] for each in arms)
    text = WORDS["deviation"].format(
        single="; ".join(single),
        told="; ".join(told),
        best="; ".join(best),
        default_arms=DEFAULTS.moment_arm_scale,
        largest=largest,
        held=PERCENT * held,
    )
    return Section("4. How sure an estimate is", text, COVER_HEADER, rows)


def two(deviation: Deviation) -> str:
    """Format both numbers of a deviation."""
    return f"{deviation.floor:.2f} and {deviation.part:.2f}"


def rule_section(pair: Sequence[Walk]) -> Section:
    """Section on other rules of the muscles."""
    text = WORDS["rule"]
    return Section("5. Other rules, which were tried", text, VARIANT_HEADER, variant_rows(pair, IN_DETAIL))


def by_default(pair: Sequence[Walk]) -> str:
    """Section on the reasons for the defaults."""
    told = " / ".join(f"{each:g}" for each in DEFAULTS)
    best = fitted_together(pair, IN_DETAIL, DEFAULTS.moment_arm_scale)
    treadmill = pair[1]
    first, _ = halves(peaks(treadmill, axial(treadmill, "knee_moment", PUBLISHED)))
    large = f"{PERCENT * mean_error(first):.0f} %"
    return WORDS["by_default"].format(
        told=told,
        largest_arms=MOST.moment_arm_scale,
        large=large,
        best_co_contraction=best.co_contraction,
        best_tone=best.tone,
    )


def limits() -> str:
    """Section on what must not be concluded."""
    return "\n".join(
        (
            "- **Other people**: two trials of one man with an implant, of whom the defaults know. How far an "
            "estimate is off for somebody who was never measured is a guess here, the one in section 4.",
            WORDS["limits"],
            "- **Sensors**: moments come from a laboratory. A shoe's wrench and encoders are worse; their error comes "
            "on top.",
            "- **Which muscle**: the cells measure the sum. Nothing here says that quadriceps, hamstrings and "
            "gastrocnemius each are right.",
            "- **The split**: how the total divides between the compartments is [another question](validation.md).",
        )
    )
