"""One part of the study as a page, as data, and as the terminal shows it."""

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
    """A table whose first column holds names, and the others numbers."""

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    note: str = ""
    prose: bool = False
    """Whether the cells are texts, which the terminal does not show"""


class Page(NamedTuple):
    """One part of the study: its tables and its data."""

    title: str
    introduction: str
    sheets: Sequence[Sheet]
    fields: Sequence[str]
    """Names of the columns of the data"""
    lines: Sequence[Sequence[Any]]
    """Rows of the data"""


def write(page: Page, folder: Path, made: str) -> list[Path]:
    """Write page and data under the page's title, and return their paths; `made` states command, machine and time."""
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
    """Format a table in Markdown."""
    rule = ["---"] + ["---" if sheet.prose else "---:"] * (len(sheet.header) - 1)
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (sheet.header, rule, *sheet.rows))


def show(page: Page) -> None:
    """Print the tables of numbers."""
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
    """Format a time [ms] for people."""
    return "-" if math.isnan(time) else f"{time:.3f}" if time < 100.0 else f"{time:.0f}"


def ratio(value: float) -> Cell:
    """Format a ratio for people."""
    return "-" if math.isnan(value) else f"{value:.2f}"
