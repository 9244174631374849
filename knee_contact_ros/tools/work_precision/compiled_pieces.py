"""The motion cut at every event of the law, compiled by Numba, for tools that stop at events in compiled code.

`piecewise.py` has the same in plain Python. A run has two places behind the numbers of `compiled_motion.py`: the piece,
and the time [s] at which it began.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from knee_contact_ros.tools.work_precision.compiled_motion import HEAD, LAW, load_in_series
from knee_contact_ros.tools.work_precision.motion import RATE_UNIT

APART, FIRST, SECOND, PULLED_FIRST, PULLED_SECOND = 0, 1, 2, 3, 4
"""No overlap; in a layer, where the formula pushes; where it would pull, and the force is 0"""
TOUCH, LAYER, PULL = 0, 1, 2
"""Ends of pieces"""
INSIDE = 1e-30
"""What an end's value is where a piece begins on it"""


@njit(inline="always")
def place(numbers: Any) -> int:
    """Of the piece, behind the loads."""
    return HEAD + 2 * (int(numbers[LAW + 2]) + 1)


@njit(inline="always")
def formula(second: bool, depth: float, scaled: float, numbers: Any) -> float:
    """A layer's force [N] without the clamp."""
    below = depth - numbers[3] if second else depth
    spring = below * np.sqrt(below) if below > 0.0 else 0.0
    speed = scaled / RATE_UNIT
    if second:
        return numbers[4] + numbers[5] * spring + numbers[6] * speed  # type: ignore[no-any-return]
    return numbers[0] * spring + numbers[1] * speed  # type: ignore[no-any-return]


@njit
def in_piece(rate: Any, time: float, state: Any, numbers: Any) -> None:
    """Right-hand side over the series within a piece."""
    piece, force = int(numbers[place(numbers)]), 0.0
    if piece in (FIRST, SECOND):
        force = formula(piece == SECOND, state[0], state[1], numbers)
    rate[0] = state[1] / RATE_UNIT
    rate[1] = (load_in_series(time, numbers) - force) * numbers[2] * RATE_UNIT


@njit
def ends(values: Any, time: float, state: Any, numbers: Any) -> None:
    """What ends a piece where it passes through 0: all are positive within it."""
    here, depth = place(numbers), state[0]
    piece = int(numbers[here])
    values[TOUCH], values[LAYER], values[PULL] = 1.0, 1.0, 1.0
    if piece == APART:
        values[TOUCH] = -depth
    else:
        second = piece in (SECOND, PULLED_SECOND)
        if second:
            values[LAYER] = depth - numbers[3]
        else:
            values[TOUCH] = depth
            values[LAYER] = min(numbers[3] - depth, 1.0)
        force = formula(second, depth, state[1], numbers)
        values[PULL] = force if piece in (FIRST, SECOND) else -force
    if time <= numbers[here + 1]:
        for i in range(3):
            values[i] = max(values[i], INSIDE)


@njit
def behind(piece: int, end: int, state: Any, numbers: Any) -> int:
    """The piece behind an end."""
    if end == TOUCH and piece != APART:
        return APART
    second = piece in (SECOND, PULLED_SECOND)
    if end == LAYER:
        second = not second
    pushes = formula(second, state[0], state[1], numbers) >= 0.0
    if end == PULL:
        pushes = piece in (PULLED_FIRST, PULLED_SECOND)
    if second:
        return SECOND if pushes else PULLED_SECOND
    return FIRST if pushes else PULLED_FIRST
