"""How far slow work has come: callbacks that tell it, and bars on the terminal (none in a pipe).

Rich is imported when a bar is made: rooms that only call back need not load it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from .errors import printable

if TYPE_CHECKING:
    from rich.progress import Progress

OnProgress = Callable[[int, int], object]
"""Function of (done, total) that is called while work goes on"""
_UPDATE_PERIOD = 0.05
"""Time [s] between two updates of a bar: an update takes about 20 µs, longer than many messages"""


def no_progress(_done: int, _total: int) -> None:
    """Show nothing: the `OnProgress` of work that nobody watches."""


class Bar:
    """The `OnProgress` of a bar on the terminal."""

    def __init__(self, bar: Progress, what: str) -> None:
        """Add a task, described by `what`, to a bar of Rich."""
        self._bar = bar
        self._task = bar.add_task(printable(what), total=None)
        self._next_update = 0.0 if not bar.disable else math.inf

    def __call__(self, done: int, total: int) -> None:
        """Update the bar, unless it has just been updated; the last step is always shown."""
        now = time.monotonic()
        if now >= self._next_update or (done == total and self._next_update < math.inf):
            self._next_update = now + _UPDATE_PERIOD
            self._bar.update(self._task, completed=done, total=total)

    def describe(self, what: str) -> None:
        """Change the description of the bar."""
        self._bar.update(self._task, description=printable(what))


@contextmanager
def progress(what: str) -> Iterator[Bar]:
    """Show a bar on the terminal, and nothing in a pipe; yield the function that updates it."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        TaskProgressColumn,
        TextColumn,
        TimeRemainingColumn,
    )

    description = TextColumn("{task.description}", markup=False)
    columns = (description, BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    console = Console(stderr=True)
    hidden = (
        console.quiet
    ) = not console.is_terminal  # Rich 13.7 ends a hidden bar with an empty line
    with Progress(*columns, console=console, disable=hidden, transient=True) as bar:
        # A process that Ctrl-Z stops would leave the terminal without a cursor.
        console.show_cursor(True)
        yield Bar(bar, what)
