"""The ESDIRK method of 4th order: L-stable, stiffly accurate, 5 implicit stages, stage order 2.

Source: Kennedy & Carpenter 2003, doi:10.1016/S0168-9274(02)00138-1, the implicit half of ARK4(3)6L[2]SA. Its embedded
3rd-order solution is not used: on gait its estimate was a fifth of the true error at the usual steps, so it bounds
nothing. `doubling.py` estimates the error instead.

With one free coordinate every stage is one scalar equation in the stage's velocity. Its left side grows with a slope of
at least 1, because a contact law's slopes are >= 0: there is one solution at any stiffness, damping, mass and step. The
laws are convex in the depth (n >= 1), so Newton's method finds it from anywhere. On a curved tibia the normal turns
with the height; Newton's slope leaves that out, for the force changes by far more.
"""

from __future__ import annotations

from knee_contact_ros.core.contact_laws.base import LayerForce
from knee_contact_ros.core.integrators.base import NO_ERROR, FemurState, Stage, Step
from knee_contact_ros.core.prescribed import Interval

ORDER = 4
STAGE_ORDER = 2
GAMMA = 1 / 4
C = (0.0, 1 / 2, 83 / 250, 31 / 50, 17 / 20, 1.0)
A = (
    (),
    (1 / 4,),
    (8611 / 62500, -1743 / 31250),
    (5012029 / 34652500, -654441 / 2922500, 174375 / 388108),
    (15267082809 / 155376265600, -71443401 / 120774400, 730878875 / 902184768, 2285395 / 8070912),
    (82889 / 524892, 0.0, 15625 / 83664, 69875 / 102672, -2260 / 8211),
)
"""Below the diagonal; the diagonal is GAMMA. The last row is the weights."""
MAX_NEWTON = 30
DEPTH_SHARE = 1e-3
"""Share of the depth at which Newton's method has arrived at most: the force, too, must be met"""
LEAST_CORRECTION = 1e-16
"""[m] that rounding of a height allows"""


def esdirk4_step(
    interval: Interval, law: LayerForce, mass: float, s: float, state: FemurState, h: float, depth_resolution: float
) -> Step:
    """Take one step of `h` [s] under one layer's formula.

    `depth_resolution` [m] is the change of depth below which Newton's method has arrived (its next correction would be
    smaller by orders of magnitude).
    """
    height, velocity = state
    depth, surface_rate, cosine = interval.touch(s)(height)
    rate = surface_rate - cosine * velocity
    force, stiffness, damping = law(depth, rate)
    begin = Stage(0.0, depth, rate, force, stiffness, surface_rate)
    acceleration = (cosine * force - interval.load(s)) / mass
    velocities, accelerations = [velocity], [acceleration]
    stages = []
    evaluations, solved = 1, True
    diagonal = h * GAMMA
    for c, row in zip(C[1:], A[1:], strict=True):
        known_height = height + h * sum(a * v for a, v in zip(row, velocities, strict=True))
        known_velocity = velocity + h * sum(a * v for a, v in zip(row, accelerations, strict=True))
        touch, load = interval.touch(s + c * h), interval.load(s + c * h)

        unknown = known_velocity + diagonal * accelerations[-1]
        for _ in range(MAX_NEWTON):
            depth, surface_rate, cosine = touch(known_height + diagonal * unknown)
            rate = surface_rate - cosine * unknown
            force, stiffness, damping = law(depth, rate)
            evaluations += 1
            acceleration = (cosine * force - load) / mass
            force_slope = cosine * (diagonal * stiffness + damping)
            feedback = diagonal * cosine * force_slope / mass
            correction = (unknown - known_velocity - diagonal * acceleration) / (1.0 + feedback)
            unknown -= correction
            if abs(correction) * diagonal <= max(min(depth_resolution, DEPTH_SHARE * depth), LEAST_CORRECTION):
                # All else follows the last correction along the tangent, at no further evaluation.
                acceleration += feedback / diagonal * correction
                force += force_slope * correction
                depth += cosine * diagonal * correction
                rate += cosine * correction
                break
        else:
            solved = False
        velocities.append(unknown)
        accelerations.append(acceleration)
        stages.append(Stage(c, depth, rate, force, stiffness, surface_rate))

    return Step(
        state=FemurState(known_height + diagonal * unknown, unknown),
        error=NO_ERROR,
        begin=begin,
        stages=tuple(stages),
        stiffness=cosine * cosine * stiffness,
        damping=cosine * cosine * damping,
        evaluations=evaluations,
        solved=solved,
    )
