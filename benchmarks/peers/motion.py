"""The contact law and the motion in plain Python, as a user writes them for a solver that takes a Python function.

The motion is first-order equations of the state: depth [m] and rate [m/s]; for solvers that stop at events it is also
cut at every event of the law, into smooth pieces and what ends them.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from benchmarks.peers.problems import EXPONENT, Problem

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

DEPTH_SCALE, RATE_SCALE = 1e-3, 1e-1
"""Depth [m] and rate [m/s] to which absolute tolerances are relative: those that occur"""
RATE_UNIT = DEPTH_SCALE / RATE_SCALE
"""Time [s] that scales rates to depths, for tools that take one absolute tolerance for all of the state"""


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


Value = Callable[[float, State], float]


class Piece(NamedTuple):
    """A region of the state in which the law is smooth."""

    layer: int
    """Index of the layer; -1 when apart"""
    pressing: bool
    """Whether the force is the formula's; else the formula would pull, and the force is 0"""


class End(NamedTuple):
    """An end of a piece: where a value passes through 0."""

    direction: int
    """1 if the value passes upwards, -1 downwards"""
    value: Value
    behind: Callable[[float, float], Piece]
    """The piece behind it at a depth [m] and rate [m/s]"""


class Pieces:
    """All pieces of a problem's law under a load."""

    def __init__(self, problem: Problem, load: Load) -> None:
        self._load, self._inverse_mass = load, 1.0 / problem.mass
        self._layers = [(0.0, 0.0, problem.stiffness, problem.first_damping)]
        if problem.layered:
            self._layers.append((problem.layer_depth, problem.layer_force, problem.stiffness_2, problem.damping))

    def formula(self, layer: int) -> Callable[[float, float], float]:
        """Build a layer's force [N] without the clamp; its derivatives do not jump at the layer's beginning."""
        begin, base, stiffness, damping = self._layers[layer]

        def force(depth: float, rate: float) -> float:
            below = depth - begin
            return base + damping * rate + (stiffness * below**EXPONENT if below > 0.0 else 0.0)

        return force

    def at(self, layer: int, depth: float, rate: float) -> Piece:
        """The piece of a layer in which a state lies."""
        return Piece(layer, layer >= 0 and self.formula(layer)(depth, rate) >= 0.0)

    def start(self, depth: float) -> Piece:
        """The piece of a femur at rest."""
        return self.at(sum(begin < depth for begin, *_ in self._layers) - 1, depth, 0.0)

    def motion(self, piece: Piece) -> Motion:
        """Build the right-hand side within a piece."""
        load, inverse_mass = self._load, self._inverse_mass
        if not piece.pressing:
            return lambda time, state: (state[1], load(time) * inverse_mass)
        force = self.formula(piece.layer)

        def right_hand_side(time: float, state: State) -> tuple[float, float]:
            depth, rate = state
            return rate, (load(time) - force(depth, rate)) * inverse_mass

        return right_hand_side

    def ends(self, piece: Piece) -> list[End]:
        """List the ends of a piece."""
        ends = []
        layer = piece.layer
        if layer >= 0:
            force = self.formula(layer)
            ends = [
                End(-1, through(self._layers[layer][0]), lambda depth, rate: self.at(layer - 1, depth, rate)),
                End(-1 if piece.pressing else 1, lambda _time, state: force(state[0], state[1]),
                    lambda _depth, _rate: Piece(layer, not piece.pressing)),
            ]  # fmt: skip
        if layer + 1 < len(self._layers):
            begin = self._layers[layer + 1][0]
            ends.append(End(1, through(begin), lambda depth, rate: self.at(layer + 1, depth, rate)))
        return ends


def through(begin: float) -> Value:
    """Build the value that is the depth relative to a layer's beginning [m]."""
    return lambda _time, state: state[0] - begin
