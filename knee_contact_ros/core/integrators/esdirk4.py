"""The ESDIRK method of 4th order: L-stable, stiffly accurate, 5 implicit stages, stage order 2.

Source: Kennedy & Carpenter 2003, doi:10.1016/S0168-9274(02)00138-1, the implicit half of ARK4(3)6L[2]SA. Its embedded
3rd-order solution is not used: on gait its estimate was a fifth of the true error at the usual steps, so it bounds
nothing. `doubling.py` estimates the error instead.

With one free coordinate every stage is one scalar equation in the stage's velocity. Its left side grows with a slope of
at least 1, because a contact law's slopes are >= 0: there is one solution at any stiffness, damping, mass and step. The
laws are convex in the depth (n >= 1), so Newton's method finds it from anywhere. On a curved tibia the normal turns
with the height; Newton's slope leaves that out, for the force changes by far more.

With a mass of 0 the same stages solve F(δ, δ̇) = L: the equation of the first-order level.
"""

from __future__ import annotations

from typing import NamedTuple

from knee_contact_ros.core.integrators.base import (
    INSIDE,
    FemurState,
    Motion,
    Stage,
    StateError,
    Step,
    acceleration_of,
    earlier,
    force_on,
    leap,
)
from knee_contact_ros.core.kernel_source import in_kernel, never_inlined
from knee_contact_ros.core.prescribed import load_at, touch_at

ORDER = 4
STAGE_ORDER = 2
STAGES = 6
GAMMA = 1 / 4
C2, C3, C4, C5 = 1 / 2, 83 / 250, 31 / 50, 17 / 20
A21 = 1 / 4
A31, A32 = 8611 / 62500, -1743 / 31250
A41, A42, A43 = 5012029 / 34652500, -654441 / 2922500, 174375 / 388108
A51, A52, A53, A54 = 15267082809 / 155376265600, -71443401 / 120774400, 730878875 / 902184768, 2285395 / 8070912
A61, A63, A64, A65 = 82889 / 524892, 15625 / 83664, 69875 / 102672, -2260 / 8211
"""Below the diagonal, which is `GAMMA`; the last row is the weights, and A62 is 0."""
MAX_NEWTON = 30
DEPTH_SHARE = 1e-4
"""Share of the depth at which Newton's method has arrived at most: the force, too, must be met"""
LEAST_CORRECTION = 1e-16
"""[m] that rounding of a height allows"""
FIRST_DEPTH = 1e-6
"""[m] from which Newton's method finds the depth of a contact without mass and damping"""


class Solved(NamedTuple):
    """An implicit stage."""

    velocity: float
    """[m/s]"""
    acceleration: float
    """[m/s²]"""
    stage: Stage
    stiffness: float
    """Slope of the force along the height over the height [N/m]"""
    damping: float
    """The same over the velocity [N s/m]"""
    evaluations: int
    arrived: bool
    left: float
    """Of the depth [m]: what Newton's method has left, by the curve of the contact law"""


