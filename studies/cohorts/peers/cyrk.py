"""CyRK's solvers inside a loop compiled by Numba: those in C++ (`nbsolve2_ivp`) and those in Numba (`nbsolve_ivp`)."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from CyRK import nbsolve_ivp
from CyRK.nb.numba_solver import cyjit, nbsolve2_ivp
from numba import njit, prange, set_num_threads

from knee_contact_ros.tools.work_precision.compiled_motion import (
    load_in_series,
    load_in_tick,
    rates,
    series_numbers,
    set_ramp,
    tick_numbers,
)
from knee_contact_ros.tools.work_precision.motion import DEPTH_SCALE
from studies.cohorts.method import COUNTS, STEPS, TOLERANCE, TOLERANCES, Method, Run
from studies.cohorts.problem import Cohort, Floats

TOOL = "CyRK"
ANYTHING = 1.0
"""Tolerance at which every step is accepted: `max_step` is the step"""
EXPLICIT = ("RK45", "Tsit5", "DOP853", "Vern7", "Vern8")
IMPLICIT = ("LSODA", "RADAU", "BDF")
IN_NUMBA = {"RK45": 1, "DOP853": 2}


def methods() -> list[Method]:
    """All solvers, along the whole series and anew in every tick; the explicit ones with equal steps too."""
    found = [
        Method(TOOL, f"{solver}, {way}", TOLERANCE, partial(prepare, run=run, solver=solver), TOLERANCES, threads=True)
        for solver in (*EXPLICIT, *IMPLICIT)
        for way, run in (("whole series", _whole), ("tick by tick", _anew))
    ]
    found += [
        Method(TOOL, f"{solver}, equal steps", STEPS, partial(prepare, run=_whole, solver=solver), COUNTS, threads=True)
        for solver in EXPLICIT
    ]
    found += [
        Method(TOOL, f"{solver} in Numba, tick by tick", TOLERANCE,
               partial(prepare, run=_anew_in_numba, solver=number), TOLERANCES, threads=True)
        for solver, number in IN_NUMBA.items()
    ]  # fmt: skip
    return found


def prepare(knees: Cohort, setting: float, threads: int, *, run: Any, solver: str | int) -> Run:
    """A call of the compiled loop."""
    equal = setting >= 1.0
    tolerance = ANYTHING if equal else setting
    step = knees.tick / setting if equal else np.inf
    tolerances = tolerance, tolerance * DEPTH_SCALE, step
    numbers = knees.stiffness, knees.damping, knees.mass, knees.start, knees.time, knees.load

    def call() -> Floats:
        set_num_threads(threads)
        depths: Floats = run(solver, *tolerances, *numbers)
        return depths

    return call


@cyjit
def _in_series(rate: Any, time: float, state: Any, numbers: Any) -> None:
    rates(rate, state[0], state[1], load_in_series(time, numbers), numbers)


@cyjit
def _in_tick(rate: Any, time: float, state: Any, numbers: Any) -> None:
    rates(rate, state[0], state[1], load_in_tick(time, numbers), numbers)


@njit
def _in_tick_for_numba(time: float, state: Any, numbers: Any) -> Any:
    rate = np.empty(2)
    rates(rate, state[0], state[1], load_in_tick(time, numbers), numbers)
    return rate


IN_SERIES, IN_TICK = _in_series.address, _in_tick.address


@njit(parallel=True)
def _whole(
    solver: str, rtol: float, atol: float, step: float,
    stiffness: Any, damping: Any, mass: Any, start: Any, time: Any, load: Any,
) -> Any:  # fmt: skip
    depths = np.full((len(mass), len(time)), np.nan)
    first_step = step if step < np.inf else 0.0
    for i in prange(len(mass)):
        numbers, state = series_numbers(stiffness[i], damping[i], mass[i], time, load), np.array([start[i], 0.0])
        found = nbsolve2_ivp(
            IN_SERIES, (time[0], time[-1]), state, method=solver, t_eval=time, args=numbers, rtol=rtol, atol=atol,
            max_step=step, first_step=first_step, force_retain_solver=False,
        )  # fmt: skip
        if found.size == len(time):
            depths[i] = found.y[0]
        found.free()
    return depths


@njit(parallel=True)
def _anew(
    solver: str, rtol: float, atol: float, _step: float,
    stiffness: Any, damping: Any, mass: Any, start: Any, time: Any, load: Any,
) -> Any:  # fmt: skip
    depths = np.full((len(mass), len(time)), np.nan)
    tick = (time[-1] - time[0]) / (len(time) - 1)
    for i in prange(len(mass)):
        numbers, state = tick_numbers(stiffness[i], damping[i], mass[i]), np.array([start[i], 0.0])
        depths[i, 0] = start[i]
        for j in range(1, len(time)):
            set_ramp(numbers, load[j - 1], (load[j] - load[j - 1]) / tick)
            # CyRK refuses a first step beyond half the span
            found = nbsolve2_ivp(
                IN_TICK, (0.0, tick), state, method=solver, args=numbers, rtol=rtol, atol=atol, first_step=0.5 * tick,
                expected_size=8, force_retain_solver=False,
            )  # fmt: skip
            reached = found.success
            if reached:
                state[0], state[1] = found.y[0, found.size - 1], found.y[1, found.size - 1]
            found.free()
            if not reached:
                break
            depths[i, j] = state[0]
    return depths


@njit(parallel=True)
def _anew_in_numba(
    solver: int, rtol: float, atol: float, _step: float,
    stiffness: Any, damping: Any, mass: Any, start: Any, time: Any, load: Any,
) -> Any:  # fmt: skip
    depths = np.full((len(mass), len(time)), np.nan)
    tick = (time[-1] - time[0]) / (len(time) - 1)
    for i in prange(len(mass)):
        numbers, state = tick_numbers(stiffness[i], damping[i], mass[i]), np.array([start[i], 0.0])
        depths[i, 0] = start[i]
        for j in range(1, len(time)):
            set_ramp(numbers, load[j - 1], (load[j] - load[j - 1]) / tick)
            found = nbsolve_ivp(
                _in_tick_for_numba, (0.0, tick), state, args=(numbers,), rtol=rtol, atol=atol, rk_method=solver,
                first_step=tick, warnings=False,
            )  # fmt: skip
            if not found.success:
                break
            state[0], state[1] = found.y[0, -1], found.y[1, -1]
            depths[i, j] = state[0]
    return depths
