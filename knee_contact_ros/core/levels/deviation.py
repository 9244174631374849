"""Deviation of a simpler level from the dynamic one: the motion that it leaves out, by the linearised contact.

With x = level's height - dynamic height, M ẍ + C ẋ + K x = p, where p [N] is what the level left out of Eq. 13: the
inertia of its own motion, and for the quasi-static level the force of the dashpot too. p/K, where x would come to rest,
is taken as linear over the tick. Where no load presses, the dynamic femur flies and x grows freely; its landing is
beyond a linearised contact (`adrift.py`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from knee_contact_ros.core.error_estimate import (
    EXPECTED,
    SPREAD,
    TINY,
    PropagatedError,
    curved,
    either,
    holding,
    propagated,
    propagated_in_flight,
    with_bound,
    with_push,
)
from knee_contact_ros.core.kernel_source import in_kernel

SOFTEST = 1e-8
"""K h²/M below which the spring has no effect in a tick"""
ROUGH = 0.2
"""Unknown part of the change of p/K in a tick, and of the oscillation of x that is left at its end"""
UNKNOWN_INERTIA = 0.8
"""Unknown part of the inertia that is left out, of which only the mean over a tick is known"""
LOOSE = 0.03
"""Unknown part of x itself, as K and C are taken as constant"""
BENT = 0.5
"""Unknown part of x over its part of the depth, as K changes with the depth"""
ANOTHER = 1.0 / 3.0
"""Part of K or C by which they must change in a tick to be taken as others at its end"""
IN_STEP = 0.5
"""Phase error of an oscillation [rad] up to which its phase counts as known"""
ANY_PHASE = 2.5
"""Factor by which an oscillation may have grown by others of unknown phase: 1 in 500 is larger"""
LAUNCHED = 0.2
"""Unknown part of the beginning or end of a flight, and of what the load does in it"""

FASTEST = 10.0
"""Speed at which a contact ends, over its mean speed in the tick, unless the work of the load gives less"""


class LeftOut(NamedTuple):
    """Quantities of a tick that the linearised deviation depends on."""

    stiffness: float
    """K [N/m] along the height, in the middle of the tick"""
    damping: float
    """C [N s/m] along the height, in the middle of the tick"""
    end_stiffness: float
    """K [N/m] at the end of the tick"""
    end_damping: float
    """C [N s/m] at the end of the tick"""
    begin_rest: float
    """p/K [m] at the beginning of the tick"""
    end_rest: float
    """p/K [m] at the end of the tick"""
    way: float
    """Way of the level [m] in the tick, beyond that of its velocity at the beginning"""
    gain: float
    """Change of the level's velocity [m/s] in the tick"""
    inertia: float
    """Mean acceleration of the level times the mass [N]"""
    begin_load: float
    """Load [N] at the beginning of the tick"""
    end_load: float
    """Load [N] at the end of the tick"""
    depth: float
    """Depth of the level in its layer [m] at the end of the tick"""


@in_kernel
def deviate(error: PropagatedError, left_out: LeftOut, mass: float, h: float) -> PropagatedError:
    """Return the deviation after a tick of `h` [s], from that at its beginning."""
    if left_out.begin_load <= 0.0 or left_out.end_load <= 0.0:
        return fly(error, left_out, mass, h)
    if min(left_out.begin_load, left_out.end_load) + left_out.inertia <= 0.0:
        return fly(error, carried_off(left_out), mass, h)
    spring = max(left_out.stiffness, SOFTEST * mass / (h * h))
    drift = (left_out.end_rest - left_out.begin_rest) / h
    lag = left_out.damping / spring * drift
    behind = lagging(error.velocity, left_out, mass, h)
    away = error._replace(height=error.height - behind - left_out.begin_rest + lag, velocity=error.velocity - drift)
    held = holding(spring, left_out.damping, mass)
    swing = abs(away.velocity) / held
    away = out_of_step(away, left_out, spring, mass, h)
    moved = propagated(away, spring, left_out.damping, mass, h)
    if changes(spring, left_out.end_stiffness) or changes(left_out.damping, left_out.end_damping):
        moved = either(moved, propagated(away, left_out.end_stiffness, left_out.end_damping, mass, h))
    still_swings = math.sqrt(moved.height * moved.height + moved.velocity * moved.velocity / (held * held))
    doubted = SPREAD * math.sqrt(max(moved.hh + moved.vv / (held * held), 0.0))
    moved = moved._replace(height=moved.height + left_out.end_rest - lag, velocity=moved.velocity + drift)
    unknown = max(ROUGH * still_swings - doubted, 0.0) + unknown_way(error, moved, left_out)
    if swing > left_out.depth:  # The surfaces come apart meanwhile, and land somehow.
        unknown += swing
    moved = with_push(moved, spring * unknown, spring, left_out.damping, mass, h)
    if behind > 0.0:
        moved = with_bound(moved, behind, 0.0)
    if pulled_back(error, left_out, spring):
        moved = either(moved, propagated_in_flight(error, h))
    return curved(moved, left_out.depth, spring, left_out.damping, mass, h)


