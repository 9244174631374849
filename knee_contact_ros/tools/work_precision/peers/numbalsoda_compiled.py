"""numbalsoda: LSODA in C++ and DOP853 in Fortran, called in code that Numba compiles."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from knee_contact_ros.tools.work_precision.motion import DEPTH_SCALE
from knee_contact_ros.tools.work_precision.problems import Problem
from knee_contact_ros.tools.work_precision.solver import Outcome, Run, Setting, Solver, half_decades, stopwatch
from knee_contact_ros.tools.work_precision.start import start_depth

LAW = (
    "exact: right-hand side compiled by Numba, called by its address; one call with the load found by index, or one "
    "call per tick in a compiled function, which Python calls for every sample or a compiled loop for all of them"
)
METHODS = ("LSODA", "DOP853")
MOST_STEPS = 1_000_000


def solvers() -> list[Solver]:
    """One per method."""
    from knee_contact_ros.tools.work_precision import compiled_ticks

    found = []
    for method in METHODS:
        make = functools.partial(ticker_of, method)
        found.append(Solver(
            f"numbalsoda {method}", "numbalsoda", LAW, half_decades(3, 13), whole(method), compiled_ticks.stream(make),
            compiled_ticks.loop(make),
        ))  # fmt: skip
    return found


def whole(method: str) -> Run:
    """One call, output at every tick."""

    def run(problem: Problem, setting: Setting) -> Outcome:
        from knee_contact_ros.tools.work_precision.compiled_motion import motions

        solve, motion = compiled(method)[0], motions(problem)
        function, rtol, atol = address(motion.in_series), setting.value, setting.value * DEPTH_SCALE
        state = np.array([start_depth(problem), 0.0])
        solve(function, state.copy(), problem.time[:2], motion.series_numbers, rtol, atol)  # compiles
        with stopwatch() as watch:
            states, reached = solve(function, state, problem.time, motion.series_numbers, rtol, atol)
        return Outcome(states[:, 0], watch.seconds, note="" if reached else "the solver gave up")

    return run


def ticker_of(method: str, problem: Problem) -> tuple[Any, int]:
    """Compiled functions, and the right-hand side's address."""
    from knee_contact_ros.tools.work_precision.compiled_motion import motions

    return compiled(method)[1], address(motions(problem).in_tick)


@functools.cache
def address(motion: Any) -> int:
    """A right-hand side as the tool takes it."""
    from numba import cfunc
    from numbalsoda import lsoda_sig

    @cfunc(lsoda_sig)
    def function(time: float, state: Any, rate: Any, numbers: Any) -> None:
        motion(rate, time, state, numbers)

    KEPT.append(function)
    return function.address  # type: ignore[no-any-return]


KEPT: list[Any] = []
"""Compiled code that is called by address"""


@functools.cache
def compiled(method: str) -> tuple[Any, Any]:
    """Functions for a run over a series, and tick after tick."""
    import numbalsoda
    from numba import njit

    from knee_contact_ros.tools.work_precision.compiled_ticks import ticker

    solver = {"LSODA": numbalsoda.lsoda, "DOP853": numbalsoda.dop853}[method]

    @njit
    def solve(function: int, state: Any, time: Any, numbers: Any, rtol: float, atol: float) -> Any:
        return solver(function, state, time, numbers, rtol, atol, MOST_STEPS)

    @njit
    def advance(function: int, state: Any, span: Any, numbers: Any, rtol: float, atol: float) -> bool:
        states, reached = solver(function, state, span, numbers, rtol, atol, MOST_STEPS)
        state[0], state[1] = states[1, 0], states[1, 1]
        return reached  # type: ignore[no-any-return]

    return solve, ticker(advance)
