"""The motion compiled by Numba, for tools that call a function by its address: the law and the load, in one place.

A right-hand side finds all of its numbers in one array: the law's (`LAW` of them), then the load's. Its state is the
depth [m] and its rate [m/s] times `RATE_UNIT` [s], so that one absolute tolerance [m] fits both.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from knee_contact_ros.tools.work_precision.motion import RATE_UNIT
from knee_contact_ros.tools.work_precision.problems import Problem

LAW = 7
"""The law's numbers: K, C, 1/M; of a second layer: its begin [m], the force there [N], K and C"""
HEAD = LAW + 3
"""The law's and the load's over a series: begin [s], ticks per second, last tick's index; then load and rise of each"""


@njit(inline="always")
def rates(rate: Any, depth: float, scaled: float, load: float, numbers: Any) -> None:
    """Fill in the rates of change [m/s] of the depth and of the scaled rate, with one layer; d^1.5 is d sqrt(d)."""
    speed, force = scaled / RATE_UNIT, 0.0
    if depth > 0.0:
        force = max(numbers[0] * depth * np.sqrt(depth) + numbers[1] * speed, 0.0)
    rate[0] = speed
    rate[1] = (load - force) * numbers[2] * RATE_UNIT


@njit(inline="always")
def rates_in_layers(rate: Any, depth: float, scaled: float, load: float, numbers: Any) -> None:
    """Fill in the rates of change as `rates` does, with two layers."""
    speed, force, below = scaled / RATE_UNIT, 0.0, depth - numbers[3]
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
    numbers[LAW], numbers[LAW + 1] = load, slope


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
    numbers[0], numbers[1], numbers[2] = stiffness, damping, 1.0 / mass
    numbers[LAW], numbers[LAW + 1], numbers[LAW + 2] = time[0], last / (time[last] - time[0]), last - 1
    for i in range(last):
        numbers[HEAD + 2 * i], numbers[HEAD + 2 * i + 1] = load[i], load[i + 1] - load[i]
    return numbers


@njit
def tick_numbers(stiffness: float, damping: float, mass: float) -> Any:
    """Numbers of a knee of one layer for a right-hand side over one tick; `set_ramp` adds each tick's load."""
    numbers = np.zeros(LAW + 2)
    numbers[0], numbers[1], numbers[2] = stiffness, damping, 1.0 / mass
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
    tick, series = tick_numbers(*knee), series_numbers(*knee, problem.time, problem.load)
    if not problem.layered:
        return Motions(in_tick, in_series, tick, series)
    for numbers in (tick, series):
        numbers[3:LAW] = problem.layer_depth, problem.layer_force, problem.stiffness_2, problem.damping
    return Motions(in_tick_in_layers, in_series_in_layers, tick, series)
