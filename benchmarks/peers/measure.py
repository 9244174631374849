"""Measure every solver on every problem at every setting, in all ways to run; timed in turns.

Each tool has a process of its own: it may hang or end its process, and must not load what another one loads. A machine
has phases of seconds to minutes in which everything takes half as long again, so all runs are timed in turns, minutes
apart.
"""

from __future__ import annotations

import gc
import math
import multiprocessing
import os
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent import futures
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from itertools import count
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.peers.problems import Problem, exact_depth
from knee_contact_ros.system.progress import OnProgress, no_progress

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


SLICE, RUNS = 0.05, 5
"""Seconds of short runs in one turn, one after another, and their largest number; the quickest counts"""
LIMIT = 20.0
"""Seconds after which a run is given up"""
SLOW = 1.0
"""Seconds of a run after which finer settings of the same solver are left out"""
FINE = 1e-11
"""Error [m] below which finer settings are left out"""


class Task(NamedTuple):
    """One run to be done in another process."""

    driver: str
    """Name of a module with a function `solvers`"""
    solver: str
    """Name of one of these solvers"""
    mode: str
    """One of `MODES`"""
    problem: Problem
    setting: Setting


class FailedRunError(Exception):
    """There is no outcome; the message is one line that says why."""


class Worker:
    """Runs the tasks of one tool in a process, which is started again when it was lost."""

    def __init__(self) -> None:
        self._pool: futures.ProcessPoolExecutor | None = None

    def run(self, task: Task) -> Outcome:
        """Run a task and return its outcome.

        Raises:
            FailedRunError: no outcome in time, the tool ended the process, or it raised something.
        """
        try:
            if not self._pool:
                spawned = multiprocessing.get_context("spawn")
                self._pool = futures.ProcessPoolExecutor(1, spawned, prepare, (task.driver,))
                self._pool.submit(int).result()  # the limit does not count what is imported
            return self._pool.submit(best, task).result(LIMIT)
        except futures.TimeoutError:
            self.stop()
            raise FailedRunError(f"given up after {LIMIT:g} s") from None
        except BrokenProcessPool:
            self.stop()
            raise FailedRunError("ended the process") from None
        except Exception as error:  # whatever a tool raises
            raise FailedRunError(
                f"{type(error).__name__}: {' '.join(str(error).split())}"[:100]
            ) from None

    def stop(self) -> None:
        """End the process."""
        if self._pool:
            for process in [*(self._pool._processes or {}).values()]:
                process.kill()
            self._pool.shutdown()
        self._pool = None


def prepare(driver: str) -> None:
    """Keep a tool's process on one processor, and silent, and import its driver."""
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    for stream in (1, 2):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream)
    import_module(driver)


def best(task: Task) -> Outcome:
    """Do a task some times, one after another, and return the fastest outcome; a long run is not repeated."""
    solvers: list[Solver] = import_module(task.driver).solvers()
    run = next(solver for solver in solvers if solver.name == task.solver).run_in(task.mode)
    assert run is not None  # noqa: S101 - for the type checker
    gc.collect()
    gc.freeze()  # a compiler's objects take 0.1 s to look through, for every task
    gc.disable()  # as `timeit` does: one run in many would pay for all
    try:
        outcomes = [run(task.problem, task.setting)]
        while len(outcomes) < RUNS and (len(outcomes) + 1) * outcomes[0].seconds < SLICE:
            outcomes.append(run(task.problem, task.setting))
    finally:
        gc.enable()
    return min(outcomes, key=lambda one: one.seconds)


class Peer(NamedTuple):
    """A tool that a user could take instead of this package."""

    name: str
    module: str
    """Module that it is imported as"""
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
    Peer("SciPy", "scipy"),
    Peer("CyRK", "CyRK"),
    Peer("numbalsoda", "numbalsoda", "peers-built"),
    Peer("diffrax", "diffrax"),
)


class Row(NamedTuple):
    """Error and time of one solver on one problem at one setting, in one mode."""

    problem: str
    solver: str
    peer: str
    mode: str
    setting: str
    error: float = math.nan
    """Largest |signed depth - reference| [m] over all ticks; nan if the run failed"""
    microseconds_per_tick: float = math.nan
    """Time of the fastest turn; nan if the run failed"""
    evaluations_per_tick: float = math.nan
    """Evaluations of the contact force; nan if the tool does not count them"""
    spread_percent: float = math.nan
    """Time between the fastest and the slowest turn, as a part of the median"""
    turns: int = 0
    """Number of turns in which it was timed"""
    failure: str = ""
    """Why the run failed; empty if it did not"""


def measure(
    problems: Sequence[Problem],
    entries: Sequence[Entry],
    turns: int,
    advance: OnProgress = no_progress,
) -> list[Row]:
    """Measure all rows, in turns; `advance` is called with the steps done and their number.

    In the first turn every solver goes from its coarsest setting to the finest that counts; in the others these runs
    are timed again, tool by tool. A run of more than a second is timed in two turns.
    """
    exact = {problem.name: exact_depth(problem) for problem in problems}
    workers = {entry.solver.peer: Worker() for entry in entries}
    runs: list[tuple[Row, Task, list[float]]] = []
    done = count(1)
    total = len(problems) * len(entries) + (turns - 1) * len(workers)
    try:
        for entry in entries:
            for problem in problems:
                for mode in MODES:
                    runs += sweep(
                        workers[entry.solver.peer], entry, problem, exact[problem.name], mode
                    )
                advance(next(done), total)
        for turn in range(1, turns):
            for peer, worker in workers.items():
                for row, task, times in runs:
                    if row.peer == peer and times and (turn == 1 or times[0] < SLOW):
                        times.append(worker.run(task).seconds)
                advance(next(done), total)
    finally:
        for worker in workers.values():
            worker.stop()
    return [timed(row, len(task.problem.time) - 1, times) for row, task, times in runs]


def timed(row: Row, ticks: int, times: Sequence[float]) -> Row:
    """Fill in the times [s] of all turns, if the run did not fail."""
    if not times:
        return row
    spread = 100.0 * (max(times) - min(times)) / statistics.median(times)
    return row._replace(
        microseconds_per_tick=1e6 * min(times) / ticks, spread_percent=spread, turns=len(times)
    )


def sweep(
    worker: Worker, entry: Entry, problem: Problem, exact: NDArray[np.float64], mode: str
) -> Iterator[tuple[Row, Task, list[float]]]:
    """Run a solver from its coarsest setting to the first one that is fine or slow enough, or has no outcome."""
    solver = entry.solver
    for setting in solver.settings if solver.run_in(mode) else ():
        row = Row(problem.name, solver.name, solver.peer, mode, setting.label)
        task = Task(entry.driver, solver.name, mode, problem, setting)
        try:
            outcome = worker.run(task)
        except FailedRunError as error:
            yield row._replace(failure=str(error)), task, []
            return
        if failure := what_failed(outcome, exact):
            yield row._replace(failure=failure), task, []
        else:
            evaluations = outcome.evaluations / (len(problem.time) - 1)
            row = row._replace(
                error=float(np.abs(outcome.depth - exact).max()), evaluations_per_tick=evaluations
            )
            yield row, task, [outcome.seconds]
        if outcome.seconds > SLOW or row.error < FINE:
            return


def what_failed(outcome: Outcome, exact: NDArray[np.float64]) -> str:
    """Why an outcome does not count as one; empty if it does."""
    if outcome.note:
        return " ".join(outcome.note.split())
    if outcome.depth.shape != exact.shape:
        return f"{len(outcome.depth)} of {len(exact)} ticks"
    return "" if np.isfinite(outcome.depth).all() else "not finite"
