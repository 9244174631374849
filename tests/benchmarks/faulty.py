"""Solvers that fail, for the tests of what runs them."""

from __future__ import annotations

import os
import time

import numpy as np

from benchmarks.peers.measure import Outcome, Setting, Solver, tolerances
from benchmarks.peers.problems import Problem


def solvers() -> list[Solver]:
    return [
        Solver(run.__name__, "faulty", "", tolerances(4, 6, 8), None, run)
        for run in (raises, ends, hangs, answers)
    ]


def raises(problem: Problem, setting: Setting) -> Outcome:
    raise ZeroDivisionError


def ends(problem: Problem, setting: Setting) -> Outcome:
    os._exit(1)


def hangs(problem: Problem, setting: Setting) -> Outcome:
    time.sleep(120.0)
    raise AssertionError


def answers(problem: Problem, setting: Setting) -> Outcome:
    return Outcome(np.zeros_like(problem.time), 1e-3)
