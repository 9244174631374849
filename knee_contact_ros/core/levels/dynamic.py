"""Forward dynamics of the femur over one tick (Eq. 13): M ÿ = -L(t) + F(δ, δ̇), with error control and events.

A step computes with the formula of one region of the contact law. When it has crossed a boundary of the region it is
shortened until it ends on the boundary, and the next region goes on from there: no step crosses a kink or a jump.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from knee_contact_ros.core.adrift import RESERVE, Adrift
from knee_contact_ros.core.error_estimate import (
    TINY,
    UNKNOWN,
    UNKNOWN_IMPLICIT,
    behind_jump,
    bounded,
    carry_in_flight,
    carry_on,
    curved,
    force_reach,
    holding,
    reach,
    swiftness,
    velocity_reach,
    with_bound,
    with_bound_aside,
    with_doubt,
    with_push,
    with_step,
)
from knee_contact_ros.core.events import end_on_boundary
from knee_contact_ros.core.integrators.base import FemurState, Step, force_on
from knee_contact_ros.core.kernel_source import aside, in_kernel, inlined
from knee_contact_ros.core.levels.flight import flies_freely, flying_tick
from knee_contact_ros.core.levels.quiet import quiet_tick
from knee_contact_ros.core.prescribed import Interval, load_at, stretch_from, touch_at
from knee_contact_ros.core.regions import (
    APART,
    BELOW,
    FORCE,
    NOWHERE,
    Entry,
    Region,
    cross_force,
    depth_ahead,
    enter,
    enter_layer,
    margin,
)
from knee_contact_ros.core.scene import Advance, Progress, Scene
from knee_contact_ros.core.stepping import (
    EXPLICIT,
    MAX_EVALUATIONS,
    NO_LANDING,
    Going,
    Landing,
    controlled_step,
    doubtful_push,
    impact_doubt,
    looks_for_doubt,
    lost_in,
    motion_in,
    spending,
)
from knee_contact_ros.core.types import Fidelity

DYNAMIC = int(Fidelity.DYNAMIC)
RELEASED = 0.05
"""Part of a velocity's error that is not known where the contact lets go: how it swings there depends on its size"""


class Dynamic(NamedTuple):
    """The level as a part of a scene."""

    fidelity: int = DYNAMIC
    """Of its answers; read by nobody, but Numba cannot pass a tuple without fields"""

    def advance(self, scene: Scene, interval: Interval, start: Progress, spent: int) -> Advance:
        """See `Level`."""
        return dynamic_tick(scene, interval, start, spent)


@inlined
def dynamic_tick(scene: Scene, interval: Interval, start: Progress, spent: int) -> Advance:
    """Carry the femur over the interval, or answer with the static solution at its end if that takes too much.

    `spent` are the evaluations that the tick has cost already.
    """
    if flies_freely(interval, start, scene.mass):
        return flying_tick(interval, start, scene.mass, spent)
    advance = quiet_tick(scene, interval, start, spent)
    return advance if advance.converged else stepwise(scene, interval, start, advance.evaluations)


@aside
def stepwise(scene: Scene, interval: Interval, start: Progress, spent: int) -> Advance:
    """A tick by steps of any length and kind, from event to event."""
    going = Going(
        0.0, start.state, start.error, start.try_step, 0.0, start.impact_speed, start.impact_error, spent, 0, False,
        most_evaluations(scene), NO_LANDING,
    )  # fmt: skip
    region = Region(APART, False)
    begin = 0.0
    while begin < interval.duration and not going.given_up:
        until, following = stretch_from(interval, begin)
        going, region = begin_stretch(scene, interval, going, begin)
        while going.s < until and not going.given_up:
            going, region = step_on(scene, interval, going, region, until)
        begin = following
    if going.given_up or not abs(going.state.height) < math.inf:
        return unresolved(interval, going, start)
    return result(scene, interval, going, region, start.adrift)


@in_kernel
def begin_stretch(scene: Scene, interval: Interval, going: Going, s: float) -> tuple[Going, Region]:
    """Go on at s [s] with the angle's new rate or the surface's new bump; return the region there."""
    state = FemurState(going.state.height + going.state.velocity * (s - going.s), going.state.velocity)
    depth, surface_rate, cosine = touch_at(interval, s).touch(state.height)
    rate = surface_rate - cosine * state.velocity
    impact_speed, impact_error = going.impact_speed, going.impact_error
    if math.isnan(impact_speed) and depth_ahead(depth, rate) >= 0.0:
        impact_speed, impact_error = rate, velocity_reach(going.error)
    entry = enter(scene.regions, depth, rate, load_at(interval, s), impact_speed)
    evaluations = going.evaluations + (1 if entry.region.layer >= 0 else 0)
    going = Going(
        s, state, going.error, going.try_step, swiftness_in(scene, entry, cosine), impact_speed, impact_error,
        evaluations, going.events, going.given_up, going.most, going.landing,
    )  # fmt: skip
    return going, entry.region


