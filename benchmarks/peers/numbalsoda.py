"""numbalsoda: LSODA in C++ and DOP853 in Fortran, called in functions that Numba compiles.

A method is its index in `METHODS`. Its `solve_ivp` also stops at every event of the law (touch, layer, pull): such a
run has two places behind the numbers of `compiled.py`, the piece and the time [s] at which it began. `motion.py` has
the same pieces in plain Python.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numba import cfunc, njit, types
from numbalsoda import dop853, lsoda, lsoda_sig, solve_ivp

from benchmarks.peers.compiled import HEAD, LAW, load_in_series, modes, motions
from benchmarks.peers.measure import Outcome, Setting, Solver, half_decades, stopwatch
from benchmarks.peers.motion import DEPTH_SCALE, RATE_UNIT
from benchmarks.peers.problems import Problem, start_depth

METHODS = ("LSODA", "DOP853")
MOST_STEPS = 1_000_000


@functools.cache
def callback(motion: Any) -> Any:
    """Compile a right-hand side `f(rate, time, state, numbers)` to the C function called by its `address`."""

    @cfunc(lsoda_sig)
    def function(time: float, state: Any, rate: Any, numbers: Any) -> None:
        motion(rate, time, state, numbers)

    return function


@njit(inline="always")
def solved(method: int, function: int, state: Any, time: Any, numbers: Any, rtol: float, atol: float) -> Any:
    """States at the stamps [s], and whether the last one is reached."""
    if method == 0:
        return lsoda(function, state, time, numbers, rtol, atol, MOST_STEPS)
    return dop853(function, state, time, numbers, rtol, atol, MOST_STEPS)


@njit
def series(
    method: int, function: int, state: Any, time: Any, numbers: Any, rtol: float, atol: float, _step: float
) -> Any:
    """Depth [m] at every stamp [s] of a run over a whole series; all are nan if the solver fails."""
    states, reached = solved(method, function, state, time, numbers, rtol, atol)
    return states[:, 0] if reached else np.full(len(time), np.nan)


@njit
def advance(method: int, function: int, state: Any, span: Any, numbers: Any, rtol: float, atol: float) -> bool:
    """Move a state on in place from `span[0]` (0) to `span[1]` [s]; return whether the solver could."""
    states, reached = solved(method, function, state, span, numbers, rtol, atol)
    state[0], state[1] = states[1, 0], states[1, 1]
    return reached  # type: ignore[no-any-return]


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
def along_pieces(piece: int, state: Any, time: Any, numbers: Any, rtol: float, atol: float) -> Any:
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


EXACT = (
    "exact: right-hand side compiled by Numba, called by its address; one call with the load found by index, or one "
    "call per tick in a compiled function, which Python calls for every sample or a compiled loop for all of them"
)
BY_PIECES = (
    "exact: one smooth right-hand side per piece of the law, compiled by Numba, and `event_fcn` for their ends; one "
    "`solve_ivp` per piece in a compiled loop; not tick by tick, where a call takes 5 µs by itself"
)


def solvers() -> list[Solver]:
    """One solver per method, and one that stops at events."""
    settings = half_decades(3, 13)
    plain = [
        Solver(f"numbalsoda {name}", "numbalsoda", EXACT, settings, *modes("numbalsoda", number))
        for number, name in enumerate(METHODS)
    ]
    return [*plain, Solver("numbalsoda DOP853, events", "numbalsoda", BY_PIECES, settings, with_events, None)]


def with_events(problem: Problem, setting: Setting) -> Outcome:
    """Solve the problem with one call per piece of the law and output at every tick."""
    depth, tolerances = start_depth(problem), (setting.value, setting.value * DEPTH_SCALE)
    numbers = np.append(motions(problem).series_numbers, (0.0, 0.0))
    numbers[3] = problem.layer_depth
    piece = FIRST if depth <= problem.layer_depth else SECOND
    along_pieces(piece, np.array([depth, 0.0]), problem.time[:3], numbers, *tolerances)  # compiles
    state = np.array([depth, 0.0])
    with stopwatch() as watch:
        depths = along_pieces(piece, state, problem.time, numbers, *tolerances)
    return Outcome(depths, watch.seconds)
