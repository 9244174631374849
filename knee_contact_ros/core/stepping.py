"""One step of a tick: by the cheapest method that fits the contact, as long as the tolerance allows."""

from __future__ import annotations

import math
import sys
from typing import NamedTuple

from knee_contact_ros.core.contact_laws.base import LayerFormula
from knee_contact_ros.core.contact_modes import NOWHERE, ContactMode, has_deeper
from knee_contact_ros.core.error_estimate import (
    HORIZON,
    TINY,
    PropagatedError,
    decay_rate,
    depth_error,
    holding,
)
from knee_contact_ros.core.integrators.base import FemurState, Motion, StateError, Step, no_step
from knee_contact_ros.core.integrators.doubling import doubled_step
from knee_contact_ros.core.integrators.esdirk4 import ORDER, STAGE_ORDER, STAGES
from knee_contact_ros.core.integrators.fehlberg import fehlberg_step
from knee_contact_ros.core.integrators.free_flight import MAX_PEAK, PARTS, free_flight_step
from knee_contact_ros.core.integrators.massless import massless_step
from knee_contact_ros.core.kernel_source import always_inlined, in_kernel, never_inlined
from knee_contact_ros.core.prescribed import Interval, load_at
from knee_contact_ros.core.scene import Scene
from knee_contact_ros.core.unresolved_motion import lost_creep, lost_swing

LOCAL_SHARE = 0.1
"""Share of the tolerance that the errors of all steps together may use while the contact remembers them."""
FORGETTING = 1.0
"""How long [s] an error is taken to count where nothing damps it."""
ROUNDING = 4.0 * sys.float_info.epsilon
"""Part of a height or a velocity below which an estimated error is rounding, which no smaller step can cure."""
NEWTON_SHARE = 0.01
"""Share of the tolerance at which Newton's method has converged."""
RELEASE = 8.0
"""Number of further steps within which a falling force must vanish to count as one that is about to end"""
REBOUND = 2.0
"""Contact force, as a multiple of the load, above which the femur is expected to rebound into the air"""
THROWN = 64.0
"""Factor by which the tolerance is stricter for steps whose errors go into a flight, where they grow"""
FOLLOWED = 0.02
"""Part of an undamped oscillation that its error may be"""
MAX_EVALUATIONS = 100_000
"""Contact law evaluations after which a tick is answered with the static solution, and is `NOT_CONVERGED`."""
WATCHED = 2 * PARTS + 2 * MAX_PEAK
"""Largest number of evaluations of a flight through overlapping surfaces; `MAX_PEAK` more above a deeper layer"""
MAX_EVENTS = 1_000
"""Crossed boundaries after which a tick is answered with the static solution, and is `NOT_CONVERGED`."""
EXPLICIT = 1.0
"""Largest step times spectral radius of the contact that is taken explicitly"""
MOST_EXPLICIT = 6.0
"""Number of explicit steps that cost less than an implicit step with its halves"""


class Landing(NamedTuple):
    """The last touch of a tick, for which the exact solution may be late."""

    latest: float
    """Time [s] in the tick by which the exact solution has touched, too"""
    rate: float
    """Penetration rate [m/s] at the touch"""


NO_LANDING = Landing(0.0, 0.0)


class StepperState(NamedTuple):
    """State of a tick between two steps."""

    s: float
    """Time [s] since the beginning of the tick"""
    state: FemurState
    error: PropagatedError
    try_step: float
    """Duration [s] that the next step should try"""
    spectral_radius: float
    """Spectral radius [1/s] of the present contact"""
    impact_speed: float
    """Penetration rate [m/s] at which the present contact began; NaN while the surfaces are apart"""
    impact_error: float
    """Estimated error of the impact speed [m/s]"""
    evaluations: int
    events: int
    given_up: bool
    """Whether the tick needs more evaluations or events than it may take"""
    most: int
    """Largest number of evaluations of the tick"""
    landing: Landing


