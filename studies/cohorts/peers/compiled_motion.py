"""The motion compiled by Numba, for tools that call a function by its address."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from studies.cohorts.method import RATE_UNIT

ONE_TICK = 5
"""Length of the numbers for a motion over one tick: K, C, 1/M, load [N] at its begin and the load's rate [N/s]"""
HEAD = 6
"""Of those over the whole series: K, C, 1/M, begin [s], ticks per second, last tick's index; then load and rise each"""


@njit(inline="always")
def rates(rate: Any, depth: float, scaled: float, load: float, numbers: Any) -> None:
    """Fill in the rates of change of depth [m] and of the scaled rate [m]; K d^1.5 as K d sqrt(d)."""
    speed, force = scaled / RATE_UNIT, 0.0
    if depth > 0.0:
        force = max(numbers[0] * depth * np.sqrt(depth) + numbers[1] * speed, 0.0)
    rate[0] = speed
    rate[1] = (load - force) * numbers[2] * RATE_UNIT


@njit(inline="always")
def load_in_tick(time: float, numbers: Any) -> float:
    """Load [N] at a time [s] since a tick's begin."""
    return numbers[3] + numbers[4] * time  # type: ignore[no-any-return]


@njit(inline="always")
def load_in_series(time: float, numbers: Any) -> float:
    """Load [N] at a time [s]: the ticks are evenly spaced, so that no search is needed."""
    ticks = (time - numbers[3]) * numbers[4]
    i = min(max(int(ticks), 0), int(numbers[5]))
    return numbers[HEAD + 2 * i] + numbers[HEAD + 2 * i + 1] * (ticks - i)  # type: ignore[no-any-return]


@njit
def series_numbers(stiffness: float, damping: float, mass: float, time: Any, load: Any) -> Any:
    """The numbers of a knee over the whole series."""
    last = len(time) - 1
    numbers = np.empty(HEAD + 2 * last)
    numbers[0], numbers[1], numbers[2] = stiffness, damping, 1.0 / mass
    numbers[3], numbers[4], numbers[5] = time[0], last / (time[last] - time[0]), last - 1
    for i in range(last):
        numbers[HEAD + 2 * i], numbers[HEAD + 2 * i + 1] = load[i], load[i + 1] - load[i]
    return numbers


@njit
def tick_numbers(stiffness: float, damping: float, mass: float) -> Any:
    """The numbers of a knee over one tick; the load's are filled in from tick to tick."""
    numbers = np.empty(ONE_TICK)
    numbers[0], numbers[1], numbers[2] = stiffness, damping, 1.0 / mass
    return numbers
