"""CyRK's solvers inside a loop compiled by Numba: those in C++ (`nbsolve2_ivp`) and those in Numba (`nbsolve_ivp`)."""

from __future__ import annotations

from typing import Any

import numpy as np
from CyRK import nbsolve_ivp
from numba import njit

from benchmarks.peers.compiled import in_series, in_tick
from benchmarks.peers.cyrk import advance, callback, series
from studies.cohorts.method import Method
from studies.cohorts.peers.compiled_loop import described, tick_by_tick, whole_series

TOOL = "CyRK"
EXPLICIT = ("RK45", "Tsit5", "DOP853", "Vern7", "Vern8")
IMPLICIT = ("LSODA", "RADAU", "BDF")
IN_NUMBA = {"RK45": 1, "DOP853": 2}


def methods() -> list[Method]:
    """List all solvers, over the series and anew in every tick, the explicit ones with equal steps, and Numba's."""
    whole = whole_series(series, callback(in_series).address)
    anew, anew_in_numba = tick_by_tick(advance, callback(in_tick).address), tick_by_tick(advance_in_numba, 0)
    found = [
        described(TOOL, f"{solver}, {how}", loop, solver)
        for solver in (*EXPLICIT, *IMPLICIT)
        for how, loop in (("whole series", whole), ("tick by tick", anew))
    ]
    found += [described(TOOL, f"{solver}, equal steps", whole, solver) for solver in EXPLICIT]
    return found + [
        described(TOOL, f"{solver} in Numba, tick by tick", anew_in_numba, number)
        for solver, number in IN_NUMBA.items()
    ]


@njit
def _motion(time: float, state: Any, numbers: Any) -> Any:
    rate = np.empty(2)
    in_tick(rate, time, state, numbers)
    return rate


@njit
def advance_in_numba(
    solver: int, _function: int, state: Any, span: Any, numbers: Any, rtol: float, atol: float
) -> bool:
    """Move a state on as `compiled.cyrk.advance` does, by `nbsolve_ivp`, which takes no address of a motion."""
    answer = nbsolve_ivp(
        _motion, (span[0], span[1]), state, args=(numbers,), rtol=rtol, atol=atol, rk_method=solver,
        first_step=span[1], warnings=False,
    )  # fmt: skip
    if answer.success:
        state[0], state[1] = answer.y[0, -1], answer.y[1, -1]
    return answer.success  # type: ignore[no-any-return]