@in_kernel
def unknown_way(error: PropagatedError, moved: PropagatedError, left_out: LeftOut) -> float:
    """Return how far [m] a deviation may be wrong because p/K is not linear and K and C are not constant."""
    size = abs(moved.height) + abs(error.height)
    bent = BENT * size * min(1.0, size / max(left_out.depth, TINY))
    return ROUGH * abs(left_out.end_rest - left_out.begin_rest) + LOOSE * size + bent


@in_kernel
def changes(middle: float, end: float) -> bool:
    """Whether K or C at the end of a tick differs much from that in its middle."""
    return abs(end - middle) > ANOTHER * middle


@in_kernel
def out_of_step(away: PropagatedError, left_out: LeftOut, spring: float, mass: float, h: float) -> PropagatedError:
    """Return a deviation from rest, as one of any phase if its phase at the end of the tick is not known."""
    frequency = math.sqrt(spring / mass)
    if h * frequency <= IN_STEP or left_out.damping >= 2.0 * frequency * mass:
        return away
    late = abs(math.sqrt(max(left_out.end_stiffness, 0.0) / mass) - frequency) + LOOSE * frequency
    if h * late <= IN_STEP:
        return away
    square = away.height * away.height + away.velocity * away.velocity / (frequency * frequency)
    added = ANY_PHASE * ANY_PHASE * square / (SPREAD * SPREAD)
    return away._replace(height=0.0, velocity=0.0, hh=away.hh + added, vv=away.vv + added * frequency * frequency)


@in_kernel
def pulled_back(error: PropagatedError, left_out: LeftOut, spring: float) -> bool:
    """Whether the linearised contact pulls the femur towards the level with more than the load, as no contact does."""
    pull = EXPECTED * abs(spring * error.height + left_out.damping * error.velocity)
    return pull > min(left_out.begin_load, left_out.end_load)


@in_kernel
def carried_off(left_out: LeftOut) -> LeftOut:
    """Return a tick in which the surface recedes faster than the load can move the femur, seen from the surface."""
    begin, end = left_out.begin_load + left_out.inertia, left_out.end_load + left_out.inertia
    return left_out._replace(way=0.0, gain=0.0, inertia=0.0, begin_load=begin, end_load=end)


@in_kernel
def fly(error: PropagatedError, left_out: LeftOut, mass: float, h: float) -> PropagatedError:
    """Return the deviation after a tick of `h` [s] in which the load does not press throughout."""
    lift, launch = lifted(left_out.begin_load, left_out.end_load, mass, h)
    way, gain = left_out.way, left_out.gain
    unknown_way = 2.0 * LAUNCHED * (abs(way) + abs(lift))
    unknown_gain = LAUNCHED * (abs(gain) + abs(launch))
    if left_out.begin_load > 0.0:
        # A contact that ends throws the femur after the level that it carries, the faster the softer it becomes.
        thrown = abs(way) / h
        fastest = min(FASTEST * thrown, math.sqrt(left_out.begin_load * abs(way) / mass))
        unknown_way, unknown_gain = unknown_way + abs(way), unknown_gain + max(thrown, fastest)
        way, gain = 0.0, gain - thrown
    flown = propagated_in_flight(error, h)
    height, velocity = flown.height + way + lift, flown.velocity + gain + launch
    if height > 0.0 and left_out.end_load <= 0.0:
        # No femur is below a level that nothing presses: it is carried, or thrown up by the tibia.
        unknown_way, height = unknown_way + height, 0.0
        if velocity > 0.0:
            unknown_gain, velocity = unknown_gain + 0.5 * velocity, -0.5 * velocity
    return with_bound(flown._replace(height=height, velocity=velocity), unknown_way, unknown_gain)


@in_kernel
def lagging(velocity: float, left_out: LeftOut, mass: float, h: float) -> float:
    """Return how far [m] at most the femur falls behind a level that sinks away from it in `h` [s].

    `velocity` [m/s] is that of the level relative to the femur. The linearised dashpot would pull the femur along
    with more than the load, but the contact does not pull: only the load accelerates the femur.
    """
    load = 0.5 * (left_out.begin_load + left_out.end_load)
    if left_out.damping * -velocity <= load:
        return 0.0
    speed = -velocity - load / left_out.damping
    return min(speed * h, 0.5 * mass * speed * speed / load) if load > 0.0 else speed * h


@in_kernel
def lifted(begin: float, end: float, mass: float, h: float) -> tuple[float, float]:
    """How far [m] and how fast [m/s] a level falls behind a femur that the loads [N] of a tick pull away, both <= 0."""
    if begin <= 0.0:
        return (2.0 * begin + end) * h * h / (6.0 * mass), 0.5 * (begin + end) * h / mass
    flying = h * end / (end - begin) if end < 0.0 else 0.0
    return end * flying * flying / (6.0 * mass), 0.5 * end * flying / mass
