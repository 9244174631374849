"""How far a simpler level is from the dynamic one: the motion that it leaves out, by the linearised contact.

With x = level's height - dynamic height, M ẍ + C ẋ + K x = p, where p [N] is what the level left out of Eq. 13: the
inertia of its own motion, and for the quasi-static level the dashpot's force too. Where the dynamic femur flies, x
grows freely; what it may swing after that is remembered as an unrest that the contact calms.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from knee_contact_ros.core.error_estimate import carry, decay_rate, depth_error
from knee_contact_ros.core.integrators.base import StateError
from knee_contact_ros.core.kernel_source import in_kernel

SOFTEST = 1e-8
"""K h²/M below which the spring does not count in a tick"""
BOUNCE = math.pi / math.sqrt(8.0)
"""A bounce of the height A lasts √(8 A M/L), and the contact in between half a period, π √(M/K)"""


class Deviation(NamedTuple):
    """Estimated deviation of a level from the dynamic one."""

    state: StateError
    unrest: float
    """Error [m] of no known sign: of the level's steps, and a swing after a flight"""


class LeftOut(NamedTuple):
    """What the linearised deviation follows over a tick."""

    stiffness: float
    """K [N/m] along the height, of the tick's middle"""
    damping: float
    """C [N s/m], likewise"""
    acceleration: float
    """Of the level [m/s²]"""
    dashpot: float
    """Force of the dashpot along the height that the level leaves out [N]"""
    begin_load: float
    """[N] at the tick's beginning"""
    end_load: float
    """[N] at its end"""
    reach: float
    """Depth over n_y of the level [m]: as far as the dynamic femur must be above it to fly"""


@in_kernel
def deviate(deviation: Deviation, left_out: LeftOut, mass: float, h: float) -> Deviation:
    """The deviation after a tick of `h` [s]."""
    error, unrest = deviation
    flying = -error.height > left_out.reach
    if flying or left_out.begin_load < 0.0 or left_out.end_load < 0.0:
        push = left_out.acceleration + lifting(left_out, flying) / mass
        error = StateError(error.height + h * (error.velocity + 0.5 * push * h), error.velocity + push * h)
        return Deviation(error, max(unrest, abs(error.height)))
    spring = max(left_out.stiffness, SOFTEST * mass / (h * h))
    rest = (mass * left_out.acceleration - left_out.dashpot) / spring
    behind = error.height - lagging(error.velocity, left_out, mass, h)
    moved = carry(StateError(behind - rest, error.velocity), spring, left_out.damping, mass, h)
    error = StateError(moved.height + rest, moved.velocity)
    return Deviation(error, max(calmed(unrest, left_out, spring, mass, h), thrown(error, left_out, spring, mass)))


@in_kernel
def lagging(velocity: float, left_out: LeftOut, mass: float, h: float) -> float:
    """By how much [m] the femur falls behind a level that sinks away from it, at most in `h` [s]; `velocity` is theirs.

    The dashpot would hold it back by more than presses it, but the contact does not pull: the load alone must speed the
    femur up.
    """
    load = 0.5 * (left_out.begin_load + left_out.end_load)
    if left_out.damping * -velocity <= load:
        return 0.0
    speed = -velocity - load / left_out.damping
    return min(speed * h, 0.5 * mass * speed * speed / load) if load > 0.0 else speed * h


@in_kernel
def thrown(error: StateError, left_out: LeftOut, spring: float, mass: float) -> float:
    """How high [m] a contact that swings further than its depth throws the femur; 0 if it swings less.

    What the spring had stored beyond the depth is lifted against the load.
    """
    swung = error.height * error.height + error.velocity * error.velocity * mass / spring
    spare = swung - left_out.reach * left_out.reach
    load = 0.5 * (left_out.begin_load + left_out.end_load)
    return math.sqrt(swung) + 0.5 * spring * spare / load if spare > 0.0 and load > 0.0 else 0.0


@in_kernel
def calmed(unrest: float, left_out: LeftOut, spring: float, mass: float, h: float) -> float:
    """What is left of a swing's depth [m] after `h` [s]; a femur that bounces is in contact for a part of the time."""
    rate, load = decay_rate(spring, left_out.damping, mass), 0.5 * (left_out.begin_load + left_out.end_load)
    if unrest > left_out.reach:
        rate *= min(1.0, BOUNCE * math.sqrt(load / (spring * unrest)))
    return unrest * math.exp(-rate * h)


@in_kernel
def lifting(left_out: LeftOut, flying: bool) -> float:
    """Mean load [N] of a tick on a femur that flies, or that leaves the tibia when the load changes its sign."""
    begin, end = left_out.begin_load, left_out.end_load
    if flying or begin < 0.0 or end >= 0.0:
        return 0.5 * (begin + end)
    return 0.5 * end * end / (end - begin)


@in_kernel
def deviation_of_depth(deviation: Deviation, stiffness: float, damping: float, mass: float) -> float:
    """The deviation as an error of the depth [m]."""
    return depth_error(deviation.state, stiffness, damping, mass) + deviation.unrest
