"""Forward dynamics of the femur over one tick (Eq. 13): M ÿ = -L(t) + F(δ, δ̇), with error control and events.

A step computes with the formula of one mode of the contact law. When it has crossed a boundary of the mode it is
shortened until it ends on the boundary, and the next mode continues from there: no step crosses a kink or a jump.
"""

from __future__ import annotations

import math

from knee_contact_ros.core.adrift import RESERVE, Adrift
from knee_contact_ros.core.contact_modes import (
    APART,
    BELOW,
    FORCE,
    NOWHERE,
    ContactMode,
    Entry,
    depth_ahead,
    enter,
    enter_layer,
    event_function,
    switch,
)
from knee_contact_ros.core.error_estimate import (
    TINY,
    UNKNOWN,
    UNKNOWN_IMPLICIT,
    bounded,
    curved,
    force_reach,
    holding,
    propagated_in_flight,
    propagated_over_step,
    reach,
    saltation,
    spectral_radius,
    velocity_reach,
    with_bound,
    with_doubt,
    with_push,
    with_step,
    with_uncorrelated_bound,
)
from knee_contact_ros.core.events import end_on_boundary
from knee_contact_ros.core.integrators.base import FemurState, Step, force_on
from knee_contact_ros.core.kernel_source import always_inlined, in_kernel, never_inlined
from knee_contact_ros.core.levels.flight import AIRBORNE, flies_freely, flying_tick
from knee_contact_ros.core.levels.smooth import not_begun, smooth_tick
from knee_contact_ros.core.prescribed import Interval, load_at, stretch_from, touch_at
from knee_contact_ros.core.scene import DYNAMIC, RunState, Scene, TickResult
from knee_contact_ros.core.stepping import (
    EXPLICIT,
    MAX_EVALUATIONS,
    NO_LANDING,
    Landing,
    StepperState,
    controlled_step,
    doubtful_push,
    impact_doubt,
    looks_for_doubt,
    motion_in,
)
from knee_contact_ros.core.unresolved_motion import lost_creep, lost_swing

RELEASED = 0.05
"""Unknown part of the velocity's error where a contact ends, as the end of an oscillation depends on its size"""
LOST = 1.75
"""Largest speed of an oscillation that a step has damped away, over its estimate, which takes springs as linear"""


@always_inlined
def dynamic_tick(scene: Scene, interval: Interval, start: RunState, spent: int) -> TickResult:
    """Carry the femur over the interval; the result is not `converged` if that takes too many evaluations.

    `spent` is the number of evaluations that the tick has taken already.
    """
    if flies_freely(interval, start, scene.mass):
        return flying_tick(interval, start, scene.mass, spent)
    result = smooth_tick(scene, interval, start, spent)
    return result if result.converged else stepwise(scene, interval, start, result.evaluations)


@never_inlined
def stepwise(scene: Scene, interval: Interval, start: RunState, spent: int) -> TickResult:
    """Compute a tick by steps of any length and kind, from event to event."""
    stepper = StepperState(
        s=0.0, state=start.state, error=start.error, try_step=start.try_step, spectral_radius=0.0,
        impact_speed=start.impact_speed, impact_error=start.impact_error, evaluations=spent, events=0, given_up=False,
        most=most_evaluations(scene), landing=NO_LANDING,
    )  # fmt: skip
    mode = ContactMode(APART, False)
    begin = 0.0
    while begin < interval.duration and not stepper.given_up:
        until, following = stretch_from(interval, begin)
        stepper, mode = begin_stretch(scene, interval, stepper, begin)
        while stepper.s < until and not stepper.given_up:
            stepper, mode = step_dynamic(scene, interval, stepper, mode, until)
        begin = following
    if stepper.given_up or not abs(stepper.state.height) < math.inf:
        return unresolved(interval, stepper, start)
    return dynamic_result(scene, interval, stepper, mode, start.adrift)


@in_kernel
def begin_stretch(
    scene: Scene, interval: Interval, stepper: StepperState, s: float
) -> tuple[StepperState, ContactMode]:
    """Continue at s [s], where the rate of the surface has jumped; return the mode there."""
    state = FemurState(stepper.state.height + stepper.state.velocity * (s - stepper.s), stepper.state.velocity)
    depth, surface_rate, cosine = touch_at(interval, s).touch(state.height)
    rate = surface_rate - cosine * state.velocity
    impact_speed, impact_error = stepper.impact_speed, stepper.impact_error
    if math.isnan(impact_speed) and depth_ahead(depth, rate) >= 0.0:
        impact_speed, impact_error = rate, velocity_reach(stepper.error)
    entry = enter(scene.modes, depth, rate, load_at(interval, s), impact_speed)
    stepper = stepper._replace(
        s=s, state=state, spectral_radius=spectral_radius_in(scene, entry, cosine), impact_speed=impact_speed,
        impact_error=impact_error, evaluations=stepper.evaluations + (1 if entry.mode.layer >= 0 else 0),
    )  # fmt: skip
    return stepper, entry.mode


