"""numbalsoda: LSODA in C++ and DOP853 in Fortran, inside a loop compiled by Numba."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numba import cfunc, njit, prange, set_num_threads
from numbalsoda import dop853, lsoda, lsoda_sig, solve_ivp

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

TOOL = "numbalsoda"
MOST_STEPS = 1_000_000
ANYTHING = 1.0
"""Tolerance at which every step is accepted: `max_step` is the step"""


def methods() -> list[Method]:
    """Both solvers, along the whole series and anew in every tick; DOP853 with equal steps too."""
    found = [
        Method(TOOL, f"{name}, {way}", TOLERANCE, partial(prepare, run=make(solver)), TOLERANCES, threads=True)
        for name, solver in (("LSODA", lsoda), ("DOP853", dop853))
        for way, make in (("whole series", _whole), ("tick by tick", _anew))
    ]
    equal = Method(TOOL, "DOP853, equal steps", STEPS, partial(prepare, run=_equal_steps), COUNTS, threads=True)
    return [*found, equal]


def prepare(knees: Cohort, setting: float, threads: int, *, run: Any) -> Run:
    """A call of the compiled loop; the setting is a relative tolerance below 1, else steps per tick."""
    numbers = knees.stiffness, knees.damping, knees.mass, knees.start, knees.time, knees.load
    settings = (setting, setting * DEPTH_SCALE) if setting < 1.0 else (ANYTHING, knees.tick / setting)

    def call() -> Floats:
        set_num_threads(threads)
        depths: Floats = run(*settings, *numbers)
        return depths

    return call


@cfunc(lsoda_sig)
def _in_series(time: float, state: Any, rate: Any, numbers: Any) -> None:
    rates(rate, state[0], state[1], load_in_series(time, numbers), numbers)


@cfunc(lsoda_sig)
def _in_tick(time: float, state: Any, rate: Any, numbers: Any) -> None:
    rates(rate, state[0], state[1], load_in_tick(time, numbers), numbers)


IN_SERIES, IN_TICK = _in_series.address, _in_tick.address


def _whole(solver: Any) -> Callable[..., Any]:
    @njit(parallel=True)
    def run(rtol: float, atol: float, stiffness: Any, damping: Any, mass: Any, start: Any, time: Any, load: Any) -> Any:
        depths = np.full((len(mass), len(time)), np.nan)
        for i in prange(len(mass)):
            numbers, state = series_numbers(stiffness[i], damping[i], mass[i], time, load), np.array([start[i], 0.0])
            states, reached = solver(IN_SERIES, state, time, numbers, rtol, atol, MOST_STEPS)
            if reached:
                depths[i] = states[:, 0]
        return depths

    return run  # type: ignore[no-any-return]


def _anew(solver: Any) -> Callable[..., Any]:
    @njit(parallel=True)
    def run(rtol: float, atol: float, stiffness: Any, damping: Any, mass: Any, start: Any, time: Any, load: Any) -> Any:
        depths = np.full((len(mass), len(time)), np.nan)
        tick = (time[-1] - time[0]) / (len(time) - 1)
        for i in prange(len(mass)):
            numbers, state = tick_numbers(stiffness[i], damping[i], mass[i]), np.array([start[i], 0.0])
            span = np.array([0.0, tick])
            depths[i, 0] = start[i]
            for j in range(1, len(time)):
                set_ramp(numbers, load[j - 1], (load[j] - load[j - 1]) / tick)
                states, reached = solver(IN_TICK, state, span, numbers, rtol, atol, MOST_STEPS)
                if not reached:
                    break
                state[0], state[1] = states[1, 0], states[1, 1]
                depths[i, j] = state[0]
        return depths

    return run  # type: ignore[no-any-return]


@njit(parallel=True)
def _equal_steps(
    rtol: float, step: float, stiffness: Any, damping: Any, mass: Any, start: Any, time: Any, load: Any
) -> Any:
    depths = np.full((len(mass), len(time)), np.nan)
    span = np.array([time[0], time[-1]])
    for i in prange(len(mass)):
        numbers, state = series_numbers(stiffness[i], damping[i], mass[i], time, load), np.array([start[i], 0.0])
        found = solve_ivp(
            IN_SERIES, span, state, time, data=numbers.ctypes.data, first_step=step, max_step=step, rtol=rtol, atol=rtol
        )
        if found.success:
            depths[i] = found.y[:, 0]
    return depths
