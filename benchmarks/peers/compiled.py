"""The motion compiled by Numba, for tools that call a function by its address, and runs with such a tool.

A right-hand side finds all of its numbers in one array: the law's (`LAW` of them), then the load's. Its state is the
depth [m] and its rate [m/s] times `RATE_UNIT` [s], so that one absolute tolerance [m] fits both.

A tool is a module of this folder with the functions `callback`, `series` and `advance`: `cyrk`, `numbalsoda`. A method
is what the tool's functions take as such: a name or a number.
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

from benchmarks.peers.measure import Outcome, Setting, Way, stopwatch
from benchmarks.peers.problems import DEPTH_SCALE, RATE_UNIT, Problem, start_depth

LAW = 7
"""The law's numbers: K, C, 1/M; of a second layer: its begin [m], the force there [N], K and C"""
HEAD = LAW + 3
"""The law's and the load's over a series: begin [s], ticks per second, last tick's index; then load and rise of each"""


@njit(inline="always")
def rates(rate: Any, depth: float, scaled: float, load: float, numbers: Any) -> None:
    """Fill in the rates of change [m/s] of the depth and of the scaled rate, with one layer; d^1.5 is d sqrt(d)."""
    speed = scaled / RATE_UNIT
    force = 0.0
    if depth > 0.0:
        force = max(numbers[0] * depth * np.sqrt(depth) + numbers[1] * speed, 0.0)
    rate[0] = speed
    rate[1] = (load - force) * numbers[2] * RATE_UNIT


@njit(inline="always")
def rates_in_layers(rate: Any, depth: float, scaled: float, load: float, numbers: Any) -> None:
    """Fill in the rates of change as `rates` does, with two layers."""
    speed = scaled / RATE_UNIT
    force = 0.0
    below = depth - numbers[3]
    if below > 0.0:
        force = max(numbers[4] + numbers[5] * below * np.sqrt(below) + numbers[6] * speed, 0.0)
    elif depth > 0.0:
        force = max(numbers[0] * depth * np.sqrt(depth) + numbers[1] * speed, 0.0)
    rate[0] = speed
    rate[1] = (load - force) * numbers[2] * RATE_UNIT


@njit(inline="always")
def load_in_tick(time: float, numbers: Any) -> float:
    """Load [N] at a time [s] since a tick's begin."""
    return numbers[LAW] + numbers[LAW + 1] * time  # type: ignore[no-any-return]


@njit(inline="always")
def set_ramp(numbers: Any, load: float, slope: float) -> None:
    """Set the load of a tick: its value [N] at the tick's begin and its slope [N/s]."""
    numbers[LAW] = load
    numbers[LAW + 1] = slope


@njit(inline="always")
def load_in_series(time: float, numbers: Any) -> float:
    """Load [N] at a time [s]: the ticks are evenly spaced, so that no search is needed."""
    ticks = (time - numbers[LAW]) * numbers[LAW + 1]
    i = min(max(int(ticks), 0), int(numbers[LAW + 2]))
    return numbers[HEAD + 2 * i] + numbers[HEAD + 2 * i + 1] * (ticks - i)  # type: ignore[no-any-return]


@njit
def series_numbers(stiffness: float, damping: float, mass: float, time: Any, load: Any) -> Any:
    """Numbers of a knee of one layer for a right-hand side over the whole series."""
    last = len(time) - 1
    numbers = np.zeros(HEAD + 2 * last)
    numbers[0] = stiffness
    numbers[1] = damping
    numbers[2] = 1.0 / mass
    numbers[LAW] = time[0]
    numbers[LAW + 1] = last / (time[last] - time[0])
    numbers[LAW + 2] = last - 1
    for i in range(last):
        numbers[HEAD + 2 * i], numbers[HEAD + 2 * i + 1] = load[i], load[i + 1] - load[i]
    return numbers


@njit
def tick_numbers(stiffness: float, damping: float, mass: float) -> Any:
    """Numbers of a knee of one layer for a right-hand side over one tick; `set_ramp` adds each tick's load."""
    numbers = np.zeros(LAW + 2)
    numbers[0] = stiffness
    numbers[1] = damping
    numbers[2] = 1.0 / mass
    return numbers


@njit
def in_tick(rate: Any, time: float, state: Any, numbers: Any) -> None:
    """Right-hand side over a tick with one layer; times [s] count from the tick's begin."""
    rates(rate, state[0], state[1], load_in_tick(time, numbers), numbers)


