"""Bounds of the exact solution by its energy, for when the error estimate may no longer hold.

A run loses the exact solution where a tick could not be resolved, or where its estimated error is so large that the
exact femur may be apart while the answer is in contact: the linearised contact is not valid then. What is left is a
bound on the energy of the exact femur. It is computed from the time at which the error becomes significant, so that it
is hardly more than the energy of the answer at that time; it is dropped when the error is no longer significant.

All quantities are along the normal: a mass m = M/n_y² at a depth z under the load P = L/n_y + m a, with what the
surface's acceleration a adds. While P presses, the energy is H = ½ m ż² + U(z) - P z, which a femur that is apart by h
has as P h; at rest it is smallest, and X above that. A load that rises raises H by P' h at most, one that falls by P'
z: the bounds of both follow from H, and so does the time in which the femur must come back to the depth at rest and
overshoot it. What the dashpot must at least take from that is taken from H. Under a load that pulls nothing but ½ m ż²
+ U(z) is bounded, and the distance. Where nothing damps the contact nothing is ever forgotten.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from knee_contact_ros.core.contact_laws.base import ContactLaw, static_force
from knee_contact_ros.core.energy import (
    FEW,
    LAYERS,
    LOOKS,
    STEPS,
    at_rest,
    elastic_energy,
    overshoot,
    softest,
    taken_by,
)
from knee_contact_ros.core.error_estimate import (
    EXPECTED,
    LARGEST_HEIGHT_ERROR,
    LARGEST_VELOCITY_ERROR,
    SPREAD,
    TINY,
    PropagatedError,
    reach,
    velocity_reach,
)
from knee_contact_ros.core.kernel_source import in_kernel, never_inlined
from knee_contact_ros.core.prescribed import Interval, load_at
from knee_contact_ros.core.statics import ANSWER

NONE, WATCHED, LOST = 0.0, 1.0, 2.0
"""Stages: the estimate holds; bounds are kept in case it should be lost; it is lost, and only the bounds hold"""
NOTED = 0.05
"""Part of the depth above which an error may grow until the exact solution is lost"""
SLACK = 1.2
"""Safety factor on the period of an oscillation with linear springs"""
CALMING = FEW + LOOKS + 2 * STEPS + 5 * LAYERS + 4
"""Largest number of evaluations of `calmed`"""
RESERVE = ANSWER + 3 * FEW + 2 * LOOKS + 4 * LAYERS + 10
"""Number of evaluations of a budget that are reserved for a static answer and the bounds of its error"""
LARGEST_ENERGY = LARGEST_VELOCITY_ERROR * LARGEST_VELOCITY_ERROR
"""Bound of any energy [J]"""


class Adrift(NamedTuple):
    """Bounds of the motion of the exact femur over the tibia."""

    stage: float
    """`NONE`, `WATCHED` or `LOST`"""
    energy: float
    """H [J] while the load presses; kinetic plus elastic energy while it pulls"""
    height: float
    """Largest distance [m] from the tibia"""
    load: float
    """P [N] at the last tick"""
    rest: float
    """Depth at rest [m] under P; 0 if it pulls"""
    stored: float
    """Lower bound of the energy [J] that the contact stores at rest"""
    pressed: float
    """Time [s] for which the load has pressed since the beginning of the window; see `calmed`"""
    least: float
    """Least P in the window [N]"""
    begun: float
    """H at the beginning of the window [J]"""
    impact: float
    """Largest penetration rate [m/s] at which the present contact may have begun"""


FOUND = Adrift(
    stage=NONE, energy=0.0, height=0.0, load=0.0, rest=0.0, stored=0.0, pressed=0.0, least=0.0, begun=0.0, impact=0.0,
)  # fmt: skip


class Drive(NamedTuple):
    """What moves the femur for some time, along the normal: load and acceleration of the surface."""

    mass: float
    """Mass m along the normal [kg]"""
    load: float
    """P at the end of that time [N]"""
    rise: float
    """Sum of all rises of P [N]"""
    fall: float
    """Sum of all falls of P [N]"""
    least: float
    """Least P [N]"""
    largest: float
    """Largest P [N]"""
    kick: float
    """Sum of all jumps of the surface's rate [m/s]"""
    duration: float
    """Length of that time [s]"""


class Enclosure(NamedTuple):
    """Bounds of the exact solution at the end of a tick."""

    least: float
    """Least depth [m]; < 0 apart"""
    most: float
    """Largest depth [m]"""
    rate: float
    """Largest absolute rate of the depth [m/s]"""
    force: float
    """Largest force [N]"""
    evaluations: int


@in_kernel
def loses(interval: Interval, depth: float, force: float, never_flies: bool, error: PropagatedError) -> bool:
    """Whether the exact femur may be apart from the tibia while that of the answer carries the load.

    `depth` [m] and `force` [N] along the height are those at the beginning of the tick. A level that never flies
    carries any load; a contact that is about to end or has just begun carries none, and the linearised contact is valid
    for it.
    """
    begin = interval.start_load
    if begin <= 0.0 or load_at(interval, interval.duration) <= 0.0:
        return False
    least = depth if depth > 0.0 else 0.0
    carries = never_flies or (depth > 0.0 and force >= 0.5 * begin)
    return carries and exceeds(error, least)