@never_inlined
def esdirk4_step(motion: Motion, s: float, state: FemurState, h: float, resolution: float, most: int) -> Step:
    """Take one step of `h` [s] under one layer's formula.

    `resolution` [m] is the change of depth below which Newton's method has arrived (its next correction would be
    smaller by orders of magnitude). Once the step has taken `most` evaluations its stages are not solved any more.
    """
    y, v = state.height, state.velocity
    d = h * GAMMA
    depth, surface_rate, cosine = touch_at(motion.interval, s).touch(y)
    rate = surface_rate - cosine * v
    force, stiffness, _ = force_on(motion, depth, rate)
    begin = Stage(depth, rate, force, stiffness, surface_rate)
    a = acceleration_of(motion, cosine * force - load_at(motion.interval, s))

    one = solve_stage(motion, s + C2 * h, y + h * (A21 * v), v + h * (A21 * a), d, a, resolution, most)
    most -= one.evaluations
    v2, a2 = one.velocity, one.acceleration
    two = solve_stage(
        motion, s + C3 * h, y + h * (A31 * v + A32 * v2), v + h * (A31 * a + A32 * a2), d, a2, resolution, most
    )
    most -= two.evaluations
    v3, a3 = two.velocity, two.acceleration
    three = solve_stage(
        motion, s + C4 * h,
        y + h * (A41 * v + A42 * v2 + A43 * v3), v + h * (A41 * a + A42 * a2 + A43 * a3), d, a3, resolution,
        most,
    )  # fmt: skip
    most -= three.evaluations
    v4, a4 = three.velocity, three.acceleration
    four = solve_stage(
        motion, s + C5 * h,
        y + h * (A51 * v + A52 * v2 + A53 * v3 + A54 * v4), v + h * (A51 * a + A52 * a2 + A53 * a3 + A54 * a4),
        d, a4, resolution, most,
    )  # fmt: skip
    most -= four.evaluations
    v5, a5 = four.velocity, four.acceleration
    known_height = y + h * (A61 * v + A63 * v3 + A64 * v4 + A65 * v5)
    known_velocity = v + h * (A61 * a + A63 * a3 + A64 * a4 + A65 * a5)
    five = solve_stage(motion, s + h, known_height, known_velocity, d, a5, resolution, most)

    crossing = earlier(INSIDE, motion, two.stage, s + C3 * h, C3)
    crossing = earlier(crossing, motion, one.stage, s + C2 * h, C2)
    crossing = earlier(crossing, motion, three.stage, s + C4 * h, C4)
    crossing = earlier(crossing, motion, four.stage, s + C5 * h, C5)
    crossing = earlier(crossing, motion, five.stage, s + h, 1.0)
    leapt = 0.0
    if motion.interval.pair.is_non_convex():
        turn = motion.interval.angle_rate
        leapt = max(
            leap(begin.surface_rate, two.stage.surface_rate, turn, C3 * h),
            leap(two.stage.surface_rate, one.stage.surface_rate, turn, (C2 - C3) * h),
            leap(one.stage.surface_rate, three.stage.surface_rate, turn, (C4 - C2) * h),
            leap(three.stage.surface_rate, four.stage.surface_rate, turn, (C5 - C4) * h),
            leap(four.stage.surface_rate, five.stage.surface_rate, turn, (1.0 - C5) * h),
        )
    return Step(
        FemurState(known_height + d * five.velocity, five.velocity),
        StateError(one.left + two.left + three.left + four.left + five.left, 0.0),
        begin,
        five.stage,
        crossing,
        five.stiffness,
        five.damping,
        cosine,
        leapt,
        1 + one.evaluations + two.evaluations + three.evaluations + four.evaluations + five.evaluations,
        one.arrived and two.arrived and three.arrived and four.arrived and five.arrived,
    )


@in_kernel
def solve_stage(
    motion: Motion, s: float, height: float, velocity: float, diagonal: float, guess: float, resolution: float,
    most: int,
) -> Solved:  # fmt: skip
    """Solve a stage at s [s]: its height is `height` + `diagonal` times its velocity, and so on with the acceleration.

    Newton's method from the acceleration `guess` [m/s²], for `most` evaluations, but one at least.
    """
    touch, load = touch_at(motion.interval, s), load_at(motion.interval, s)
    unknown = velocity + diagonal * guess
    most = max(1, min(most, MAX_NEWTON))
    evaluations, arrived = 0, False
    while not arrived and evaluations < most:
        depth, surface_rate, cosine = touch.touch(height + diagonal * unknown)
        rate = surface_rate - cosine * unknown
        force, stiffness, damping = force_on(motion, depth, rate)
        evaluations += 1
        # Where a formula pulls its slope may be negative; Newton's method is to go on downhill there, too.
        force_slope = cosine * (diagonal * max(stiffness, 0.0) + damping)
        residual = motion.mass * (unknown - velocity) - diagonal * (cosine * force - load)
        slope = motion.mass + diagonal * cosine * force_slope
        # Without mass, and where nothing presses yet, there is no slope to follow: go into contact.
        correction = residual / slope if slope > 0.0 else (FIRST_DEPTH - depth) / (cosine * diagonal)
        unknown -= correction
        arrived = abs(correction) * diagonal <= max(min(resolution, DEPTH_SHARE * depth), LEAST_CORRECTION)
    last = cosine * diagonal * correction
    left = last * last / max(depth, LEAST_CORRECTION)
    if arrived:  # all else follows the last correction along the tangent, at no further evaluation
        force += force_slope * correction
        depth += cosine * diagonal * correction
        rate += cosine * correction
    acceleration = acceleration_of(motion, cosine * force - load)
    return Solved(
        unknown,
        acceleration,
        Stage(depth, rate, force, stiffness, surface_rate),
        cosine * cosine * stiffness,
        cosine * cosine * damping,
        evaluations,
        arrived,
        left,
    )
