"""Measure every solver on every problem at every setting, in all ways to run; timed in turns.

Each tool has a process of its own: it may hang or end its process, and must not load what another one loads. A machine
has phases of seconds to minutes in which everything takes half as long again: its other processors are busy, or the
host of a virtual machine is. One look measures the phase, so all runs are timed in turns, minutes apart.
"""

from __future__ import annotations

import gc
import math
import os
import statistics
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from importlib.util import find_spec
from itertools import count
from multiprocessing.connection import Connection
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.peers.problems import Problem, exact_depth
from knee_contact_ros.system.processes import Process, connected, reap

WHOLE, LOOP, STREAM = "whole", "loop", "stream"
"""Modes of a run: all samples known; one after another, in the tool's loop or a compiled one; when each arrives"""
MODES = (WHOLE, LOOP, STREAM)


class Setting(NamedTuple):
    """A tolerance, or a number of steps per tick."""

    label: str
    value: float


class Outcome(NamedTuple):
    """Answer and time of one run."""

    depth: NDArray[np.float64]
    """Signed depth [m] at every tick, shape (n,)"""
    seconds: float
    """Processor time [s] of the run alone, without set-up, compilation and the building of models"""
    evaluations: float = math.nan
    """Evaluations of the contact force; nan if the tool does not count them"""
    note: str = ""
    """Why the run failed; empty if it did not"""


Way = Callable[[Problem, Setting], Outcome]
"""A way to run a solver, by the mode"""


class Solver(NamedTuple):
    """A way to solve a problem."""

    name: str
    peer: str
    """Name of the tool that it belongs to"""
    law: str
    """How it expresses the contact law: one sentence"""
    settings: Sequence[Setting]
    """Settings to be tried, from coarse to fine"""
    whole: Way | None
    """Run of the whole series in one call, with output at every tick; None if the tool has none"""
    stream: Way | None
    """Run that solves every tick when its sample arrives, by a call from Python for each: nothing later is known"""
    loop: Way | None = None
    """Run that solves tick after tick as `stream` does, but in compiled code, with the samples in memory"""

    def run_in(self, mode: str) -> Way | None:
        """The run in one of the `MODES`, if there is one."""
        run: Way | None = getattr(self, mode)
        return run


class Stopwatch:
    """Seconds of processor time of the process: another process that takes the processor away does not count."""

    seconds = math.nan
    """Time [s], once it is over"""


@contextmanager
def stopwatch() -> Iterator[Stopwatch]:
    """Time what happens inside a `with` statement."""
    watch = Stopwatch()
    begin = time.process_time_ns()
    yield watch
    watch.seconds = 1e-9 * (time.process_time_ns() - begin)


def tolerances(*exponents: int) -> list[Setting]:
    """Tolerances 1e-4, 1e-5 and so on, from their exponents 4, 5 and so on."""
    return [Setting(f"1e-{exponent}", 10.0**-exponent) for exponent in exponents]


def half_decades(first: int, last: int) -> list[Setting]:
    """Tolerances half a decade apart: 1e-4, 3e-5, 1e-5 and so on, from the first exponent (4) to the last."""
    labels = [f"{digit}e-{exponent}" for exponent in range(first, last + 1) for digit in (3, 1)]
    return [Setting(label, float(label)) for label in labels[1:]]


def steps_per_tick(*counts: int) -> list[Setting]:
    """Settings for solvers with steps of equal size."""
    return [Setting(f"{count} per tick", float(count)) for count in counts]


ENOUGH = 1.0
"""Seconds of one run in all turns together, about, after which it is not timed again"""
LEAST_TURNS = 2
"""Least number of turns of a run that takes longer, where more than one was asked for"""
RUNS = 5
"""Number of short runs in one turn, one after another; the quickest counts"""
SLICE = 0.05
"""Seconds of such runs after which a turn ends"""


class Times(NamedTuple):
    """Statistics of a run's times in all turns."""

    least: float
    """Shortest time; this and the median are in the unit of the turns"""
    median: float
    spread_percent: float
    """Time between the quickest and the slowest turn, as a part of the median"""
    turns: int


def turns_for(seconds: float, most: int) -> int:
    """Number of turns in which a run of `seconds` [s] is timed, at most `most`."""
    return min(most, max(LEAST_TURNS, int(ENOUGH / seconds) if seconds > 0.0 else most))


def runs_for(seconds: float) -> int:
    """Number of runs of `seconds` [s] that a turn has."""
    return min(RUNS, max(1, int(SLICE / seconds))) if seconds > 0.0 else RUNS


def summed_up(turns: Sequence[float]) -> Times:
    """Statistics of the times of all turns, of which there is at least one, in any unit."""
    median = statistics.median(turns)
    return Times(min(turns), median, 100.0 * (max(turns) - min(turns)) / median, len(turns))


GRACE = 30.0
"""Seconds beyond the limit for the tool to be imported"""
START = 600.0
"""Seconds for the process to start: on a busy machine imports take minutes"""
READY = "ready"


class Task(NamedTuple):
    """One run to be done in another process."""

    driver: str
    """Name of a module with a function `solvers`"""
    solver: str
    """Name of one of these solvers"""
    mode: str
    """One of `solver.MODES`"""
    problem: Problem
    setting: Setting


class FailedRunError(Exception):
    """There is no outcome; the message is one line that says why."""


class GivenUpError(FailedRunError):
    """The run took too long."""


