"""CyRK: solvers in C++, called in code that Numba compiles (`nbsolve2_ivp`)."""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np

from knee_contact_ros.tools.work_precision.motion import DEPTH_SCALE
from knee_contact_ros.tools.work_precision.problems import Problem
from knee_contact_ros.tools.work_precision.solver import (
    Outcome,
    Run,
    Setting,
    Solver,
    half_decades,
    steps_per_tick,
    stopwatch,
)
from knee_contact_ros.tools.work_precision.start import start_depth

LAW = (
    "exact: right-hand side compiled by Numba, called by its address; one `nbsolve2_ivp` with the load found by index, "
    "or one per tick in a compiled function, which Python calls for every sample or a compiled loop for all of them"
)
EQUAL = "exact: the same with steps of equal size, without error control, over the whole series"
METHODS = ("RK45", "Tsit5", "DOP853", "Vern7", "LSODA", "RADAU")
EQUAL_STEPS = ("RK45", "DOP853")
ANYTHING = 1.0
"""Tolerance at which every step is accepted: `max_step` is the step"""


def solvers() -> list[Solver]:
    """One per method, and two with equal steps; `nbsolve_ivp`, in Numba itself, is slower than these."""
    from knee_contact_ros.tools.work_precision import compiled_ticks

    found = []
    for method in METHODS:
        make = functools.partial(ticker_of, method)
        found.append(Solver(
            f"CyRK {method}", "CyRK", LAW, half_decades(3, 13), whole(method), compiled_ticks.stream(make),
            compiled_ticks.loop(make),
        ))  # fmt: skip
    counts = steps_per_tick(1, 2, 3, 4, 6, 10, 20, 50, 100)
    return [*found, *(Solver(f"CyRK {method}, equal steps", "CyRK", EQUAL, counts, equal_steps(method), None)
                      for method in EQUAL_STEPS)]  # fmt: skip


def whole(method: str) -> Run:
    """One call, output at every tick."""

    def run(problem: Problem, setting: Setting) -> Outcome:
        return run_whole(problem, method, setting.value, setting.value * DEPTH_SCALE, math.inf)

    return run


def equal_steps(method: str) -> Run:
    """Likewise, with a number of steps for every tick."""

    def run(problem: Problem, setting: Setting) -> Outcome:
        tick = (problem.time[-1] - problem.time[0]) / (len(problem.time) - 1)
        return run_whole(problem, method, ANYTHING, ANYTHING, tick / setting.value)

    return run


def run_whole(problem: Problem, method: str, rtol: float, atol: float, step: float) -> Outcome:
    """One call."""
    from knee_contact_ros.tools.work_precision.compiled_motion import motions

    solve, motion = compiled_series(), motions(problem)
    function, state = address(motion.in_series), np.array([start_depth(problem), 0.0])
    given = motion.series_numbers, method, rtol, atol, step
    solve(function, state.copy(), problem.time[:3], *given)  # compiles
    with stopwatch() as watch:
        depths = solve(function, state, problem.time, *given)
    return Outcome(depths, watch.seconds)


def ticker_of(method: str, problem: Problem) -> tuple[Any, int]:
    """Compiled functions, and the right-hand side's address."""
    from knee_contact_ros.tools.work_precision.compiled_motion import motions

    return compiled_ticker(method), address(motions(problem).in_tick)


@functools.cache
def address(motion: Any) -> int:
    """A right-hand side as the tool takes it."""
    from CyRK.nb.numba_solver import cyjit

    @cyjit
    def function(rate: Any, time: float, state: Any, numbers: Any) -> None:
        motion(rate, time, state, numbers)

    KEPT.append(function)
    return function.address  # type: ignore[no-any-return]


KEPT: list[Any] = []
"""Compiled code that is called by address"""


@functools.cache
def compiled_series() -> Any:
    """A run over a series; nothing of it remains if the solver fails."""
    from CyRK.nb.numba_solver import nbsolve2_ivp
    from numba import njit

    @njit
    def solve(
        function: int, state: Any, time: Any, numbers: Any, method: str, rtol: float, atol: float, step: float
    ) -> Any:
        found = nbsolve2_ivp(
            function, (time[0], time[-1]), state, method=method, t_eval=time, args=numbers, rtol=rtol, atol=atol,
            max_step=step, first_step=step if step < np.inf else 0.0, force_retain_solver=False,
        )  # fmt: skip
        depths = np.full(len(time), np.nan)
        if found.size == len(time):
            depths[:] = found.y[0]
        found.free()
        return depths

    return solve


@functools.cache
def compiled_ticker(method: str) -> Any:
    """Tick after tick."""
    from CyRK.nb.numba_solver import nbsolve2_ivp
    from numba import njit

    from knee_contact_ros.tools.work_precision.compiled_ticks import ticker

    @njit
    def advance(function: int, state: Any, span: Any, numbers: Any, rtol: float, atol: float) -> bool:
        # CyRK refuses a first step beyond half the span
        found = nbsolve2_ivp(
            function, (span[0], span[1]), state, method=method, args=numbers, rtol=rtol, atol=atol,
            first_step=0.5 * span[1], expected_size=8, force_retain_solver=False,
        )  # fmt: skip
        reached = found.success
        if reached:
            state[0], state[1] = found.y[0, found.size - 1], found.y[1, found.size - 1]
        found.free()
        return reached  # type: ignore[no-any-return]

    return ticker(advance)