@in_kernel
def controlled_step(
    scene: Scene, interval: Interval, stepper: StepperState, mode: ContactMode, until: float
) -> tuple[StepperState, Step, float]:
    """Compute a step towards `until` [s] whose estimated error fits the tolerance; return it and its duration [s]."""
    remaining = until - stepper.s
    h = min(stepper.try_step, remaining) if mode.pressing else remaining
    if stepper.spectral_radius * h > EXPLICIT and stepper.spectral_radius * remaining <= MOST_EXPLICIT * EXPLICIT:
        h = remaining / math.ceil(stepper.spectral_radius * remaining / EXPLICIT) if mode.pressing else h
    while True:
        stepper, step = attempt(scene, interval, stepper, mode, h, NOWHERE)
        if not mode.pressing or stepper.given_up:
            return stepper, step, h
        ratio = error_ratio(scene, interval, stepper, step, h)
        factor = 0.9 / math.sqrt(math.sqrt(max(ratio, 1e-4)))
        if ratio <= 1.0:
            try_step = h * factor if h < remaining else max(stepper.try_step, h * factor)
            return stepper._replace(try_step=try_step), step, h
        h *= max(0.1, factor)
        if not until + h > until:
            return stepper._replace(given_up=True), step, h


@never_inlined
def attempt(
    scene: Scene, interval: Interval, stepper: StepperState, mode: ContactMode, h: float, known: int
) -> tuple[StepperState, Step]:
    """Compute one step of `h` [s] by the mode's formula, without error control.

    `known` is the boundary that it is to end on, or `NOWHERE`.
    """
    least = 3 * STAGES
    if mode.layer >= 0 and not mode.pressing:
        least = WATCHED + (MAX_PEAK if has_deeper(scene.modes, mode) else 0)
    if stepper.evaluations + least >= stepper.most or stepper.events >= MAX_EVENTS:
        return stepper._replace(given_up=True), no_step(stepper.state)
    motion = motion_in(scene, interval, stepper, mode, known)
    if not mode.pressing:
        step = free_flight_step(motion, stepper.s, stepper.state, h)
    elif stepper.spectral_radius * h <= EXPLICIT:
        if scene.mass > 0.0:
            step = fehlberg_step(motion, stepper.s, stepper.state, h)
        else:
            step = massless_step(motion, stepper.s, stepper.state, h)
    else:
        order, reduced = orders(interval, h)
        most = stepper.most - stepper.evaluations - 3 * STAGES
        step = doubled_step(motion, order, reduced, stepper.s, stepper.state, h, NEWTON_SHARE * scene.tolerance, most)
    return stepper._replace(evaluations=stepper.evaluations + step.evaluations), step


@in_kernel
def motion_in(scene: Scene, interval: Interval, stepper: StepperState, mode: ContactMode, known: int) -> Motion:
    """Return what the steps in a mode compute with; `known` is the boundary to end on, or `NOWHERE`."""
    impact_speed = 0.0 if math.isnan(stepper.impact_speed) else stepper.impact_speed
    return Motion(
        interval=interval, modes=scene.modes, mode=mode, impact_speed=impact_speed, mass=scene.mass, known=known,
    )  # fmt: skip


@in_kernel
def error_ratio(scene: Scene, interval: Interval, stepper: StepperState, step: Step, h: float) -> float:
    """Return the estimated error of a step over its share of the tolerance: all steps that still count share it."""
    if not step.solved:
        return math.inf
    load, mass = load_at(interval, stepper.s), scene.mass
    ratio = local_ratio(
        scene, load, step.state, step.error, step.begin.force, step.end.force, step.stiffness, step.damping, step.leapt,
        h, stepper.impact_speed > 0.0,
    )  # fmt: skip
    lost = StateError(lost_creep(step, load, mass, h), lost_swing(step, load, interval.load_rate, mass, h))
    ratio += depth_error(lost, step.stiffness, step.damping, mass) / (
        LOCAL_SHARE * wanted(scene, step.stiffness, step.damping)
    )
    return ratio if ratio < math.inf else math.inf


