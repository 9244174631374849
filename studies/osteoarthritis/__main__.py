"""Compute 10 000 knees and write docs/osteoarthritis-study.md, its figures and its table."""

from __future__ import annotations

from pathlib import Path

import click

from benchmarks.report import machine
from studies.osteoarthritis.figures import draw
from studies.osteoarthritis.findings import find
from studies.osteoarthritis.knees import compute, curves, whole, write_csv
from studies.osteoarthritis.page import text


@click.command()
@click.option(
    "--folder", type=click.Path(path_type=Path), default=Path("docs"), help="gets the page, images/, studies/"
)
def main(folder: Path) -> None:
    """Compute all knees, draw the figures and write the page."""
    knees = compute(whole())
    (folder / "studies").mkdir(parents=True, exist_ok=True)
    (folder / "osteoarthritis-study.md").write_text(text(knees, find(knees), machine()), encoding="utf-8")
    write_csv(knees, folder / "studies" / "osteoarthritis.csv")
    draw(knees, curves(knees), folder / "images")


if __name__ == "__main__":
    main()
