"""A fixed piece of work in the form of a solver: changes of its time are the machine's noise."""

from __future__ import annotations

import numpy as np

from knee_contact_ros.tools.work_precision.problems import Problem
from knee_contact_ros.tools.work_precision.solver import Outcome, Setting, Solver, stopwatch

NAME = "yardstick"
SETTING = Setting("", 0.0)
ADDITIONS = 100_000


def solvers() -> list[Solver]:
    """The one solver: the yardstick."""
    return [Solver(NAME, NAME, "none", [SETTING], run, None)]


def run(_problem: Problem, _setting: Setting) -> Outcome:
    """Add numbers in plain Python for some milliseconds."""
    total = 0.0
    with stopwatch() as watch:
        for number in range(ADDITIONS):
            total += number * 0.5
    return Outcome(np.array([total]), watch.seconds)
