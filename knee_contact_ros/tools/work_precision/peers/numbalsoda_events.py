"""numbalsoda's `solve_ivp`, ended at every event of the law (touch, layer, pull) and started again behind it."""

from __future__ import annotations

import numpy as np

from knee_contact_ros.tools.work_precision.compiled.motion import motions
from knee_contact_ros.tools.work_precision.motion import DEPTH_SCALE
from knee_contact_ros.tools.work_precision.problems import Problem
from knee_contact_ros.tools.work_precision.solver import Outcome, Setting, Solver, half_decades, stopwatch
from knee_contact_ros.tools.work_precision.start import start_depth

LAW = (
    "exact: one smooth right-hand side per piece of the law, compiled by Numba, and `event_fcn` for their ends; one "
    "`solve_ivp` per piece in a compiled loop; not tick by tick, where a call takes 5 µs by itself"
)


def solvers() -> list[Solver]:
    """The one solver whose `solve_ivp` knows events."""
    return [Solver("numbalsoda DOP853, events", "numbalsoda", LAW, half_decades(3, 13), whole, None)]


def whole(problem: Problem, setting: Setting) -> Outcome:
    """Solve the problem with one call per piece of the law and output at every tick."""
    from knee_contact_ros.tools.work_precision.compiled.pieces import FIRST, SECOND, solve

    depth, tolerances = start_depth(problem), (setting.value, setting.value * DEPTH_SCALE)
    numbers = np.append(motions(problem).series_numbers, (0.0, 0.0))
    numbers[3] = problem.layer_depth
    piece = FIRST if depth <= problem.layer_depth else SECOND
    solve(piece, np.array([depth, 0.0]), problem.time[:3], numbers, *tolerances)  # compiles
    state = np.array([depth, 0.0])
    with stopwatch() as watch:
        depths = solve(piece, state, problem.time, numbers, *tolerances)
    return Outcome(depths, watch.seconds)
