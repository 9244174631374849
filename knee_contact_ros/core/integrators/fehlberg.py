"""Fehlberg's explicit pair of orders 4 and 5; the solution that is continued is the one of 4th order.

See `tableaus.py` for its source. Six evaluations give a step and a sharp estimate of its error, a quarter of what the
implicit method takes: it is used wherever the contact is not stiff against the step.
"""

from __future__ import annotations

from typing import NamedTuple

from knee_contact_ros.core.integrators.base import (
    Crossing,
    FemurState,
    Motion,
    Stage,
    StateError,
    Step,
    first_crossing,
    force_on,
    largest_leap,
)
from knee_contact_ros.core.integrators.tableaus import FEHLBERG, onward, weighted
from knee_contact_ros.core.kernel_source import always_inlined, in_kernel, never_inlined
from knee_contact_ros.core.prescribed import load_at, touch_at

ORDER = 4
EVALUATIONS = 6
_, C2, C3, C4, _, C6 = FEHLBERG.nodes
IN_ORDER = (C2, C3, C6, C4, 1.0)
"""Where the second, third, sixth and fourth stage and the end lie, in parts of the step"""
SINGULAR = 10.0
"""Factor on the error estimate where a layer begins: the force is the 1.5th power of the way from there, and both
orders fail alike. For t^1.5 they are 8.2e-4 and 9.0e-4 off, for (1 - t)^1.5 1.6e-3 and 1.4e-3, so that their difference
is a tenth of the error"""


class Slope(NamedTuple):
    """Contact and acceleration at a stage."""

    acceleration: float
    """Acceleration of the femur [m/s²]"""
    stage: Stage
    stiffness: float
    """Slope of the force along the height over the height [N/m]"""
    damping: float
    """Slope of the force along the height over the velocity [N s/m]"""
    cosine: float
    """n_y of the contact normal"""


class Stride(NamedTuple):
    """A step of Fehlberg's method."""

    state: FemurState
    error: StateError
    """Estimated local error of the state"""
    middle: Slope
    """The stage in the middle, whose slopes carry an error over the step at second order"""
    end: Slope
    crossing: Crossing
    leapt: float
    """Change of the depth's rate [m/s] by a leap of the contact; see `Step.leapt`"""


@never_inlined
def fehlberg_step(motion: Motion, s: float, state: FemurState, h: float) -> Step:
    """Take one step of `h` [s] from s [s] on under one layer's formula, with its estimated error."""
    begin = slope_at(motion, s, state.height, state.velocity)
    stride = fehlberg_stride(motion, s, state, h, begin)
    return Step(
        state=stride.state, error=stride.error, begin=begin.stage, end=stride.end.stage, crossing=stride.crossing,
        stiffness=stride.middle.stiffness, damping=stride.middle.damping, cosine=begin.cosine, leapt=stride.leapt,
        evaluations=EVALUATIONS + 1, solved=True,
    )  # fmt: skip


@always_inlined
def fehlberg_stride(motion: Motion, s: float, state: FemurState, h: float, one: Slope) -> Stride:
    """Take one step of `h` [s] from s [s] on, with the contact at its beginning already known as `one`."""
    y, v, m = state.height, state.velocity, FEHLBERG
    a = one.acceleration
    v2 = v + h * m.second[0] * a
    two = slope_at(motion, s + C2 * h, y + h * m.second[0] * v, v2)
    a2 = two.acceleration
    v3 = onward(v, h, m.third, (a,), a2)
    three = slope_at(motion, s + C3 * h, onward(y, h, m.third, (v,), v2), v3)
    a3 = three.acceleration
    v4 = onward(v, h, m.fourth, (a, a2), a3)
    four = slope_at(motion, s + C4 * h, onward(y, h, m.fourth, (v, v2), v3), v4)
    a4 = four.acceleration
    v5 = onward(v, h, m.fifth, (a, a2, a3), a4)
    five = slope_at(motion, s + h, onward(y, h, m.fifth, (v, v2, v3), v4), v5)
    a5 = five.acceleration
    v6 = onward(v, h, m.sixth, (a, a2, a3, a4), a5)
    six = slope_at(motion, s + C6 * h, onward(y, h, m.sixth, (v, v2, v3, v4), v5), v6)
    a6 = six.acceleration

    height = onward(y, h, m.weights, (v, v3, v4), v5)
    velocity = onward(v, h, m.weights, (a, a3, a4), a5)
    end = slope_at(motion, s + h, height, velocity)
    estimate = h * SINGULAR if begins_layer(motion, one.stage.depth, end.stage.depth) else h
    error = StateError(
        estimate * weighted(m.error, (v, v3, v4, v5, v6)), estimate * weighted(m.error, (a, a3, a4, a5, a6))
    )
    stages = (two.stage, three.stage, six.stage, four.stage, end.stage)
    crossing = first_crossing(motion, s, h, IN_ORDER, stages)
    leapt = largest_leap(motion, h, one.stage, IN_ORDER, stages)
    return Stride(state=FemurState(height, velocity), error=error, middle=six, end=end, crossing=crossing, leapt=leapt)


@in_kernel
def begins_layer(motion: Motion, begin: float, end: float) -> bool:
    """Whether a step between two depths [m] is longer than its distance from the beginning of the layer."""
    return abs(end - begin) >= min(begin, end) - motion.modes.law.layers[motion.mode.layer].begin


@in_kernel
def slope_at(motion: Motion, s: float, height: float, velocity: float) -> Slope:
    """Evaluate contact and acceleration at s [s] for a height [m] and a velocity [m/s]."""
    depth, surface_rate, cosine = touch_at(motion.interval, s).touch(height)
    rate = surface_rate - cosine * velocity
    force, stiffness, damping = force_on(motion, depth, rate)
    return Slope(
        acceleration=(cosine * force - load_at(motion.interval, s)) * (1.0 / motion.mass),
        stage=Stage(depth=depth, rate=rate, force=force, stiffness=stiffness, surface_rate=surface_rate),
        stiffness=cosine * cosine * stiffness, damping=cosine * cosine * damping, cosine=cosine,
    )  # fmt: skip
