"""One step of an integrator: from a state, over a duration, under one smooth formula of the contact law."""

from __future__ import annotations

from typing import NamedTuple

from knee_contact_ros.core.contact_modes import NOWHERE, ContactMode, ContactModes, crossed
from knee_contact_ros.core.kernel_source import always_inlined, in_kernel
from knee_contact_ros.core.prescribed import Interval, load_at


class FemurState(NamedTuple):
    """The one free coordinate: height of the femoral reference point [m] and its velocity [m/s], superior positive."""

    height: float
    velocity: float


class StateError(NamedTuple):
    """Error of a femur state: height [m] and velocity [m/s]."""

    height: float
    velocity: float


NO_ERROR = StateError(0.0, 0.0)
LARGEST_RADIUS = 0.2
"""Largest radius of curvature [m] of femur and tibia together over which a contact glides; else it has leapt."""


class Motion(NamedTuple):
    """What a step computes with, which is the same from one event to the next."""

    interval: Interval
    modes: ContactModes
    mode: ContactMode
    impact_speed: float
    """Penetration rate [m/s] at which the present contact began"""
    mass: float
    """Mass of the femur [kg]; 0 for the first-order level"""
    known: int
    """The boundary on which the step is made to end, whose crossing at the end is not reported; else `NOWHERE`"""


class Stage(NamedTuple):
    """The contact at a point inside a step or at its end."""

    depth: float
    """Signed depth [m]: < 0 apart"""
    rate: float
    """Rate of the depth [m/s]"""
    force: float
    """Force [N] of the layer's formula, not clamped"""
    stiffness: float
    """Slope of the force over depth [N/m]; 0 in flight"""
    surface_rate: float
    """Rate of the depth [m/s] if the height were held"""


class Crossing(NamedTuple):
    """The boundary that a step crosses first, and where."""

    boundary: int
    """The boundary, or `NOWHERE` if the step stays inside its mode"""
    fraction: float
    """Place of the crossing as a part of the step, 0 to 1"""


INSIDE = Crossing(NOWHERE, 1.0)


class Step(NamedTuple):
    """The end of a step, its estimated local error and the first boundary that it has crossed."""

    state: FemurState
    error: StateError
    """Estimated local error; 0 where the step is exact or its error is estimated elsewhere"""
    begin: Stage
    """The contact at the beginning of the step"""
    end: Stage
    """The contact at the end of the step"""
    crossing: Crossing
    stiffness: float
    """Slope of the force along the height over the height [N/m], typical of the step: it carries errors over it"""
    damping: float
    """Slope of the force along the height over the velocity [N s/m], typical of the step"""
    cosine: float
    """n_y at the beginning of the step"""
    leapt: float
    """Change of the depth's rate [m/s] by a leap of the contact from one bump to another in the step; 0 if none"""
    evaluations: int
    solved: bool
    """False if a stage's equation was not solved; the step must then be repeated with a smaller duration."""


@in_kernel
def earlier(crossing: Crossing, motion: Motion, stage: Stage, s: float, fraction: float) -> Crossing:
    """The first crossing of a step, given the first one so far and a stage at s [s], a `fraction` of the step."""
    known = motion.known if fraction == 1.0 else NOWHERE
    if crossing.boundary != NOWHERE and crossing.fraction <= fraction:
        return crossing
    load = load_at(motion.interval, s)
    boundary = crossed(motion.modes, motion.mode, stage.depth, stage.force, load, known)
    return Crossing(boundary, fraction) if boundary != NOWHERE else crossing


@always_inlined
def first_crossing(
    motion: Motion, s: float, h: float, fractions: tuple[float, ...], stages: tuple[Stage, ...]
) -> Crossing:
    """The first crossing of a step of `h` [s] from s [s] on, given its stages in the order of their fractions."""
    crossing = INSIDE
    for i in range(len(stages)):
        crossing = earlier(crossing, motion, stages[i], s + fractions[i] * h, fractions[i])
    return crossing


@in_kernel
def largest_leap(
    motion: Motion, h: float, begin: Stage, fractions: tuple[float, ...], stages: tuple[Stage, ...]
) -> float:
    """Return the largest `leap` [m/s] between two neighbouring stages of a step of `h` [s], given in their order."""
    if not motion.interval.pair.is_non_convex():
        return 0.0
    largest, before, from_fraction = 0.0, begin, 0.0
    for i in range(len(stages)):
        duration = (fractions[i] - from_fraction) * h
        leapt = leap(before.surface_rate, stages[i].surface_rate, motion.interval.angle_rate, duration)
        largest, before, from_fraction = max(largest, leapt), stages[i], fractions[i]
    return largest


@in_kernel
def force_on(motion: Motion, depth: float, rate: float) -> tuple[float, float, float]:
    """Return the force [N] of the present layer's formula and its slopes over depth [N/m] and rate [N s/m]."""
    return motion.modes.law.layers[motion.mode.layer].formula.force_at(depth, rate, motion.impact_speed)


@in_kernel
def acceleration_of(motion: Motion, force: float) -> float:
    """Return the acceleration [m/s²] by a sum of forces [N]; 0 for a contact without mass, which has none."""
    return force / motion.mass if motion.mass > 0.0 else 0.0


@in_kernel
def leap(before: float, after: float, angle_rate: float, duration: float) -> float:
    """Return the change of the depth's rate [m/s] by a leap of the contact between bumps in a `duration` [s]; else 0.

    `before` and `after` [m/s] are the rates at a held height. A contact that glides changes its rate by the radius of
    curvature times the turn: beyond `LARGEST_RADIUS` it has leapt.
    """
    jump = abs(after - before)
    return jump if jump > LARGEST_RADIUS * angle_rate * angle_rate * duration else 0.0


@in_kernel
def staying(state: FemurState, contact: Stage) -> Step:
    """Return a step of no duration in a contact."""
    return Step(
        state=state, error=NO_ERROR, begin=contact, end=contact, crossing=INSIDE, stiffness=0.0, damping=0.0,
        cosine=1.0, leapt=0.0, evaluations=0, solved=True,
    )  # fmt: skip


@in_kernel
def no_step(state: FemurState) -> Step:
    """Return a step of no duration that is not `solved`, in place of one that a tick cannot afford."""
    nothing = Stage(depth=0.0, rate=0.0, force=0.0, stiffness=0.0, surface_rate=0.0)
    return staying(state, nothing)._replace(solved=False)
