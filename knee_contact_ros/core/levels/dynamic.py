"""Forward dynamics of the femur over one tick (Eq. 13): M ÿ = -L(t) + F(δ, δ̇), with error control and events.

A step computes with the formula of one region of the contact law. When it has crossed a boundary of the region it is
shortened until it ends on the boundary, and the next region goes on from there: no step crosses a kink or a jump.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from knee_contact_ros.core.error_estimate import (
    HORIZON,
    SAFETY,
    behind_jump,
    carry,
    carry_in_flight,
    depth_error,
    let_go,
    settled_doubt,
    swiftness,
)
from knee_contact_ros.core.events import end_on_boundary
from knee_contact_ros.core.integrators.base import FemurState, StateError, Step, force_on
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
from knee_contact_ros.core.statics import START_HEIGHT, static_contact
from knee_contact_ros.core.stepping import (
    Going,
    controlled_step,
    doubtful_push,
    impact_doubt,
    lost_in,
    motion_in,
)
from knee_contact_ros.core.types import Fidelity

DYNAMIC = int(Fidelity.DYNAMIC)
GIVEN_UP = int(Fidelity.QUASI_STATIC)


class Dynamic(NamedTuple):
    """The level as a part of a scene."""

    rank: int = DYNAMIC

    def advance(self, scene: Scene, interval: Interval, start: Progress) -> Advance:
        """See `Level`."""
        return dynamic_tick(scene, interval, start, 0)


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
    """The same by steps of any length and kind, from event to event."""
    going = Going(
        0.0, start.state, start.error, start.try_step, 0.0, start.impact_speed, start.impact_error, 0.0, spent, 0, False
    )
    region = Region(APART, False)
    begin = 0.0
    while begin < interval.duration and not going.given_up:
        until, following = stretch_from(interval, begin)
        going, region = begin_stretch(scene, interval, going, begin)
        while going.s < until and not going.given_up:
            going, region = step_on(scene, interval, going, region, until)
        begin = following
    if going.given_up or not abs(going.state.height) < math.inf:
        return settled(scene, interval, going)
    return result(scene, interval, going, region)


@in_kernel
def begin_stretch(scene: Scene, interval: Interval, going: Going, s: float) -> tuple[Going, Region]:
    """Go on at s [s] with the angle's new rate or the surface's new bump; return the region there."""
    state = FemurState(going.state.height + going.state.velocity * (s - going.s), going.state.velocity)
    depth, surface_rate, cosine = touch_at(interval, s).touch(state.height)
    rate = surface_rate - cosine * state.velocity
    impact_speed, impact_error = going.impact_speed, going.impact_error
    if math.isnan(impact_speed) and depth_ahead(depth, rate) >= 0.0:
        impact_speed, impact_error = rate, going.error.velocity
    entry = enter(scene.regions, depth, rate, load_at(interval, s), impact_speed)
    evaluations = going.evaluations + (1 if entry.region.layer >= 0 else 0)
    going = Going(
        s, state, going.error, going.try_step, swiftness_in(scene, entry, cosine), impact_speed, impact_error,
        going.error_at_events, evaluations, going.events, False,
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
        carried = carry(going.error, step.stiffness, step.damping, scene.mass, h)
        swift = swiftness(step.stiffness, step.damping, scene.mass)
    else:
        carried, swift = carry_in_flight(going.error, h), 0.0
    velocity = carried.velocity + step.error.velocity
    unsigned = lost_in(scene, interval, going, step, h) + doubtful_push(scene, interval, going, region, step, h)
    return Going(
        until if h == until - going.s else going.s + h,
        step.state,
        StateError(carried.height + step.error.height, velocity + math.copysign(unsigned, velocity)),
        going.try_step,
        swift,
        going.impact_speed,
        going.impact_error,
        going.error_at_events,
        going.evaluations,
        going.events,
        going.given_up,
    )


@aside
def behind_boundary(
    scene: Scene, interval: Interval, going: Going, region: Region, step: Step, boundary: int
) -> tuple[Going, Region]:
    """Go on behind a boundary that a step has ended on; return the region there."""
    end = step.end
    impact_speed, impact_error = going.impact_speed, going.impact_error
    if region.layer < 0:
        impact_speed, impact_error = end.rate, going.error.velocity
    if boundary == FORCE:
        entry = cross_force(scene.regions, region, end.depth, end.rate, impact_speed)
    else:
        layer, load = region.layer + (1 if boundary == BELOW else -1), load_at(interval, going.s)
        entry = enter_layer(scene.regions, layer, end.depth, end.rate, load, impact_speed)
    following = entry.region
    jump = entry.force - (end.force if region.pressing else 0.0)
    error = going.error
    if region.pressing and not following.pressing:
        error = let_go(error, step.stiffness, scene.mass)
    off = 0.0 if boundary == FORCE else margin(scene.regions, region, boundary, end.depth, end.force)
    evaluated = following.pressing or (boundary != FORCE and following.layer >= 0)
    _, _, cosine = touch_at(interval, going.s).touch(going.state.height)
    going = Going(
        going.s,
        going.state,
        behind_jump(error, end.rate, jump, off, scene.mass, interval.duration),
        going.try_step,
        swiftness_in(scene, entry, cosine),
        math.nan if following.layer < 0 else impact_speed,
        impact_error,
        max(going.error_at_events, abs(going.error.height)),
        going.evaluations + (1 if evaluated else 0),
        going.events + 1,
        going.given_up,
    )
    return going, following


@in_kernel
def result(scene: Scene, interval: Interval, going: Going, region: Region) -> Advance:
    """The contact at the end of the interval."""
    depth, surface_rate, cosine = touch_at(interval, going.s).touch(going.state.height)
    rate, load = surface_rate - cosine * going.state.velocity, load_at(interval, interval.duration)
    force, stiffness, damping, evaluations = 0.0, 0.0, 0.0, going.evaluations
    if region.pressing:
        motion = motion_in(scene, interval, going, region, NOWHERE)
        force, stiffness, damping = force_on(motion, depth, rate)
        evaluations += 1
    # In flight a velocity error does nothing to the height until later; in contact the two turn into each other.
    error = abs(going.error.height)
    if region.pressing:
        error = depth_error(going.error, stiffness, damping, scene.mass)
        doubt = impact_doubt(scene, interval, going, region, depth, rate, force)
        error += doubt / max(stiffness, scene.mass / (HORIZON * HORIZON))
    return Advance(
        Progress(
            going.state, going.error, going.try_step, going.impact_speed, going.impact_error, DYNAMIC, 0.0,
            cosine * cosine * stiffness, cosine * cosine * damping, cosine * force - load, rate / cosine, depth,
        ),
        depth,
        rate,
        force if scene.regions.allow_tension else max(force, 0.0),
        # A bounce turns the height's error round: where that is underway, its signed estimate says little.
        SAFETY * max(error, going.error_at_events),
        math.nan,
        evaluations,
        True,
    )  # fmt: skip


@aside
def settled(scene: Scene, interval: Interval, going: Going) -> Advance:
    """The static contact at the end of the interval, in doubt by all the motion that was going on."""
    depth, surface_rate, cosine = touch_at(interval, going.s).touch(going.state.height)
    rate = surface_rate - cosine * going.state.velocity
    left = interval.duration - going.s
    touch, load = touch_at(interval, interval.duration), load_at(interval, interval.duration)
    static = static_contact(scene.regions.law, touch, load, START_HEIGHT, 0.0, 0.0)
    _, surface_rate, cosine = touch.touch(static.height)
    reach = max(abs(depth), static.depth)
    doubt = settled_doubt(reach, rate, load, load - interval.load_rate * left, scene.mass, left)
    return Advance(
        # How the contact began is lost with the motion: it may have begun as fast as all of this doubt.
        Progress(
            FemurState(static.height, surface_rate / cosine), doubt, math.inf, 0.0, doubt.velocity, GIVEN_UP,
            0.0, 0.0, 0.0, 0.0, 0.0, static.depth,
        ),
        static.depth,
        0.0,
        static.force,
        doubt.height,
        math.nan,
        going.evaluations + static.evaluations,
        False,
    )  # fmt: skip