@in_kernel
def exceeds(error: PropagatedError, limit: float) -> bool:
    """Whether the error estimate of the height exceeds a limit [m]."""
    if 4.5 * error.height * error.height + 18.0 * error.hh <= limit * limit:  # no less than the square of the reach
        return False
    return reach(error, math.inf) > limit


@never_inlined
def bounds_near(
    law: ContactLaw, depth: float, rate: float, error: PropagatedError, impact: float, load: float, mass: float
) -> tuple[Adrift, int]:
    """Return bounds of an exact solution within an error of a `depth` [m] with its `rate` [m/s]; and evaluations.

    `load` [N] and `mass` [kg] are those along the normal; the contact has begun at no more than `impact` [m/s].
    """
    # The answer's height less the exact one's is expected to be that of the error, which is positive in deeper contact.
    doubt = (EXPECTED - 1.0) * abs(error.height) + SPREAD * math.sqrt(max(error.hh, 0.0))
    deepest, highest = depth + max(error.height + doubt, 0.0), max(0.0, -depth + max(doubt - error.height, 0.0))
    speed = abs(rate) + velocity_reach(error)
    stored, extra = elastic_energy(law, deepest, 1.0)
    energy = 0.5 * mass * speed * speed + stored
    if load > 0.0:
        energy += load * (highest if highest > 0.0 else max(doubt - error.height, 0.0) - depth)
    rest, stored, evaluations = at_rest(law, load, depth)
    return Adrift(
        stage=WATCHED, energy=energy, height=highest, load=load, rest=rest, stored=stored, pressed=0.0, least=load,
        begun=energy, impact=impact,
    ), evaluations + extra  # fmt: skip


@in_kernel
def excess_of(adrift: Adrift) -> float:
    """Return X [J], the energy above that at rest."""
    return max(adrift.energy + max(adrift.load, 0.0) * adrift.rest - adrift.stored, 0.0)


@never_inlined
def pushed(law: ContactLaw, adrift: Adrift, drive: Drive, near: float) -> tuple[Adrift, int]:
    """Return the bounds after some time without dissipation; `near` [m] guesses the depth at rest.

    The second number is that of evaluations.
    """
    rest, stored, evaluations = at_rest(law, drive.load, near if near > 0.0 else adrift.rest)
    presses = adrift.load > 0.0 and drive.least > 0.0
    if presses:
        energy, root, extra = pressed_on(law, adrift, drive, drive.load * rest - stored)
    else:
        energy, root, extra = pulled(law, adrift, drive)
    height = min(adrift.height + math.sqrt(2.0 / drive.mass) * root * drive.duration, LARGEST_HEIGHT_ERROR)
    pressed, least, begun = 0.0, drive.load, energy
    if presses:
        height = min(height, max(energy, 0.0) / drive.load)
        pressed, least = adrift.pressed + drive.duration, min(adrift.least, drive.least)
        begun = min(adrift.begun, energy)
    elif drive.load > 0.0:
        energy = begun = min(energy + drive.load * height, LARGEST_ENERGY)
    impact = max(adrift.impact, math.sqrt(2.0 / drive.mass) * root)
    return adrift._replace(
        energy=energy, height=height, load=drive.load, rest=rest, stored=stored, pressed=pressed, least=least,
        begun=begun, impact=impact,
    ), evaluations + extra  # fmt: skip


@in_kernel
def pressed_on(law: ContactLaw, adrift: Adrift, drive: Drive, still: float) -> tuple[float, float, int]:
    """Return energy [J] and root of the largest kinetic one [J^½] where the load presses all the time; and evaluations.

    `still` [J] is the work of the last load over the depth at rest, less the energy stored there. A surface whose rate
    jumps at every sample kicks the femur; except for one or two kicks in an oscillation, which may come at its largest
    speed, that has the effect of an acceleration.
    """
    mass, load, energy = drive.mass, adrift.load, adrift.energy
    _, stiffness, _ = static_force(law, adrift.rest)
    swing = 2.0 * math.sqrt(2.0 * max(energy, 0.0) * mass) / load + math.tau * math.sqrt(mass / max(stiffness, TINY))
    kick = math.sqrt(0.5 * mass) * drive.kick * min(1.0, 4.0 * drive.duration / swing)
    rest, evaluations = adrift.rest, 1
    most = max(still, load * rest - adrift.stored)
    if drive.largest > max(load, drive.load):
        rest, stored, evaluations = at_rest(law, drive.largest, rest)
        most, load = drive.largest * rest - stored, drive.largest
        _, stiffness, _ = static_force(law, rest)
        evaluations += 2
    root = math.sqrt(max(energy + most, 0.0)) + kick
    energy += kick * (2.0 * root - kick)
    energy = min(energy + drive.rise * max(energy, 0.0) / adrift.load, LARGEST_ENERGY)
    if drive.fall > 0.0:
        beyond, extra = overshoot(law, rest, load, stiffness, max(energy + most, 0.0))
        energy = min(energy + drive.fall * (rest + beyond), LARGEST_ENERGY)
        evaluations += extra
    return energy, math.sqrt(max(energy + most, 0.0)), evaluations


