"""Write docs/validation.md and its pictures."""

from __future__ import annotations

from pathlib import Path

import click

from benchmarks.report import machine, save
from studies.validation.data import is_there, read
from studies.validation.sections import COMMAND, TITLE, sections


@click.command()
@click.option(
    "--data",
    type=click.Path(path_type=Path),
    envvar="INSTRUMENTED_KNEE",
    help="Folder with ngait_og5_*.csv and ngait_tm_fast1_*.csv; or the environment's INSTRUMENTED_KNEE.",
)
@click.option("--folder", type=click.Path(path_type=Path), default=Path("docs"), help="gets validation.md and images/")
def main(data: Path | None, folder: Path) -> None:
    """Compare with the data, draw, and write the page; without the data, do nothing."""
    if data is None or not is_there(data):
        click.echo(f"no measurements of the instrumented knee in {data or '(no folder given)'}: nothing is made")
        return
    from studies.validation.figures import draw

    trials = read(data)
    save(folder / "validation.md", TITLE, COMMAND, sections(trials), machine())
    draw(trials, folder / "images")


if __name__ == "__main__":
    main()