@always_inlined
def local_ratio(
    scene: Scene, load: float, state: FemurState, error: StateError, begin_force: float, force: float,
    stiffness: float, damping: float, leapt: float, h: float, landed: bool,
) -> float:  # fmt: skip
    """Return the error of a step over its tolerance, without what the step has damped away.

    `state` is the end of the step, `error` its local error, `begin_force` and `force` [N] are the forces at both ends;
    `landed` tells whether the contact has begun with the end of a flight.
    """
    mass = scene.mass
    speed = abs(state.velocity) + h * abs(force) / mass
    above_rounding = StateError(
        max(abs(error.height) - ROUNDING * abs(state.height), 0.0),
        max(abs(error.velocity) - ROUNDING * speed, 0.0),
    )
    # A leap happens once: its error is not one of many that add up while the contact remembers them.
    memory = max(decay_rate(stiffness, damping, mass), 1.0 / FORGETTING)
    forgotten = 1.0 if leapt > 0.0 else min(1.0, h * memory)
    whole = depth_error(above_rounding, stiffness, damping, mass) / forgotten + h * leapt
    lets_go = force < RELEASE * (begin_force - force) or force > REBOUND * load
    if lets_go:
        # The error of the velocity is then carried into the flight.
        whole = max(whole, THROWN * depth_error(above_rounding, 0.0, 0.0, mass))
    allowed = wanted(scene, stiffness, damping)
    lasts = memory * HORIZON < 1.0
    if lasts and stiffness > 0.0:
        # An undamped oscillation can be followed only as long as its error is small against its amplitude.
        swing = max(abs(begin_force), abs(force)) / stiffness
        allowed = min(allowed, FOLLOWED * math.sqrt(swing * swing + state.velocity * state.velocity * mass / stiffness))
    if landed and (lasts or len(scene.modes.law.layers) > 1) and not scene.modes.allow_tension:
        # It goes into the next flight; another layer may damp less than this one.
        allowed = allowed / THROWN
    return whole / (LOCAL_SHARE * allowed)


@in_kernel
def wanted(scene: Scene, stiffness: float, damping: float) -> float:
    """The tolerated error of the depth [m]: its tolerance, or less where the tolerance of the force asks for it."""
    if scene.force_tolerance <= 0.0 or scene.mass <= 0.0:
        return scene.tolerance
    # A creeping contact turns a depth into a rate by k/c, one that swings by the root of k/m.
    slope = stiffness + damping * stiffness / (scene.mass * holding(stiffness, damping, scene.mass))
    return min(scene.tolerance, scene.force_tolerance / max(slope, TINY))


@in_kernel
def orders(interval: Interval, h: float) -> tuple[int, int]:
    """Return the order of an implicit step of `h` [s], and the order of a stiff one.

    The third derivative of a spline jumps at its points, and the first one over a dent: steps across lose their order.
    """
    if abs(interval.angle_rate) * h > interval.pair.knot_spacing():
        return 1, 1
    return (STAGE_ORDER, STAGE_ORDER) if interval.pair.is_non_convex() else (ORDER, STAGE_ORDER)


@in_kernel
def impact_doubt(
    scene: Scene, stepper: StepperState, mode: ContactMode, depth: float, rate: float, force: float
) -> float:
    """Return by how much the force [N] may be wrong because of the error of the impact speed."""
    if looks_for_doubt(scene, stepper) == 0:
        return 0.0
    formula = scene.modes.law.layers[mode.layer].formula
    return doubt_of_impact(formula, depth, rate, force, stepper.impact_speed, stepper.impact_error)


@in_kernel
def doubt_of_impact(
    formula: LayerFormula, depth: float, rate: float, force: float, impact_speed: float, impact_error: float
) -> float:
    """Return by how much a force [N] differs if its contact has begun faster or slower by an error [m/s]."""
    faster, _, _ = formula.force_at(depth, rate, impact_speed + impact_error)
    slower, _, _ = formula.force_at(depth, rate, max(0.0, impact_speed - impact_error))
    return max(abs(faster - force), abs(slower - force))


@in_kernel
def looks_for_doubt(scene: Scene, stepper: StepperState) -> int:
    """Return the number of evaluations that `impact_doubt` takes."""
    known = math.isnan(stepper.impact_speed) or stepper.impact_error == 0.0
    return 0 if known or not scene.modes.law.layers[0].formula.remembers_impact() else 2


@in_kernel
def doubtful_push(scene: Scene, stepper: StepperState, mode: ContactMode, step: Step, h: float) -> float:
    """Return the velocity error [m/s] that `impact_doubt` causes in a step, or until the contact has responded to it.

    A contact that ends has no such error at its end, where there is no force.
    """
    if h == 0.0 or not mode.pressing:
        return 0.0
    begin, end, mass = step.begin, step.end, scene.mass
    answered = max(holding(step.stiffness, step.damping, mass), 1.0 / h)
    doubt = max(
        impact_doubt(scene, stepper, mode, begin.depth, begin.rate, begin.force),
        impact_doubt(scene, stepper, mode, end.depth, end.rate, end.force),
    )
    return doubt / max(mass * answered, TINY)
