"""numbalsoda: LSODA in C++ and DOP853 in Fortran, called in functions that Numba compiles.

A method is its index in `METHODS`.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numba import cfunc, njit
from numbalsoda import dop853, lsoda, lsoda_sig

from benchmarks.peers.compiled import modes
from benchmarks.peers.measure import Solver, half_decades

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
def solved(
    method: int, function: int, state: Any, time: Any, numbers: Any, rtol: float, atol: float
) -> Any:
    """States at the stamps [s], and whether the last one is reached."""
    if method == 0:
        return lsoda(function, state, time, numbers, rtol, atol, MOST_STEPS)
    return dop853(function, state, time, numbers, rtol, atol, MOST_STEPS)


@njit
def series(
    method: int,
    function: int,
    state: Any,
    time: Any,
    numbers: Any,
    rtol: float,
    atol: float,
    _step: float,
) -> Any:
    """Depth [m] at every stamp [s] of a run over a whole series; all are nan if the solver fails."""
    states, reached = solved(method, function, state, time, numbers, rtol, atol)
    return states[:, 0] if reached else np.full(len(time), np.nan)


@njit
def advance(
    method: int, function: int, state: Any, span: Any, numbers: Any, rtol: float, atol: float
) -> bool:
    """Move a state on in place from `span[0]` (0) to `span[1]` [s]; return whether the solver could."""
    states, reached = solved(method, function, state, span, numbers, rtol, atol)
    state[0] = states[1, 0]
    state[1] = states[1, 1]
    return reached  # type: ignore[no-any-return]


EXACT = (
    "exact: right-hand side compiled by Numba, called by its address; one call with the load found by index, or one "
    "call per tick in a compiled function, which Python calls for every sample or a compiled loop for all of them"
)


def solvers() -> list[Solver]:
    """One solver per method."""
    return [
        Solver(
            f"numbalsoda {name}",
            "numbalsoda",
            EXACT,
            half_decades(3, 13),
            *modes("numbalsoda", number),
        )
        for number, name in enumerate(METHODS)
    ]
