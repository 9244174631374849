"""How far a simpler level is from the dynamic one: the motion that it leaves out, by the linearised contact.

With x = level's height - dynamic height, M ẍ + C ẋ + K x = p, where p [N] is what the level left out of Eq. 13: the
inertia of its own motion, and for the quasi-static level the dashpot's force too. p/K, where x would come to rest, is
taken as linear over the tick. Where no load presses, the dynamic femur flies and x grows freely; how it lands from
there is no matter of a linear contact any more (`adrift.py`).
"""

from __future__ import annotations

from typing import NamedTuple

from knee_contact_ros.core.error_estimate import (
    CarriedError,
    carry,
    carry_in_flight,
    curved,
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
LAUNCHED = 0.2
"""The same of a flight's acceleration"""


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
    acceleration: float
    """Of the level [m/s²]"""
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
        push = left_out.acceleration + lifting(left_out) / mass
        flown = carry_in_flight(error, h)
        flown = CarriedError(flown.height + 0.5 * push * h * h, flown.velocity + push * h, flown.hh, flown.hv, flown.vv)
        return with_bound(flown, LAUNCHED * abs(push) * h * h, LAUNCHED * abs(push) * h)
    spring = max(left_out.stiffness, SOFTEST * mass / (h * h))
    drift = (left_out.end_rest - left_out.begin_rest) / h
    lag = left_out.damping / spring * drift
    behind = lagging(error.velocity, left_out, mass, h)
    away = CarriedError(
        error.height - behind - left_out.begin_rest + lag, error.velocity - drift, error.hh, error.hv, error.vv
    )
    moved = carry(away, spring, left_out.damping, mass, h)
    moved = CarriedError(moved.height + left_out.end_rest - lag, moved.velocity + drift, moved.hh, moved.hv, moved.vv)
    unknown = ROUGH * abs(left_out.end_rest - left_out.begin_rest) + LOOSE * (abs(moved.height) + abs(error.height))
    moved = with_push(moved, spring * unknown, spring, left_out.damping, mass, h)
    if behind > 0.0:
        moved = with_bound(moved, behind, 0.0)
    return curved(moved, left_out.depth, spring, left_out.damping, mass, h)


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
def lifting(left_out: LeftOut) -> float:
    """Mean load [N] of a tick on a femur that leaves the tibia when the load changes its sign, if it does."""
    begin, end = left_out.begin_load, left_out.end_load
    if begin < 0.0 or end >= 0.0:
        return 0.5 * (begin + end)
    return 0.5 * end * end / (end - begin)
