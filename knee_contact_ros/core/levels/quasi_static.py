"""The quasi-static level: n_y F(δ, 0) = max(L, 0), an equation for the depth at the end of the tick alone."""

from __future__ import annotations

import math

from knee_contact_ros.core.adrift import RESERVE
from knee_contact_ros.core.contact_laws.base import ContactLaw, layer_at
from knee_contact_ros.core.error_estimate import (
    TINY,
    PropagatedError,
    bounded,
    force_reach,
    holding,
    reach,
    with_bound,
    with_push,
)
from knee_contact_ros.core.integrators.base import FemurState
from knee_contact_ros.core.kernel_source import in_kernel, never_inlined
from knee_contact_ros.core.levels.deviation import UNKNOWN_INERTIA, LeftOut, deviate
from knee_contact_ros.core.prescribed import Interval, load_at, touch_at
from knee_contact_ros.core.scene import QUASI_STATIC, RunState, Scene, TickResult, impact_of
from knee_contact_ros.core.statics import NO_LIMIT, RESOLVED, static_contact
from knee_contact_ros.core.stepping import NEWTON_SHARE, doubt_of_impact


@never_inlined
def quasi_static_tick(scene: Scene, interval: Interval, start: RunState, spent: int) -> TickResult:
    """Return the static contact at the end of an interval, with the error of the motion that it leaves out.

    `spent` is the number of evaluations that the tick has taken already.
    """
    h, load_rate = interval.duration, interval.load_rate
    begin_depth, surface_rate, cosine = touch_at(interval, 0.0).touch(start.state.height)
    begin_sinking = load_rate / start.stiffness if start.stiffness > 0.0 else 0.0
    begin_velocity = surface_rate / cosine - begin_sinking
    law, touch, load = scene.modes.law, touch_at(interval, h), load_at(interval, h)
    near = max(0.0, begin_depth + cosine * begin_sinking * h)
    most = scene.budget - RESERVE - spent if scene.budget > 0 else NO_LIMIT
    static = static_contact(law, touch, load, start.state.height, near, NEWTON_SHARE * scene.tolerance, most)
    _, surface_rate, cosine = touch.touch(static.height)
    impact_speed, impact_error = impact_of(start)
    evaluations, damping = spent + static.evaluations, cosine * cosine * static.damping
    if static.depth > 0.0 and impact_speed > 0.0 and law.layers[0].formula.remembers_impact():
        damping = cosine * cosine * law.layers[0].formula.force_at(static.depth, 0.0, impact_speed)[2]
        evaluations += 1
    stiffness = cosine * cosine * static.stiffness
    sinking = load_rate / stiffness if stiffness > 0.0 else 0.0
    doubt = 0.0
    if static.depth > 0.0 and impact_error > 0.0 and law.layers[0].formula.remembers_impact():
        rate = cosine * sinking
        doubt = doubt_of_impact(
            law.layers[0].formula, static.depth, rate, static.force + damping / (cosine * cosine) * rate, impact_speed,
            impact_error,
        )  # fmt: skip
        evaluations += 2
    velocity = surface_rate / cosine - sinking
    inertia = scene.mass * (velocity - begin_velocity) / h
    left_out = LeftOut(
        stiffness=0.5 * (start.stiffness + stiffness), damping=0.5 * (start.damping + damping),
        end_stiffness=stiffness, end_damping=damping,
        begin_rest=rest(inertia - start.damping * begin_sinking, start.stiffness, stiffness),
        end_rest=rest(inertia - damping * sinking, stiffness, start.stiffness),
        way=static.height - start.state.height - lag_of(start) - begin_velocity * h, gain=velocity - begin_velocity,
        inertia=inertia,
        begin_load=load_at(interval, 0.0), end_load=load,
        depth=static.depth - law.layers[max(0, layer_at(law, static.depth))].begin,
    )  # fmt: skip
    error = deviate(deviation_at_start(start, begin_velocity), left_out, scene.mass, h)
    left = min(NEWTON_SHARE * scene.tolerance, RESOLVED * static.depth)
    unknown = way_across(law, begin_depth, static.depth) + left * left / max(static.depth, TINY)
    push = UNKNOWN_INERTIA * abs(inertia) + doubt
    error = bounded(with_bound(with_push(error, push, stiffness, damping, scene.mass, h), unknown, 0.0))
    held = holding(stiffness, damping, scene.mass)
    return TickResult(
        run_state=RunState(
            state=FemurState(static.height, velocity), error=error, try_step=math.inf, impact_speed=impact_speed,
            impact_error=impact_error, fidelity=QUASI_STATIC, stiffness=stiffness, damping=damping,
            excess=damping * sinking, sinking=sinking, depth=static.depth, adrift=start.adrift,
        ),
        depth=static.depth, rate=cosine * sinking, force=static.force, error_estimate=reach(error, held),
        force_error_estimate=force_reach(error, stiffness, damping, damping * sinking, held) / cosine + doubt,
        evaluations=evaluations, reached=h, converged=True, height=static.height, fidelity=QUASI_STATIC,
    )  # fmt: skip


@in_kernel
def rest(push: float, stiffness: float, other: float) -> float:
    """Return the displacement [m] by a force [N] at a stiffness [N/m], or at the other one where that is 0."""
    spring = stiffness if stiffness > 0.0 else other
    return push / spring if spring > 0.0 else 0.0


@in_kernel
def way_across(law: ContactLaw, begin: float, end: float) -> float:
    """Return how far [m] a contact goes beyond a layer's boundary between two depths [m]; 0 if it crosses none.

    In the other layer the dynamic femur meets another dashpot, and may stay behind.
    """
    before, after = layer_at(law, max(begin, 0.0)), layer_at(law, end)
    if before == after:
        return 0.0
    return abs(end - law.layers[max(before, after)].begin)


@in_kernel
def lag_of(start: RunState) -> float:
    """The height [m] of the static contact above the state at a tick's beginning, which may be of another level."""
    return (start.excess - start.damping * start.sinking) / start.stiffness if start.stiffness > 0.0 else 0.0


@in_kernel
def deviation_at_start(start: RunState, velocity: float) -> PropagatedError:
    """Return the deviation of this level at the beginning of a tick, where it has a `velocity` [m/s]."""
    error = start.error
    return error._replace(
        height=lag_of(start) + error.height, velocity=velocity - start.state.velocity + error.velocity
    )
