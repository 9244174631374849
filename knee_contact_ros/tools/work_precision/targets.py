"""What the package wants to reach, as ratios of this run."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from knee_contact_ros.tools.work_precision import frontier
from knee_contact_ros.tools.work_precision.peers import COMPILED
from knee_contact_ros.tools.work_precision.problems import EVENTFUL, SMOOTH
from knee_contact_ros.tools.work_precision.solver import LOOP, STREAM, WHOLE
from knee_contact_ros.tools.work_precision.study import Row

ASKED, FINEST, COARSE = 1e-8, 1e-10, 1e-6
"""Errors [m]: at which times are compared; that must be reachable; from which to that one the cost's growth is taken"""
LEVELS = (1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11)
GROWTH = 0.25
ALL = SMOOTH + EVENTFUL


class Target(NamedTuple):
    """Something to reach on some problems."""

    what: str
    problems: Sequence[str]
    value: Callable[[Sequence[Row], str], float]
    enough: Callable[[float], bool]
    form: Callable[[float], str] = frontier.multiple


power = "{:.0e}".format


def targets() -> list[Target]:
    """All of them."""
    compiled = [
        Target(f"{what}: {times:g}x less time than the best of {', '.join(COMPILED)}", ALL,
               faster(COMPILED, mode), at_least(times))
        for what, mode, times in (("tick by tick, a call each", STREAM, 10.0), ("tick by tick in a loop", LOOP, 10.0),
                                  ("whole run", WHOLE, 5.0))
    ]  # fmt: skip
    return [
        *compiled,
        Target(
            "tick by tick: 1000x less time than SciPy's best",
            ALL,
            faster(("SciPy",), STREAM),
            at_least(1000.0),
        ),
        Target("tick by tick: 100x less time than CVODE", ALL, faster(("CVODE",), STREAM), at_least(100.0)),
        Target("whole run: 50x less time than the best peer", SMOOTH, faster((), WHOLE), at_least(50.0)),
        Target("whole run: the fastest at every error; least lead", EVENTFUL, least_lead, at_least(1.0)),
        Target(
            "1e-10 m is reachable; smallest error [m]",
            ALL,
            smallest_error,
            at_most(FINEST),
            "{:.0e}".format,
        ),
        Target("cost grows like error^-p, p at most 1/4", ALL, growth, at_most(GROWTH), "{:.2f}".format),
    ]


def judged(rows: Sequence[Row], problems: Sequence[str]) -> list[list[str]]:
    """A line per target, a column per problem: the value, and whether it is enough."""
    lines = []
    for target in targets():
        cells = []
        for problem in problems:
            value = target.value(rows, problem) if problem in target.problems else math.nan
            said = "yes" if target.enough(value) else "no"
            cells.append("-" if math.isnan(value) else f"{target.form(value)}, {said}")
        if any(cell != "-" for cell in cells):
            lines.append([target.what, *cells])
    return lines


def at_least(bound: float) -> Callable[[float], bool]:
    """Enough if it is this much or more."""
    return lambda value: value >= bound


def at_most(bound: float) -> Callable[[float], bool]:
    """Enough if it is this much or less."""
    return lambda value: value <= bound


def faster(peers: Sequence[str], mode: str) -> Callable[[Sequence[Row], str], float]:
    """How many times our time the cheapest run of some peers takes, or of any (empty), at the error asked for."""

    def value(rows: Sequence[Row], problem: str) -> float:
        ours, theirs = split(frontier.of(rows, problem, mode))
        theirs = [row for row in theirs if not peers or row.peer in peers]
        return frontier.cheapest(theirs, ASKED) / frontier.cheapest(ours, ASKED)

    return value


def least_lead(rows: Sequence[Row], problem: str) -> float:
    """Our lead over the best peer at the error where that is the closest to us; 0 if only a peer reaches an error."""
    ours, theirs = split(frontier.of(rows, problem, WHOLE))
    leads = []
    for level in LEVELS:
        peer, us = frontier.cheapest(theirs, level), frontier.cheapest(ours, level)
        if not math.isnan(peer):
            leads.append(0.0 if math.isnan(us) else peer / us)
    return min(leads, default=math.nan)


def smallest_error(rows: Sequence[Row], problem: str) -> float:
    """The smallest error of ours [m]."""
    return frontier.best_error(split(frontier.of(rows, problem, WHOLE))[0])


def growth(rows: Sequence[Row], problem: str) -> float:
    """The exponent of our cost."""
    return frontier.growth(split(frontier.of(rows, problem, WHOLE))[0], COARSE, FINEST)


def split(rows: Sequence[Row]) -> tuple[list[Row], list[Row]]:
    """Ours and theirs."""
    ours = [row for row in rows if frontier.is_ours(row.solver)]
    return ours, [row for row in rows if not frontier.is_ours(row.solver)]
