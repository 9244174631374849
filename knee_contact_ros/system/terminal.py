"""Lines and tables for people on the terminal, safe whatever foreign texts are in them.

Rich is imported when a table is made, so that commands which print lines only need not load it.
"""

from __future__ import annotations

import json
import math
import shutil
import sys
import textwrap
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import click

from .errors import printable

if TYPE_CHECKING:
    from rich.table import Table

WIDTH = 78
"""Largest width of a table in columns: a terminal has 80"""
UNBOUNDED = 10_000
"""Width in columns that no table reaches"""


JSON = "knee_contact_ros.json"
"""Key of Click's context: whether the results are printed as JSON"""
VERBOSE = "knee_contact_ros.verbose"
"""Key of Click's context: whether the results are printed with what developers need"""


def is_set(key: str) -> bool:
    """Return whether an option of the running command is set, by its key."""
    context = click.get_current_context(silent=True)
    return bool(context and context.meta.get(key))


def as_json() -> bool:
    """Return whether the running command prints its results as JSON, and no tables or lines."""
    return is_set(JSON)


def print_json(**values: Any) -> None:
    """Print results as one JSON object, in SI units; null stands for NaN and infinity."""
    click.echo(json.dumps(_plain(values), indent=2))


def _plain(value: Any) -> Any:
    """Return a value as what JSON has: named tuples are objects, and arrays are lists."""
    if hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, Mapping):
        return {str(name): _plain(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    if hasattr(value, "tolist"):  # of NumPy
        return _plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, bool | int) else str(value)


def warn(sentences: Iterable[str]) -> None:
    """Print warnings on stderr, a line each."""
    for sentence in sentences:
        say(f"knee-contact: warning: {sentence}", err=True)


def say(line: str, *, err: bool = False, hang: int | None = None) -> None:
    """Print a line safely, whatever foreign names and texts are in it; with `err` on stderr.

    With `hang`, a line that is too long for the terminal is broken between words, and continued with an indentation of
    that many columns.
    """
    text = printable(line)
    if hang is not None and sys.stdout.isatty():
        width = shutil.get_terminal_size().columns
        text = textwrap.fill(
            text,
            width,
            subsequent_indent=" " * hang,
            break_long_words=False,
            break_on_hyphens=False,
            replace_whitespace=False,
            drop_whitespace=True,
        )
    click.echo(text, err=err)


def show_table(
    headings: Sequence[str],
    rows: Iterable[Sequence[str]],
    right: Collection[str] = (),
    **look: Any,
) -> None:
    """Print a table; columns `right` are right-justified. Foreign texts in cells must pass `safe_cell`."""
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, **look)
    for heading in headings:
        table.add_column(
            safe_cell(heading), justify="right" if heading in right else "left", overflow="fold"
        )
    _print_rows(table, rows)


def show_pairs(pairs: Iterable[tuple[str, str]]) -> None:
    """Print names and values, a row each. Foreign texts in values must pass `safe_cell`."""
    from rich.table import Column, Table

    columns = Column(no_wrap=True), Column(overflow="fold")
    _print_rows(Table(*columns, box=None, show_header=False, pad_edge=False), pairs)


def _print_rows(table: Table, rows: Iterable[Sequence[str]]) -> None:
    """Add rows to a table and print it."""
    from rich.console import Console

    for row in rows:
        table.add_row(*row)
    Console(width=WIDTH, emoji=False).print(table, highlight=False)


def safe_cell(text: str) -> str:
    """Return a text for a cell of Rich, safe whatever foreign names and texts are in it."""
    from rich.markup import escape

    return escape(printable(text))
