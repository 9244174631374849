"""Sections of the report, in its order."""

from __future__ import annotations

from benchmarks.report import Section
from studies.reproduction import (
    contact_points,
    contradictions,
    healthy,
    loads,
    local_radius,
    numerics,
    osteoarthritis,
    ringing,
    table1,
)

TITLE = "Reproduction of the paper's numbers"
COMMAND = "python -m studies.reproduction"
INTRODUCTION = (
    "The planar knee contact model of a paper (The prediction of knee contact forces with the novel two-dimensional "
    "dynamic model of human knee, accepted 3 December 2025) against this implementation. Inputs: the bags "
    "`bags/gait2354_right` and `bags/gait2354_left` (OpenSim 4.6, gait2354, subject01 walking; 0.53 to 2.46 s, 5 "
    "ms), half of the axial joint reaction, body weight 75.16 kg x 9.80665 m/s². Models: `config/healthy.yaml`, "
    "`config/osteoarthritis.yaml`, with `config/mri_femur.yaml` for the fitted curve, solved to 1e-9 m. The MRI "
    "profile is of another knee than the paper's.\n\n"
    "**Nothing is tuned to match.** Every parameter is the paper's, or derived from the paper's, or stated in "
    "sections 2 and 5. Where a value is solved for backwards, to say what a printed number would need, the text "
    "says so. The paper's numbers are those of its text and its table; its figures were not digitised. Differences "
    "are ours less the paper's. The model describes one compartment in the plane; nothing here is a medical "
    "statement."
)


def sections() -> list[Section]:
    """All sections with their numbers."""
    return [
        Section("", INTRODUCTION, (), ()),
        loads.section(),
        table1.section(),
        healthy.force_section(),
        healthy.depth_section(),
        local_radius.section(),
        contact_points.section(),
        contact_points.curved_section(),
        osteoarthritis.section(),
        osteoarthritis.led_section(),
        ringing.section(),
        numerics.section(),
        loads.both_legs(),
        contradictions.section(),
    ]
