"""Write docs/reproduction.md and its figures."""

from __future__ import annotations

from pathlib import Path

import click

from benchmarks.report import Section, machine, save, words
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

WORDS = words(Path(__file__).with_name("words.txt"))

TITLE = "Reproduction of the paper's numbers"
COMMAND = "python -m studies.reproduction"
INTRODUCTION = WORDS["introduction"]


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
