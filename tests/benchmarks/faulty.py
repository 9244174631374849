"""Solvers that fail, for the tests of what runs them."""

import os
import time

import numpy as np

from benchmarks.peers.measure import Outcome, Solver, tolerances


def solvers():
    return [
        Solver(run.__name__, "faulty", "", tolerances(4, 6, 8), None, run)
        for run in (raises, ends, hangs, answers)
    ]


def raises(problem, setting):
    raise ZeroDivisionError


def ends(problem, setting):
    os._exit(1)


def hangs(problem, setting):
    time.sleep(120.0)
    raise AssertionError


def answers(problem, setting):
    return Outcome(np.zeros_like(problem.time), 1e-3)
