"""Measured medial and lateral force beside those of every share model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from benchmarks.report import Section
from knee_contact_ros.joint_reaction.compartments import MeasuredShare
from knee_contact_ros.lab.shares import constant, fit
from knee_contact_ros.parameters.build import load_model, load_rule
from knee_contact_ros.parameters.files import curve_texts, load_parameters
from studies.validation.data import BODY_WEIGHT, ON_PLATE, Floats, Measured

MS = 1e3
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


def section(trials: Sequence[Measured]) -> Section:
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
    text = (
        "The total is given: it is the sum of the four cells, fed in as `joint_reaction_force`. What is judged is "
        "how it "
        "is divided. The lateral force is the total less the medial one, so its error is that of the medial force with "
        "the other sign, and its RMS is the same. *Seen* says whether the trial itself was fitted to: only rows with "
        "*no* are predictions.\n\n"
        "![Measured and computed medial and lateral force](images/validation_forces.png)\n\n"
        "*Medial (above) and lateral force, and the error of the medial one. Grey: the foot is on the plate or "
        "belt. The "
        "tables are fitted to the other trial.*\n\n"
        "![The shipped table and what was measured](images/validation_share.png)\n\n"
        "*The medial share: the shipped table behind, the trials' samples before it. Where dots of two colours lie "
        "side by "
        "side, load and flexion do not say what the share is: no table of them can.*"
    )
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
    text = (
        "The largest medial force in the first and in the second half of every stance that the plate saw from its "
        f"beginning to its end, ours less measured. A sample is {MS * SAMPLE:.1f} ms. Where a peak is flat, a small "
        "error "
        "of the force moves it far in time: the largest shifts are such."
    )
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
    text = (
        "`moment_balance` needs the frontal moment that the femur exerts on the tibia. Here it is the adduction moment "
        "of inverse dynamics, with its sign: rotation about +x (anterior) of a right tibia is adduction, so torque.x = "
        "+moment; an external adduction moment in stance appears as a negative one and loads the medial side (the "
        f"other sign leaves {turned:.0f} N overground). It is the moment of muscles, ligaments and contact together, "
        "and not that of the contact alone: what the muscles take is missing. Where the feet change plates on the "
        f"treadmill it has spikes; beyond {LARGEST_MOMENT:.0f} N m they are counted here and left out. In stance (half "
        "a body weight or more) a line through lateral less medial force over the moment says which spacing of the "
        "compartments would fit, and what is left at no moment: the spacing is wider than any knee, and the medial "
        "side bears more even at none."
    )
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
