"""Runs of a problem with a solver that compiled code calls: in one call, for every sample, or in a compiled loop.

A tool is a module of this folder with the functions `callback`, `series` and `advance`: `cyrk`, `numbalsoda`. It is
imported by the run only, so that the solvers of a tool can be listed without it. A method is what the tool's functions
take as such: a name or a number.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from knee_contact_ros.tools.work_precision.compiled.motion import motions, set_ramp
from knee_contact_ros.tools.work_precision.motion import DEPTH_SCALE
from knee_contact_ros.tools.work_precision.problems import Problem
from knee_contact_ros.tools.work_precision.solver import Outcome, Run, Setting, stopwatch
from knee_contact_ros.tools.work_precision.start import start_depth

ANYTHING = 1.0
"""Tolerance at which every step is accepted, so that the largest step allowed is the step"""
Knee = NDArray[np.float64]
"""All that a tick needs, in one array, because every argument of a call costs: see the places below"""
SPAN, LOAD, RTOL, ATOL, NUMBERS = 2, 4, 5, 6, 7
"""Behind the state (2): a tick's begin, 0, and end [s]; last sample's load [N]; tolerances; the motion's numbers"""


class Ticker(NamedTuple):
    """Compiled functions that advance a knee by one tick, and by many."""

    tick: Callable[[Knee, int, float, float], float]
    """Knee, right-hand side, duration [s] and load [N] at its end to the depth [m]; nan if the solver failed"""
    loop: Callable[[Knee, int, NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]], None]
    """Knee, right-hand side, durations and loads of the ticks, and where their depths go"""


def modes(tool: str, method: str | int) -> tuple[Run, Run, Run]:
    """The runs of a tool's method in the order of the fields of `Solver`: whole series, stream, loop."""
    return tuple(functools.partial(run, tool, method) for run in (whole, stream, loop))  # type: ignore[return-value]


def whole(tool: str, method: str | int, problem: Problem, setting: Setting) -> Outcome:
    """Solve the problem in one call, with output at every tick."""
    return in_one_call(tool, method, problem, setting.value, setting.value * DEPTH_SCALE, math.inf)


def equal_steps(tool: str, method: str | int, problem: Problem, setting: Setting) -> Outcome:
    """Solve the problem in one call with a number of equal steps for every tick, without error control."""
    tick = (problem.time[-1] - problem.time[0]) / (len(problem.time) - 1)
    return in_one_call(tool, method, problem, ANYTHING, ANYTHING, tick / setting.value)


def in_one_call(tool: str, method: str | int, problem: Problem, rtol: float, atol: float, step: float) -> Outcome:
    """Time one call over the series; `atol` and `step` are in [m] and [s]."""
    module, motion = module_of(tool), motions(problem)
    solve, function = module.series, module.callback(motion.in_series).address
    state = np.array([start_depth(problem), 0.0])
    numbers = motion.series_numbers
    solve(method, function, state.copy(), problem.time[:3], numbers, rtol, atol, step)  # compiles
    with stopwatch() as watch:
        depths = solve(method, function, state, problem.time, numbers, rtol, atol, step)
    return Outcome(depths, watch.seconds, note="" if np.isfinite(depths).all() else "the solver gave up")


def stream(tool: str, method: str | int, problem: Problem, setting: Setting) -> Outcome:
    """Solve the problem with a call from Python for every sample."""
    tick, function = ticker(tool, method).tick, tick_address(tool, problem)
    samples = list(zip(np.diff(problem.time).tolist(), problem.load[1:].tolist(), strict=True))
    tick(knee_of(problem, setting.value), function, *samples[0])  # compiles
    knee = knee_of(problem, setting.value)
    depths = [float(knee[0])]
    with stopwatch() as watch:
        for duration, load in samples:
            depths.append(tick(knee, function, duration, load))
    return Outcome(np.array(depths), watch.seconds)


def loop(tool: str, method: str | int, problem: Problem, setting: Setting) -> Outcome:
    """Solve the problem with one call for all samples, each of which is looked at when its tick comes."""
    all_ticks, function = ticker(tool, method).loop, tick_address(tool, problem)
    durations, loads = np.diff(problem.time), problem.load[1:].copy()
    depths = np.empty_like(problem.time)
    all_ticks(knee_of(problem, setting.value), function, durations[:1], loads[:1], depths[1:2])  # compiles
    knee = knee_of(problem, setting.value)
    depths[0] = knee[0]
    with stopwatch() as watch:
        all_ticks(knee, function, durations, loads, depths[1:])
    return Outcome(depths, watch.seconds)


@functools.cache
def ticker(tool: str, method: str | int) -> Ticker:
    """Compile both forms of a tool's method that solve tick after tick."""
    advance = module_of(tool).advance

    @njit
    def tick(knee: Any, function: int, duration: float, load: float) -> float:
        numbers = knee[NUMBERS:]
        set_ramp(numbers, knee[LOAD], (load - knee[LOAD]) / duration)
        knee[SPAN + 1], knee[LOAD] = duration, load
        moved = advance(method, function, knee[:SPAN], knee[SPAN:LOAD], numbers, knee[RTOL], knee[ATOL])
        return knee[0] if moved else np.nan

    @njit
    def loop(knee: Any, function: int, durations: Any, loads: Any, depths: Any) -> None:
        for i in range(len(durations)):
            depths[i] = tick(knee, function, durations[i], loads[i])

    return Ticker(tick, loop)


def knee_of(problem: Problem, tolerance: float) -> Knee:
    """The knee at rest under the first load, with a relative tolerance."""
    numbers = motions(problem).tick_numbers
    head = start_depth(problem), 0.0, 0.0, 0.0, problem.load[0], tolerance, tolerance * DEPTH_SCALE
    return np.concatenate([head, numbers])


def tick_address(tool: str, problem: Problem) -> int:
    """Address of the right-hand side over one tick, as a tool calls it."""
    return module_of(tool).callback(motions(problem).in_tick).address  # type: ignore[no-any-return]


def module_of(tool: str) -> Any:
    """Import the module of a tool."""
    return import_module(f"{__package__}.{tool}")
