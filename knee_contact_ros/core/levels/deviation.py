"""How far a simpler level is from the dynamic one: the motion that it leaves out, by the linearised contact.

With x = level's height - dynamic height, M ẍ + C ẋ + K x = p, where p [N] is what the level left out of Eq. 13: the
inertia of its own motion, and for the quasi-static level the dashpot's force too. p/K, where x would come to rest, is
taken as linear over the tick. Where no load presses, the dynamic femur flies and x grows freely; how it lands from
there is no matter of a linear contact any more (`adrift.py`).
"""

from __future__ import annotations

from typing import NamedTuple

from knee_contact_ros.core.error_estimate import (
    TINY,
    CarriedError,
    carry_in_flight,
    curved,
    holding,
    propagated,
    with_bound,
    with_push,
)
from knee_contact_ros.core.kernel_source import in_kernel

SOFTEST = 1e-8
"""K h²/M below which the spring does not count in a tick"""
ROUGH = 0.2
"""Part of the change of x's place of rest in a tick that is not known"""
LOOSE = 0.03
"""The same of x itself: K and C are taken as constant"""
BENT = 0.5
"""The same over its part of the depth: K goes with the depth"""
LAUNCHED = 0.2
"""The same of a flight's beginning or end, and of what a load does to it"""


class LeftOut(NamedTuple):
    """What the linearised deviation follows over a tick."""

    stiffness: float
    """K [N/m] along the height, of the tick's middle"""
    damping: float
    """C [N s/m], likewise"""
    begin_rest: float
    """p/K [m] at the tick's beginning"""
    end_rest: float
    """The same at its end"""
    way: float
    """Of the level [m] in the tick, beyond that of its velocity at the beginning"""
    gain: float
    """Of its velocity [m/s]"""
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
    spring = max(left_out.stiffness, SOFTEST * mass / (h * h))
    drift = (left_out.end_rest - left_out.begin_rest) / h
    lag = left_out.damping / spring * drift
    behind = lagging(error.velocity, left_out, mass, h)
    away = CarriedError(
        height=error.height - behind - left_out.begin_rest + lag, velocity=error.velocity - drift, hh=error.hh,
        hv=error.hv, vv=error.vv,
    )  # fmt: skip
    moved = propagated(away, spring, left_out.damping, mass, h)
    moved = CarriedError(
        height=moved.height + left_out.end_rest - lag, velocity=moved.velocity + drift, hh=moved.hh, hv=moved.hv,
        vv=moved.vv,
    )  # fmt: skip
    size = abs(moved.height) + abs(error.height)
    unknown = ROUGH * abs(left_out.end_rest - left_out.begin_rest) + LOOSE * size
    unknown += BENT * size * min(1.0, size / max(left_out.depth, TINY))
    swing = abs(away.velocity) / holding(spring, left_out.damping, mass)
    if swing > left_out.depth:  # It comes apart meanwhile, and lands as it may.
        unknown += swing
    moved = with_push(moved, spring * unknown, spring, left_out.damping, mass, h)
    if behind > 0.0:
        moved = with_bound(moved, behind, 0.0)
    return curved(moved, left_out.depth, spring, left_out.damping, mass, h)


@in_kernel
def fly(error: CarriedError, left_out: LeftOut, mass: float, h: float) -> CarriedError:
    """The deviation after a tick of `h` [s] in which nothing presses, or not throughout."""
    lift, launch = lifted(left_out.begin_load, left_out.end_load, mass, h)
    way, gain = left_out.way, left_out.gain
    unknown_way = 2.0 * LAUNCHED * (abs(way) + abs(lift))
    unknown_gain = LAUNCHED * (abs(gain) + abs(launch))
    if left_out.begin_load > 0.0:
        # The contact that lets go throws the femur after the level that it carries.
        thrown = abs(way) / h
        unknown_way, unknown_gain = unknown_way + abs(way), unknown_gain + thrown
        way, gain = 0.0, gain - thrown
    flown = carry_in_flight(error, h)
    height, velocity = flown.height + way + lift, flown.velocity + gain + launch
    if height > 0.0 and left_out.end_load <= 0.0:
        # No femur is below a level that nothing presses: it is carried, or thrown up by the tibia.
        unknown_way, height = unknown_way + height, 0.0
        if velocity > 0.0:
            unknown_gain, velocity = unknown_gain + 0.5 * velocity, -0.5 * velocity
    flown = CarriedError(height=height, velocity=velocity, hh=flown.hh, hv=flown.hv, vv=flown.vv)
    return with_bound(flown, unknown_way, unknown_gain)


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
