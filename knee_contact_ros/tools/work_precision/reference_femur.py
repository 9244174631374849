"""The femur for the reference solution, in two formulations: by its depth on a plane, or by its height on anything."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple, Protocol

State = tuple[float, float]
Surface = Callable[[float], tuple[float, float, float]]
"""Angle [rad] to support h [m], h' and h''."""
Pose = Callable[[float, float, float], tuple[float, float, float]]
"""Angle [rad], its rate [rad/s] and height [m] to depth [m], its rate at rest [m/s], and n_y."""


class Femur(Protocol):
    """A femur whose state is two numbers: a depth or height [m], and its rate [m/s]."""

    def start(self, depth: float, angle: float) -> State:
        """State at rest at a depth [m] and an angle [rad]; the rate of the depth is 0 once the femur turns."""
        ...

    def turned(self, state: State, angle: float, before: float, after: float) -> State:
        """The state when the angle's rate [rad/s] jumps."""
        ...

    def contact(self, state: State, angle: float, turn: float) -> State:
        """Depth [m] and its rate [m/s] of a state at an angle [rad] and its rate [rad/s]."""
        ...

    def motion(self, state: State, angle: float, turn: float, force: float, load: float) -> State:
        """Rates of change of the state under contact force and load [N] per kg."""
        ...


class ByDepth(NamedTuple):
    """Femur on a plane: the state is depth and rate, and the turning surface accelerates them."""

    surface: Surface

    def start(self, depth: float, angle: float) -> State:
        """See `Femur`."""
        return depth, 0.0

    def turned(self, state: State, angle: float, before: float, after: float) -> State:
        """See `Femur`."""
        return state[0], state[1] + self.surface(angle)[1] * (after - before)

    def contact(self, state: State, angle: float, turn: float) -> State:
        """See `Femur`."""
        return state

    def motion(self, state: State, angle: float, turn: float, force: float, load: float) -> State:
        """See `Femur`."""
        return state[1], self.surface(angle)[2] * turn * turn + load - force


class ByHeight(NamedTuple):
    """Femur on any surface: the state is height and velocity."""

    pose: Pose

    def start(self, depth: float, angle: float) -> State:
        """See `Femur`."""
        height = 0.05
        for _ in range(100):
            reached, _, cosine = self.pose(angle, 0.0, height)
            height += (reached - depth) / cosine
        return height, 0.0

    def turned(self, state: State, angle: float, before: float, after: float) -> State:
        """See `Femur`."""
        return state

    def contact(self, state: State, angle: float, turn: float) -> State:
        """See `Femur`."""
        depth, rate, cosine = self.pose(angle, turn, state[0])
        return depth, rate - cosine * state[1]

    def motion(self, state: State, angle: float, turn: float, force: float, load: float) -> State:
        """See `Femur`."""
        return state[1], self.pose(angle, turn, state[0])[2] * force - load


def circle(_angle: float) -> tuple[float, float, float]:
    """Support of a circle; its radius does not matter for the depth."""
    return 0.034, 0.0, 0.0


def ellipse(a: float, b: float) -> Surface:
    """Build the support of an ellipse with half axes a (anterior) and b (superior) [m]."""

    def surface(angle: float) -> tuple[float, float, float]:
        sine, cosine = math.sin(angle), math.cos(angle)
        h = math.sqrt(a * a * sine * sine + b * b * cosine * cosine)
        first = (a * a - b * b) * sine * cosine / h
        return h, first, ((a * a - b * b) * (cosine * cosine - sine * sine) - first * first) / h

    return surface


def circle_in_circle(radius: float, tibial_radius: float, translation: float) -> Pose:
    """Build the pose of a circle in a concave one, carried forwards by `translation` [m] x sin(angle)."""

    def pose(angle: float, turn: float, height: float) -> tuple[float, float, float]:
        x, x_rate = translation * math.sin(angle), translation * math.cos(angle) * turn
        above = height - tibial_radius
        distance = math.sqrt(x * x + above * above)
        return distance + radius - tibial_radius, x * x_rate / distance, -above / distance

    return pose


def ellipse_on_slope(a: float, b: float, slope: float, translation: float) -> Pose:
    """Build the pose of an ellipse on an inclined plane, carried forwards by `translation` [m] x sin(angle)."""
    support = ellipse(a, b)

    def pose(angle: float, turn: float, height: float) -> tuple[float, float, float]:
        h, first, _ = support(angle - slope)
        x, x_rate = translation * math.sin(angle), translation * math.cos(angle) * turn
        sine, cosine = math.sin(slope), math.cos(slope)
        return h + sine * x - cosine * height, first * turn + sine * x_rate, cosine

    return pose
