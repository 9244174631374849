"""SciPy with all knees as one system: what SciPy does in Python for a step, it does once for all of them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numba import njit
from scipy.integrate import solve_ivp

from benchmarks.peers.motion import DEPTH_SCALE, RATE_SCALE
from studies.cohorts.method import COUNTS, STEPS, TOLERANCE, TOLERANCES, Method, Run
from studies.cohorts.problem import Cohort, Floats

TOOL = "SciPy, one system"
Rates = Callable[[Floats, float], Floats]
"""State and load [N] to the state's rate of change"""


def methods() -> list[Method]:
    """List two explicit methods, tick by tick with error control and with equal steps."""
    found = []
    for how, make in (("NumPy", in_numpy), ("Numba", in_numba)):
        for solver in ("RK45", "DOP853"):
            anew, equal = (partial(prepare, solver=solver, make=make) for prepare in (_anew, _equal_steps))
            found.append(Method(TOOL, f"{solver}, tick by tick, {how}", TOLERANCE, anew, TOLERANCES))
            found.append(Method(TOOL, f"{solver}, equal steps, {how}", STEPS, equal, COUNTS))
    return found


def in_numpy(knees: Cohort) -> Rates:
    """Build the right-hand side of all knees in NumPy, array by array."""
    stiffness, damping, inverse_mass, cases = knees.stiffness, knees.damping, 1.0 / knees.mass, knees.cases

    def rates(state: Floats, load: float) -> Floats:
        depth, rate = state[:cases], state[cases:]
        inside = np.maximum(depth, 0.0)
        force = np.sqrt(inside)
        force *= inside
        force *= stiffness
        force += damping * rate
        np.maximum(force, 0.0, out=force)
        force *= depth > 0.0
        change = np.empty_like(state)
        change[:cases] = rate
        np.subtract(load, force, out=force)
        np.multiply(force, inverse_mass, out=change[cases:])
        return change

    return rates


def in_numba(knees: Cohort) -> Rates:
    """Build the right-hand side of all knees as one loop compiled by Numba."""
    stiffness, damping, inverse_mass, cases = knees.stiffness, knees.damping, 1.0 / knees.mass, knees.cases

    @njit
    def rates(state: Any, load: float) -> Any:
        change = np.empty_like(state)
        for i in range(cases):
            depth, rate = state[i], state[cases + i]
            inside = max(depth, 0.0)
            force = max(stiffness[i] * inside * np.sqrt(inside) + damping[i] * rate, 0.0)
            change[i] = rate
            change[cases + i] = (load - (force if depth > 0.0 else 0.0)) * inverse_mass[i]
        return change

    return rates  # type: ignore[no-any-return]


def _anew(knees: Cohort, tolerance: float, _threads: int, *, solver: str, make: Callable[[Cohort], Rates]) -> Run:
    rates, loads, tick, cases = make(knees), knees.load.tolist(), knees.tick, knees.cases
    atol = np.repeat((tolerance * DEPTH_SCALE, tolerance * RATE_SCALE), cases)

    def run() -> Floats:
        state = np.concatenate([knees.start, np.zeros(cases)])
        depths = np.empty((cases, knees.ticks))
        depths[:, 0] = knees.start
        for i in range(1, knees.ticks):
            begin, slope = loads[i - 1], (loads[i] - loads[i - 1]) / tick

            def motion(time: float, state: Floats, begin: float = begin, slope: float = slope) -> Floats:
                return rates(state, begin + slope * time)

            state = solve_ivp(
                motion, (0.0, tick), state, solver, (tick,), first_step=tick, rtol=tolerance, atol=atol
            ).y[:, -1]
            depths[:, i] = state[:cases]
        return depths

    return run


def _equal_steps(knees: Cohort, count: float, _threads: int, *, solver: str, make: Callable[[Cohort], Rates]) -> Run:
    rates, cases, last = make(knees), knees.cases, knees.ticks - 2
    begin, per_second = float(knees.time[0]), 1.0 / knees.tick
    loads, rises = knees.load.tolist(), np.diff(knees.load).tolist()
    step, span = knees.tick / count, (knees.time[0], knees.time[-1])

    def motion(time: float, state: Floats) -> Floats:
        ticks = (time - begin) * per_second
        i = min(max(int(ticks), 0), last)
        return rates(state, loads[i] + rises[i] * (ticks - i))

    def run() -> Floats:
        state = np.concatenate([knees.start, np.zeros(cases)])
        found = solve_ivp(
            motion, span, state, solver, knees.time, first_step=step, max_step=step, rtol=1.0, atol=1.0
        )  # fmt: skip
        depths: Floats = found.y[:cases]
        return depths

    return run
