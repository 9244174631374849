"""Sections of docs/validation.md: shares, events, path, and what the field says."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.report import Section, words
from knee_contact_ros.joint_reaction.compartments import MeasuredShare
from knee_contact_ros.lab.shares import constant, fit
from knee_contact_ros.parameters.build import load_model, load_rule
from knee_contact_ros.parameters.files import curve_texts, load_parameters
from knee_contact_ros.streams.gait_events import HEEL_STRIKE, TOE_OFF, GaitEvents
from studies.validation.data import BODY_WEIGHT, ON_PLATE, Floats, Measured

WORDS = words(Path(__file__).with_name("words.txt"))

ROWS = (
    ("Grand Challenge 2010 to 2012, winners (Kinney et al. 2013, doi:10.1115/1.4023255)",
     "motion, ground reaction, some with EMG; muscle and contact models; blinded",
     "medial and lateral force in two gait trials",
     "medial 229 to 312 N, lateral 238 to 326 N; r² at most 0.91 and 0.70"),
    ("static optimisation in OpenSim (Bennett et al. 2024, doi:10.1115/1.4064550)",
     "motion, ground reaction", "medial force in walking", "medial 0.33 BW, r² 0.77"),
    ("recurrent network (the same)", "motion only; trained on six persons, tested on two others",
     "medial force in walking", "medial 0.27 BW, r² 0.77"),
    ("recurrent network (Derungs et al. 2026, doi:10.3390/bioengineering13020173)",
     "motion, EMG and ground reaction; the tested person left out",
     "total, medial and lateral force", "total 0.16 BW in walking at best"),
)  # fmt: skip


def field_section(ours: tuple[float, float]) -> Section:
    """Section with the table; `ours` are RMS errors [BW] of the medial force with a table of the other trial."""
    low, high = sorted(ours)
    mine = (
        "ours, `measured_share` (above)", "**the measured total force** and flexion; fitted to another trial of the "
        "same person", "how the total is divided", f"medial {low:.2f} and {high:.2f} BW",
    )  # fmt: skip
    text = WORDS["field"]
    return Section(
        "6. The field", text, ("source", "given", "predicts", "RMS error"), [list(row) for row in (*ROWS, mine)]
    )


NANOSECONDS, MS = 1e9, 1e3
NEAR = 0.2
"""Largest time [s] between an event and that of the plate"""


def found_in(measured: Measured) -> dict[str, list[float]]:
    """Times [s] of heel strikes and toe-offs by `pipeline.gait`, from flexion and total load."""
    stamps = np.rint((measured.time - measured.time[0]) * NANOSECONDS).astype(np.int64)
    events = GaitEvents(BODY_WEIGHT)
    all_events = events.add(stamps, measured.flexion, measured.total) + events.finish()
    return {
        kind: sorted(measured.time[0] + each.stamp / NANOSECONDS for each in all_events if each.kind == kind)
        for kind in (HEEL_STRIKE, TOE_OFF)
    }


def errors_of(found: Sequence[float], plate: Sequence[float]) -> list[float]:
    """Times [s] by which events come after those of the plate, for the ones that have a partner."""
    return [
        min((time - other for time in found), key=abs)
        for other in plate
        if found and min(abs(time - other) for time in found) <= NEAR
    ]


def events_section(trials: Sequence[Measured]) -> Section:
    """Section on how far events lie from those of the plates, and which were missed."""
    rows = []
    for measured in trials:
        within = measured.time[0], measured.time[-1]
        found = found_in(measured)
        for kind, plate in zip((HEEL_STRIKE, TOE_OFF), measured.contacts(), strict=True):
            seen = [time for time in plate if within[0] <= time <= within[1]]
            errors = MS * np.array(errors_of(found[kind], seen))
            numbers = (f"{errors.mean():+.0f} ms", f"{np.abs(errors).max():.0f} ms") if len(errors) else ("-", "-")
            first, last = measured.plate_time[0] + NEAR, measured.plate_time[-1] - NEAR
            covered = [time for time in found[kind] if first <= time <= last]
            extra = len([time for time in covered if not any(abs(time - other) <= NEAR for other in plate)])
            rows.append([measured.name, kind, str(len(seen)), str(len(errors)), *numbers, str(extra)])
    text = WORDS["events"].format(ON_PLATE=ON_PLATE)
    header = ("trial", "event", "on the plate", "found", "mean error", "largest", "found where no plate was")
    return Section("4. Gait events", text, header, rows)


MM = 1e3
KNEES = {
    "circle, hinge (`healthy.yaml`)": ["healthy"],
    "MRI femur on a measured plateau, table of translation (`mri_knee.yaml`)": ["mri_knee"],
}
LOADED = 0.5
"""Medial force [BW] above which its measured place is meaningful"""


def path(measured: Measured, names: Sequence[str]) -> Floats:
    """Contact point x [m], anterior positive, of a shipped model under the medial load of the shipped table."""
    model = load_model([*names, {"body_weight": BODY_WEIGHT, "fidelity.level": "quasi_static"}], compiled=False)
    series = model.run(measured.time - measured.time[0], measured.flexion, shipped(measured))
    return np.asarray(series.contact_point.x)


def path_section(trials: Sequence[Measured]) -> Section:
    """Section on the range of the path, and its correlation with the cells'."""
    rows = []
    for measured in trials:
        loaded = measured.medial > LOADED * BODY_WEIGHT
        front = measured.front[loaded]
        for name, files in KNEES.items():
            x = path(measured, files)[loaded]
            related = f"{np.corrcoef(x, front)[0, 1]:+.2f}" if np.ptp(x) > 1e-6 else "it stands still"
            rows.append([
                measured.name, name, f"{MM * x.min():+.1f} to {MM * x.max():+.1f} mm",
                f"{front.min():.2f} to {front.max():.2f}", related,
            ])  # fmt: skip
    text = WORDS["path"].format(LOADED=LOADED)
    header = ("trial", "model", "contact point x", "part of the anterior cell", "r")
    return Section("5. Contact path", text, header, rows)


