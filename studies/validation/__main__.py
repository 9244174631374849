"""Write docs/explanation/validation.md, its picture and the shipped share."""

from __future__ import annotations

from pathlib import Path

import click

from benchmarks.report import machine, save
from studies.validation.data import walks, with_medial
from studies.validation.sections import COMMAND, TITLE, sections
from studies.validation.split import write_shipped
from studies.validation.total import estimates

LEAST_PERSONS = 2
"""Number of persons without whom nothing can be judged on a person who was left out"""
WHERE = (
    "The measurements are public: the Grand Challenge Competition to Predict In Vivo Knee Loads, "
    "simtk.org/projects/kneeloads (JW's fourth and PS's fifth as tables of their own), and single strides in "
    "github.com/fmoissenet/MSK_Delp_U_Ankle (GPL-3). studies/validation/data.py says which names and columns are read."
)


@click.command()
@click.option(
    "--data",
    type=click.Path(path_type=Path),
    envvar="INSTRUMENTED_KNEE",
    help="Folder above the files of all persons; or the environment's INSTRUMENTED_KNEE.",
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
    """Compare with the data, draw, and write the page; without the data of two persons, do nothing."""
    found = walks(data) if data else []
    if len({walk.person.name for walk in with_medial(found)}) < LEAST_PERSONS:
        click.echo(
            f"no two persons with a measured medial force in {data or '(no folder given)'}: nothing is made"
        )
        click.echo(WHERE)
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
    draw(estimated, with_medial(found), folder / "images")
    if share:
        write_shipped(with_medial(found), share)


if __name__ == "__main__":
    main()
