"""The contact law and the motion in plain Python, as a user writes them for a solver that takes a Python function."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable

import numpy as np

from knee_contact_ros.tools.work_precision.problems import EXPONENT, Problem

Force = Callable[[float, float], float]
"""From depth [m] and its rate [m/s] to the force [N], never below 0"""
Gradient = Callable[[float, float], tuple[float, float]]
"""From depth [m] and its rate [m/s] to the force's derivatives by depth [N/m] and by rate [N s/m]"""
Load = Callable[[float], float]
"""From time [s] to the load [N]"""


def contact_force(problem: Problem) -> Force:
    """Build the contact law of a problem: 0 N when apart, and 0 N where the formula would pull."""
    stiffness, damping = problem.stiffness, problem.damping

    def one_layer(depth: float, rate: float) -> float:
        if depth <= 0.0:
            return 0.0
        force = stiffness * depth**EXPONENT + damping * rate
        return force if force > 0.0 else 0.0

    if not problem.layered:
        return one_layer
    begin, base, stiffness_2 = problem.layer_depth, problem.layer_force, problem.stiffness_2
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
    force, begin = contact_force(problem), problem.layer_depth
    damping_1, damping = problem.first_damping, problem.damping
    slope_1, slope_2, power = EXPONENT * problem.stiffness, EXPONENT * problem.stiffness_2, EXPONENT - 1.0

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
