"""A process of its own for each tool: a tool may hang or end its process, and must not load what another one loads."""

from __future__ import annotations

import gc
import os
import sys
from contextlib import suppress
from importlib import import_module
from multiprocessing.connection import Connection
from typing import NamedTuple

from knee_contact_ros.system.processes import Process, connected, reap
from knee_contact_ros.tools.work_precision.problems import Problem
from knee_contact_ros.tools.work_precision.solver import Outcome, Setting, Solver
from knee_contact_ros.tools.work_precision.timing import runs_for

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

    def run(self, task: Task, limit: float) -> Outcome:
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
            connection.send(best(task))
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


if __name__ == "__main__":
    with Connection(int(sys.argv[1])) as ours:
        serve(ours)
