"""SciPy, called once per knee."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numba import njit
from scipy.integrate import odeint, solve_ivp

from benchmarks.peers.motion import DEPTH_SCALE, RATE_SCALE
from studies.cohorts.method import COUNTS, STEPS, TOLERANCE, TOLERANCES, Method, Run
from studies.cohorts.problem import Cohort, Floats

TOOL = "SciPy, a loop"
MOST_STEPS = 1_000_000
CASES = 16
"""Every knee takes its milliseconds, however many there are"""
Motion = Callable[..., Any]


def methods() -> list[Method]:
    """List LSODA by `odeint` and an explicit method by `solve_ivp`, with plain and with compiled right-hand sides."""
    found = []
    for how, compile_it in (("plain Python", False), ("Numba", True)):
        make = partial(_lsoda, compile_it=compile_it)
        found.append(Method(TOOL, f"LSODA (odeint), {how}", TOLERANCE, make, TOLERANCES, most=CASES))
        make = partial(_equal_steps, compile_it=compile_it)
        found.append(Method(TOOL, f"RK45, equal steps, {how}", STEPS, make, COUNTS, most=CASES))
    return found


def plain(knees: Cohort) -> Motion:
    """Build the right-hand side in plain Python."""
    begin, per_second, last = float(knees.time[0]), 1.0 / knees.tick, knees.ticks - 2
    loads, rises = knees.load.tolist(), np.diff(knees.load).tolist()

    def motion(time: float, state: Floats, stiffness: float, damping: float, inverse_mass: float) -> Any:
        depth, rate = state.tolist()
        ticks = (time - begin) * per_second
        i = min(max(int(ticks), 0), last)
        force = max(stiffness * depth**1.5 + damping * rate, 0.0) if depth > 0.0 else 0.0
        return rate, (loads[i] + rises[i] * (ticks - i) - force) * inverse_mass

    return motion


def in_numba(knees: Cohort) -> Motion:
    """Build the right-hand side compiled by Numba."""
    begin, per_second, last = float(knees.time[0]), 1.0 / knees.tick, knees.ticks - 2
    loads, rises = knees.load, np.diff(knees.load)

    @njit
    def motion(time: float, state: Any, stiffness: float, damping: float, inverse_mass: float) -> Any:
        ticks = (time - begin) * per_second
        i = min(max(int(ticks), 0), last)
        force = 0.0
        if state[0] > 0.0:
            force = max(stiffness * state[0] * np.sqrt(state[0]) + damping * state[1], 0.0)
        return np.array([state[1], (loads[i] + rises[i] * (ticks - i) - force) * inverse_mass])

    return motion  # type: ignore[no-any-return]


def _knees(knees: Cohort) -> list[tuple[tuple[float, float], tuple[float, float, float]]]:
    """State at rest and constants of every knee."""
    columns = knees.start.tolist(), knees.stiffness.tolist(), knees.damping.tolist(), (1.0 / knees.mass).tolist()
    return [((start, 0.0), constants) for start, *constants in zip(*columns, strict=True)]  # type: ignore[misc]


def _lsoda(knees: Cohort, tolerance: float, _threads: int, *, compile_it: bool) -> Run:
    motion, each = (in_numba if compile_it else plain)(knees), _knees(knees)
    atol = tolerance * DEPTH_SCALE, tolerance * RATE_SCALE

    def run() -> Floats:
        return np.array([
            odeint(motion, state, knees.time, tuple(constants), tfirst=True, rtol=tolerance, atol=atol,
                   mxstep=MOST_STEPS)[:, 0]
            for state, constants in each
        ])  # fmt: skip

    return run


def _equal_steps(knees: Cohort, count: float, _threads: int, *, compile_it: bool) -> Run:
    motion, each = (in_numba if compile_it else plain)(knees), _knees(knees)
    step, span = knees.tick / count, (knees.time[0], knees.time[-1])

    def run() -> Floats:
        return np.array([
            solve_ivp(motion, span, state, "RK45", knees.time, args=tuple(constants), first_step=step, max_step=step,
                      rtol=1.0, atol=1.0).y[0]
            for state, constants in each
        ])  # fmt: skip

    return run
