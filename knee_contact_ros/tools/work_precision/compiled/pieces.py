"""numbalsoda's `solve_ivp` along the motion cut at every event of the law, compiled by Numba.

`piecewise.py` has the same pieces in plain Python. A run has two places behind the numbers of `motion.py`: the piece,
and the time [s] at which it began.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import cfunc, njit, types
from numbalsoda import lsoda_sig, solve_ivp

from knee_contact_ros.tools.work_precision.compiled.motion import HEAD, LAW, load_in_series
from knee_contact_ros.tools.work_precision.motion import RATE_UNIT

APART, FIRST, SECOND, PULLED_FIRST, PULLED_SECOND = 0, 1, 2, 3, 4
"""No overlap; in a layer, where the formula pushes; where it would pull, and the force is 0"""
TOUCH, LAYER, PULL = 0, 1, 2
"""Ends of pieces"""
INSIDE = 1e-30
"""What an end's value is where a piece begins on it"""
MOST_EVENTS = 10_000


@njit(inline="always")
def place(numbers: Any) -> int:
    """Index of the piece among the numbers, behind the loads."""
    return HEAD + 2 * (int(numbers[LAW + 2]) + 1)


@njit(inline="always")
def formula(second: bool, depth: float, scaled: float, numbers: Any) -> float:
    """Force [N] of the first or second layer without the clamp at 0."""
    below = depth - numbers[3] if second else depth
    spring = below * np.sqrt(below) if below > 0.0 else 0.0
    speed = scaled / RATE_UNIT
    if second:
        return numbers[4] + numbers[5] * spring + numbers[6] * speed  # type: ignore[no-any-return]
    return numbers[0] * spring + numbers[1] * speed  # type: ignore[no-any-return]


@cfunc(lsoda_sig)
def in_piece(time: float, state: Any, rate: Any, numbers: Any) -> None:
    """Fill in the rates of change over the series within a piece."""
    piece, force = int(numbers[place(numbers)]), 0.0
    if piece in (FIRST, SECOND):
        force = formula(piece == SECOND, state[0], state[1], numbers)
    rate[0] = state[1] / RATE_UNIT
    rate[1] = (load_in_series(time, numbers) - force) * numbers[2] * RATE_UNIT


@cfunc(types.void(types.double, *[types.CPointer(types.double)] * 3))
def ends(time: float, state: Any, values: Any, numbers: Any) -> None:
    """Fill in the values that end a piece where they pass through 0; all are positive within it."""
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
    """The piece behind an end, at a state on it."""
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


IN_PIECE, ENDS = in_piece.address, ends.address


@njit
def solve(piece: int, state: Any, time: Any, numbers: Any, rtol: float, atol: float) -> Any:
    """Depth [m] at every stamp [s] of a run that begins in a piece; nan where the run did not get."""
    depths, here, done = np.full(len(time), np.nan), place(numbers), 1
    depths[0] = state[0]
    span = np.array([time[0], time[-1]])
    for _ in range(MOST_EVENTS):
        numbers[here], numbers[here + 1] = piece, span[0]
        answer = solve_ivp(IN_PIECE, span, state, time[done:], n_events=3, event_fcn=ENDS, data=numbers.ctypes.data,
                           rtol=rtol, atol=atol)  # fmt: skip
        if not answer.success:
            break
        count = len(answer.t)
        depths[done : done + count] = answer.y[:, 0]
        done += count
        if not answer.event_found or done >= len(time):
            break
        state, span[0] = answer.y_event.copy(), answer.t_event
        piece = behind(piece, answer.ind_event, state, numbers)
    return depths
