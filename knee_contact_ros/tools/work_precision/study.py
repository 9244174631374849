"""Measure every solver on every problem at every setting, in all modes; timed in turns."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import count
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.tools.work_precision import yardstick
from knee_contact_ros.tools.work_precision.peers import Entry
from knee_contact_ros.tools.work_precision.problems import Problem
from knee_contact_ros.tools.work_precision.solver import MODES, WHOLE, Outcome
from knee_contact_ros.tools.work_precision.start import exact_depth
from knee_contact_ros.tools.work_precision.timing import summed_up, turns_for
from knee_contact_ros.tools.work_precision.worker import FailedRunError, GivenUpError, LostProcessError, Task, Worker

LIMIT = 20.0
"""Seconds after which a run is given up"""
SLOW = 1.0
"""Seconds of a run after which finer settings of the same solver are left out"""
FINE = 1e-11
"""Error [m] below which finer settings are left out"""
MOST_LOSSES = 2
"""How often a sweep may lose the process before it is left"""


class Row(NamedTuple):
    """Error and time of one solver on one problem at one setting, in one mode."""

    problem: str
    solver: str
    peer: str
    mode: str
    setting: str
    error: float
    """Largest |signed depth - reference| [m] over all ticks; nan if the run failed"""
    microseconds_per_tick: float
    """Time of the fastest turn; nan if the run failed"""
    evaluations_per_tick: float
    """Evaluations of the contact force; nan if the tool does not count them"""
    median_microseconds: float = math.nan
    """Median time per tick of all turns"""
    spread_percent: float = math.nan
    """Time between the fastest and the slowest turn, as a part of the median"""
    turns: int = 0
    """Number of turns in which it was timed"""
    failure: str = ""
    """Why the run failed; empty if it did not"""


class Run:
    """A run that is timed in several turns, and becomes a row."""

    def __init__(self, row: Row, task: Task) -> None:
        self.task, self.turns = task, list[float]()
        self._row = row

    @property
    def row(self) -> Row:
        """The row by the turns so far."""
        if self._row.failure:
            return self._row
        per_tick = 1e6 / (len(self.task.problem.time) - 1)
        times = summed_up([seconds * per_tick for seconds in self.turns])
        return self._row._replace(
            microseconds_per_tick=times.least, median_microseconds=times.median,
            spread_percent=times.spread_percent, turns=times.turns,
        )  # fmt: skip

    def due(self, turn: int, most: int) -> bool:
        """Whether it is timed in a turn, counted from 0, out of `most` turns."""
        return not self._row.failure and turn < turns_for(self.turns[0], most)


class Measured(NamedTuple):
    """Rows of a study, and the yardsticks of the machine's noise."""

    rows: list[Row]
    yardsticks: list[float]
    """Time [s] of the same piece of work in every turn of every peer"""


def measure(
    problems: Sequence[Problem],
    entries: Sequence[Entry],
    turns: int,
    advance: Callable[[int, int], None] = lambda _done, _total: None,
) -> Measured:
    """Measure all rows, in turns; `advance` is called with the steps done and their number.

    In the first turn every solver goes from its coarsest setting to the finest that counts; in the others these runs
    are timed again, tool by tool.
    """
    exact = {problem.name: exact_depth(problem) for problem in problems}
    workers = {entry.solver.peer: Worker() for entry in entries}
    runs: list[Run] = []
    yardsticks: list[float] = []
    done, total = count(1), len(problems) * len(entries) + (turns - 1) * len(workers)
    try:
        for peer, worker in workers.items():
            yardsticks.append(time_yardstick(worker, problems[0]))
            for entry in (entry for entry in entries if entry.solver.peer == peer):
                for problem in problems:
                    for mode in MODES:
                        runs += sweep(worker, entry, problem, exact[problem.name], mode)
                    advance(next(done), total)
        for turn in range(1, turns):
            for peer, worker in workers.items():
                yardsticks.append(time_yardstick(worker, problems[0]))
                time_again(worker, (run for run in runs if run.row.peer == peer and run.due(turn, turns)))
                advance(next(done), total)
    finally:
        for worker in workers.values():
            worker.stop()
    return Measured([run.row for run in runs], yardsticks)


def time_yardstick(worker: Worker, problem: Problem) -> float:
    """Time [s] of the yardstick in a worker's process."""
    task = Task(yardstick.__name__, yardstick.NAME, WHOLE, problem, yardstick.SETTING)
    return worker.run(task, LIMIT).seconds


def time_again(worker: Worker, runs: Iterable[Run]) -> None:
    """Time every run once more; a run that fails now keeps the turns that it has."""
    for run in runs:
        try:
            run.turns.append(worker.run(run.task, LIMIT).seconds)
        except FailedRunError:
            continue


def sweep(worker: Worker, entry: Entry, problem: Problem, exact: NDArray[np.float64], mode: str) -> Iterator[Run]:
    """Run a solver from its coarsest setting to the first one that is fine or slow enough."""
    solver, ticks = entry.solver, len(problem.time) - 1
    if solver.run_in(mode) is None:
        return
    losses = 0
    for setting in solver.settings:
        row = Row(problem.name, solver.name, solver.peer, mode, setting.label, math.nan, math.nan, math.nan)
        task = Task(entry.driver, solver.name, mode, problem, setting)
        try:
            outcome = worker.run(task, LIMIT)
        except FailedRunError as error:
            yield Run(row._replace(failure=str(error)), task)
            losses += isinstance(error, LostProcessError)
            if isinstance(error, GivenUpError) or losses == MOST_LOSSES:
                return
            continue
        failure = what_failed(outcome, exact)
        if failure:
            yield Run(row._replace(failure=failure), task)
        else:
            largest = float(np.abs(outcome.depth - exact).max())
            row = row._replace(error=largest, evaluations_per_tick=outcome.evaluations / ticks)
            run = Run(row, task)
            run.turns.append(outcome.seconds)
            yield run
        if outcome.seconds > SLOW or row.error < FINE:
            return


def what_failed(outcome: Outcome, exact: NDArray[np.float64]) -> str:
    """Why an outcome does not count as one; empty if it does."""
    if outcome.note:
        return " ".join(outcome.note.split())
    if outcome.depth.shape != exact.shape:
        return f"{len(outcome.depth)} of {len(exact)} ticks"
    return "" if np.isfinite(outcome.depth).all() else "not finite"
