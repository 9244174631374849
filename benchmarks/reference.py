"""A reference solution by another method, another library and another formulation.

SciPy's DOP853 (8th order) or Radau (5th order, for stiff scenes) at a relative tolerance of 1e-12, stopped at every
event and started again behind it. Laws and surfaces are written down once more from their sources; nothing of the
package is used. A femur is given in one of two formulations: by its depth on a plane, or by its height on anything.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

Force = Callable[[float, float, float], float]
"""(depth [m], rate [m/s], rate at first touch [m/s]) to the force [N]."""
Layers = Sequence[tuple[float, Force]]
"""Depth at which each layer begins [m], and its force."""


def power(stiffness: float, exponent: float, depth: float) -> float:
    """Force K δⁿ [N] of a depth δ [m]; 0 for δ <= 0."""
    return stiffness * depth**exponent if depth > 0.0 else 0.0


def kelvin_voigt(stiffness: float, exponent: float, damping: float) -> Layers:
    """Layers of Kelvin and Voigt's law, Eq. 10 of the paper."""
    return [(0.0, lambda depth, rate, _impact: power(stiffness, exponent, depth) + damping * rate)]


def two_layer(
    stiffness: float,
    exponent: float,
    damping: float,
    layer_depth: float,
    stiffness_2: float,
    damped: bool,
) -> Layers:
    """Layers of the two-layer law, Eq. 12 of the paper, with the dashpot in both layers if `damped`."""
    above = damping if damped else 0.0
    base = stiffness * layer_depth**exponent
    return [
        (0.0, lambda depth, rate, _impact: power(stiffness, exponent, depth) + above * rate),
        (
            layer_depth,
            lambda depth, rate, _impact: (
                base + power(stiffness_2, exponent, depth - layer_depth) + damping * rate
            ),
        ),
    ]


def impact_damped(
    stiffness: float, exponent: float, loss: float, least_impact_speed: float
) -> Layers:
    """Layers of the force K δⁿ (1 + D δ̇ / v₀), with v₀ the speed at first touch, or the least one [m/s]."""

    def force(depth: float, rate: float, impact: float) -> float:
        return power(stiffness, exponent, depth) * (
            1.0 + loss * rate / max(impact, least_impact_speed)
        )

    return [(0.0, force)]


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
        sine = math.sin(angle)
        cosine = math.cos(angle)
        h = math.sqrt(a * a * sine * sine + b * b * cosine * cosine)
        first = (a * a - b * b) * sine * cosine / h
        return h, first, ((a * a - b * b) * (cosine * cosine - sine * sine) - first * first) / h

    return surface


def circle_in_circle(radius: float, tibial_radius: float, translation: float) -> Pose:
    """Build the pose of a circle in a concave one, carried forwards by `translation` [m] x sin(angle)."""

    def pose(angle: float, turn: float, height: float) -> tuple[float, float, float]:
        x = translation * math.sin(angle)
        x_rate = translation * math.cos(angle) * turn
        above = height - tibial_radius
        distance = math.sqrt(x * x + above * above)
        return distance + radius - tibial_radius, x * x_rate / distance, -above / distance

    return pose


def ellipse_on_slope(a: float, b: float, slope: float, translation: float) -> Pose:
    """Build the pose of an ellipse on an inclined plane, carried forwards by `translation` [m] x sin(angle)."""
    support = ellipse(a, b)

    def pose(angle: float, turn: float, height: float) -> tuple[float, float, float]:
        h, first, _ = support(angle - slope)
        x = translation * math.sin(angle)
        x_rate = translation * math.cos(angle) * turn
        sine = math.sin(slope)
        cosine = math.cos(slope)
        return h + sine * x - cosine * height, first * turn + sine * x_rate, cosine

    return pose


RTOL = 1e-12
ATOL = 1e-17
"""Absolute tolerance [m] and [m/s]: a part of 1e-13 of the depths and rates that occur"""
MAX_EVENTS = 1000
"""Largest number of events in one tick"""

Event = Callable[[float, NDArray[np.float64]], float]


