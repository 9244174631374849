"""Where the exact solution can be, once it has been lost: wherever its energy lets it be, until the contact forgets.

A run loses the exact solution where a tick could not be resolved, or where its estimated error is so large that the
exact femur may be apart while the answer is in contact: the linearised contact says nothing then. What is left is a
bound on the femur's energy: kinetic, elastic, and that of the load over its height. A pulling load raises it, a
pressing one keeps it but for its own change, and each compression takes from it what the dashpot must at least take.
Where nothing damps the contact nothing is ever forgotten.

The bound on a compression: from touch at a speed v to the depth z where a quarter of that energy is stored, the femur
is at least half as fast unless the dashpot has taken half of the energy already; so it takes min(½ E, ½ v ∫ c dz), for
dampings c that do not fall with the depth (`LayerFormula`).

The load that presses the femur in bounds it, too: as long as the energy would do for a flight, it comes to half of the
static depth z, or to the layer that this lies in, at no less than the root of L z/M, as U(z) <= ½ F(z) z <= ½ L z; and
it goes on to the static depth at least, and back.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from knee_contact_ros.core.contact_laws.base import layer_at, static_force
from knee_contact_ros.core.error_estimate import (
    LARGEST_HEIGHT_ERROR,
    LARGEST_VELOCITY_ERROR,
    SPREAD,
    TINY,
    CarriedError,
    reach,
    velocity_reach,
)
from knee_contact_ros.core.kernel_source import aside, in_kernel
from knee_contact_ros.core.prescribed import Interval, load_at
from knee_contact_ros.core.regions import Regions
from knee_contact_ros.core.statics import ANSWER, static_depth

SWING = 0.7
"""Largest part of the depth that such a swing has, so that height and velocity together stay within it"""
NEAR = 0.1
"""Energy over what lifts the femur out of its static contact from which on it stays in contact, give or take"""
HALVINGS = 8
"""Looks for the depth that stores a quarter of the energy; it is in question by a part of 2^(1/HALVINGS-th) decade"""
FEW = 6
"""Evaluations for a static depth that need not be exact"""
RESERVE = ANSWER + 2 * FEW + HALVINGS + 5
"""Evaluations that a budget keeps for an answer and for the bounds of what it does not know"""
THERE_AND_BACK = 8.0
"""Time from touch to touch in units of the root of mass times static depth over load, where the load does the most"""
SHALLOWEST = 1e-9
"""[m] of these depths"""


class Adrift(NamedTuple):
    """Bounds of the exact solution's motion over the tibia."""

    energy: float
    """[J] kinetic and elastic, and that of a pressing load over the height; 0: it is not adrift"""
    height: float
    """[m] that it is at most above the tibia"""
    pressed: float
    """[s] for which the load has pressed since the last compression that counts"""


FOUND = Adrift(0.0, 0.0, 0.0)


class Range(NamedTuple):
    """What the exact solution can be at a tick's end."""

    depth: float
    """Largest [m]; the least is -`height`"""
    height: float
    """[m]"""
    force: float
    """Largest [N]"""
    evaluations: int


@in_kernel
def loses(interval: Interval, depth: float, force: float, never_flies: bool, error: CarriedError) -> bool:
    """Whether an answer that carries the load may have an exact solution that is apart from the tibia.

    `depth` [m] and `force` [N] along the height are those of the tick's beginning. A level that never flies carries any
    load; a contact that is about to part, or has just been touched, carries none yet, and errs as its linear one does.
    """
    begin = interval.start_load
    if begin <= 0.0 or load_at(interval, interval.duration) <= 0.0:
        return False
    least = depth if depth > 0.0 else 0.0
    if 4.5 * error.height * error.height + 18.0 * error.hh <= least * least:  # no less than the square of the reach
        return False
    carries = never_flies or (depth > 0.0 and force >= 0.5 * begin)
    return carries and reach(error, math.inf) > least


@in_kernel
def set_adrift(depth: float, rate: float, elastic: float, load: float, error: CarriedError, mass: float) -> Adrift:
    """Bounds that hold for an exact solution that lies within an error of a contact.

    `depth` [m], `rate` [m/s] and the force at rest `elastic` [N] are the contact's, `load` [N] presses.
    """
    off, speed = reach(error, math.inf), abs(rate) + velocity_reach(error)
    height = max(0.0, -depth) + off
    stored = elastic * max(depth, 0.0)
    return Adrift(0.5 * mass * speed * speed + stored + max(load, 0.0) * height + TINY, height, 0.0)