LARGEST_MOMENT = 80.0
"""Largest plausible moment of inverse dynamics [N m] in walking; larger ones come from a change of plates"""
PEAK_WITHIN = 0.5
"""Part of a stance on either side of its middle in which a peak is searched"""
SAMPLE = 1.0 / 120.0
"""Time [s] between two samples of the cells"""


class Answer(NamedTuple):
    """Medial force of a trial by a share model."""

    name: str
    medial: Floats
    """Medial force [N]"""
    seen: bool = False
    """Whether the trial itself was used to make it"""


class Peak(NamedTuple):
    """Errors of a peak of the medial force in a stance."""

    error: float
    """Our peak less the measured one [N]"""
    late: float
    """Time of our peak less that of the measured one [s]"""


def answers(measured: Measured, others: Sequence[Measured]) -> list[Answer]:
    """Medial forces of a trial by every share model; models may be fitted to `others` only."""
    known = [other.trial for other in others]
    table = MeasuredShare(fit(known), BODY_WEIGHT)
    return [
        Answer("`fixed_share` 0.5", rule_of(measured, {"load.share": 0.5})),
        Answer("`fixed_share`, best constant of the other trial", constant(known) * measured.total),
        Answer("`moment_balance`, 40 mm", rule_of(measured, {"load.compartment": "moment_balance"})),
        Answer(
            "`measured_share`, fitted to the other trial",
            table.share(measured.total, measured.flexion) * measured.total,
        ),
        Answer("`measured_share`, shipped (fitted to both)", shipped(measured), seen=True),
    ]


def shipped(measured: Measured) -> Floats:
    """Medial force [N] by the shipped table."""
    return rule_of(measured, {"load.compartment": "measured_share"})


def rule_of(measured: Measured, values: dict[str, object]) -> Floats:
    """Medial force [N] by the rule that parameters name."""
    parameters = load_parameters({"body_weight": BODY_WEIGHT} | values)
    rule = load_rule(parameters, curve_texts(parameters, {}))
    return np.asarray(rule(measured.total, measured.moment, measured.flexion))


def rms(error: Floats) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(error**2)))


def peaks(measured: Measured, medial: Floats) -> list[Peak]:
    """Errors of the largest medial force in either half of every whole stance that the plate saw."""
    strikes, leaves = measured.contacts()
    found = []
    for begin in strikes:
        end = next((time for time in leaves if time > begin), None)
        if end is None or end > measured.time[-1]:
            continue
        middle = begin + PEAK_WITHIN * (end - begin)
        for first, last in ((begin, middle), (middle, end)):
            part = np.flatnonzero((measured.time >= first) & (measured.time < last))
            ours, theirs = part[medial[part].argmax()], part[measured.medial[part].argmax()]
            late = float(measured.time[ours] - measured.time[theirs])
            found.append(Peak(float(medial[ours] - measured.medial[theirs]), late))
    return found


def shares_section(trials: Sequence[Measured]) -> Section:
    """Section on RMS error and r of both compartments."""
    rows = []
    for place, measured in enumerate(trials):
        others = [*trials[:place], *trials[place + 1 :]]
        lateral = measured.total - measured.medial
        for answer in answers(measured, others):
            error = answer.medial - measured.medial
            plausible = np.abs(measured.moment) <= LARGEST_MOMENT
            shown = f"{rms(error):.0f} N, {rms(error) / BODY_WEIGHT:.3f} BW"
            if "moment" in answer.name and not plausible.all():
                kept = rms(error[plausible])
                shown += f" ({kept:.0f} N, {kept / BODY_WEIGHT:.3f} BW without the spikes)"
            rows.append([
                measured.name, answer.name, "yes" if answer.seen else "no", shown,
                f"{np.corrcoef(answer.medial, measured.medial)[0, 1]:.3f}",
                f"{np.corrcoef(measured.total - answer.medial, lateral)[0, 1]:.3f}", f"{np.mean(error):+.0f} N",
            ])  # fmt: skip
    text = WORDS["shares"]
    header = (
        "trial",
        "share model",
        "seen",
        "RMS error, medial = lateral",
        "r medial",
        "r lateral",
        "mean error, medial",
    )
    return Section("1. The share", text, header, rows)