class Scene(NamedTuple):
    """A knee and the series of angles and loads that it goes through; the contact never pulls."""

    time: NDArray[np.float64]
    """[s], shape (n,)"""
    angle: NDArray[np.float64]
    """[rad], shape (n,)"""
    load: NDArray[np.float64]
    """[N], shape (n,)"""
    layers: Layers
    mass: float
    femur: Femur
    stiff: bool = False
    relative_tolerance: float = RTOL


class Answers(NamedTuple):
    """Reference solution at every tick, shape (n,) each."""

    depth: NDArray[np.float64]
    """Signed depth [m]: penetration > 0, gap < 0"""
    force: NDArray[np.float64]
    """Contact force along its normal [N]"""
    state: NDArray[np.float64]
    """First of the femur's two numbers: depth or height [m]"""


class _Mode(NamedTuple):
    layer: int
    """Index of the layer; -1 when apart"""
    pressing: bool


class _Tick(NamedTuple):
    """Angle, its rate, load and its rate, prescribed from one stamp to the next."""

    angle: float
    turn: float
    load: float
    slope: float


class _Point(NamedTuple):
    """State of a solution at a time within a tick."""

    s: float
    state: State
    mode: _Mode
    impact: float


def solve(scene: Scene) -> NDArray[np.float64]:
    """Signed depth [m] at every tick, shape (n,), from the static start under the first load."""
    return answers(scene).depth


def answers(scene: Scene) -> Answers:
    """Solve a scene from the static start under the first load.

    Raises:
        RuntimeError: SciPy fails, or a tick has more than `MAX_EVENTS` events.
    """
    depth = static_depth(scene)
    layer = sum(begin < depth for begin, _ in scene.layers) - 1
    point = _Point(
        0.0,
        scene.femur.start(depth, scene.angle[0]),
        _mode_in(scene.layers, layer, depth, 0.0, 0.0),
        0.0,
    )
    rows = [(depth, _force(scene.layers, point, depth, 0.0), point.state[0])]
    turn = 0.0
    for i in range(1, len(scene.time)):
        duration = scene.time[i] - scene.time[i - 1]
        before = turn
        turn = (scene.angle[i] - scene.angle[i - 1]) / duration
        slope = (scene.load[i] - scene.load[i - 1]) / duration
        tick = _Tick(scene.angle[i - 1], turn, scene.load[i - 1], slope)
        state = _turned(scene, point, tick, before, first=i == 1)
        contact = scene.femur.contact(state, tick.angle, turn)
        mode = _mode_in(
            scene.layers, point.mode.layer, *contact, point.impact
        )  # the rate has jumped, and the force
        point = _Point(0.0, state, mode, point.impact)
        events = 0
        while point.s < duration:
            point = _piece(scene, tick, duration, point)
            events += 1
            if events > MAX_EVENTS:
                raise RuntimeError(f"more than {MAX_EVENTS} events in tick {i}")
        depth, rate = scene.femur.contact(point.state, scene.angle[i], turn)
        rows.append((depth, _force(scene.layers, point, depth, rate), point.state[0]))
    return Answers(*np.array(rows).T)


def _force(layers: Layers, point: _Point, depth: float, rate: float) -> float:
    """Force of the contact [N] at a point with this depth [m] and rate [m/s]."""
    return (
        max(0.0, layers[point.mode.layer][1](depth, rate, point.impact))
        if point.mode.pressing
        else 0.0
    )


def _turned(scene: Scene, point: _Point, tick: _Tick, before: float, first: bool) -> State:
    """The state at the beginning of a tick: the angle's rate has jumped; the first one begins with a rate of 0."""
    if not first:
        return scene.femur.turned(point.state, tick.angle, before, tick.turn)
    _, rate = scene.femur.contact(point.state, tick.angle, tick.turn)
    _, slower = scene.femur.contact((point.state[0], 1.0), tick.angle, tick.turn)
    return point.state[0], rate / (rate - slower) if rate else 0.0


