"""How far a simpler level is from the dynamic one: the motion that it leaves out, by the linearised contact.

With x = level's height - dynamic height, M ẍ + C ẋ + K x = p, where p [N] is what the level left out of Eq. 13: the
inertia of its own motion, and for the quasi-static level the dashpot's force too. p/K, where x would come to rest, is
taken as linear over the tick. Where no load presses, the dynamic femur flies and x grows freely; how it lands from
there is no matter of a linear contact any more (`adrift.py`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from knee_contact_ros.core.error_estimate import (
    EXPECTED,
    SPREAD,
    TINY,
    CarriedError,
    carry_in_flight,
    curved,
    either,
    holding,
    propagated,
    with_bound,
    with_push,
)
from knee_contact_ros.core.kernel_source import in_kernel

SOFTEST = 1e-8
"""K h²/M below which the spring does not count in a tick"""
ROUGH = 0.2
"""Part of the change of x's place of rest in a tick that is not known, and of the swing that is left of x at its end"""
UNKNOWN_INERTIA = 0.8
"""Part of the inertia that is left out that is not known: it is a tick's mean"""
LOOSE = 0.03
"""The same of x itself: K and C are taken as constant"""
BENT = 0.5
"""The same over its part of the depth: K goes with the depth"""
ANOTHER = 1.0 / 3.0
"""Part of a slope of the contact by which it differs where it is another one"""
IN_STEP = 0.5
"""Radians of a swing up to which its phase is known"""
ANY_PHASE = 2.5
"""So many times its expected size a swing may have become by others of any phase: 1 in 500 is larger"""
LAUNCHED = 0.2
"""The same of a flight's beginning or end, and of what a load does to it"""

FASTEST = 10.0
"""Speed at which a contact is left, over that of its way to there in a tick, unless the load's work gives less"""


class LeftOut(NamedTuple):
    """What the linearised deviation follows over a tick."""

    stiffness: float
    """K [N/m] along the height, of the tick's middle"""
    damping: float
    """C [N s/m], likewise"""
    end_stiffness: float
    """[N/m] at its end"""
    end_damping: float
    """[N s/m] likewise"""
    begin_rest: float
    """p/K [m] at the tick's beginning"""
    end_rest: float
    """The same at its end"""
    way: float
    """Of the level [m] in the tick, beyond that of its velocity at the beginning"""
    gain: float
    """Of its velocity [m/s]"""
    inertia: float
    """Its mean acceleration times the mass [N]"""
    begin_load: float
    """[N] at the tick's beginning"""
    end_load: float
    """[N] at its end"""
    depth: float
    """Of the level in its layer [m] at the tick's end"""


@in_kernel
def deviate(error: CarriedError, left_out: LeftOut, mass: float, h: float) -> CarriedError:
    """The deviation after a tick of `h` [s]."""
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
    if swing > left_out.depth:  # It comes apart meanwhile, and lands as it may.
        unknown += swing
    moved = with_push(moved, spring * unknown, spring, left_out.damping, mass, h)
    if behind > 0.0:
        moved = with_bound(moved, behind, 0.0)
    if pulled_back(error, left_out, spring):
        moved = either(moved, carry_in_flight(error, h))
    return curved(moved, left_out.depth, spring, left_out.damping, mass, h)


@in_kernel
def unknown_way(error: CarriedError, moved: CarriedError, left_out: LeftOut) -> float:
    """How far [m] a deviation that goes from one to another may be wrong, by where it rests and by K and C."""
    size = abs(moved.height) + abs(error.height)
    bent = BENT * size * min(1.0, size / max(left_out.depth, TINY))
    return ROUGH * abs(left_out.end_rest - left_out.begin_rest) + LOOSE * size + bent


@in_kernel
def changes(middle: float, end: float) -> bool:
    """Whether a slope of the contact is another one at a tick's end than in its middle."""
    return abs(end - middle) > ANOTHER * middle


@in_kernel
def out_of_step(away: CarriedError, left_out: LeftOut, spring: float, mass: float, h: float) -> CarriedError:
    """A swing about the place of rest, as one of any phase where nobody can tell that at the tick's end."""
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
def pulled_back(error: CarriedError, left_out: LeftOut, spring: float) -> bool:
    """Whether the linearised contact draws the femur back to the level by more than the load, which no contact does."""
    pull = EXPECTED * abs(spring * error.height + left_out.damping * error.velocity)
    return pull > min(left_out.begin_load, left_out.end_load)


@in_kernel
def carried_off(left_out: LeftOut) -> LeftOut:
    """A tick in which the surface goes away faster than the load presses the femur after it, seen from the surface."""
    begin, end = left_out.begin_load + left_out.inertia, left_out.end_load + left_out.inertia
    return left_out._replace(way=0.0, gain=0.0, inertia=0.0, begin_load=begin, end_load=end)


@in_kernel
def fly(error: CarriedError, left_out: LeftOut, mass: float, h: float) -> CarriedError:
    """The deviation after a tick of `h` [s] in which nothing presses, or not throughout."""
    lift, launch = lifted(left_out.begin_load, left_out.end_load, mass, h)
    way, gain = left_out.way, left_out.gain
    unknown_way = 2.0 * LAUNCHED * (abs(way) + abs(lift))
    unknown_gain = LAUNCHED * (abs(gain) + abs(launch))
    if left_out.begin_load > 0.0:
        # The contact that lets go throws the femur after the level that it carries, the faster the softer it becomes.
        thrown = abs(way) / h
        fastest = min(FASTEST * thrown, math.sqrt(left_out.begin_load * abs(way) / mass))
        unknown_way, unknown_gain = unknown_way + abs(way), unknown_gain + max(thrown, fastest)
        way, gain = 0.0, gain - thrown
    flown = carry_in_flight(error, h)
    height, velocity = flown.height + way + lift, flown.velocity + gain + launch
    if height > 0.0 and left_out.end_load <= 0.0:
        # No femur is below a level that nothing presses: it is carried, or thrown up by the tibia.
        unknown_way, height = unknown_way + height, 0.0
        if velocity > 0.0:
            unknown_gain, velocity = unknown_gain + 0.5 * velocity, -0.5 * velocity
    return with_bound(flown._replace(height=height, velocity=velocity), unknown_way, unknown_gain)


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
def lifted(begin: float, end: float, mass: float, h: float) -> tuple[float, float]:
    """How far [m] below, and how much slower [m/s], loads of a tick [N] leave a level than a femur that is let go."""
    if begin <= 0.0:
        return (2.0 * begin + end) * h * h / (6.0 * mass), 0.5 * (begin + end) * h / mass
    flying = h * end / (end - begin) if end < 0.0 else 0.0
    return end * flying * flying / (6.0 * mass), 0.5 * end * flying / mass
