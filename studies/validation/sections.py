"""Sections of the page, in its order."""

from __future__ import annotations

from collections.abc import Sequence

from benchmarks.report import Section
from studies.validation import events, field, path, shares
from studies.validation.data import BODY_WEIGHT, Measured

TITLE = "Against an instrumented knee"
COMMAND = "python -m studies.validation --data FOLDER"


def sections(trials: Sequence[Measured]) -> list[Section]:
    """All sections with their numbers."""
    return [
        Section("", introduction(trials), (), ()),
        shares.section(trials),
        shares.peak_section(trials),
        shares.moment_section(trials),
        events.section(trials),
        path.section(trials),
        field.section(left_out(trials)),
        Section("7. What these data cannot show", limits(trials), (), ()),
    ]


def left_out(trials: Sequence[Measured]) -> tuple[float, float]:
    """RMS error [BW] of the medial force in both trials, with the table of the other one."""
    one, two = trials
    found = [
        next(shares.rms(each.medial - a.medial) for each in shares.answers(a, [b]) if "to the other" in each.name)
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
    return (
        f"Two walking trials of one man (right knee, {BODY_WEIGHT} N) whose total knee replacement has four force "
        "cells in its "
        f"tibial tray: {told}. Fourth Grand Challenge Competition to Predict In Vivo Knee Loads (Fregly et al. 2012, "
        "J Orthop "
        "Res 30:503; Kinney et al. 2013, doi:10.1115/1.4023255). Flexion, and the frontal moment, are those of inverse "
        "kinematics and dynamics; the medial force is the tray's published regression of its cells, 0.9871 AM + "
        "0.9683 PM + "
        "0.0387 AL + 0.0211 PL. The data are not part of this project: without them the command makes nothing, and "
        "says so."
    )


def limits(trials: Sequence[Measured]) -> str:
    """Section on what must not be concluded."""
    most = max(map(shares.through_the_model, trials))
    return "\n".join(
        (
            "- **Depth, pressure and stiffness**: polyethylene on metal gives way otherwise than cartilage. No "
            "depth of this "
            "model was held against these trials.",
            "- **Whether the contact model gets the force right**: a force that presses is answered with the same "
            "force, but "
            f"for inertia (`healthy.yaml` at 120 Hz: {most:.1f} N at most). What is tested here is the split, the "
            "timing and the events.",
            "- **Other people**: two trials of one man with an implant. A table of his shares says nothing of a "
            "varus knee, "
            "a knee with its ligaments, stairs or squats.",
            "- **The total**: it is measured here, and computed where there is no implant. Its error is not in these "
            "numbers.",
            "- **The cells themselves**: a regression stands between them and the medial force, and its own error "
            "is not "
            "known here.",
        )
    )