@in_kernel
def spectral_radius_in(scene: Scene, entry: Entry, cosine: float) -> float:
    """Return the spectral radius [1/s] of the contact in a mode; `cosine` is n_y."""
    if not entry.mode.pressing:
        return 0.0
    return spectral_radius(cosine * cosine * entry.stiffness, cosine * cosine * entry.damping, scene.mass)


@in_kernel
def step_dynamic(
    scene: Scene, interval: Interval, stepper: StepperState, mode: ContactMode, until: float
) -> tuple[StepperState, ContactMode]:
    """Take a step towards `until` [s]; return the mode after it."""
    stepper, step, h = controlled_step(scene, interval, stepper, mode, until)
    boundary = NOWHERE
    while h > 0.0 and step.crossing.boundary != NOWHERE and not stepper.given_up:
        stepper, step, h, boundary = end_on_boundary(scene, interval, stepper, mode, step, h)
    if stepper.given_up:
        return stepper, mode
    stepper = accepted(scene, interval, stepper, mode, step, h, until)
    if boundary == NOWHERE:
        return stepper, mode
    return behind_boundary(scene, interval, stepper, mode, step, boundary)


@in_kernel
def accepted(
    scene: Scene, interval: Interval, stepper: StepperState, mode: ContactMode, step: Step, h: float, until: float
) -> StepperState:
    """Return the tick at the end of a step of `h` [s], with its error propagated there."""
    evaluations = stepper.evaluations
    if mode.pressing:
        square = step.cosine * step.cosine
        begin, end = square * step.begin.stiffness, square * step.end.stiffness
        error = propagated_over_step(stepper.error, begin, step.stiffness, end, step.damping, scene.mass, h)
        unknown = UNKNOWN if stepper.spectral_radius * h <= EXPLICIT else UNKNOWN_IMPLICIT
        error = with_step(error, step.error, unknown, holding(step.stiffness, step.damping, scene.mass))
        error = curved(error, max(step.begin.depth, step.end.depth), step.stiffness, step.damping, scene.mass, h)
        stepper = touching_anew(scene, stepper, step)
        load = load_at(interval, stepper.s)
        swung = lost_swing(step, load, interval.load_rate, scene.mass, h)
        unsigned = LOST * swung + doubtful_push(scene, stepper, mode, step, h)
        crept = lost_creep(step, load, scene.mass, h)
        error = with_bound(error, crept, unsigned) if crept + unsigned > 0.0 else error
        fastest = spectral_radius(step.stiffness, step.damping, scene.mass)
        if h > 0.0:
            evaluations += 2 * looks_for_doubt(scene, stepper)
    else:
        error, fastest = with_uncorrelated_bound(propagated_in_flight(stepper.error, h), step.error.height, 0.0), 0.0
    s = until if h == until - stepper.s else stepper.s + h
    return stepper._replace(s=s, state=step.state, error=error, spectral_radius=fastest, evaluations=evaluations)


@in_kernel
def touching_anew(scene: Scene, stepper: StepperState, step: Step) -> StepperState:
    """The tick with a larger error of the impact speed where the exact surfaces may have parted and met again."""
    if not scene.modes.law.layers[0].formula.remembers_impact():
        return stepper
    begin, end = step.begin, step.end
    if not begin.rate < 0.0 < end.rate or min(begin.depth, end.depth) > reach(stepper.error, math.inf):
        return stepper
    speed = abs(stepper.impact_speed) + max(-begin.rate, end.rate) + velocity_reach(stepper.error)
    return stepper._replace(impact_error=max(stepper.impact_error, speed))


@never_inlined
def behind_boundary(
    scene: Scene, interval: Interval, stepper: StepperState, mode: ContactMode, step: Step, boundary: int
) -> tuple[StepperState, ContactMode]:
    """Continue beyond a boundary that a step has ended on; return the mode there."""
    end = step.end
    impact_speed, impact_error = stepper.impact_speed, stepper.impact_error
    landing = stepper.landing
    if mode.layer < 0:
        late = lateness(interval, stepper, end.rate, scene.mass)
        # A femur that comes later has been sped up or slowed down by the load meanwhile.
        gained = abs(load_at(interval, stepper.s)) / scene.mass * late
        impact_speed, impact_error = end.rate, velocity_reach(stepper.error) + gained
        landing = Landing(stepper.s + late, end.rate)
    if boundary == FORCE:
        entry = switch(scene.modes, mode, end.depth, end.rate, impact_speed)
    else:
        layer, load = mode.layer + (1 if boundary == BELOW else -1), load_at(interval, stepper.s)
        entry = enter_layer(scene.modes, layer, end.depth, end.rate, load, impact_speed)
    following = entry.mode
    jump = entry.force - (end.force if mode.pressing else 0.0)
    off = 0.0 if boundary == FORCE else event_function(scene.modes, mode, boundary, end.depth, end.force)
    evaluated = following.pressing or (boundary != FORCE and following.layer >= 0)
    _, _, cosine = touch_at(interval, stepper.s).touch(stepper.state.height)
    error = saltation(stepper.error, end.rate, jump, off, scene.mass, interval.duration)
    if following.layer < 0:
        error = with_doubt(error, RELEASED * velocity_reach(error))
    stepper = stepper._replace(
        error=bounded(error), spectral_radius=spectral_radius_in(scene, entry, cosine),
        impact_speed=math.nan if following.layer < 0 else impact_speed, impact_error=impact_error,
        evaluations=stepper.evaluations + (1 if evaluated else 0), events=stepper.events + 1, landing=landing,
    )  # fmt: skip
    return stepper, following