@in_kernel
def swiftness_in(scene: Scene, entry: Entry, cosine: float) -> float:
    """Largest rate [1/s] of the contact in a region; `cosine` is n_y."""
    if not entry.region.pressing:
        return 0.0
    return swiftness(cosine * cosine * entry.stiffness, cosine * cosine * entry.damping, scene.mass)


@in_kernel
def step_on(scene: Scene, interval: Interval, going: Going, region: Region, until: float) -> tuple[Going, Region]:
    """Take a step towards `until` [s]; return the region behind it."""
    going, step, h = controlled_step(scene, interval, going, region, until)
    boundary = NOWHERE
    while h > 0.0 and step.crossing.boundary != NOWHERE and not going.given_up:
        going, step, h, boundary = end_on_boundary(scene, interval, going, region, step, h)
    if going.given_up:
        return going, region
    going = accepted(scene, interval, going, region, step, h, until)
    if boundary == NOWHERE:
        return going, region
    return behind_boundary(scene, interval, going, region, step, boundary)


@in_kernel
def accepted(
    scene: Scene, interval: Interval, going: Going, region: Region, step: Step, h: float, until: float
) -> Going:
    """Go to the end of a step."""
    if region.pressing:
        square = step.cosine * step.cosine
        begin, end = square * step.begin.stiffness, square * step.end.stiffness
        error = carry_on(going.error, begin, step.stiffness, end, step.damping, scene.mass, h)
        unknown = UNKNOWN if going.swiftness * h <= EXPLICIT else UNKNOWN_IMPLICIT
        error = with_step(error, step.error, unknown, holding(step.stiffness, step.damping, scene.mass))
        error = curved(error, max(step.begin.depth, step.end.depth), step.stiffness, step.damping, scene.mass, h)
        going = touching_anew(scene, going, step)
        unsigned = lost_in(scene, interval, going, step, h) + doubtful_push(scene, going, region, step, h)
        error = with_bound(error, 0.0, unsigned) if unsigned > 0.0 else error
        swift = swiftness(step.stiffness, step.damping, scene.mass)
        if h > 0.0:
            going = spending(going, looks_for_doubt(scene, going), False)
    else:
        error, swift = with_bound_aside(carry_in_flight(going.error, h), step.error.height, 0.0), 0.0
    return Going(
        until if h == until - going.s else going.s + h,
        step.state,
        error,
        going.try_step,
        swift,
        going.impact_speed,
        going.impact_error,
        going.evaluations,
        going.events,
        going.given_up,
        going.most,
        going.landing,
    )


@in_kernel
def touching_anew(scene: Scene, going: Going, step: Step) -> Going:
    """A tick with what is not known of the contact's begin, where the exact one may have parted since."""
    if not scene.regions.law.layers[0].formula.remembers_impact():
        return going
    begin, end = step.begin, step.end
    if not begin.rate < 0.0 < end.rate or min(begin.depth, end.depth) > reach(going.error, math.inf):
        return going
    speed = abs(going.impact_speed) + max(-begin.rate, end.rate) + velocity_reach(going.error)
    return Going(
        going.s, going.state, going.error, going.try_step, going.swiftness, going.impact_speed,
        max(going.impact_error, speed), going.evaluations, going.events, going.given_up, going.most, going.landing,
    )  # fmt: skip


@aside
def behind_boundary(
    scene: Scene, interval: Interval, going: Going, region: Region, step: Step, boundary: int
) -> tuple[Going, Region]:
    """Go on behind a boundary that a step has ended on; return the region there."""
    end = step.end
    impact_speed, impact_error = going.impact_speed, going.impact_error
    landing = going.landing
    if region.layer < 0:
        impact_speed, impact_error = end.rate, velocity_reach(going.error)
        late = lateness(interval, going, end.rate, scene.mass)
        landing = Landing(going.s + late, end.rate)
    if boundary == FORCE:
        entry = cross_force(scene.regions, region, end.depth, end.rate, impact_speed)
    else:
        layer, load = region.layer + (1 if boundary == BELOW else -1), load_at(interval, going.s)
        entry = enter_layer(scene.regions, layer, end.depth, end.rate, load, impact_speed)
    following = entry.region
    jump = entry.force - (end.force if region.pressing else 0.0)
    off = 0.0 if boundary == FORCE else margin(scene.regions, region, boundary, end.depth, end.force)
    evaluated = following.pressing or (boundary != FORCE and following.layer >= 0)
    _, _, cosine = touch_at(interval, going.s).touch(going.state.height)
    error = behind_jump(going.error, end.rate, jump, off, scene.mass, interval.duration)
    if following.layer < 0:
        error = with_doubt(error, RELEASED * velocity_reach(error))
    going = Going(
        going.s,
        going.state,
        bounded(error),
        going.try_step,
        swiftness_in(scene, entry, cosine),
        math.nan if following.layer < 0 else impact_speed,
        impact_error,
        going.evaluations + (1 if evaluated else 0),
        going.events + 1,
        going.given_up,
        going.most,
        landing,
    )
    return going, following


