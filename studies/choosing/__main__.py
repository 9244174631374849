"""The command of the study of levels, tolerances and geometries.

python -m studies.choosing [--turns N] [--page FILE] [--data FILE] [--picture FILE] [--latency FILE]
"""

from __future__ import annotations

import os
from pathlib import Path

import click

from benchmarks import report
from studies.choosing.page import block, read_latency, with_block, write_csv
from studies.choosing.picture import draw
from studies.choosing.study import measure

FILE = click.Path(path_type=Path, dir_okay=False)
COMMAND = "python -m studies.choosing"


@click.command()
@click.option("--turns", type=click.IntRange(1, 1000), default=9, show_default=True, help="How often a tick is timed.")
@click.option(
    "--page",
    type=FILE,
    default="docs/choosing-fidelity.md",
    show_default=True,
    help="Whose measured part is exchanged.",
)
@click.option("--data", type=FILE, default="docs/studies/choosing.csv", show_default=True)
@click.option("--picture", type=FILE, default="docs/images/choosing_fidelity.png", show_default=True)
@click.option("--latency", type=FILE, default="docs/studies/latency.csv", show_default=True,
              help="What `benchmarks.latency` found.")  # fmt: skip
def main(turns: int, page: Path, data: Path, picture: Path, latency: Path) -> None:
    """Measure what level, tolerance and geometry cost and leave out, beside what the inputs leave open."""
    text, end_to_end = page.read_text(encoding="utf-8"), read_latency(latency)
    with_block(text, "")  # before an hour of work
    machine = report.machine("numba")
    study = measure(turns, lambda done: click.echo(done, err=True))
    write_csv(study, data)
    draw(study, picture)
    seen = os.path.relpath(picture.resolve(), page.resolve().parent)
    command = COMMAND if turns == 9 else f"{COMMAND} --turns {turns}"
    page.write_text(with_block(text, block(study, end_to_end, seen, command, machine)), encoding="utf-8")


if __name__ == "__main__":
    main()