def peak_section(trials: Sequence[Measured]) -> Section:
    """Section on the errors of the peaks in size and time."""
    rows = []
    for place, measured in enumerate(trials):
        others = [*trials[:place], *trials[place + 1 :]]
        for answer in answers(measured, others):
            found = peaks(measured, answer.medial)
            for which, half in (("first", found[::2]), ("second", found[1::2])):
                sizes, times = (np.array(column) for column in zip(*half, strict=True))
                rows.append([
                    measured.name, answer.name, which, str(len(half)),
                    f"{sizes.mean():+.0f} ± {sizes.std():.0f} N", f"{np.abs(sizes).max():.0f} N",
                    f"{MS * np.median(times):+.0f} ms", f"{MS * np.abs(times).max():.0f} ms",
                ])  # fmt: skip
    text = WORDS["peak"].format(sample=MS * SAMPLE)
    header = ("trial", "share model", "peak", "stances", "error", "largest", "median shift", "largest shift")
    return Section("2. Peaks of the medial force", text, header, rows)


def moment_section(trials: Sequence[Measured]) -> Section:
    """Section on how the frontal moment of inverse dynamics relates to the split."""
    rows = []
    for measured in trials:
        stance = (np.abs(measured.moment) <= LARGEST_MOMENT) & (measured.total > 0.5 * BODY_WEIGHT)
        moment, difference = measured.moment[stance], (measured.total - 2.0 * measured.medial)[stance]
        slope, offset = np.polyfit(moment, difference, 1)
        spikes = int((np.abs(measured.moment) > LARGEST_MOMENT).sum())
        rows.append([
            measured.name, f"{spikes} of {len(measured.time)}", f"{np.abs(measured.moment).max():.0f} N m",
            f"{np.corrcoef(moment, difference)[0, 1]:.2f}", f"{MS * 2.0 / slope:.0f} mm", f"{offset:+.0f} N",
        ])  # fmt: skip
    first = trials[0]
    mirrored = rule_of(first._replace(moment=-first.moment), {"load.compartment": "moment_balance"})
    turned = rms(mirrored - first.medial)
    text = WORDS["moment"].format(turned=turned, LARGEST_MOMENT=LARGEST_MOMENT)
    header = (
        "trial",
        "samples with spikes",
        "largest moment",
        "r, lateral − medial and moment",
        "spacing of the line",
        "at no moment",
    )
    return Section("3. `moment_balance` and the moment of inverse dynamics", text, header, rows)


def through_the_model(measured: Measured) -> float:
    """Largest difference [N] between the model's contact force and the load that it was given, the start left out."""
    model = load_model(["healthy", {"body_weight": BODY_WEIGHT}], compiled=False)
    load = shipped(measured)
    series = model.run(measured.time - measured.time[0], measured.flexion, load)
    return float(np.abs(series.contact_force - load)[12:].max())


def in_stance(measured: Measured) -> Floats:
    """Whether the foot is on the plate, at the cells' samples: 0 or 1."""
    on = (measured.plate > ON_PLATE).astype(float)
    found: Floats = np.interp(measured.time, measured.plate_time, on, left=0.0, right=0.0).round()
    return found


TITLE = "Against an instrumented knee"
COMMAND = "python -m studies.validation --data FOLDER"


def sections(trials: Sequence[Measured]) -> list[Section]:
    """All sections with their numbers."""
    return [
        Section("", introduction(trials), (), ()),
        shares_section(trials),
        peak_section(trials),
        moment_section(trials),
        events_section(trials),
        path_section(trials),
        field_section(left_out(trials)),
        Section("7. What these data cannot show", limits(trials), (), ()),
    ]


def left_out(trials: Sequence[Measured]) -> tuple[float, float]:
    """RMS error [BW] of the medial force in both trials, with the table of the other one."""
    one, two = trials
    found = [
        next(rms(each.medial - a.medial) for each in answers(a, [b]) if "to the other" in each.name)
        for a, b in ((one, two), (two, one))
    ]
    return found[0] / BODY_WEIGHT, found[1] / BODY_WEIGHT


def introduction(trials: Sequence[Measured]) -> str:
    """Section that introduces the person and the comparison."""
    told = "; ".join(
        f"{each.name} ({len(each.time)} samples over {each.time[-1] - each.time[0]:.1f} s, total force up to "
        f"{each.total.max():.0f} N, medial up to {each.medial.max():.0f} N)"
        for each in trials
    )
    return WORDS["introduction"].format(BODY_WEIGHT=BODY_WEIGHT, told=told)


def limits(trials: Sequence[Measured]) -> str:
    """Section on what must not be concluded."""
    most = max(map(through_the_model, trials))
    return "\n".join(
        (
            "- **Depth, pressure and stiffness**: polyethylene on metal gives way otherwise than cartilage. No "
            "depth of this "
            "model was held against these trials.",
            WORDS["limits"].format(most=most),
            WORDS["limits_2"],
            "- **The total**: it is measured here, and computed where there is no implant. Its error is not in these "
            "numbers.",
            "- **The cells themselves**: a regression stands between them and the medial force, and its own error "
            "is not "
            "known here.",
        )
    )
