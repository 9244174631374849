"""numbalsoda's `solve_ivp`, ended at every event of the law (touch, layer, pull) and started again behind it."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from knee_contact_ros.tools.work_precision.motion import DEPTH_SCALE
from knee_contact_ros.tools.work_precision.problems import Problem
from knee_contact_ros.tools.work_precision.solver import Outcome, Setting, Solver, half_decades, stopwatch
from knee_contact_ros.tools.work_precision.start import start_depth

LAW = (
    "exact: one smooth right-hand side per piece of the law, compiled by Numba, and `event_fcn` for their ends; one "
    "`solve_ivp` per piece in a compiled loop; not tick by tick, where a call takes 5 µs by itself"
)
MOST_EVENTS = 10_000


def solvers() -> list[Solver]:
    """One."""
    return [Solver("numbalsoda DOP853, events", "numbalsoda", LAW, half_decades(3, 13), whole, None)]


def whole(problem: Problem, setting: Setting) -> Outcome:
    """One call per piece of the law, output at every tick."""
    from knee_contact_ros.tools.work_precision.compiled_motion import motions
    from knee_contact_ros.tools.work_precision.compiled_pieces import FIRST, SECOND

    solve = compiled()
    depth, tolerances = start_depth(problem), (setting.value, setting.value * DEPTH_SCALE)
    numbers = np.append(motions(problem).series_numbers, (0.0, 0.0))
    numbers[3] = problem.layer_depth
    piece = FIRST if depth <= problem.layer_depth else SECOND
    solve(piece, np.array([depth, 0.0]), problem.time[:3], numbers, *tolerances)  # compiles
    state = np.array([depth, 0.0])
    with stopwatch() as watch:
        depths = solve(piece, state, problem.time, numbers, *tolerances)
    return Outcome(depths, watch.seconds)


@functools.cache
def compiled() -> Any:
    """A run over a series, from piece, state, stamps, numbers and tolerances; what it does not reach is nan."""
    from numba import cfunc, njit, types
    from numbalsoda import lsoda_sig, solve_ivp

    from knee_contact_ros.tools.work_precision.compiled_pieces import behind, ends, in_piece, place

    @cfunc(lsoda_sig)
    def motion(time: float, state: Any, rate: Any, numbers: Any) -> None:
        in_piece(rate, time, state, numbers)

    @cfunc(types.void(types.double, *[types.CPointer(types.double)] * 3))
    def events(time: float, state: Any, values: Any, numbers: Any) -> None:
        ends(values, time, state, numbers)

    KEPT.extend((motion, events))
    motion_address, events_address = motion.address, events.address

    @njit
    def solve(piece: int, state: Any, time: Any, numbers: Any, rtol: float, atol: float) -> Any:
        depths, here, done = np.full(len(time), np.nan), place(numbers), 1
        depths[0] = state[0]
        span = np.array([time[0], time[-1]])
        for _ in range(MOST_EVENTS):
            numbers[here], numbers[here + 1] = piece, span[0]
            found = solve_ivp(motion_address, span, state, time[done:], n_events=3, event_fcn=events_address,
                              data=numbers.ctypes.data, rtol=rtol, atol=atol)  # fmt: skip
            if not found.success:
                break
            count = len(found.t)
            depths[done : done + count] = found.y[:, 0]
            done += count
            if not found.event_found or done >= len(time):
                break
            state, span[0] = found.y_event.copy(), found.t_event
            piece = behind(piece, found.ind_event, state, numbers)
        return depths

    return solve


KEPT: list[Any] = []
"""Compiled code that is called by address"""
