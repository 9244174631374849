"""What a person sees on the terminal: progress bars (none in a pipe) and the table of results."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager

import click
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.table import Table

from knee_contact_ros.messages import NANOSECONDS
from knee_contact_ros.printable import printable
from knee_contact_ros.salvage.recover import Recovery
from knee_contact_ros.summary import Summary

MM = 1e3
MICROMETRE = 1e6
WIDTH = 78
MOST_FAULTS = 20
"""That are printed"""
PERIOD = 0.05
"""[s] from one movement of a bar to the next: a movement takes some 20 µs, more than many a message"""


class Bar:
    """A function of (done, total) that moves a bar on the terminal."""

    def __init__(self, bar: Progress, what: str, *, still: bool) -> None:
        self._bar = bar
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
        self._bar.update(self._task, description=shown(what), refresh=self._still)


@contextmanager
def progress(what: str, *, still: bool = False) -> Iterator[Bar]:
    """A bar on the terminal, nothing in a pipe; yields a function of (done, total).

    A `still` bar moves only in that function, so that no thread disturbs what is measured.
    """
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    disable = not console.is_terminal
    with Progress(*columns, console=console, disable=disable, transient=True, auto_refresh=not still) as bar:
        console.show_cursor(True)  # a process that Ctrl-Z stops would leave the terminal without one
        yield Bar(bar, what, still=still)


def show_summary(summary: Summary, live: Mapping[str, str], files: Mapping[str, str]) -> None:
    """Print the peaks, the figures of the run and where the files are; `live` has rows that only a live run knows."""
    console = Console(width=WIDTH)
    console.print(peak_table(summary))
    figures = Table(box=None, show_header=False, pad_edge=False)
    figures.add_column(no_wrap=True)
    figures.add_column(overflow="fold")
    figures.add_row("ticks", f"{summary.ticks} over {summary.duration:.2f} s")
    for name, value in live.items():
        figures.add_row(name, shown(value))
    if summary.split:
        figures.add_row("share of the load", summary.split.text)
    figures.add_row("samples refused", _counts(summary.refused))
    figures.add_row("ticks flagged", _counts(summary.flagged))
    figures.add_row("error estimate", f"{error_of_depth(summary)} of depth at most, {error_of_force(summary)} of force")
    figures.add_row("levels", _shares(summary.levels))
    figures.add_row("cost", f"{summary.evaluations / max(summary.ticks, 1):.1f} contact law evaluations per tick")
    for sentence in summary.doubts.sentences:
        figures.add_row("warning", shown(sentence))
    console.print(figures)
    console.print()
    for name, path in files.items():
        console.print(printable(f"{name}: {path}"), soft_wrap=True, highlight=False, markup=False)


def warn(sentences: Iterable[str]) -> None:
    """Say what makes no sense, a line each, beside what is printed."""
    for sentence in sentences:
        say(f"knee-contact: warning: {sentence}", err=True)


def say(line: str, *, err: bool = False) -> None:
    """Print a line, whatever names and texts of others are in it."""
    click.echo(printable(line), err=err)


def shown(text: str) -> str:
    """A text for a cell or a bar of Rich, likewise."""
    return escape(printable(text))


def error_of_depth(summary: Summary) -> str:
    """The largest estimate, with its unit."""
    error = summary.largest_error
    return f"{error * MICROMETRE:.2g} um" if math.isfinite(error) else "no bound"


def error_of_force(summary: Summary) -> str:
    """The same of the contact force."""
    error = summary.largest_force_error
    return f"{error:.2g} N" if math.isfinite(error) else "no bound"


def show_recovery(recovery: Recovery, output: str) -> None:
    """Print what was recovered, what is missing, and where the file is."""
    console = Console(width=WIDTH)
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("topic", overflow="fold")
    table.add_column("type", overflow="fold")
    table.add_column("messages", justify="right", no_wrap=True)
    table.add_column("missing", justify="right", no_wrap=True)
    for row in recovery.topics:
        missing = "unknown" if row.missing is None else str(row.missing)
        table.add_row(shown(row.topic), shown(row.type), str(row.messages), missing)
    console.print(table)
    lines = [f"{recovery.unread} of {recovery.size} bytes could not be read"]
    if recovery.times:
        first, last = recovery.times
        lines.insert(0, f"from {first / NANOSECONDS:.3f} s to {last / NANOSECONDS:.3f} s")
    lines += [f"- {fault}" for fault in recovery.faults[:MOST_FAULTS]]
    if len(recovery.faults) > MOST_FAULTS:
        lines.append(f"- and {len(recovery.faults) - MOST_FAULTS} more, all in the file's metadata")
    for line in [*lines, f"Recovered: {output}"]:
        console.print(printable(line), soft_wrap=True, highlight=False, markup=False)


def peak_table(summary: Summary) -> Table:
    """Peaks in N, BW and mm: those of the whole run, and each local peak of the load if they were looked for."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("")
    for heading in ("load [N]", "[BW]", "contact force [N]", "[BW]", "depth [mm]", "at [s]"):
        table.add_column(escape(heading), justify="right", no_wrap=True)

    def forces(load: float, force: float, depth: float) -> tuple[str, ...]:
        weight = summary.body_weight
        return f"{load:.1f}", f"{load / weight:.2f}", f"{force:.1f}", f"{force / weight:.2f}", f"{depth * MM:.3f}"

    for number, peak in enumerate(summary.load_peaks, start=1):
        values = forces(peak.load, peak.contact_force, peak.penetration_depth)
        table.add_row(f"peak {number}", *values, f"{peak.stamp / NANOSECONDS:.3f}")
    load, force, depth = (summary.peaks[name] for name in ("load", "contact_force", "penetration_depth"))
    table.add_row("largest", *forces(load.value, force.value, depth.value), f"{depth.stamp / NANOSECONDS:.3f}")
    return table


def _counts(counter: Mapping[str, int]) -> str:
    reasons = ", ".join(f"{count} x {name}" for name, count in counter.items())
    return f"{sum(counter.values())}" + (f" ({reasons})" if reasons else "")


def _shares(levels: Mapping[str, int]) -> str:
    whole = max(sum(levels.values()), 1)
    return ", ".join(f"{name} {100.0 * count / whole:.1f} %" for name, count in sorted(levels.items()))
