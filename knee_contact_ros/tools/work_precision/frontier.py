"""What an error costs: the cheapest runs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from knee_contact_ros.tools.work_precision.ours import NAME
from knee_contact_ros.tools.work_precision.solver import LOOP, MODES, STREAM, WHOLE
from knee_contact_ros.tools.work_precision.study import Row

COUNTED = {WHOLE: MODES, LOOP: (LOOP, STREAM), STREAM: (STREAM,)}
"""What counts for a way of running: who knows less, or is called more often, may do so where that is the cheaper way"""


def of(rows: Iterable[Row], problem: str, mode: str) -> list[Row]:
    """The runs of a problem that count for a way of running: a streamed run also is a whole run."""
    return [row for row in rows if row.problem == problem and row.mode in COUNTED[mode] and not row.failure]


def quickest(rows: Iterable[Row], error: float) -> Row | None:
    """The cheapest run with at most this error [m], if there is one."""
    able = [row for row in rows if row.error <= error]
    return min(able, key=lambda row: row.microseconds_per_tick) if able else None


def cheapest(rows: Iterable[Row], error: float) -> float:
    """Time per tick [µs] of the cheapest run with at most this error [m]; nan if there is none."""
    return min((row.microseconds_per_tick for row in rows if row.error <= error), default=math.nan)


def best_error(rows: Iterable[Row]) -> float:
    """The smallest error [m] reached; nan if there is no run."""
    return min((row.error for row in rows), default=math.nan)


def envelope(rows: Sequence[Row]) -> list[tuple[float, float]]:
    """Errors [m] and times per tick [µs] of the runs that no other run beats in both, by falling error."""
    points: list[tuple[float, float]] = []
    for row in sorted(rows, key=lambda each: (each.microseconds_per_tick, each.error)):
        if not points or row.error < points[-1][0]:
            points.append((row.error, row.microseconds_per_tick))
    return points


def line_name(row: Row) -> str:
    """Whose line a run belongs to: one per peer, and one per level of ours."""
    return row.solver if row.peer == NAME else row.peer


def line_names(rows: Iterable[Row]) -> list[str]:
    """All of them, ours first."""
    names = dict.fromkeys(line_name(row) for row in rows)
    return sorted(names, key=lambda name: not is_ours(name))


def is_ours(name: str) -> bool:
    """Whether a line or a solver is ours."""
    return name.startswith(NAME)


def growth(rows: Sequence[Row], coarse: float, fine: float) -> float:
    """Exponent p of cost = error^-p between two errors [m], from the envelope; nan if one is not reached."""
    ratio = cheapest(rows, fine) / cheapest(rows, coarse)
    return math.log(ratio) / math.log(coarse / fine)


def multiple(ratio: float) -> str:
    """A ratio with two digits: 6.1x, 42x, 1300x."""
    return f"{float(f'{ratio:.2g}'):g}x"