def _piece(scene: Scene, tick: _Tick, end: float, start: _Point) -> _Point:
    """Integrate within one mode to the next event or to the end of the tick."""
    layers = scene.layers
    mode = start.mode
    impact = start.impact
    pressing = layers[mode.layer][1] if mode.pressing else None

    def contact(s: float, z: NDArray[np.float64]) -> State:
        return scene.femur.contact((z[0], z[1]), tick.angle + tick.turn * s, tick.turn)

    def motion(s: float, z: NDArray[np.float64]) -> State:
        force = pressing(*contact(s, z), impact) if pressing else 0.0
        load = tick.load + tick.slope * s
        angle = tick.angle + tick.turn * s
        return scene.femur.motion(
            (z[0], z[1]), angle, tick.turn, force / scene.mass, load / scene.mass
        )

    events = _events(layers, mode, impact, contact)
    method = "Radau" if scene.stiff else "DOP853"
    span = (start.s, end)
    solution = solve_ivp(
        motion,
        span,
        start.state,
        method=method,
        rtol=scene.relative_tolerance,
        atol=ATOL,
        events=list(events.values()),
    )
    if not solution.success:
        raise RuntimeError(solution.message)
    s = float(solution.t[-1])
    z = solution.y[:, -1]
    if solution.status == 1:
        hit = next(
            name for name, times in zip(events, solution.t_events, strict=True) if len(times)
        )
        mode, impact = _behind(layers, mode, hit, contact(s, z), impact)
    return _Point(s, (float(z[0]), float(z[1])), mode, impact)


def _behind(
    layers: Layers, mode: _Mode, hit: str, contact: State, impact: float
) -> tuple[_Mode, float]:
    """Mode and speed of touch behind an event."""
    if hit == "force":
        return _Mode(mode.layer, not mode.pressing), impact
    depth, rate = contact
    if mode.layer < 0:
        impact = float(rate)
    return _mode_in(
        layers, mode.layer + (1 if hit == "below" else -1), depth, rate, impact
    ), impact


def _events(
    layers: Layers,
    mode: _Mode,
    impact: float,
    contact: Callable[[float, NDArray[np.float64]], State],
) -> dict[str, Event]:
    """Events that end a mode: the layer's two ends, and the force's change of sign."""
    events: dict[str, Event] = {}

    def watch(name: str, direction: float, value: Callable[[float, float], float]) -> None:
        def event(s: float, z: NDArray[np.float64]) -> float:
            return value(*contact(s, z))

        event.terminal, event.direction = True, direction  # type: ignore[attr-defined]
        events[name] = event

    if mode.layer >= 0:
        begin, force = layers[mode.layer]
        watch("above", -1.0, lambda depth, _rate: depth - begin)
        watch(
            "force", -1.0 if mode.pressing else 1.0, lambda depth, rate: force(depth, rate, impact)
        )
    if mode.layer + 1 < len(layers):
        end = layers[mode.layer + 1][0]
        watch("below", 1.0, lambda depth, _rate: depth - end)
    return events


def _mode_in(layers: Layers, layer: int, depth: float, rate: float, impact: float) -> _Mode:
    return _Mode(layer, layer >= 0 and layers[layer][1](depth, rate, impact) >= -1e-10)


def static_depth(scene: Scene) -> float:
    """Depth [m] at which the contact carries the first load; the normal's lean is part of the balance."""
    if scene.load[0] <= 0.0:
        return 0.0
    depth = 0.0
    last = -1.0
    while depth != last:  # the normal hardly leans with the height
        state = scene.femur.start(depth, scene.angle[0])
        push, pull = (
            scene.femur.motion(state, scene.angle[0], 0.0, force, 0.0)[1] for force in (1.0, 0.0)
        )
        depth, last = _static_depth(scene.layers, scene.load[0] / abs(push - pull)), depth
    return depth


def _static_depth(layers: Layers, force: float) -> float:
    layer = max(
        i for i in range(len(layers)) if i == 0 or layers[i - 1][1](layers[i][0], 0.0, 0.0) < force
    )
    begin, law = layers[layer]
    end = begin + 1e-9
    while law(end, 0.0, 0.0) < force:
        end = begin + 2.0 * (end - begin)
    return float(
        brentq(lambda depth: law(depth, 0.0, 0.0) - force, begin, end, xtol=1e-20, rtol=1e-15)
    )
