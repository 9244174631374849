"""The motion as first-order equations of the state (depth [m], rate [m/s]), for solvers that take a Python function."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from knee_contact_ros.tools.work_precision.law import Load, contact_force, force_gradient
from knee_contact_ros.tools.work_precision.problems import Problem

State = Sequence[float]
Motion = Callable[[float, State], tuple[float, float]]
Matrix = list[list[float]]
Jacobian = Callable[[float, State], Matrix]

DEPTH_SCALE, RATE_SCALE = 1e-3, 1e-1
"""Depth [m] and rate [m/s] to which absolute tolerances are relative: those that occur"""
RATE_UNIT = DEPTH_SCALE / RATE_SCALE
"""Time [s] that scales rates to depths, for tools that take one absolute tolerance for all of the state"""


def absolute_tolerances(tolerance: float) -> list[float]:
    """Absolute tolerances of depth [m] and rate [m/s], from a relative one."""
    return [tolerance * DEPTH_SCALE, tolerance * RATE_SCALE]


def motion(problem: Problem, load: Load) -> Motion:
    """Build the right-hand side of a problem under a load."""
    force, inverse_mass = contact_force(problem), 1.0 / problem.mass

    def right_hand_side(time: float, state: State) -> tuple[float, float]:
        depth, rate = state
        return rate, (load(time) - force(depth, rate)) * inverse_mass

    return right_hand_side


def jacobian(problem: Problem) -> Jacobian:
    """Build the derivative of the right-hand side of a problem by the state."""
    gradient, inverse_mass = force_gradient(problem), 1.0 / problem.mass

    def derivative(_time: float, state: State) -> Matrix:
        by_depth, by_rate = gradient(state[0], state[1])
        return [[0.0, 1.0], [-by_depth * inverse_mass, -by_rate * inverse_mass]]

    return derivative


class Ramp:
    """A load that knows the current tick only, for streaming solvers."""

    def __init__(self) -> None:
        self._begin, self._load, self._slope = 0.0, 0.0, 0.0

    def set(self, tick: Tick) -> None:
        """Set the load to run from a tick's first load to its last."""
        self._begin, self._load = tick.begin, tick.start_load
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
    times, loads = problem.time.tolist(), problem.load.tolist()
    return [Tick(*row) for row in zip(times, times[1:], loads, loads[1:], strict=False)]