@njit
def in_tick_in_layers(rate: Any, time: float, state: Any, numbers: Any) -> None:
    """Right-hand side over a tick with two layers; times [s] count from the tick's begin."""
    rates_in_layers(rate, state[0], state[1], load_in_tick(time, numbers), numbers)


@njit
def in_series(rate: Any, time: float, state: Any, numbers: Any) -> None:
    """Right-hand side over the series with one layer."""
    rates(rate, state[0], state[1], load_in_series(time, numbers), numbers)


@njit
def in_series_in_layers(rate: Any, time: float, state: Any, numbers: Any) -> None:
    """Right-hand side over the series with two layers."""
    rates_in_layers(rate, state[0], state[1], load_in_series(time, numbers), numbers)


class Motions(NamedTuple):
    """Right-hand sides of a problem, over a tick and over the series, and their numbers.

    Each is compiled and called as `f(rate, time, state, numbers)`.
    """

    in_tick: Any
    in_series: Any
    tick_numbers: NDArray[np.float64]
    series_numbers: NDArray[np.float64]


def motions(problem: Problem) -> Motions:
    """Choose the right-hand sides of a problem: with one layer they compute no second one."""
    knee = problem.stiffness, problem.first_damping, problem.mass
    tick = tick_numbers(*knee)
    series = series_numbers(*knee, problem.time, problem.load)
    if not problem.layered:
        return Motions(in_tick, in_series, tick, series)
    for numbers in (tick, series):
        numbers[3:LAW] = (
            problem.layer_depth,
            problem.layer_force,
            problem.stiffness_2,
            problem.damping,
        )
    return Motions(in_tick_in_layers, in_series_in_layers, tick, series)


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
    loop: Callable[
        [Knee, int, NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]], None
    ]
    """Knee, right-hand side, durations and loads of the ticks, and where their depths go"""


def modes(tool: str, method: str | int) -> tuple[Way, Way, Way]:
    """The runs of a tool's method in the order of the fields of `Solver`: whole series, stream, loop."""
    return tuple(functools.partial(run, tool, method) for run in (whole, stream, loop))  # type: ignore[return-value]


def whole(tool: str, method: str | int, problem: Problem, setting: Setting) -> Outcome:
    """Solve the problem in one call, with output at every tick."""
    return in_one_call(tool, method, problem, setting.value, setting.value * DEPTH_SCALE, math.inf)


def equal_steps(tool: str, method: str | int, problem: Problem, setting: Setting) -> Outcome:
    """Solve the problem in one call with a number of equal steps for every tick, without error control."""
    tick = (problem.time[-1] - problem.time[0]) / (len(problem.time) - 1)
    return in_one_call(tool, method, problem, ANYTHING, ANYTHING, tick / setting.value)


def in_one_call(
    tool: str, method: str | int, problem: Problem, rtol: float, atol: float, step: float
) -> Outcome:
    """Time one call over the series; `atol` and `step` are in [m] and [s]."""
    module = module_of(tool)
    motion = motions(problem)
    solve = module.series
    function = module.callback(motion.in_series).address
    state = np.array([start_depth(problem), 0.0])
    numbers = motion.series_numbers
    solve(method, function, state.copy(), problem.time[:3], numbers, rtol, atol, step)  # compiles
    with stopwatch() as watch:
        depths = solve(method, function, state, problem.time, numbers, rtol, atol, step)
    return Outcome(
        depths, watch.seconds, note="" if np.isfinite(depths).all() else "the solver gave up"
    )


def stream(tool: str, method: str | int, problem: Problem, setting: Setting) -> Outcome:
    """Solve the problem with a call from Python for every sample."""
    tick = ticker(tool, method).tick
    function = tick_address(tool, problem)
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
    all_ticks = ticker(tool, method).loop
    function = tick_address(tool, problem)
    durations = np.diff(problem.time)
    loads = problem.load[1:].copy()
    depths = np.empty_like(problem.time)
    all_ticks(
        knee_of(problem, setting.value), function, durations[:1], loads[:1], depths[1:2]
    )  # compiles
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
        knee[SPAN + 1] = duration
        knee[LOAD] = load
        moved = advance(
            method, function, knee[:SPAN], knee[SPAN:LOAD], numbers, knee[RTOL], knee[ATOL]
        )
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
