"""Write docs/reproduction.md and its figures."""

from __future__ import annotations

from pathlib import Path

import click

from benchmarks.report import machine, save
from studies.reproduction.sections import COMMAND, TITLE, sections


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