@in_kernel
def lateness(interval: Interval, going: Going, rate: float, mass: float) -> float:
    """How long [s] a femur that is farther away than the one that touches now, at a `rate` [m/s], may need yet."""
    gap = reach(going.error, math.inf)
    load = min(load_at(interval, going.s), load_at(interval, interval.duration))
    late = gap / max(abs(rate), TINY)
    if load > 0.0:
        late = min(late, math.sqrt(2.0 * gap * mass / load))
    if load >= 0.0 and interval.load_rate > 0.0:
        late = min(late, (6.0 * gap * mass / interval.load_rate) ** (1.0 / 3.0))
    return late


@in_kernel
def most_evaluations(scene: Scene) -> int:
    """Evaluations that the steps of a tick may take, so that there are some left for an answer."""
    return scene.budget - RESERVE if scene.budget > 0 else MAX_EVALUATIONS


@in_kernel
def result(scene: Scene, interval: Interval, going: Going, region: Region, adrift: Adrift) -> Advance:
    """The contact at the end of the interval."""
    depth, surface_rate, cosine = touch_at(interval, going.s).touch(going.state.height)
    rate, load = surface_rate - cosine * going.state.velocity, load_at(interval, interval.duration)
    force, stiffness, damping, evaluations, held = 0.0, 0.0, 0.0, going.evaluations, math.inf
    error, force_error = bounded(going.error), 0.0
    if going.landing.latest > interval.duration:
        # The exact solution may still be on its way, with the velocity that it came with.
        way = (going.landing.latest - interval.duration) * going.landing.rate
        error = bounded(with_bound(error, way + max(depth, 0.0), abs(going.landing.rate - rate)))
    if region.pressing:
        motion = motion_in(scene, interval, going, region, NOWHERE)
        force, stiffness, damping = force_on(motion, depth, rate)
        evaluations += 1 + looks_for_doubt(scene, going)
        doubt = impact_doubt(scene, going, region, depth, rate, force)
        if doubt > 0.0:
            error = with_push(error, doubt, stiffness, damping, scene.mass, interval.duration)
        held = holding(cosine * cosine * stiffness, cosine * cosine * damping, scene.mass)
        force_error = cosine * force_reach(error, stiffness, damping, 0.0, held) + doubt
    return Advance(
        Progress(
            going.state, error, going.try_step, going.impact_speed, going.impact_error, DYNAMIC,
            cosine * cosine * stiffness, cosine * cosine * damping, cosine * force - load, rate / cosine, depth, adrift,
        ),
        depth,
        rate,
        force if scene.regions.allow_tension else max(force, 0.0),
        reach(error, held),
        force_error,
        evaluations,
        interval.duration,
        True,
        going.state.height,
        DYNAMIC,
    )  # fmt: skip


@in_kernel
def unresolved(interval: Interval, going: Going, start: Progress) -> Advance:
    """How far the motion has come in a tick that was given up; there is no answer yet (`backlog.py`)."""
    depth, surface_rate, cosine = touch_at(interval, going.s).touch(going.state.height)
    if not abs(depth) < math.inf:
        return Advance(start, start.depth, 0.0, 0.0, math.inf, math.inf, going.evaluations, 0.0, False, 0.0, DYNAMIC)
    rate = surface_rate - cosine * going.state.velocity
    return Advance(
        Progress(
            going.state, bounded(going.error), going.try_step, going.impact_speed, going.impact_error, start.fidelity,
            start.stiffness, start.damping, start.excess, rate / cosine, depth, start.adrift,
        ),
        depth,
        rate,
        0.0,
        math.inf,
        math.inf,
        going.evaluations,
        going.s,
        False,
        going.state.height,
        DYNAMIC,
    )  # fmt: skip
