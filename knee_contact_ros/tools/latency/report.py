"""A part of the study as a page, as data, and as the terminal shows it."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from rich import box
from rich.console import Console
from rich.table import Table

from knee_contact_ros.system.terminal import WIDTH

Cell = str


class Sheet(NamedTuple):
    """A table; the first column has names, the others numbers."""

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    note: str = ""
    prose: bool = False
    """Texts instead of numbers, which the terminal does not show"""


class Page(NamedTuple):
    """A part of the study."""

    title: str
    introduction: str
    sheets: Sequence[Sheet]
    fields: Sequence[str]
    """Of the data"""
    lines: Sequence[Sequence[Any]]
    """The data"""


def write(page: Page, folder: Path, made: str) -> list[Path]:
    """Write the page and its data under its title; `made` says by which command, where and when. Return their names."""
    paths = [folder / f"{page.title.lower()}{suffix}" for suffix in (".md", ".csv")]
    parts = [f"# {page.title}", made, page.introduction]
    for sheet in page.sheets:
        parts += [f"## {sheet.title}", markdown(sheet), *filter(None, [sheet.note])]
    paths[0].write_text("\n\n".join(parts) + "\n", encoding="utf-8")
    with paths[1].open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(page.fields)
        writer.writerows([f"{value:.6g}" if isinstance(value, float) else value for value in row] for row in page.lines)
    return paths


def markdown(sheet: Sheet) -> str:
    """A table in Markdown."""
    rule = ["---"] + ["---" if sheet.prose else "---:"] * (len(sheet.header) - 1)
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (sheet.header, rule, *sheet.rows))


def show(page: Page) -> None:
    """Print the tables."""
    console = Console(width=WIDTH)
    for sheet in page.sheets:
        if not sheet.prose:
            table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
            table.add_column(sheet.header[0], overflow="fold")
            for heading in sheet.header[1:]:
                table.add_column(heading, justify="right", overflow="fold")
            for row in sheet.rows:
                table.add_row(*row)
            console.print(table, markup=False)


def milliseconds(time: float) -> Cell:
    """A time [ms] for people."""
    return "-" if math.isnan(time) else f"{time:.3f}" if time < 100.0 else f"{time:.0f}"


def ratio(value: float) -> Cell:
    """A ratio for people."""
    return "-" if math.isnan(value) else f"{value:.2f}"
