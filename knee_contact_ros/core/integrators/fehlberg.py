"""Fehlberg's explicit pair of orders 4 and 5; the solution that goes on is the one of 4th order.

Source: Fehlberg 1969, NASA TR R-315, formula 2. Six evaluations give a step and a sharp estimate of its error, a
quarter of what the implicit method takes: it is used wherever the contact is not stiff against the step.
"""

from __future__ import annotations

from typing import NamedTuple

from knee_contact_ros.core.integrators.base import (
    INSIDE,
    Crossing,
    FemurState,
    Motion,
    Stage,
    StateError,
    Step,
    earlier,
    force_on,
    leap,
)
from knee_contact_ros.core.kernel_source import always_inlined, in_kernel, never_inlined
from knee_contact_ros.core.prescribed import load_at, touch_at

ORDER = 4
EVALUATIONS = 6
C2, C3, C4, C6 = 1 / 4, 3 / 8, 12 / 13, 1 / 2
A21 = 1 / 4
A31, A32 = 3 / 32, 9 / 32
A41, A42, A43 = 1932 / 2197, -7200 / 2197, 7296 / 2197
A51, A52, A53, A54 = 439 / 216, -8.0, 3680 / 513, -845 / 4104
A61, A62, A63, A64, A65 = -8 / 27, 2.0, -3544 / 2565, 1859 / 4104, -11 / 40
B1, B3, B4, B5 = 25 / 216, 1408 / 2565, 2197 / 4104, -1 / 5
E1, E3, E4, E5, E6 = (
    25 / 216 - 16 / 135,
    1408 / 2565 - 6656 / 12825,
    2197 / 4104 - 28561 / 56430,
    -1 / 5 + 9 / 50,
    -2 / 55,
)
"""Weights of the 4th order less those of the 5th"""
SINGULAR = 10.0
"""Where a layer begins, the force is the 1.5th power of the way from there. Both orders fail alike: for t^1.5 they are
8.2e-4 and 9.0e-4 off, for (1 - t)^1.5 1.6e-3 and 1.4e-3, so their difference is a tenth of the error"""


class Slope(NamedTuple):
    """Contact and acceleration at a stage."""

    acceleration: float
    """[m/s²]"""
    stage: Stage
    stiffness: float
    """Slope of the force along the height over the height [N/m]"""
    damping: float
    """The same over the velocity [N s/m]"""
    cosine: float
    """n_y"""


class Stride(NamedTuple):
    """A step of this method."""

    state: FemurState
    error: StateError
    """Estimated local error"""
    middle: Slope
    """At the middle; its slopes carry an error over the step at second order"""
    end: Slope
    crossing: Crossing
    leapt: float
    """See `Step`"""


@never_inlined
def fehlberg_step(motion: Motion, s: float, state: FemurState, h: float) -> Step:
    """Take one step of `h` [s] under one layer's formula, with its estimated error."""
    begin = slope_at(motion, s, state.height, state.velocity)
    stride = fehlberg_stride(motion, s, state, h, begin)
    return Step(
        stride.state, stride.error, begin.stage, stride.end.stage, stride.crossing, stride.middle.stiffness,
        stride.middle.damping, begin.cosine, stride.leapt, EVALUATIONS + 1, True,
    )  # fmt: skip


@always_inlined
def fehlberg_stride(motion: Motion, s: float, state: FemurState, h: float, one: Slope) -> Stride:
    """A step with the contact at its beginning known."""
    y, v = state.height, state.velocity
    a = one.acceleration
    # The newest slope is added last: all else is known while it is still being computed.
    v2 = v + h * A21 * a
    two = slope_at(motion, s + C2 * h, y + h * A21 * v, v2)
    a2 = two.acceleration
    v3 = v + h * (A31 * a) + h * A32 * a2
    three = slope_at(motion, s + C3 * h, y + h * (A31 * v) + h * A32 * v2, v3)
    a3 = three.acceleration
    v4 = v + h * (A41 * a + A42 * a2) + h * A43 * a3
    four = slope_at(motion, s + C4 * h, y + h * (A41 * v + A42 * v2) + h * A43 * v3, v4)
    a4 = four.acceleration
    v5 = v + h * (A51 * a + A52 * a2 + A53 * a3) + h * A54 * a4
    five = slope_at(motion, s + h, y + h * (A51 * v + A52 * v2 + A53 * v3) + h * A54 * v4, v5)
    a5 = five.acceleration
    v6 = v + h * (A61 * a + A62 * a2 + A63 * a3 + A64 * a4) + h * A65 * a5
    six = slope_at(motion, s + C6 * h, y + h * (A61 * v + A62 * v2 + A63 * v3 + A64 * v4) + h * A65 * v5, v6)
    a6 = six.acceleration

    height = y + h * (B1 * v + B3 * v3 + B4 * v4) + h * B5 * v5
    velocity = v + h * (B1 * a + B3 * a3 + B4 * a4) + h * B5 * a5
    end = slope_at(motion, s + h, height, velocity)
    estimate = h * SINGULAR if begins_layer(motion, one.stage.depth, end.stage.depth) else h
    error = StateError(
        estimate * (E1 * v + E3 * v3 + E4 * v4 + E5 * v5 + E6 * v6),
        estimate * (E1 * a + E3 * a3 + E4 * a4 + E5 * a5 + E6 * a6),
    )
    crossing = earlier(INSIDE, motion, two.stage, s + C2 * h, C2)
    crossing = earlier(crossing, motion, three.stage, s + C3 * h, C3)
    crossing = earlier(crossing, motion, six.stage, s + C6 * h, C6)
    crossing = earlier(crossing, motion, four.stage, s + C4 * h, C4)
    crossing = earlier(crossing, motion, end.stage, s + h, 1.0)
    leapt = 0.0
    if motion.interval.pair.is_non_convex():
        turn = motion.interval.angle_rate
        leapt = max(
            leap(one.stage.surface_rate, two.stage.surface_rate, turn, C2 * h),
            leap(two.stage.surface_rate, three.stage.surface_rate, turn, (C3 - C2) * h),
            leap(three.stage.surface_rate, six.stage.surface_rate, turn, (C6 - C3) * h),
            leap(six.stage.surface_rate, four.stage.surface_rate, turn, (C4 - C6) * h),
            leap(four.stage.surface_rate, end.stage.surface_rate, turn, (1.0 - C4) * h),
        )
    return Stride(FemurState(height, velocity), error, six, end, crossing, leapt)


@in_kernel
def begins_layer(motion: Motion, begin: float, end: float) -> bool:
    """Whether a step from one depth [m] to another covers more than its distance from the layer's beginning."""
    return abs(end - begin) >= min(begin, end) - motion.modes.law.layers[motion.mode.layer].begin


@in_kernel
def slope_at(motion: Motion, s: float, height: float, velocity: float) -> Slope:
    """Evaluate the contact at s [s] in a state."""
    depth, surface_rate, cosine = touch_at(motion.interval, s).touch(height)
    rate = surface_rate - cosine * velocity
    force, stiffness, damping = force_on(motion, depth, rate)
    return Slope(
        (cosine * force - load_at(motion.interval, s)) * (1.0 / motion.mass),
        Stage(depth, rate, force, stiffness, surface_rate),
        cosine * cosine * stiffness,
        cosine * cosine * damping,
        cosine,
    )