@in_kernel
def pushed(interval: Interval, adrift: Adrift, kick: float, mass: float) -> Adrift:
    """The bounds after an interval that takes nothing from them; `kick` [m/s] is the surface's change of rate in it."""
    h, kicked = interval.duration, math.sqrt(adrift.energy) + math.sqrt(0.5 * mass) * abs(kick)
    begin, end = interval.start_load, load_at(interval, h)
    least, most = min(begin, end), max(abs(begin), abs(end))
    speed = min(math.sqrt(2.0 / mass) * kicked + most * h / mass, LARGEST_VELOCITY_ERROR)
    height = min(adrift.height + speed * h, LARGEST_HEIGHT_ERROR)
    if least <= 0.0:
        return Adrift(0.5 * mass * speed * speed, height, 0.0)
    energy = kicked * kicked + (most * adrift.height if adrift.pressed == 0.0 else 0.0)
    height = min(height, energy / least)
    energy += abs(end - begin) * max(height, SHALLOWEST)
    energy = min(energy, 0.5 * mass * LARGEST_VELOCITY_ERROR * LARGEST_VELOCITY_ERROR)
    return Adrift(energy, min(height, energy / least), adrift.pressed + h)


@aside
def calmed(regions: Regions, load: float, adrift: Adrift, mass: float) -> tuple[Adrift, int]:
    """The bounds less what a compression takes from them, once there has been time for one; and its evaluations.

    `load` [N] is the least of late.
    """
    if adrift.pressed == 0.0 or load <= 0.0:
        return adrift, 0
    speed = math.sqrt(2.0 * adrift.energy / mass)
    flight = 2.0 * speed * mass / load
    if adrift.pressed < flight:
        return adrift, 0
    depth, evaluations = storing(regions, 0.25 * adrift.energy)
    static = static_depth(regions.law, load, depth, 1e-9, FEW)
    evaluations += static.evaluations
    if adrift.pressed < flight + max(math.pi * depth / speed, THERE_AND_BACK * math.sqrt(mass * static.depth / load)):
        return adrift, evaluations
    half = 0.5 * depth
    _, _, damping = regions.law.layers[max(0, layer_at(regions.law, half))].formula.force_at(half, 0.0, speed)
    taken = min(0.5 * adrift.energy, 0.25 * speed * damping * depth)
    layer = regions.law.layers[max(0, layer_at(regions.law, static.depth))]
    near = max(layer.begin, 0.5 * static.depth)
    _, _, damping = layer.formula.force_at(near, 0.0, speed)
    # Half of what there and back take: the static depth is not exact.
    taken = max(taken, damping * math.sqrt(load * near / mass) * (static.depth - near))
    energy = max(adrift.energy - taken, TINY)
    return Adrift(energy, min(adrift.height, energy / load), TINY), evaluations + 2


@in_kernel
def storing(regions: Regions, energy: float) -> tuple[float, int]:
    """A depth [m] at which a contact stores no more than an energy [J] (½ F z bounds it: the force is convex)."""
    low, high = SHALLOWEST, 1.0
    for _ in range(HALVINGS):
        middle = math.sqrt(low * high)
        if 0.5 * static_force(regions.law, middle)[0] * middle <= energy:
            low = middle
        else:
            high = middle
    return low, HALVINGS


@aside
def range_of(regions: Regions, interval: Interval, adrift: Adrift, near: float, mass: float) -> Range:
    """What the contact can be at the end of an interval; `near` [m] is a guess of the static depth."""
    load = max(load_at(interval, interval.duration), 0.0)
    static = static_depth(regions.law, load, near, 1e-9, FEW)
    _, stiffness, _ = static_force(regions.law, static.depth)
    evaluations = static.evaluations + (1 if static.depth > 0.0 else 0) + 1
    energy = adrift.energy + load * static.depth
    if stiffness > 0.0:
        depth = static.depth + math.sqrt(2.0 * energy / stiffness)
    else:
        depth, looks = storing(regions, 16.0 * energy)
        depth, evaluations = 4.0 * depth, evaluations + looks
    at_rest, _, damping = static_force(regions.law, depth)
    force = at_rest + damping * math.sqrt(2.0 * energy / mass)
    return Range(depth, adrift.height, force, evaluations)


@in_kernel
def found_again(adrift: Adrift, depth: float, load: float) -> bool:
    """Whether the energy keeps the exact solution in a contact that is `depth` [m] deep under a load [N]."""
    return load > 0.0 and adrift.energy <= NEAR * load * depth


@in_kernel
def error_near(depth: float, held: float) -> CarriedError:
    """The error of a contact `depth` [m] deep whose exact solution is found again: a swing that does not leave it.

    `held` [1/s] is the rate at which the contact holds velocities.
    """
    height = SWING * depth / SPREAD
    return CarriedError(0.0, 0.0, height * height, 0.0, height * height * held * held)
