"""Every solver on every problem at every setting, in both ways of running."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.trade.peers import Entry
from knee_contact_ros.trade.problems import Problem
from knee_contact_ros.trade.solver import Outcome
from knee_contact_ros.trade.start import exact_depth
from knee_contact_ros.trade.worker import FailedRunError, GivenUpError, LostProcessError, Task, Worker

WHOLE, STREAM = "whole", "stream"
LIMIT = 20.0
"""Seconds after which a run is given up"""
SLOW = 1.0
"""Seconds of a run after which finer settings of the same solver are left out"""
FINE = 1e-11
"""Error [m] below which finer settings are left out"""
MOST_LOSSES = 2
"""How often a sweep may lose the process before it is left"""


class Row(NamedTuple):
    """One solver on one problem at one setting, run in one way."""

    problem: str
    solver: str
    peer: str
    mode: str
    setting: str
    error: float
    """Largest |signed depth - reference| [m] over all ticks; nan if the run failed"""
    microseconds_per_tick: float
    """Of the fastest repetition; nan if the run failed"""
    evaluations_per_tick: float
    """Of the contact force; nan if the tool does not tell"""
    failure: str = ""
    """Why the run failed"""


def measure(
    problems: Sequence[Problem],
    entries: Sequence[Entry],
    repeat: int,
    advance: Callable[[int, int], None] = lambda _done, _total: None,
) -> list[Row]:
    """All rows; `advance` is told how many of how many solvers on problems are done."""
    exact = {problem.name: exact_depth(problem) for problem in problems}
    rows: list[Row] = []
    done = 0
    for peer in dict.fromkeys(entry.solver.peer for entry in entries):
        worker = Worker()
        try:
            for entry in (each for each in entries if each.solver.peer == peer):
                for problem in problems:
                    for streamed in (False, True):
                        rows += sweep(worker, entry, problem, exact[problem.name], streamed, repeat)
                    done += 1
                    advance(done, len(problems) * len(entries))
        finally:
            worker.stop()
    return rows


def sweep(
    worker: Worker, entry: Entry, problem: Problem, exact: NDArray[np.float64], streamed: bool, repeat: int
) -> Iterator[Row]:
    """From the coarsest setting to the first one that is fine or slow enough."""
    solver, mode, ticks = entry.solver, STREAM if streamed else WHOLE, len(problem.time) - 1
    if (solver.stream if streamed else solver.whole) is None:
        return
    losses = 0
    for setting in solver.settings:
        row = Row(problem.name, solver.name, solver.peer, mode, setting.label, math.nan, math.nan, math.nan)
        try:
            outcome = worker.run(Task(entry.driver, solver.name, streamed, problem, setting, repeat), LIMIT)
        except FailedRunError as error:
            yield row._replace(failure=str(error))
            losses += isinstance(error, LostProcessError)
            if isinstance(error, GivenUpError) or losses == MOST_LOSSES:
                return
            continue
        failure = what_failed(outcome, exact)
        if failure:
            yield row._replace(failure=failure)
        else:
            row = row._replace(
                error=float(np.abs(outcome.depth - exact).max()),
                microseconds_per_tick=1e6 * outcome.seconds / ticks,
                evaluations_per_tick=outcome.evaluations / ticks,
            )
            yield row
        if outcome.seconds > SLOW or row.error < FINE:
            return


def what_failed(outcome: Outcome, exact: NDArray[np.float64]) -> str:
    """Why an outcome is none; empty if it is one."""
    if outcome.note:
        return " ".join(outcome.note.split())
    if outcome.depth.shape != exact.shape:
        return f"{len(outcome.depth)} of {len(exact)} ticks"
    return "" if np.isfinite(outcome.depth).all() else "not finite"
