"""Loops over knees, compiled by Numba, for tools that are called by what is compiled; one thread per core.

The solvers are those of `benchmarks.peers.compiled`.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numba import njit, prange, set_num_threads

from benchmarks.peers.compiled import ANYTHING, series_numbers, set_ramp, tick_numbers
from benchmarks.peers.motion import DEPTH_SCALE
from studies.cohorts.method import COUNTS, STEPS, TOLERANCE, TOLERANCES, Method, Run
from studies.cohorts.problem import Cohort, Floats


def described(tool: str, name: str, loop: Any, method: str | int) -> Method:
    """Describe a loop with a tool's method; what its name says decides on error control or equal steps."""
    control, settings = (STEPS, COUNTS) if name.endswith("equal steps") else (TOLERANCE, TOLERANCES)
    return Method(tool, name, control, partial(prepare, loop=loop, method=method), settings, threads=True)


def prepare(knees: Cohort, setting: float, threads: int, *, loop: Any, method: str | int) -> Run:
    """Prepare a call of a loop; the setting is a relative tolerance below 1, else steps per tick."""
    tolerance, step = (setting, np.inf) if setting < 1.0 else (ANYTHING, knees.tick / setting)
    arguments = (method, tolerance, tolerance * DEPTH_SCALE, step, knees.stiffness, knees.damping, knees.mass,
                 knees.start, knees.time, knees.load)  # fmt: skip

    def run() -> Floats:
        set_num_threads(threads)
        depths: Floats = loop(*arguments)
        return depths

    return run


def whole_series(solve: Any, function: int) -> Any:
    """Compile a loop in which a solver runs over the whole series of every knee, with the address of a motion."""

    @njit(parallel=True)
    def loop(
        method: Any, rtol: float, atol: float, step: float,
        stiffness: Any, damping: Any, mass: Any, start: Any, time: Any, load: Any,
    ) -> Any:  # fmt: skip
        depths = np.empty((len(mass), len(time)))
        for i in prange(len(mass)):
            numbers, state = series_numbers(stiffness[i], damping[i], mass[i], time, load), np.array([start[i], 0.0])
            depths[i] = solve(method, function, state, time, numbers, rtol, atol, step)
        return depths

    return loop


def tick_by_tick(advance: Any, function: int) -> Any:
    """Compile a loop in which a solver begins anew in every tick of every knee; depths are nan where it failed."""

    @njit(parallel=True)
    def loop(
        method: Any, rtol: float, atol: float, _step: float,
        stiffness: Any, damping: Any, mass: Any, start: Any, time: Any, load: Any,
    ) -> Any:  # fmt: skip
        depths = np.full((len(mass), len(time)), np.nan)
        tick = (time[-1] - time[0]) / (len(time) - 1)
        for i in prange(len(mass)):
            numbers, state = tick_numbers(stiffness[i], damping[i], mass[i]), np.array([start[i], 0.0])
            span = np.array([0.0, tick])
            depths[i, 0] = start[i]
            for j in range(1, len(time)):
                set_ramp(numbers, load[j - 1], (load[j] - load[j - 1]) / tick)
                if not advance(method, function, state, span, numbers, rtol, atol):
                    break
                depths[i, j] = state[0]
        return depths

    return loop
