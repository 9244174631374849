"""The ESDIRK method of 4th order: L-stable, stiffly accurate, 5 implicit stages, stage order 2.

See `tableaus.py` for its source. Its embedded 3rd-order solution is not used: on gait its estimate was a fifth of the
true error at the usual steps, so it bounds nothing. `doubling.py` estimates the error instead.

With one free coordinate every stage is one scalar equation in the stage's velocity. Its left side grows with a slope of
at least 1, because a contact law's slopes are >= 0: there is one solution at any stiffness, damping, mass and step. The
laws are convex in the depth (n >= 1), so Newton's method finds it from anywhere. On a curved tibia the normal turns
with the height; Newton's slope leaves that out, for the force changes by far more.

With a mass of 0 the same stages solve F(δ, δ̇) = L: the equation of the first-order level.
"""

from __future__ import annotations

from typing import NamedTuple

from knee_contact_ros.core.integrators.base import (
    FemurState,
    Motion,
    Stage,
    StateError,
    Step,
    acceleration_of,
    first_crossing,
    force_on,
    largest_leap,
)
from knee_contact_ros.core.integrators.tableaus import ESDIRK4, ahead
from knee_contact_ros.core.kernel_source import in_kernel, never_inlined
from knee_contact_ros.core.prescribed import load_at, touch_at

ORDER = 4
STAGE_ORDER = 2
STAGES = 6
_, C2, C3, C4, C5, _ = ESDIRK4.nodes
IN_ORDER = (C3, C2, C4, C5, 1.0)
"""Where the implicit stages lie in parts of the step, the second of them first"""
MAX_NEWTON = 30
DEPTH_SHARE = 1e-4
"""Largest share of the depth at which Newton's method has converged: the force must be exact, too"""
LEAST_CORRECTION = 1e-16
"""Smallest correction [m] that the rounding of a height allows"""
FIRST_DEPTH = 1e-6
"""Depth [m] at which Newton's method begins for a contact without mass and damping that is apart"""


class Solved(NamedTuple):
    """The solution of an implicit stage."""

    velocity: float
    """Velocity of the femur [m/s]"""
    acceleration: float
    """Acceleration of the femur [m/s²]"""
    stage: Stage
    stiffness: float
    """Slope of the force along the height over the height [N/m]"""
    damping: float
    """Slope of the force along the height over the velocity [N s/m]"""
    evaluations: int
    arrived: bool
    """Whether Newton's method has converged"""
    left: float
    """Error of the depth [m] that Newton's method has left because the contact law is not linear"""


@never_inlined
def esdirk4_step(motion: Motion, s: float, state: FemurState, h: float, resolution: float, most: int) -> Step:
    """Take one step of `h` [s] under one layer's formula.

    `resolution` [m] is the change of depth below which Newton's method has converged (its next correction would be
    smaller by orders of magnitude). Once the step has taken `most` evaluations, no more stages are solved.
    """
    y, v, m = state.height, state.velocity, ESDIRK4
    d = h * m.diagonal
    depth, surface_rate, cosine = touch_at(motion.interval, s).touch(y)
    rate = surface_rate - cosine * v
    force, stiffness, _ = force_on(motion, depth, rate)
    begin = Stage(depth=depth, rate=rate, force=force, stiffness=stiffness, surface_rate=surface_rate)
    a = acceleration_of(motion, cosine * force - load_at(motion.interval, s))

    high, fast = ahead(y, h, m.second, (v,)), ahead(v, h, m.second, (a,))
    one = solve_stage(motion, s + C2 * h, high, fast, d, a, resolution, most)
    most -= one.evaluations
    v2, a2 = one.velocity, one.acceleration
    high, fast = ahead(y, h, m.third, (v, v2)), ahead(v, h, m.third, (a, a2))
    two = solve_stage(motion, s + C3 * h, high, fast, d, a2, resolution, most)
    most -= two.evaluations
    v3, a3 = two.velocity, two.acceleration
    high, fast = ahead(y, h, m.fourth, (v, v2, v3)), ahead(v, h, m.fourth, (a, a2, a3))
    three = solve_stage(motion, s + C4 * h, high, fast, d, a3, resolution, most)
    most -= three.evaluations
    v4, a4 = three.velocity, three.acceleration
    high, fast = ahead(y, h, m.fifth, (v, v2, v3, v4)), ahead(v, h, m.fifth, (a, a2, a3, a4))
    four = solve_stage(motion, s + C5 * h, high, fast, d, a4, resolution, most)
    most -= four.evaluations
    v5, a5 = four.velocity, four.acceleration
    high, fast = ahead(y, h, m.last, (v, v3, v4, v5)), ahead(v, h, m.last, (a, a3, a4, a5))
    five = solve_stage(motion, s + h, high, fast, d, a5, resolution, most)

    stages = (two.stage, one.stage, three.stage, four.stage, five.stage)
    crossing = first_crossing(motion, s, h, IN_ORDER, stages)
    leapt = largest_leap(motion, h, begin, IN_ORDER, stages)
    return Step(
        state=FemurState(high + d * five.velocity, five.velocity),
        error=StateError(one.left + two.left + three.left + four.left + five.left, 0.0), begin=begin, end=five.stage,
        crossing=crossing, stiffness=five.stiffness, damping=five.damping, cosine=cosine, leapt=leapt,
        evaluations=1 + one.evaluations + two.evaluations + three.evaluations + four.evaluations + five.evaluations,
        solved=one.arrived and two.arrived and three.arrived and four.arrived and five.arrived,
    )  # fmt: skip


@in_kernel
def solve_stage(
    motion: Motion, s: float, height: float, velocity: float, diagonal: float, guess: float, resolution: float,
    most: int,
) -> Solved:  # fmt: skip
    """Solve an implicit stage at s [s] by Newton's method from the acceleration `guess` [m/s²].

    The height of the stage is `height` [m] plus `diagonal` [s] times its velocity, and the velocity is `velocity` [m/s]
    plus `diagonal` times its acceleration. At most `most` evaluations are taken, but one at least.
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
        velocity=unknown, acceleration=acceleration,
        stage=Stage(depth=depth, rate=rate, force=force, stiffness=stiffness, surface_rate=surface_rate),
        stiffness=cosine * cosine * stiffness, damping=cosine * cosine * damping, evaluations=evaluations,
        arrived=arrived, left=left,
    )  # fmt: skip