class LostProcessError(FailedRunError):
    """The tool ended the process."""


class Worker:
    """Runs tasks in a process, which is started again when it was lost."""

    def __init__(self) -> None:
        self._process: Process | None = None
        self._connection: Connection | None = None

    def run(self, task: Task | str, limit: float) -> Outcome:
        """Run a task and return its outcome.

        Raises:
            GivenUpError: no outcome within `limit` [s], and a little for the start.
            LostProcessError: the tool ended the process.
            FailedRunError: the tool raised something.
        """
        connection = self._connection or self._start()
        connection.send(task)
        if not connection.poll(limit + GRACE):
            self.stop()
            raise GivenUpError(f"given up after {limit:g} s")
        try:
            answer = connection.recv()
        except (EOFError, ConnectionError):
            self.stop()
            raise LostProcessError("ended the process") from None
        if isinstance(answer, str):
            raise FailedRunError(answer)
        assert isinstance(answer, Outcome)  # noqa: S101 - for the type checker
        return answer

    def stop(self) -> None:
        """End the process."""
        if self._process and self._connection:
            self._connection.close()
            self._process.kill()
            reap(self._process)
        self._process = self._connection = None

    def _start(self) -> Connection:
        ours, self._process = connected(__name__)
        self._connection = ours
        with suppress(EOFError, ConnectionError):
            if ours.poll(START) and ours.recv() == READY:
                return ours
        self.stop()
        raise RuntimeError("a process for the study did not start")


def serve(connection: Connection) -> None:
    """Answer tasks with an outcome, or with what went wrong, until the other end is closed."""
    for stream in (1, 2):  # tools print as they like
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream)
    pin()
    connection.send(READY)
    while True:
        try:
            task = connection.recv()
        except (EOFError, ConnectionError, KeyboardInterrupt):
            return
        try:
            connection.send(yardstick() if task == YARDSTICK else best(task))
        except KeyboardInterrupt:
            return
        except Exception as error:  # whatever a tool raises
            connection.send(f"{type(error).__name__}: {' '.join(str(error).split())}"[:100])


def best(task: Task) -> Outcome:
    """Do a task some times, one after another, and return the fastest outcome; a long run is not repeated."""
    solvers: list[Solver] = import_module(task.driver).solvers()
    solver = next(solver for solver in solvers if solver.name == task.solver)
    run = solver.run_in(task.mode)
    assert run is not None  # noqa: S101 - for the type checker
    gc.collect()
    gc.freeze()  # a compiler's objects take 0.1 s to look through, for every task
    gc.disable()  # as `timeit` does: one run in many would pay for all
    try:
        outcome = run(task.problem, task.setting)
        for _ in range(runs_for(outcome.seconds) - 1):
            outcome = min(outcome, run(task.problem, task.setting), key=lambda one: one.seconds)
    finally:
        gc.enable()
    return outcome


def pin() -> None:
    """Keep this process on one processor, where the system lets a process choose."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})


class Peer(NamedTuple):
    """A tool that a user could take instead of this package."""

    name: str
    module: str
    """Module that it is imported as"""
    distribution: str
    """Its name on PyPI"""
    extra: str = "peers"
    """Extra of this package that installs it"""

    @property
    def driver(self) -> str:
        """Module here that drives it, with a function `solvers`."""
        return f"{__package__}.{self.name.lower()}"

    @property
    def installed(self) -> bool:
        """Whether it can be imported."""
        return find_spec(self.module) is not None


class Entry(NamedTuple):
    """A solver, and the module in which another process finds it."""

    driver: str
    solver: Solver


def entries(driver: str) -> list[Entry]:
    """List the solvers of a module."""
    return [Entry(driver, solver) for solver in import_module(driver).solvers()]


COMPILED = ("CyRK", "numbalsoda", "diffrax")
"""Peers whose right-hand side is compiled, and called by what is compiled"""
PEERS = (
    Peer("SciPy", "scipy", "scipy"),
    Peer("CyRK", "CyRK", "CyRK"),
    Peer("numbalsoda", "numbalsoda", "numbalsoda", "peers-built"),
    Peer("diffrax", "diffrax", "diffrax"),
)


YARDSTICK = "yardstick"
"""Task of a fixed piece of work: changes of its time are the machine's noise"""
ADDITIONS = 100_000


def yardstick() -> Outcome:
    """Add numbers in plain Python for some milliseconds."""
    total = 0.0
    with stopwatch() as watch:
        for number in range(ADDITIONS):
            total += number * 0.5
    return Outcome(np.array([total]), watch.seconds)


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
            yardsticks.append(worker.run(YARDSTICK, LIMIT).seconds)
            for entry in (entry for entry in entries if entry.solver.peer == peer):
                for problem in problems:
                    for mode in MODES:
                        runs += sweep(worker, entry, problem, exact[problem.name], mode)
                    advance(next(done), total)
        for turn in range(1, turns):
            for peer, worker in workers.items():
                yardsticks.append(worker.run(YARDSTICK, LIMIT).seconds)
                time_again(worker, (run for run in runs if run.row.peer == peer and run.due(turn, turns)))
                advance(next(done), total)
    finally:
        for worker in workers.values():
            worker.stop()
    return Measured([run.row for run in runs], yardsticks)


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


if __name__ == "__main__":
    with Connection(int(sys.argv[1])) as own_end:
        import_module("benchmarks.peers.measure").serve(own_end)  # what it sends is not of `__main__`
