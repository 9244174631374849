"""SUNDIALS' CVODE through scikit-sundae."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.peers.measure import Outcome, Setting, Solver, stopwatch, tolerances
from benchmarks.peers.motion import (
    Load,
    Ramp,
    absolute_tolerances,
    contact_force,
    force_gradient,
    load_at,
    ticks,
)
from benchmarks.peers.problems import Problem, start_depth

LAW = (
    "exact: right-hand side and Jacobian in plain Python; one call with the load in tables, or one step to every tick, "
    "not beyond it and without a restart"
)
MOST_STEPS = 1_000_000
Vector = NDArray[np.float64]


def solvers() -> list[Solver]:
    """One solver for each of the two multistep methods."""
    return [
        Solver(f"CVODE {method}", "CVODE", LAW, tolerances(*range(4, 14)), partial(whole, method),
               partial(stream, method))
        for method in ("BDF", "Adams")
    ]  # fmt: skip


def whole(method: str, problem: Problem, setting: Setting) -> Outcome:
    """Solve the problem in one call, with output at every tick."""
    solver = make(problem, load_at(problem), method, setting)
    state = np.array([start_depth(problem), 0.0])
    with stopwatch() as watch:
        answer = solver.solve(problem.time, state)
    return Outcome(answer.y[:, 0], watch.seconds, answer.nfev, "" if answer.success else answer.message)


def stream(method: str, problem: Problem, setting: Setting) -> Outcome:
    """Solve the problem with one step to every tick; `tstop` keeps the solver from looking beyond it."""
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


def make(problem: Problem, load: Load, method: str, setting: Setting) -> Any:
    """Build the solver of a problem under a load."""
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
    """Build the function that fills in the state's rate of change [m/s, m/s^2]."""
    force, inverse_mass = contact_force(problem), 1.0 / problem.mass

    def motion(time: float, state: Vector, change: Vector) -> None:
        depth, rate = state.tolist()
        change[0] = rate
        change[1] = (load(time) - force(depth, rate)) * inverse_mass

    return motion


def derivative(problem: Problem) -> Callable[[float, Vector, Vector, Vector], None]:
    """Build the function that fills in the Jacobian."""
    gradient, inverse_mass = force_gradient(problem), 1.0 / problem.mass

    def jacobian(_time: float, state: Vector, _change: Vector, matrix: Vector) -> None:
        by_depth, by_rate = gradient(*state.tolist())
        matrix[0, 0], matrix[0, 1] = 0.0, 1.0
        matrix[1, 0], matrix[1, 1] = -by_depth * inverse_mass, -by_rate * inverse_mass

    return jacobian