@in_kernel
def lateness(interval: Interval, stepper: StepperState, rate: float, mass: float) -> float:
    """Return the time [s] by which the exact femur may touch later than this one, which touches at a `rate` [m/s]."""
    gap = reach(stepper.error, math.inf)
    load = min(load_at(interval, stepper.s), load_at(interval, interval.duration))
    late = gap / max(abs(rate), TINY)
    if load > 0.0:
        late = min(late, math.sqrt(2.0 * gap * mass / load))
    if load >= 0.0 and interval.load_rate > 0.0:
        late = min(late, (6.0 * gap * mass / interval.load_rate) ** (1.0 / 3.0))
    return late


@in_kernel
def most_evaluations(scene: Scene) -> int:
    """Return the largest number of evaluations for the steps of a tick, which leaves some for a static answer."""
    return scene.budget - RESERVE if scene.budget > 0 else MAX_EVALUATIONS


@in_kernel
def dynamic_result(
    scene: Scene, interval: Interval, stepper: StepperState, mode: ContactMode, adrift: Adrift
) -> TickResult:
    """Return the contact at the end of the interval."""
    depth, surface_rate, cosine = touch_at(interval, stepper.s).touch(stepper.state.height)
    rate, load = surface_rate - cosine * stepper.state.velocity, load_at(interval, interval.duration)
    force, stiffness, damping, evaluations, held = 0.0, 0.0, 0.0, stepper.evaluations, math.inf
    error, force_error = bounded(stepper.error), 0.0
    if stepper.landing.latest > interval.duration:
        # The exact femur may not have touched yet, and still has the velocity of its flight.
        way = (stepper.landing.latest - interval.duration) * stepper.landing.rate
        error = bounded(with_bound(error, way + max(depth, 0.0), abs(stepper.landing.rate - rate)))
    if mode.pressing:
        motion = motion_in(scene, interval, stepper, mode, NOWHERE)
        force, stiffness, damping = force_on(motion, depth, rate)
        evaluations += 1 + looks_for_doubt(scene, stepper)
        doubt = impact_doubt(scene, stepper, mode, depth, rate, force)
        if doubt > 0.0:
            error = with_push(error, doubt, stiffness, damping, scene.mass, interval.duration)
        held = holding(cosine * cosine * stiffness, cosine * cosine * damping, scene.mass)
        force_error = cosine * force_reach(error, stiffness, damping, 0.0, held) + doubt
    estimate = reach(error, held) if mode.pressing else AIRBORNE * reach(error, held)
    return TickResult(
        run_state=RunState(
            state=stepper.state, error=error, try_step=stepper.try_step, impact_speed=stepper.impact_speed,
            impact_error=stepper.impact_error, fidelity=DYNAMIC, stiffness=cosine * cosine * stiffness,
            damping=cosine * cosine * damping, excess=cosine * force - load, sinking=rate / cosine, depth=depth,
            adrift=adrift,
        ),
        depth=depth, rate=rate, force=force if scene.modes.allow_tension else max(force, 0.0),
        error_estimate=estimate, force_error_estimate=force_error, evaluations=evaluations,
        reached=interval.duration, converged=True, height=stepper.state.height, fidelity=DYNAMIC,
    )  # fmt: skip


@in_kernel
def unresolved(interval: Interval, stepper: StepperState, start: RunState) -> TickResult:
    """Return where the motion has come to in a tick that was given up; `backlog.py` makes an answer of it."""
    depth, surface_rate, cosine = touch_at(interval, stepper.s).touch(stepper.state.height)
    if not abs(depth) < math.inf:
        return not_begun(start, stepper.evaluations)
    rate = surface_rate - cosine * stepper.state.velocity
    # At s = 0 the surface has not kicked the femur yet: the bounds of its motion count that kick once.
    sinking = rate / cosine if stepper.s > 0.0 else start.sinking
    return TickResult(
        run_state=start._replace(
            state=stepper.state, error=bounded(stepper.error), try_step=stepper.try_step,
            impact_speed=stepper.impact_speed, impact_error=stepper.impact_error, sinking=sinking, depth=depth,
        ),
        depth=depth, rate=rate, force=0.0, error_estimate=math.inf, force_error_estimate=math.inf,
        evaluations=stepper.evaluations, reached=stepper.s, converged=False, height=stepper.state.height,
        fidelity=DYNAMIC,
    )  # fmt: skip
