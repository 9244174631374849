"""Processes that run the methods of one tool on their shares of a cohort.

`load` is called once in each process; what the other functions prepare stays there.
"""

from __future__ import annotations

import time
import warnings
from concurrent.futures import ProcessPoolExecutor
from importlib import import_module
from multiprocessing import get_context
from typing import NamedTuple

import numpy as np

from studies.cohorts import search
from studies.cohorts.method import Method, Run
from studies.cohorts.problem import Cohort, Floats

_methods: dict[str, Method] = {}
_runs: dict[str, Run] = {}
_depths: dict[str, Floats] = {}


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


class Workers:
    """The processes of all tools: two for each tool, so that each compiles once, whatever it runs."""

    def __init__(self) -> None:
        self._of: dict[str, list[ProcessPoolExecutor]] = {}

    def of(self, driver: str) -> list[ProcessPoolExecutor]:
        """Both processes of a tool, each an executor of its own; they are started on first use."""
        if driver not in self._of:
            self._of[driver] = [ProcessPoolExecutor(1, get_context("spawn"), load, (driver,)) for _ in range(2)]
        return self._of[driver]

    def close(self) -> None:
        """End all processes."""
        for workers in self._of.values():
            for worker in workers:
                worker.shutdown(cancel_futures=True)


def load(driver: str) -> None:
    """Import the module that drives a tool."""
    warnings.simplefilter("ignore")  # SciPy and Numba on tolerances that are meant to be loose, and on contiguity
    _methods.update((method.key, method) for method in import_module(driver).methods())


def search_setting(key: str, knees: Cohort, truth: Floats) -> search.Setting:
    """Search the setting of a method; see `search.search`."""
    return search.search(_methods[key], knees, truth)


def prepare(slot: str, key: str, knees: Cohort, share: Share, setting: float) -> float:
    """Set up a run under a name and do it once, in which some tools compile; return the time [s] of the set-up."""
    ranged = {name: getattr(knees, name)[share.begin : share.end] for name in ("stiffness", "damping", "mass")}
    begin = time.perf_counter()
    _runs[slot] = _methods[key].prepare(knees._replace(**ranged), setting, share.threads)
    set_up = time.perf_counter() - begin
    run(slot)
    return set_up


def run(slot: str) -> Span:
    """Do the run that was prepared under a name."""
    prepared, processor, begin = _runs[slot], time.process_time(), time.monotonic()
    answer = prepared()
    span = Span(begin, time.monotonic(), time.process_time() - processor)
    _depths[slot] = answer
    return span


def depths(slot: str) -> Floats:
    """Depths [m] of the last run under a name, shape (cases, ticks)."""
    return np.asarray(_depths[slot])
