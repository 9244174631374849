"""Answers as a short table with the first and the last few rows, for terminals and notebooks."""

from __future__ import annotations

from html import escape
from io import StringIO

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from knee_contact_ros.model.types import NANOSECOND, Rows, Status
from knee_contact_ros.results.columns import begin_in, stamp_text, time_of

ENDS = 4
"""Number of rows that are shown of the beginning, and of the end"""
WIDTH = 78
"""Width of the table in a terminal [characters]"""
HEADINGS = ("time [s]", "flexion [°]", "load [N]", "contact force [N]", "depth [mm]", "point x [mm]", "status")


def in_a_line(rows: Rows) -> str:
    """Summarise answers in a line: number, duration and peaks."""
    if not len(rows):
        return "no ticks"
    time = time_of(rows)
    force, depth = float(np.max(rows["contact_force"])), 1e3 * float(np.max(rows["penetration_depth"]))
    ticks = f"{len(rows)} tick{'s' * (len(rows) != 1)}"
    return f"{ticks} over {time[-1] - time[0]:.3f} s, at most {force:.1f} N and {depth:.3f} mm"


def as_text(rows: Rows) -> str:
    """Write the table as text for a terminal."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in HEADINGS:
        table.add_column(heading.replace("[", r"\["), justify="right")
    for cells in _cells(rows):
        table.add_row(*cells)
    text = StringIO()
    Console(file=text, width=WIDTH).print(table)
    lines = [in_a_line(rows), _origin(rows), *(line.rstrip() for line in text.getvalue().splitlines())]
    return "\n".join(filter(None, lines))


def as_html(rows: Rows) -> str:
    """Write the table as HTML for a notebook."""
    head = "".join(f"<th>{escape(heading)}</th>" for heading in HEADINGS)
    body = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in cells)}</tr>" for cells in _cells(rows))
    whole = f'<table style="text-align: right"><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>'
    return f"<p>{escape(f'{in_a_line(rows)} {_origin(rows)}'.strip())}</p>{whole}"


def _origin(rows: Rows) -> str:
    begin = begin_in(rows)
    return f"time from {NANOSECOND * begin:.3f} s on" if begin else ""


def _cells(rows: Rows) -> list[tuple[str, ...]]:
    begin = begin_in(rows)
    if len(rows) <= 2 * ENDS + 1:
        return _cells_of(rows, begin)
    return [*_cells_of(rows[:ENDS], begin), ("…",) * len(HEADINGS), *_cells_of(rows[-ENDS:], begin)]


def _cells_of(rows: Rows, begin: int) -> list[tuple[str, ...]]:
    return [
        (
            stamp_text(int(row["stamp"]), begin), f"{np.degrees(row['flexion_angle']):.1f}",
            f"{row['load']:.1f}", f"{row['contact_force']:.1f}", f"{1e3 * row['penetration_depth']:.3f}",
            f"{1e3 * row['contact_point']['x']:.2f}", Status(int(row["status"])).name or str(row["status"]),
        )
        for row in np.asarray(rows)
    ]  # fmt: skip
