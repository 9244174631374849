"""Bounds of how far an energy carries a femur in a contact, and of how much energy the dashpot dissipates.

Contact laws give no energies. The bounds follow from their contract (`ContactLaw`): at rest the force rises with the
depth, and is convex within a layer.
"""

from __future__ import annotations

import math

from knee_contact_ros.core.contact_laws.base import ContactLaw, layer_at, static_force
from knee_contact_ros.core.error_estimate import LARGEST_HEIGHT_ERROR, TINY
from knee_contact_ros.core.kernel_source import in_kernel
from knee_contact_ros.core.statics import static_depth

FEW = 3
"""Number of evaluations for a static depth that need not be exact"""
LOOKS = 3
"""Number of evaluations for the depth that an energy reaches"""
FIRST_LOOK = 1e-4
"""First guess of an overshoot [m] where nothing else is known"""
STEPS = 10
"""Number of pieces of an overshoot, on each of its two ways"""
TAKEN = 0.8
"""Safety factor on the dissipated energy that the pieces give"""
LAYERS = 2
"""Number of layers that the limits of evaluations allow for; a law with more layers takes more evaluations"""


@in_kernel
def at_rest(law: ContactLaw, load: float, near: float) -> tuple[float, float, int]:
    """Return the depth at rest [m] under a load [N], a lower bound of the energy stored there [J], and evaluations.

    `near` [m] is a guess. Only load times depth less the stored energy is bounded: the depth need not be exact.
    """
    static = static_depth(law, load, max(near, 0.0), 1e-9, FEW)
    stored, extra = elastic_energy(law, static.depth, 0.5)
    force, stiffness, _ = static_force(law, static.depth)
    off, way = abs(force - load), static.depth
    if force >= load:
        for layer in law.layers:  # The layer is the right one: its beginning carries less than the load.
            way = static.depth - layer.begin if layer.begin < static.depth else way
    elif force < 0.5 * load:
        way = off / max(stiffness, TINY)
    # Where the depth is not exact, the load does more over the exact one than is stored there by no more than this.
    more = off * min(way, off / max(stiffness, TINY)) if force < load else off * way
    return static.depth, stored - more, static.evaluations + extra + 1


@in_kernel
def elastic_energy(law: ContactLaw, depth: float, part: float) -> tuple[float, int]:
    """Return a bound of the energy [J] that a contact stores at a depth [m], and evaluations.

    It is an upper bound with `part` 1, a lower one with `part` ½. In each layer the force is convex: below the line
    through its ends, and on average above its value in the middle.
    """
    energy, begin, force, evaluations = 0.0, 0.0, 0.0, 0
    for index in range(len(law.layers)):
        if begin < depth:
            end = min(law.layers[index + 1].begin, depth) if index + 1 < len(law.layers) else depth
            reached, _, _ = law.layers[index].formula.force_at(begin + part * (end - begin), 0.0, 0.0)
            energy += (end - begin) * (0.5 * (force + reached) if part == 1.0 else reached)
            begin, force, evaluations = end, reached, evaluations + 1
    return energy, evaluations


@in_kernel
def overshoot(law: ContactLaw, rest: float, load: float, stiffness: float, excess: float) -> tuple[float, int]:
    """How far [m] beyond its depth at rest [m] a contact with an excess energy [J] comes at most, and evaluations.

    Within a layer the force is convex, so that its tangent at rest, the `stiffness` [N/m], is a bound; another layer
    may be softer at first, and there only the rise of the force is used.
    """
    far = math.sqrt(2.0 * excess / stiffness) if stiffness > 0.0 else math.inf
    begin = math.inf if stiffness > 0.0 else rest
    for index in range(len(law.layers) - 1, 0, -1):
        begin = law.layers[index].begin if stiffness > 0.0 and law.layers[index].begin >= rest else begin
    if begin >= rest + far:
        return far, 0
    first, evaluations = begin - rest, 1
    force, _, _ = static_force(law, begin)
    there, left = max(force - load, stiffness * first, 0.0), excess - 0.5 * stiffness * first * first
    found = min(left / max(there, TINY), LARGEST_HEIGHT_ERROR)
    tried = min(math.sqrt(2.0 * left / stiffness) if stiffness > 0.0 else FIRST_LOOK, 0.5 * found)
    shrinks = False
    for look in range(LOOKS):
        half, _, _ = static_force(law, begin + 0.5 * tried)
        evaluations += 1
        enough = 0.5 * tried * (there + half - load) >= left
        shrinks = enough if look == 0 else shrinks
        found = tried if enough else found
        if enough != shrinks or (not shrinks and 8.0 * tried >= found):
            break
        tried *= 0.5 if shrinks else 8.0
    return first + found, evaluations


@in_kernel
def softest(law: ContactLaw, rest: float, load: float) -> tuple[float, int]:
    """Return the least spring [N/m] that draws a femur back to its depth at rest [m] from above, and evaluations.

    In each layer the force is convex, so that the spring is softest from a layer's beginning.
    """
    spring, evaluations = load / max(rest, TINY), 0
    for index in range(1, len(law.layers)):
        begin = law.layers[index].begin
        if begin < rest:
            force, _, _ = law.layers[index - 1].formula.force_at(begin, 0.0, 0.0)
            spring, evaluations = min(spring, max(load - force, 0.0) / (rest - begin)), evaluations + 1
    return spring, evaluations


@in_kernel
def taken_by(
    law: ContactLaw, rest: float, beyond: float, load: float, excess: float, impact: float, mass: float
) -> tuple[float, int]:
    """Return the energy [J] that the dashpot dissipates between the depth at rest [m], the deepest point, and back.

    The deepest point lies at most `beyond` [m] beyond; the faster a contact has begun, the less it may be damped. The
    way is integrated in pieces within layers by the midpoint rule, times `TAKEN`. The second number is that of
    evaluations.
    """
    piece, depth, kinetic, taken, evaluations = beyond / STEPS, rest, excess, 0.0, 0
    while kinetic > 0.0 and evaluations < STEPS + LAYERS:
        layer = max(0, layer_at(law, depth))
        end = depth + piece if layer + 1 == len(law.layers) else min(depth + piece, law.layers[layer + 1].begin)
        force, _, damping = law.layers[layer].formula.force_at(0.5 * (depth + end), 0.0, impact)
        evaluations += 1
        free = kinetic - (force - load) * (end - depth)
        work = min(damping * math.sqrt((kinetic + max(free, 0.0)) / mass) * (end - depth), kinetic)
        part = 1.0 if free > work else kinetic / (kinetic - free + work)
        taken, depth, kinetic = taken + part * work, depth + part * (end - depth), max(free - work, 0.0)
    kinetic, piece, pieces = 0.0, (depth - rest) / STEPS, 0
    while depth > rest and pieces < STEPS + LAYERS:
        layer = 0
        for index in range(1, len(law.layers)):
            layer += 1 if law.layers[index].begin < depth else 0
        end = max(depth - piece, law.layers[layer].begin, rest)
        force, _, damping = law.layers[layer].formula.force_at(0.5 * (depth + end), 0.0, impact)
        pieces += 1
        free = kinetic + max(force - load, 0.0) * (depth - end)
        work = min(damping * math.sqrt((kinetic + free) / mass), max(force, 0.0)) * (depth - end)  # It does not pull.
        work = min(work, free)
        taken, depth, kinetic = taken + work, end, free - work
    return TAKEN * taken, evaluations + pieces
