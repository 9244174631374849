"""What a person sees on the terminal: progress bars (none in a pipe), and lines that hold texts of others."""

from __future__ import annotations

import math
import shutil
import sys
import textwrap
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

import click
from rich.console import Console
from rich.markup import escape
from rich.measure import Measurement
from rich.progress import (
    BarColumn,
    Progress,
    SpinnerColumn,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table

from knee_contact_ros.system.printable import printable

WIDTH = 78
"""Columns of a table: a terminal has 80"""
UNBOUNDED = 10_000
PERIOD = 0.05
"""[s] from one movement of a bar to the next: a movement takes some 20 µs, more than many a message"""


_BAR: ContextVar[Bar | None] = ContextVar("bar", default=None)
"""The one that is on the terminal"""


class Bar:
    """A function of (done, total) that moves a bar on the terminal."""

    def __init__(self, bar: Progress, what: str, *, still: bool) -> None:
        self._bar = bar
        self.what = what
        self._task = bar.add_task(shown(what), total=None)
        self._still = still
        self._next = 0.0 if not bar.disable else math.inf

    def __call__(self, done: int, total: int) -> None:
        """Move the bar, unless it has just moved; the last step always shows."""
        now = time.monotonic()
        if now >= self._next or (done == total and self._next < math.inf):
            self._next = now + PERIOD
            self._bar.update(self._task, completed=done, total=total, refresh=self._still)

    def describe(self, what: str) -> None:
        """Say something else beside the bar."""
        self.what = what
        self._bar.update(self._task, description=shown(what), refresh=self._still)


@contextmanager
def progress(what: str, *, still: bool = False) -> Iterator[Bar]:
    """A bar on the terminal, nothing in a pipe; yields a function of (done, total).

    A `still` bar moves only in that function, so that no thread disturbs what is measured.
    """
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    disable = console.quiet = not console.is_terminal  # Rich 13.7 ends a bar that is not shown with an empty line
    with Progress(*columns, console=console, disable=disable, transient=True, auto_refresh=not still) as bar:
        console.show_cursor(True)  # a process that Ctrl-Z stops would leave the terminal without one
        moving = Bar(bar, what, still=still)
        token = _BAR.set(None if disable else moving)
        try:
            yield moving
        finally:
            _BAR.reset(token)


@contextmanager
def busy(what: str) -> Iterator[None]:
    """Say on stderr what takes its time: with a clock on a terminal, beside a bar if there is one; else as a line."""
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
            clock.add_task(shown(what), total=None)
            yield
    else:
        say(what, err=True)
        yield


def warn(sentences: Iterable[str]) -> None:
    """Say what makes no sense, a line each, beside what is printed."""
    for sentence in sentences:
        say(f"knee-contact: warning: {sentence}", err=True)


def say(line: str, *, err: bool = False, hang: int | None = None) -> None:
    """Print a line, whatever names and texts of others are in it.

    On a terminal that is narrower, one that may `hang` is broken between words, and goes on indented by so many
    columns.
    """
    text = printable(line)
    if hang is not None and sys.stdout.isatty():
        width = shutil.get_terminal_size().columns
        text = textwrap.fill(
            text, width, subsequent_indent=" " * hang, break_long_words=False, break_on_hyphens=False,
            replace_whitespace=False, drop_whitespace=True,
        )  # fmt: skip
    click.echo(text, err=err)


def natural_width(table: Table) -> int:
    """The columns that a table takes if nothing of it is broken."""
    console = Console(width=UNBOUNDED)
    return Measurement.get(console, console.options, table).maximum


def shown(text: str) -> str:
    """A text for a cell or a bar of Rich, likewise."""
    return escape(printable(text))
