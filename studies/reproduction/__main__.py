"""Write docs/reproduction.md and its figures."""

from __future__ import annotations

from pathlib import Path

import click

from benchmarks.report import Section, machine, save
from studies.reproduction.healthy import (
    both_legs,
    contact_points_section,
    curved_section,
    depth_section,
    force_section,
    loads_section,
    local_radius_section,
    table1_section,
)
from studies.reproduction.osteoarthritis import (
    contradictions_section,
    led_section,
    numerics_section,
    osteoarthritis_section,
    ringing_section,
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
        loads_section(),
        table1_section(),
        force_section(),
        depth_section(),
        local_radius_section(),
        contact_points_section(),
        curved_section(),
        osteoarthritis_section(),
        led_section(),
        ringing_section(),
        numerics_section(),
        both_legs(),
        contradictions_section(),
    ]


@click.command()
@click.option(
    "--folder", type=click.Path(path_type=Path), default=Path("docs"), help="gets reproduction.md and images/"
)
def main(folder: Path) -> None:
    """Compute all numbers, draw the figures and write the page."""
    from studies.reproduction.figures import draw

    save(folder / "reproduction.md", TITLE, COMMAND, sections(), machine())
    draw(folder / "images")


if __name__ == "__main__":
    main()
