"""Every solver on every problem at every setting, in both ways of running; timed in turns."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
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
    """One solver on one problem at one setting, run in one way."""

    problem: str
    solver: str
    peer: str
    mode: str
    setting: str
    error: float
    """Largest |signed depth - reference| [m] over all ticks; nan if the run failed"""
    microseconds_per_tick: float
    """Of the fastest turn; nan if the run failed"""
    evaluations_per_tick: float
    """Of the contact force; nan if the tool does not tell"""
    median_microseconds: float = math.nan
    """Of all turns"""
    spread_percent: float = math.nan
    """From the fastest to the slowest turn, as a part of the median"""
    turns: int = 0
    failure: str = ""
    """Why the run failed"""


class Run:
    """A row in the making."""

    def __init__(self, row: Row, task: Task) -> None:
        self.task, self.turns = task, list[float]()
        self._row = row

    @property
    def row(self) -> Row:
        """What is known so far."""
        if self._row.failure:
            return self._row
        per_tick = 1e6 / (len(self.task.problem.time) - 1)
        times = summed_up([seconds * per_tick for seconds in self.turns])
        return self._row._replace(
            microseconds_per_tick=times.least, median_microseconds=times.median,
            spread_percent=times.spread_percent, turns=times.turns,
        )  # fmt: skip

    def due(self, turn: int, most: int) -> bool:
        """Whether it is timed in a turn, counted from 0."""
        return not self._row.failure and turn < turns_for(self.turns[0], most)


class Measured(NamedTuple):
    """What a study has found."""

    rows: list[Row]
    yardsticks: list[float]
    """Seconds of the same piece of work in every turn of every peer"""


def measure(
    problems: Sequence[Problem],
    entries: Sequence[Entry],
    turns: int,
    advance: Callable[[int, int], None] = lambda _done, _total: None,
) -> Measured:
    """All rows; `advance` is told how much of how much is done.

    In the first of the turns every solver goes from its coarsest setting to the finest that counts; in the others what
    it did is timed again, tool by tool.
    """
    exact = {problem.name: exact_depth(problem) for problem in problems}
    workers = {entry.solver.peer: Worker() for entry in entries}
    runs: list[Run] = []
    yardsticks: list[float] = []
    steps = Steps(len(problems) * len(entries) + (turns - 1) * len(workers), advance)
    try:
        for peer, worker in workers.items():
            yardsticks.append(time_yardstick(worker, problems[0]))
            for entry in (each for each in entries if each.solver.peer == peer):
                for problem in problems:
                    for mode in MODES:
                        runs += sweep(worker, entry, problem, exact[problem.name], mode)
                    steps.done()
        for turn in range(1, turns):
            for peer, worker in workers.items():
                yardsticks.append(time_yardstick(worker, problems[0]))
                time_again(worker, (run for run in runs if run.row.peer == peer and run.due(turn, turns)))
                steps.done()
    finally:
        for worker in workers.values():
            worker.stop()
    return Measured([run.row for run in runs], yardsticks)


class Steps:
    """Counts what is done."""

    def __init__(self, total: int, advance: Callable[[int, int], None]) -> None:
        self._done, self._total, self._advance = 0, total, advance

    def done(self) -> None:
        """One more."""
        self._done += 1
        self._advance(self._done, self._total)


def time_yardstick(worker: Worker, problem: Problem) -> float:
    """Seconds of the yardstick in a worker's process."""
    task = Task(yardstick.__name__, yardstick.NAME, WHOLE, problem, yardstick.SETTING)
    return worker.run(task, LIMIT).seconds


def time_again(worker: Worker, runs: Iterable[Run]) -> None:
    """One turn more for each; what fails now keeps the turns that it has."""
    for run in runs:
        try:
            run.turns.append(worker.run(run.task, LIMIT).seconds)
        except FailedRunError:
            continue


def sweep(worker: Worker, entry: Entry, problem: Problem, exact: NDArray[np.float64], mode: str) -> Iterator[Run]:
    """From the coarsest setting to the first one that is fine or slow enough."""
    solver, ticks = entry.solver, len(problem.time) - 1
    if solver.way(mode) is None:
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
    """Why an outcome is none; empty if it is one."""
    if outcome.note:
        return " ".join(outcome.note.split())
    if outcome.depth.shape != exact.shape:
        return f"{len(outcome.depth)} of {len(exact)} ticks"
    return "" if np.isfinite(outcome.depth).all() else "not finite"
