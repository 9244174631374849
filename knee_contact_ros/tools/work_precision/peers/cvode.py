"""SUNDIALS' CVODE through scikit-sundae."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.tools.work_precision.law import Load, contact_force, force_gradient, load_at
from knee_contact_ros.tools.work_precision.motion import Ramp, absolute_tolerances, ticks
from knee_contact_ros.tools.work_precision.problems import Problem
from knee_contact_ros.tools.work_precision.solver import Outcome, Run, Setting, Solver, stopwatch, tolerances
from knee_contact_ros.tools.work_precision.start import start_depth

LAW = (
    "exact: right-hand side and Jacobian in plain Python; one call with the load in tables, or one step to every tick, "
    "not beyond it and without a restart"
)
MOST_STEPS = 1_000_000
Vector = NDArray[np.float64]


def solvers() -> list[Solver]:
    """Both multistep methods."""
    return [
        Solver(f"CVODE {method}", "CVODE", LAW, tolerances(*range(4, 14)), whole(method), stream(method))
        for method in ("BDF", "Adams")
    ]


def whole(method: str) -> Run:
    """One call, output at every tick."""

    def run(problem: Problem, setting: Setting) -> Outcome:
        solver = make(problem, load_at(problem), method, setting)
        state = np.array([start_depth(problem), 0.0])
        with stopwatch() as watch:
            answer = solver.solve(problem.time, state)
        return Outcome(answer.y[:, 0], watch.seconds, answer.nfev, "" if answer.success else answer.message)

    return run


def stream(method: str) -> Run:
    """One step to every tick; `tstop` keeps the solver from looking beyond it."""

    def run(problem: Problem, setting: Setting) -> Outcome:
        ramp, depth, samples = Ramp(), start_depth(problem), ticks(problem)
        ramp.set(samples[0])
        solver, depths, evaluations = make(problem, ramp, method, setting), [depth], math.nan
        with stopwatch() as watch:
            solver.init_step(samples[0].begin, np.array([depth, 0.0]))
            for tick in samples:
                ramp.set(tick)
                answer = solver.step(tick.end, tstop=tick.end)
                depths.append(float(answer.y[0]))
            evaluations = answer.nfev
        return Outcome(np.array(depths), watch.seconds, evaluations)

    return run


def make(problem: Problem, load: Load, method: str, setting: Setting) -> Any:
    """The solver with the problem in it."""
    from sksundae.cvode import CVODE

    return CVODE(
        right_hand_side(problem, load),
        method=method,
        rtol=setting.value,
        atol=np.array(absolute_tolerances(setting.value)),
        jacfn=derivative(problem),
        max_num_steps=MOST_STEPS,
    )


def right_hand_side(problem: Problem, load: Load) -> Callable[[float, Vector, Vector], None]:
    """Fills the state's rate of change."""
    force, inverse_mass = contact_force(problem), 1.0 / problem.mass

    def motion(time: float, state: Vector, change: Vector) -> None:
        depth, rate = state.tolist()
        change[0] = rate
        change[1] = (load(time) - force(depth, rate)) * inverse_mass

    return motion


def derivative(problem: Problem) -> Callable[[float, Vector, Vector, Vector], None]:
    """Fills the Jacobian."""
    gradient, inverse_mass = force_gradient(problem), 1.0 / problem.mass

    def jacobian(_time: float, state: Vector, _change: Vector, matrix: Vector) -> None:
        by_depth, by_rate = gradient(*state.tolist())
        matrix[0, 0], matrix[0, 1] = 0.0, 1.0
        matrix[1, 0], matrix[1, 1] = -by_depth * inverse_mass, -by_rate * inverse_mass

    return jacobian
