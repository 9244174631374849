"""The loosest setting of a method with which every depth is within the limit."""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np

from studies.cohorts.method import Method
from studies.cohorts.problem import Cohort, Floats

LIMIT = 1e-8
"""Largest error [m] of a depth that is allowed"""
MOST_TIME = 4.0
"""Processor time [s] of a run with a setting that does not hold, beyond which the method is given up"""
TRIES = 2


class Setting(NamedTuple):
    """The loosest setting of a method that holds, and what it costs."""

    key: str
    value: float
    """Tolerance or steps per tick; nan if there is none"""
    error: float
    """Largest error [m] of the knees"""
    per_tick: float
    """Processor time [s] per knee and tick on one core; nan if there is none"""
    first: float
    """Processor time [s] of the very first set-up and run with a few knees, in which some tools compile"""


def search(method: Method, knees: Cohort, truth: Floats) -> Setting:
    """Search from coarse to fine with a few knees, and from there on with all knees."""
    settings, least, seconds = list(method.settings), np.inf, np.nan
    few, all_ = min(method.few, knees.cases), min(knees.cases, method.most)
    begin = time.process_time()
    method.prepare(knees.first(few), settings[0], 1)()
    first = time.process_time() - begin
    for cases in (few, all_):
        while settings:
            error, seconds = _tried(method, knees.first(cases), settings[0], truth[:cases])
            least = min(least, error)
            if error <= LIMIT:
                break
            settings = settings[1:] if seconds <= MOST_TIME else []
    if not settings:
        return Setting(method.key, np.nan, least, np.nan, first)
    return Setting(method.key, settings[0], error, seconds / (all_ * knees.ticks), first)


def _tried(method: Method, knees: Cohort, setting: float, truth: Floats) -> tuple[float, float]:
    """Largest error [m], infinite if the run failed, and the shortest processor time [s] of some runs."""
    run = method.prepare(knees, setting, 1)
    error = np.nan_to_num(np.abs(run() - truth).max(), nan=np.inf)
    times = []
    for _ in range(TRIES if error <= LIMIT else 1):
        begin = time.process_time()
        run()
        times.append(time.process_time() - begin)
    return float(error), min(times)
