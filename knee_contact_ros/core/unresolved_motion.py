"""Motion within a step that its method does not resolve, and that the error estimate of the step does not see."""

from __future__ import annotations

import math

from knee_contact_ros.core.integrators.base import Stage, Step
from knee_contact_ros.core.kernel_source import in_kernel

FAST_SWING = 5.0
"""Angle [rad] of the contact's oscillation in a step above which the method damps it away."""
KICKED = 0.3
"""Error of a step that does not resolve a transient, as a part of the way of the transient"""


@in_kernel
def lost_swing(step: Step, load: float, load_rate: float, mass: float, h: float) -> float:
    """Return the speed [m/s] of the oscillation that a step of `h` [s] has damped away although the contact does not.

    Where the contact oscillates by several radians within the step, an L-stable method damps the oscillation at once,
    in the whole step as in its halves, so that doubling does not see it. It is the oscillation about the quasi-static
    contact; the contact's own damping accounts for a part of the loss. `load` [N] is that at the beginning.
    """
    half_rate, square = 0.5 * step.damping / mass, step.stiffness / mass
    if square * h * h < FAST_SWING * FAST_SWING or half_rate * half_rate >= square:
        return 0.0
    begin, end = step.begin, step.end
    if min(begin.stiffness, end.stiffness) < 0.25 * step.stiffness:  # as at first touch: all of the work may swing
        return math.sqrt(2.0 * abs((end.force - begin.force) * (end.depth - begin.depth)) / mass)
    load, load_rate = load / step.cosine, load_rate / step.cosine
    before, after = swing(begin, load, load_rate, mass), swing(end, load + load_rate * h, load_rate, mass)
    return max(0.0, before * math.exp(-half_rate * h) - after)


@in_kernel
def lost_creep(step: Step, load: float, mass: float, h: float) -> float:
    """Return the way [m] of a transient that is over in a small part of a step of `h` [s], when the femur creeps.

    A kick or a landing at the beginning of the step has decayed before the stages of the step. `load` [N] is that at
    the beginning.
    """
    damping = step.damping
    if damping * h < FAST_SWING * mass or damping * damping < 4.0 * step.stiffness * mass:
        return 0.0
    return KICKED * abs(step.cosine * step.begin.force - load) * mass / (damping * damping)


@in_kernel
def swing(stage: Stage, load: float, load_rate: float, mass: float) -> float:
    """Return the speed [m/s] of a contact's oscillation about the quasi-static contact under the load [N]."""
    excess = (stage.force - load) / math.sqrt(stage.stiffness * mass)
    rate = stage.rate - load_rate / stage.stiffness
    return math.sqrt(rate * rate + excess * excess)
