"""CyRK: solvers in C++ (`nbsolve2_ivp`), called in functions that Numba compiles; a method is its name in CyRK."""

from __future__ import annotations

import functools
from functools import partial
from typing import Any

import numpy as np
from CyRK.nb.numba_solver import cyjit, nbsolve2_ivp
from numba import njit

from benchmarks.peers.compiled import equal_steps, modes
from benchmarks.peers.measure import Solver, half_decades, steps_per_tick


@functools.cache
def callback(motion: Any) -> Any:
    """Compile a right-hand side `f(rate, time, state, numbers)` to the C function that CyRK calls by its `address`."""

    @cyjit
    def function(rate: Any, time: float, state: Any, numbers: Any) -> None:
        motion(rate, time, state, numbers)

    return function


@njit
def series(
    method: str,
    function: int,
    state: Any,
    time: Any,
    numbers: Any,
    rtol: float,
    atol: float,
    step: float,
) -> Any:
    """Depth [m] at every stamp [s] of a run over a whole series; all are nan if the solver fails.

    A finite `step` [s] is the size of the first step and of the largest one allowed.
    """
    answer = nbsolve2_ivp(
        function,
        (time[0], time[-1]),
        state,
        method=method,
        t_eval=time,
        args=numbers,
        rtol=rtol,
        atol=atol,
        max_step=step,
        first_step=step if step < np.inf else 0.0,
        force_retain_solver=False,
    )
    depths = np.full(len(time), np.nan)
    if answer.size == len(time):
        depths[:] = answer.y[0]
    answer.free()
    return depths


@njit
def advance(
    method: str, function: int, state: Any, span: Any, numbers: Any, rtol: float, atol: float
) -> bool:
    """Move a state on in place from `span[0]` (0) to `span[1]` [s]; return whether the solver could."""
    # CyRK refuses a first step beyond half the span
    answer = nbsolve2_ivp(
        function,
        (span[0], span[1]),
        state,
        method=method,
        args=numbers,
        rtol=rtol,
        atol=atol,
        first_step=0.5 * span[1],
        expected_size=8,
        force_retain_solver=False,
    )
    reached = answer.success
    if reached:
        state[0] = answer.y[0, answer.size - 1]
        state[1] = answer.y[1, answer.size - 1]
    answer.free()
    return reached  # type: ignore[no-any-return]


LAW = (
    "exact: right-hand side compiled by Numba, called by its address; one `nbsolve2_ivp` with the load found by index, "
    "or one per tick in a compiled function, which Python calls for every sample or a compiled loop for all of them"
)
EQUAL = "exact: the same with steps of equal size, without error control, over the whole series"
METHODS = ("RK45", "Tsit5", "DOP853", "Vern7", "LSODA", "RADAU")
EQUAL_STEPS = ("RK45", "DOP853")


def solvers() -> list[Solver]:
    """One solver per method, and two with equal steps; `nbsolve_ivp`, in Numba itself, is slower than these."""
    settings = half_decades(3, 13)
    counts = steps_per_tick(1, 2, 3, 4, 6, 10, 20, 50, 100)
    return [
        *(
            Solver(f"CyRK {method}", "CyRK", LAW, settings, *modes("cyrk", method))
            for method in METHODS
        ),
        *(
            Solver(
                f"CyRK {method}, equal steps",
                "CyRK",
                EQUAL,
                counts,
                partial(equal_steps, "cyrk", method),
                None,
            )
            for method in EQUAL_STEPS
        ),
    ]
