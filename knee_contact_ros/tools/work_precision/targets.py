"""What the package aims to reach, as ratios of one run of the study, and whether it does."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Sequence
from typing import NamedTuple

from knee_contact_ros.tools.work_precision import frontier
from knee_contact_ros.tools.work_precision.peers import COMPILED
from knee_contact_ros.tools.work_precision.problems import EVENTFUL, SMOOTH
from knee_contact_ros.tools.work_precision.solver import LOOP, STREAM, WHOLE
from knee_contact_ros.tools.work_precision.study import Row

FINEST, COARSE = 1e-10, 1e-6
"""Errors [m]: that must be reachable; from which to the finest the cost's growth is taken"""
LEVELS = (1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11)
GROWTH = 0.25
ALL = SMOOTH + EVENTFUL


class Target(NamedTuple):
    """A bound for a value that is measured on some problems."""

    what: str
    problems: Sequence[str]
    value: Callable[[Sequence[Row], str], float]
    """Computes the figure from all rows and a problem's name"""
    bound: float
    holds: Callable[[float, float], bool] = operator.ge
    """Compares the value with the bound"""
    form: Callable[[float], str] = frontier.multiple


def targets() -> list[Target]:
    """List all targets."""
    compiled = [
        Target(f"{what}: {times:g}x less time than the best of {', '.join(COMPILED)}", ALL,
               faster(COMPILED, mode), times)
        for what, mode, times in (("tick by tick, a call each", STREAM, 10.0), ("tick by tick in a loop", LOOP, 10.0),
                                  ("whole run", WHOLE, 5.0))
    ]  # fmt: skip
    return [
        *compiled,
        Target("tick by tick: 1000x less time than SciPy's best", ALL, faster(("SciPy",), STREAM), 1000.0),
        Target("tick by tick: 100x less time than CVODE", ALL, faster(("CVODE",), STREAM), 100.0),
        Target("whole run: 50x less time than the best peer", SMOOTH, faster((), WHOLE), 50.0),
        Target("whole run: the fastest at every error; least lead", EVENTFUL, least_lead, 1.0),
        Target("1e-10 m is reachable; smallest error [m]", ALL, smallest_error, FINEST, operator.le, "{:.0e}".format),
        Target("cost grows like error^-p, p at most 1/4", ALL, growth, GROWTH, operator.le, "{:.2f}".format),
    ]


def judged(rows: Sequence[Row], problems: Sequence[str]) -> list[list[str]]:
    """Judge every target: a line per target, a column per problem with the value and whether the bound holds."""
    lines = []
    for target in targets():
        cells = []
        for problem in problems:
            value = target.value(rows, problem) if problem in target.problems else math.nan
            verdict = "yes" if target.holds(value, target.bound) else "no"
            cells.append("-" if math.isnan(value) else f"{target.form(value)}, {verdict}")
        if any(cell != "-" for cell in cells):
            lines.append([target.what, *cells])
    return lines


def faster(peers: Sequence[str], mode: str) -> Callable[[Sequence[Row], str], float]:
    """Build the value of how many times our time the quickest of some peers takes; no peers: of all of them."""

    def value(rows: Sequence[Row], problem: str) -> float:
        ours, theirs = split(frontier.of(rows, problem, mode))
        theirs = [row for row in theirs if not peers or row.peer in peers]
        return frontier.cheapest(theirs, frontier.ASKED) / frontier.cheapest(ours, frontier.ASKED)

    return value


def least_lead(rows: Sequence[Row], problem: str) -> float:
    """Least ratio of the best peer's time to ours over all errors; 0 if only a peer reaches an error."""
    ours, theirs = split(frontier.of(rows, problem, WHOLE))
    leads = []
    for level in LEVELS:
        peer, us = frontier.cheapest(theirs, level), frontier.cheapest(ours, level)
        if not math.isnan(peer):
            leads.append(0.0 if math.isnan(us) else peer / us)
    return min(leads, default=math.nan)


def smallest_error(rows: Sequence[Row], problem: str) -> float:
    """Smallest error [m] that ours reaches."""
    return frontier.best_error(split(frontier.of(rows, problem, WHOLE))[0])


def growth(rows: Sequence[Row], problem: str) -> float:
    """Exponent with which our cost grows as the error falls."""
    return frontier.growth(split(frontier.of(rows, problem, WHOLE))[0], COARSE, FINEST)


def split(rows: Sequence[Row]) -> tuple[list[Row], list[Row]]:
    """Split rows into ours and those of the peers."""
    ours = [row for row in rows if frontier.is_ours(row.solver)]
    return ours, [row for row in rows if not frontier.is_ours(row.solver)]
