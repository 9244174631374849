"""SciPy: `solve_ivp` and the solver objects behind it; the motion is in plain Python, as by a user."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from benchmarks.peers.measure import Outcome, Setting, Solver, stopwatch, tolerances
from benchmarks.peers.problems import DEPTH_SCALE, EXPONENT, RATE_SCALE, Problem, start_depth

Force = Callable[[float, float], float]
"""Force [N], never below 0, as a function of depth [m] and rate of the depth [m/s]"""
Gradient = Callable[[float, float], tuple[float, float]]
"""Derivatives of the force by depth [N/m] and by rate [N s/m], as a function of both"""
Load = Callable[[float], float]
"""Load [N] as a function of time [s]"""
State = Sequence[float]
Motion = Callable[[float, State], tuple[float, float]]
Matrix = list[list[float]]
Jacobian = Callable[[float, State], Matrix]


def contact_force(problem: Problem) -> Force:
    """Build the contact law of a problem: 0 N when apart, and 0 N where the formula would pull."""
    stiffness = problem.stiffness
    damping = problem.damping

    def one_layer(depth: float, rate: float) -> float:
        if depth <= 0.0:
            return 0.0
        force = stiffness * depth**EXPONENT + damping * rate
        return force if force > 0.0 else 0.0

    if not problem.layered:
        return one_layer
    begin = problem.layer_depth
    base = problem.layer_force
    stiffness_2 = problem.stiffness_2
    damping_1 = problem.first_damping

    def two_layers(depth: float, rate: float) -> float:
        if depth <= 0.0:
            return 0.0
        if depth <= begin:
            force = stiffness * depth**EXPONENT + damping_1 * rate
        else:
            force = base + stiffness_2 * (depth - begin) ** EXPONENT + damping * rate
        return force if force > 0.0 else 0.0

    return two_layers


def force_gradient(problem: Problem) -> Gradient:
    """Build the derivatives of the contact law of a problem; they are 0 where the force is 0."""
    force = contact_force(problem)
    begin = problem.layer_depth
    damping_1 = problem.first_damping
    damping = problem.damping
    slope_1 = EXPONENT * problem.stiffness
    slope_2 = EXPONENT * problem.stiffness_2
    power = EXPONENT - 1.0

    def gradient(depth: float, rate: float) -> tuple[float, float]:
        if force(depth, rate) <= 0.0:
            return 0.0, 0.0
        if depth <= begin:
            return slope_1 * depth**power, damping_1
        return slope_2 * (depth - begin) ** power, damping

    return gradient


def load_at(problem: Problem) -> Load:
    """Build the load at any time: linear between the ticks, from tables."""
    times: list[float] = problem.time.tolist()
    loads: list[float] = problem.load.tolist()
    slopes: list[float] = (np.diff(problem.load) / np.diff(problem.time)).tolist()
    last = len(slopes) - 1

    def load(time: float) -> float:
        i = bisect_right(times, time) - 1
        i = 0 if i < 0 else last if i > last else i
        return loads[i] + slopes[i] * (time - times[i])

    return load


def absolute_tolerances(tolerance: float) -> list[float]:
    """Absolute tolerances of depth [m] and rate [m/s], from a relative one."""
    return [tolerance * DEPTH_SCALE, tolerance * RATE_SCALE]


def motion(problem: Problem, load: Load) -> Motion:
    """Build the right-hand side of a problem under a load."""
    force = contact_force(problem)
    inverse_mass = 1.0 / problem.mass

    def right_hand_side(time: float, state: State) -> tuple[float, float]:
        depth, rate = state
        return rate, (load(time) - force(depth, rate)) * inverse_mass

    return right_hand_side


def jacobian(problem: Problem) -> Jacobian:
    """Build the derivative of the right-hand side of a problem by the state."""
    gradient = force_gradient(problem)
    inverse_mass = 1.0 / problem.mass

    def derivative(_time: float, state: State) -> Matrix:
        by_depth, by_rate = gradient(state[0], state[1])
        return [[0.0, 1.0], [-by_depth * inverse_mass, -by_rate * inverse_mass]]

    return derivative


class Ramp:
    """A load that knows the current tick only, for streaming solvers."""

    def __init__(self) -> None:
        self._begin = 0.0
        self._load = 0.0
        self._slope = 0.0

    def set(self, tick: Tick) -> None:
        """Set the load to run from a tick's first load to its last."""
        self._begin = tick.begin
        self._load = tick.start_load
        self._slope = (tick.end_load - tick.start_load) / (tick.end - tick.begin)

    def __call__(self, time: float) -> float:
        """The load [N] at a time [s]."""
        return self._load + self._slope * (time - self._begin)


class Tick(NamedTuple):
    """The interval from one sample to the next."""

    begin: float
    end: float
    """[s]"""
    start_load: float
    end_load: float
    """[N]"""


def ticks(problem: Problem) -> list[Tick]:
    """Ticks of a problem, length n - 1."""
    times = problem.time.tolist()
    loads = problem.load.tolist()
    return [Tick(*row) for row in zip(times, times[1:], loads, loads[1:], strict=False)]


IVP = "exact: right-hand side in plain Python{}; one call with the load in tables, or a fresh solver for every tick"
METHODS = ("LSODA", "Radau", "DOP853", "RK45")
IMPLICIT = ("LSODA", "Radau")


def solvers() -> list[Solver]:
    """One solver per method of `solve_ivp`."""
    return [
        Solver(
            f"SciPy {method}",
            "SciPy",
            IVP.format(" with its Jacobian" if method in IMPLICIT else ""),
            tolerances(*range(4, 14)),
            partial(whole, method),
            partial(stream, method),
        )
        for method in METHODS
    ]


def whole(method: str, problem: Problem, setting: Setting) -> Outcome:
    """Solve the problem by `solve_ivp` with output at every tick."""
    from scipy.integrate import solve_ivp

    function = motion(problem, load_at(problem))
    state = [start_depth(problem), 0.0]
    time = problem.time
    options = options_of(problem, method, setting.value)
    with stopwatch() as watch:
        answer = solve_ivp(
            function, (time[0], time[-1]), state, method=method, t_eval=time, **options
        )
    return Outcome(
        answer.y[0], watch.seconds, answer.nfev, "" if answer.success else answer.message
    )


def stream(method: str, problem: Problem, setting: Setting) -> Outcome:
    """Solve the problem with a solver object per tick, which begins with the last step of the one before."""
    from scipy import integrate

    make: Callable[..., Any] = getattr(integrate, method)
    ramp = Ramp()
    state = np.array([start_depth(problem), 0.0])
    depths = [start_depth(problem)]
    evaluations = 0
    function = motion(problem, ramp)
    options = options_of(problem, method, setting.value)
    step = None
    samples = ticks(problem)
    with stopwatch() as watch:
        for tick in samples:
            ramp.set(tick)
            first = None if step is None else min(step, tick.end - tick.begin)
            solver = make(function, tick.begin, state, tick.end, first_step=first, **options)
            while solver.status == "running":
                solver.step()
            state = solver.y
            step = solver.step_size or None
            evaluations += solver.nfev
            depths.append(float(state[0]))
    return Outcome(np.array(depths), watch.seconds, evaluations)


def options_of(problem: Problem, method: str, tolerance: float) -> dict[str, Any]:
    """Options of a method: tolerances, and the Jacobian if it takes one."""
    options: dict[str, Any] = {"rtol": tolerance, "atol": absolute_tolerances(tolerance)}
    return options | ({"jac": jacobian(problem)} if method in IMPLICIT else {})
