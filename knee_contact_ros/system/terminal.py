"""Output for people on the terminal: progress bars (none in a pipe), and lines with foreign texts."""

from __future__ import annotations

import math
import shutil
import sys
import textwrap
import time
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

import click
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    Progress,
    SpinnerColumn,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Column, Table

from knee_contact_ros.system.errors import printable

WIDTH = 78
"""Largest width of a table in columns: a terminal has 80"""
UNBOUNDED = 10_000
"""Width in columns that no table reaches"""
PERIOD = 0.05
"""Time [s] between two updates of a bar: an update takes about 20 µs, longer than many messages"""


_BAR: ContextVar[Bar | None] = ContextVar("bar", default=None)
"""Bar that is now on the terminal"""


class Bar:
    """Function of (done, total) that updates a bar on the terminal."""

    def __init__(self, bar: Progress, what: str) -> None:
        """Add a task, described by `what`, to a bar."""
        self._bar = bar
        self.what = what
        """Current description"""
        self._task = bar.add_task(safe_cell(what), total=None)
        self._next = 0.0 if not bar.disable else math.inf

    def __call__(self, done: int, total: int) -> None:
        """Update the bar, unless it has just been updated; the last step is always shown."""
        now = time.monotonic()
        if now >= self._next or (done == total and self._next < math.inf):
            self._next = now + PERIOD
            self._bar.update(self._task, completed=done, total=total)

    def describe(self, what: str) -> None:
        """Change the description of the bar."""
        self.what = what
        self._bar.update(self._task, description=safe_cell(what))


@contextmanager
def progress(what: str) -> Iterator[Bar]:
    """Show a bar on the terminal, and nothing in a pipe; yields a function of (done, total) that updates it."""
    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeRemainingColumn(),
    )
    disable = (
        console.quiet
    ) = not console.is_terminal  # Rich 13.7 ends a hidden bar with an empty line
    with Progress(*columns, console=console, disable=disable, transient=True) as bar:
        console.show_cursor(
            True
        )  # a process that Ctrl-Z stops would leave the terminal without one
        update = Bar(bar, what)
        token = _BAR.set(None if disable else update)
        try:
            yield update
        finally:
            _BAR.reset(token)


@contextmanager
def announce(what: str) -> Iterator[None]:
    """Announce slow work on stderr: on a terminal in its bar, if any, or with a clock; else as a line."""
    console, bar = Console(stderr=True), _BAR.get()
    if bar:
        before = bar.what
        bar.describe(what)
        yield
        bar.describe(before)
    elif console.is_terminal:
        columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
        with Progress(*columns, console=console, transient=True) as clock:
            console.show_cursor(True)
            clock.add_task(safe_cell(what), total=None)
            yield
    else:
        say(what, err=True)
        yield


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
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, **look)
    for heading in headings:
        table.add_column(
            escape(heading), justify="right" if heading in right else "left", overflow="fold"
        )
    for row in rows:
        table.add_row(*row)
    Console(width=WIDTH, emoji=False).print(table, highlight=False)


def show_pairs(pairs: Iterable[tuple[str, str]]) -> None:
    """Print names and values, a row each. Foreign texts in values must pass `safe_cell`."""
    table = Table(
        Column(no_wrap=True), Column(overflow="fold"), box=None, show_header=False, pad_edge=False
    )
    for pair in pairs:
        table.add_row(*pair)
    Console(width=WIDTH, emoji=False).print(table, highlight=False)


def safe_cell(text: str) -> str:
    """Safe text for a cell or a bar of Rich, whatever foreign names and texts are in it."""
    return escape(printable(text))
