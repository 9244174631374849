"""SciPy's `solve_ivp`; tick by tick the solver objects behind it, which cost less per call."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from knee_contact_ros.tools.work_precision.motion import Ramp, absolute_tolerances, jacobian, load_at, motion, ticks
from knee_contact_ros.tools.work_precision.problems import Problem
from knee_contact_ros.tools.work_precision.solver import Outcome, Setting, Solver, stopwatch, tolerances
from knee_contact_ros.tools.work_precision.start import start_depth

LAW = "exact: right-hand side in plain Python{}; one call with the load in tables, or a fresh solver for every tick"
METHODS = ("LSODA", "Radau", "DOP853", "RK45")
IMPLICIT = ("LSODA", "Radau")


def solvers() -> list[Solver]:
    """One solver per method."""
    return [
        Solver(
            f"SciPy {method}",
            "SciPy",
            LAW.format(" with its Jacobian" if method in IMPLICIT else ""),
            tolerances(*range(4, 14)),
            partial(whole, method),
            partial(stream, method),
        )
        for method in METHODS
    ]


def whole(method: str, problem: Problem, setting: Setting) -> Outcome:
    """Solve the problem by `solve_ivp` with output at every tick."""
    from scipy.integrate import solve_ivp

    function, state, time = motion(problem, load_at(problem)), [start_depth(problem), 0.0], problem.time
    options = options_of(problem, method, setting.value)
    with stopwatch() as watch:
        answer = solve_ivp(function, (time[0], time[-1]), state, method=method, t_eval=time, **options)
    return Outcome(answer.y[0], watch.seconds, answer.nfev, "" if answer.success else answer.message)


def stream(method: str, problem: Problem, setting: Setting) -> Outcome:
    """Solve the problem with a solver object per tick, which begins with the last step of the one before."""
    from scipy import integrate

    make: Callable[..., Any] = getattr(integrate, method)
    ramp, state, depths, evaluations = Ramp(), np.array([start_depth(problem), 0.0]), [start_depth(problem)], 0
    function, options, step = motion(problem, ramp), options_of(problem, method, setting.value), None
    samples = ticks(problem)
    with stopwatch() as watch:
        for tick in samples:
            ramp.set(tick)
            first = None if step is None else min(step, tick.end - tick.begin)
            solver = make(function, tick.begin, state, tick.end, first_step=first, **options)
            while solver.status == "running":
                solver.step()
            state, step = solver.y, solver.step_size or None
            evaluations += solver.nfev
            depths.append(float(state[0]))
    return Outcome(np.array(depths), watch.seconds, evaluations)


def options_of(problem: Problem, method: str, tolerance: float) -> dict[str, Any]:
    """Options of a method: tolerances, and the Jacobian if it takes one."""
    options: dict[str, Any] = {"rtol": tolerance, "atol": absolute_tolerances(tolerance)}
    return options | ({"jac": jacobian(problem)} if method in IMPLICIT else {})
