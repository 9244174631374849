"""The frontier of work and precision: the cheapest runs that reach an error."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from knee_contact_ros.tools.work_precision.ours import NAME
from knee_contact_ros.tools.work_precision.solver import LOOP, MODES, STREAM, WHOLE
from knee_contact_ros.tools.work_precision.study import Row

ASKED = 1e-8
"""Error [m] at which tables, targets and the picture compare times"""
COUNTED = {WHOLE: MODES, LOOP: (LOOP, STREAM), STREAM: (STREAM,)}
"""Modes whose runs count for a mode: a solver may know less, or be called more often, where that is cheaper"""


def of(rows: Iterable[Row], problem: str, mode: str) -> list[Row]:
    """Runs of a problem that count for a mode and did not fail; a streamed run also counts as a whole run."""
    return [row for row in rows if row.problem == problem and row.mode in COUNTED[mode] and not row.failure]


def quickest(rows: Iterable[Row], error: float) -> Row | None:
    """The cheapest run with at most this error [m], if there is one."""
    able = [row for row in rows if row.error <= error]
    return min(able, key=lambda row: row.microseconds_per_tick) if able else None


def cheapest(rows: Iterable[Row], error: float) -> float:
    """Time per tick [µs] of the cheapest run with at most this error [m]; nan if there is none."""
    row = quickest(rows, error)
    return row.microseconds_per_tick if row else math.nan


def best_error(rows: Iterable[Row]) -> float:
    """The smallest error [m] reached; nan if there is no run."""
    return min((row.error for row in rows), default=math.nan)


def line_name(row: Row) -> str:
    """Name of the line that a run belongs to: there is one per peer, and one per level of ours."""
    return row.solver if row.peer == NAME else row.peer


def line_names(rows: Iterable[Row]) -> list[str]:
    """Names of the lines of some runs, ours first."""
    names = dict.fromkeys(line_name(row) for row in rows)
    return sorted(names, key=lambda name: not is_ours(name))


def is_ours(name: str) -> bool:
    """Whether a line or a solver is ours."""
    return name.startswith(NAME)


def growth(rows: Sequence[Row], coarse: float, fine: float) -> float:
    """Exponent p of cost = error^-p between two errors [m], by the cheapest runs; nan if one is not reached."""
    ratio = cheapest(rows, fine) / cheapest(rows, coarse)
    return math.log(ratio) / math.log(coarse / fine)


def multiple(ratio: float) -> str:
    """Format a ratio with two digits: 6.1x, 42x, 1300x."""
    return f"{float(f'{ratio:.2g}'):g}x"