@in_kernel
def pulled(law: ContactLaw, adrift: Adrift, drive: Drive) -> tuple[float, float, int]:
    """Return kinetic plus elastic energy [J], its root [J^½] at most and evaluations, where the load pulls at times."""
    mass, energy, evaluations = drive.mass, adrift.energy, 0
    if adrift.load > 0.0:
        _, stiffness, _ = static_force(law, adrift.rest)
        beyond, evaluations = overshoot(law, adrift.rest, adrift.load, stiffness, excess_of(adrift))
        energy, evaluations = energy + adrift.load * (adrift.rest + beyond), evaluations + 1
    most = max(abs(adrift.load), abs(drive.largest), abs(drive.least))
    root = math.sqrt(max(energy, 0.0)) + math.sqrt(0.5 * mass) * drive.kick
    root += most * drive.duration / math.sqrt(2.0 * mass)
    return min(root * root, LARGEST_ENERGY), root, evaluations


@never_inlined
def calmed(law: ContactLaw, adrift: Adrift, mass: float) -> tuple[Adrift, int]:
    """Return the bounds less the energy that an overshoot dissipates, once there was time for one; and evaluations.

    Two windows compete: since the last overshoot, under the least load since then, and from now on.
    """
    if adrift.load <= 0.0:
        return adrift, 0
    speed = math.sqrt(2.0 * max(adrift.energy, 0.0) / mass)
    flight = 2.0 * speed * mass / adrift.least
    if 2.0 * speed * mass / adrift.load < flight - adrift.pressed:
        return with_window(adrift, adrift.energy), 0
    if adrift.pressed <= flight:
        return adrift, 0
    rest, _, evaluations = at_rest(law, adrift.least, adrift.rest)
    _, stiffness, _ = static_force(law, rest)
    stored, extra = elastic_energy(law, rest, 1.0)
    excess = adrift.begun + adrift.least * rest - stored
    evaluations += extra + 1
    if excess <= 0.0:
        return with_window(adrift, adrift.energy), evaluations
    beyond, extra = overshoot(law, rest, adrift.least, stiffness, excess)
    spring, more = softest(law, rest, adrift.least)
    _, _, above = static_force(law, 0.5 * rest)
    _, _, damping = static_force(law, rest + beyond)
    # Next to a boundary or under next to no load either spring may be none: then there is never time enough.
    spring, stiffness = max(spring, TINY), max(min(stiffness, 2.0 * excess / max(beyond * beyond, TINY)), TINY)
    evaluations += extra + more + 2
    swing = math.pi * math.sqrt(mass / spring) + above / spring
    swing += math.pi * math.sqrt(mass / stiffness) + 2.0 * damping / stiffness
    if adrift.pressed < flight + SLACK * swing:
        return adrift, evaluations
    taken, steps = taken_by(law, rest, beyond, adrift.least, excess, adrift.impact, mass)
    evaluations += steps
    energy = max(adrift.energy - taken, adrift.stored - adrift.load * adrift.rest)
    return with_window(adrift, energy), evaluations


@in_kernel
def with_window(adrift: Adrift, energy: float) -> Adrift:
    """Return bounds with another energy [J] and a window that begins now."""
    height = min(adrift.height, max(energy, 0.0) / adrift.load)
    return adrift._replace(energy=energy, height=height, pressed=0.0, least=adrift.load, begun=energy)


@never_inlined
def enclosure_of(law: ContactLaw, adrift: Adrift, mass: float) -> Enclosure:
    """Return the range of depth, rate and force that the bounds allow for."""
    load, excess = max(adrift.load, 0.0), excess_of(adrift)
    force, stiffness, _ = static_force(law, adrift.rest)
    beyond, evaluations = overshoot(law, adrift.rest, load, stiffness, excess)
    most = min(adrift.rest + beyond, LARGEST_HEIGHT_ERROR)
    spring, extra = softest(law, adrift.rest, load)
    # The depth at rest may be less than it is taken to be.
    back = (math.sqrt(2.0 * excess / spring) + max(force - load, 0.0) / spring) if spring > 0.0 else math.inf
    least = max(adrift.rest - back, 0.0) if back < adrift.rest else -adrift.height
    force, _, damping = static_force(law, most)
    rate = math.sqrt(2.0 * excess / mass)
    return Enclosure(least, most, rate, force + damping * rate, evaluations + extra + 2)


@in_kernel
def error_within(limits: Enclosure, depth: float, rate: float, cosine: float) -> PropagatedError:
    """Return the error of a `depth` [m] and its `rate` [m/s] if the exact ones lie within limits; `cosine` is n_y."""
    height = max(limits.most - depth, depth - limits.least) / (cosine * SPREAD)
    velocity = (limits.rate + abs(rate)) / (cosine * SPREAD)
    return PropagatedError(height=0.0, velocity=0.0, hh=height * height, hv=0.0, vv=velocity * velocity)
