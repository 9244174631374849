"""The table that `fit-share` prints."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from rich import box
from rich.console import Console
from rich.table import Table

from knee_contact_ros.system.terminal import WIDTH, say, shown
from knee_contact_ros.tools.shares.fit import Errors


def show_errors(errors: Sequence[Errors], output: Path) -> None:
    """Print the RMS errors of the medial force in every trial, and the output file."""
    console = Console(width=WIDTH, emoji=False)
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, title="RMS error of the medial force", title_justify="left")
    table.add_column("trial", overflow="fold")
    for name in ("share of 1/2", "constant of\nthe others", "table of\nthe others", "table of\nall trials"):
        table.add_column(name, justify="right")
    for trial in errors:
        values = (trial.half, trial.constant, trial.left_out, trial.fitted)
        table.add_row(shown(trial.trial), *(_both(value, trial.body_weight) for value in values))
    console.print(table)
    if len(errors) == 1:
        console.print("One trial: nothing says how well the table holds on another.", highlight=False)
    say(f"Written: {output}")


def _both(force: float, body_weight: float) -> str:
    """Return a force [N] as text in N and in body weights; a dash for NaN."""
    return "-" if math.isnan(force) else f"{force:.1f} N\n{force / body_weight:.3f} BW"
