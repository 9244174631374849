"""The motion cut at every event of the law, for solvers that stop at events: smooth functions, and what ends them."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from knee_contact_ros.tools.work_precision.motion import Load, Motion, State
from knee_contact_ros.tools.work_precision.problems import EXPONENT, Problem

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
