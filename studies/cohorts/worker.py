"""A process that runs the methods of one tool on its share of a cohort when it is told to."""

from __future__ import annotations

import multiprocessing
import time
import traceback
import warnings
from importlib import import_module
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

import numpy as np

from studies.cohorts.method import Run
from studies.cohorts.problem import Cohort, Floats
from studies.cohorts.search import Setting, search


class Share(NamedTuple):
    """The knees of a cohort that a process runs, and with how many threads."""

    begin: int
    end: int
    threads: int


class Span(NamedTuple):
    """When a run began and ended [s] by the machine's monotonic clock, which processes share."""

    begin: float
    end: float
    processor: float
    """Processor time [s] of all its threads"""


class WorkerError(RuntimeError):
    """What the process raised."""


class Worker:
    """The process, seen from outside. `ask` and `answer` are two so that several can be at work at once."""

    def __init__(self, driver: str) -> None:
        context = multiprocessing.get_context("spawn")
        self._end, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(driver, theirs), daemon=True)
        self._process.start()

    def ask(self, what: str, *arguments: Any) -> None:
        """Name a method of `_Served`."""
        self._end.send((what, arguments))

    def answer(self) -> Any:
        """Wait for what it says.

        Raises:
            WorkerError: it failed.
        """
        answer, error = self._end.recv()
        if error:
            raise WorkerError(error)
        return answer

    def call(self, what: str, *arguments: Any) -> Any:
        """Both."""
        self.ask(what, *arguments)
        return self.answer()

    def close(self) -> None:
        """End it."""
        self._end.close()
        self._process.join(5.0)
        if self._process.is_alive():
            self._process.terminate()


class Workers:
    """The processes of all tools: two each, so that each compiles once whatever is asked of it."""

    def __init__(self) -> None:
        self._of: dict[str, list[Worker]] = {}

    def of(self, driver: str) -> list[Worker]:
        """A tool's."""
        if driver not in self._of:
            self._of[driver] = [Worker(driver) for _ in range(2)]
        return self._of[driver]

    def close(self) -> None:
        """End all of them."""
        for each in self._of.values():
            for worker in each:
                worker.close()


class _Served:
    """What a process can be asked."""

    def __init__(self, driver: str) -> None:
        self._methods = {method.key: method for method in import_module(driver).methods()}
        self._runs: dict[Any, Run] = {}
        self._depths: dict[Any, Floats] = {}

    def search(self, key: str, knees: Cohort, truth: Floats) -> Setting:
        """See `search.search`."""
        return search(self._methods[key], knees, truth)

    def prepare(self, slot: Any, key: str, knees: Cohort, share: Share, setting: float) -> float:
        """Set up a run under a name and do it once, in which some tools compile: time [s] of the set-up alone."""
        ranged = {name: getattr(knees, name)[share.begin : share.end] for name in ("stiffness", "damping", "mass")}
        begin = time.perf_counter()
        self._runs[slot] = self._methods[key].prepare(knees._replace(**ranged), setting, share.threads)
        set_up = time.perf_counter() - begin
        self.run(slot)
        return set_up

    def run(self, slot: Any) -> Span:
        """Run what was prepared."""
        run, processor, begin = self._runs[slot], time.process_time(), time.monotonic()
        depths = run()
        span = Span(begin, time.monotonic(), time.process_time() - processor)
        self._depths[slot] = depths
        return span

    def depths(self, slot: Any) -> Floats:
        """What the last run found [m]."""
        return np.asarray(self._depths[slot])


def _serve(driver: str, end: Connection) -> None:
    """Until the other end is closed."""
    warnings.simplefilter("ignore")  # SciPy and Numba on tolerances that are meant to be loose, and on contiguity
    served: _Served | None = None
    while True:
        try:
            what, arguments = end.recv()
        except EOFError:
            return
        try:
            served = served or _Served(driver)
            end.send((getattr(served, what)(*arguments), ""))
        except Exception:
            end.send((None, traceback.format_exc()))
