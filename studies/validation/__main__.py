"""Write docs/explanation/validation.md, its picture and the shipped share."""

from __future__ import annotations

from pathlib import Path

import click

from benchmarks.report import machine, save
from studies.validation.data import PERSONS, walks
from studies.validation.sections import COMMAND, TITLE, sections
from studies.validation.split import write_shipped
from studies.validation.total import estimates


@click.command()
@click.option(
    "--data",
    type=click.Path(path_type=Path),
    envvar="INSTRUMENTED_KNEE",
    help="Folder above the files of both persons; or the environment's INSTRUMENTED_KNEE.",
)
@click.option(
    "--folder",
    type=click.Path(path_type=Path),
    default=Path("docs"),
    help="gets explanation/ and images/",
)
@click.option(
    "--share", type=click.Path(path_type=Path), help="File to write the shipped share to."
)
def main(data: Path | None, folder: Path, share: Path | None) -> None:
    """Compare with the data, draw, and write the page; without the data of both persons, do nothing."""
    found = walks(data) if data else []
    if {walk.person.name for walk in found} != {person.name for person in PERSONS}:
        click.echo(
            f"no measurements of both instrumented knees in {data or '(no folder given)'}: nothing is made"
        )
        return
    from studies.validation.figures import draw

    estimated = estimates(found)
    save(
        folder / "explanation" / "validation.md",
        TITLE,
        COMMAND,
        sections(found, estimated),
        machine(),
    )
    draw(estimated, found, folder / "images")
    if share:
        write_shipped(found, share)


if __name__ == "__main__":
    main()
