"""The smooth ticks of forward dynamics, which are nearly all: in contact throughout, in one layer, and not stiff.

A few equal explicit steps carry the femur over the interval, with the error control of `dynamic.py` at the first and
the last of them. Where anything else turns up, this gives up and leaves the tick to it.
"""

from __future__ import annotations

import math

from knee_contact_ros.core.adrift import RESERVE
from knee_contact_ros.core.contact_modes import NOWHERE, enter
from knee_contact_ros.core.error_estimate import (
    UNKNOWN,
    bounded,
    carry_on,
    curved,
    force_reach,
    holding,
    reach,
    spectral_radius,
    with_step,
)
from knee_contact_ros.core.integrators.base import Motion, Stage, StateError
from knee_contact_ros.core.integrators.fehlberg import EVALUATIONS, Slope, fehlberg_stride
from knee_contact_ros.core.kernel_source import always_inlined, in_kernel
from knee_contact_ros.core.prescribed import Interval, stretch_from, touch_at
from knee_contact_ros.core.scene import DYNAMIC, RunState, Scene, TickResult
from knee_contact_ros.core.stepping import EXPLICIT, local_ratio

FINEST = 10.0
"""Most steps of a tick that are tried here: fewer cost less than implicit ones"""


@always_inlined
def smooth_tick(scene: Scene, interval: Interval, start: RunState, spent: int) -> TickResult:
    """Carry the femur over the interval by explicit steps; not `converged`, with what it cost, if it is no smooth tick.

    `spent` are the evaluations that the tick has cost already.
    """
    h, state, error = interval.duration, start.state, start.error
    until, _ = stretch_from(interval, 0.0)
    law = scene.modes.law
    if until < h or math.isnan(start.impact_speed) or law.layers[0].formula.remembers_impact():
        return not_smooth(start, spent)
    depth, surface_rate, cosine = touch_at(interval, 0.0).touch(state.height)
    rate, load = surface_rate - cosine * state.velocity, interval.start_load
    entry = enter(scene.modes, depth, rate, load, start.impact_speed)
    spent += 1 if entry.mode.layer >= 0 else 0
    if not entry.mode.pressing:
        return not_smooth(start, spent)
    stiffness, damping = cosine * cosine * entry.stiffness, cosine * cosine * entry.damping
    swift = spectral_radius(stiffness, damping, scene.mass)
    parts = math.ceil(max(1.0, h * swift / EXPLICIT, h / start.try_step))
    if parts > FINEST or (scene.budget > 0 and spent + parts * EVALUATIONS > scene.budget - RESERVE):
        return not_smooth(start, spent)

    motion = Motion(
        interval=interval, modes=scene.modes, mode=entry.mode, impact_speed=start.impact_speed, mass=scene.mass,
        known=NOWHERE,
    )  # fmt: skip
    begin = Stage(depth=depth, rate=rate, force=entry.force, stiffness=entry.stiffness, surface_rate=surface_rate)
    slope = Slope(
        acceleration=(cosine * entry.force - load) / scene.mass, stage=begin, stiffness=stiffness, damping=damping,
        cosine=cosine,
    )  # fmt: skip
    part, held, leapt, middle, before = h / parts, holding(stiffness, damping, scene.mass), 0.0, slope, 0.0
    largest, ratio = StateError(0.0, 0.0), 0.0
    for i in range(parts):
        stride, before = fehlberg_stride(motion, i * part, state, part, slope), slope.stage.force
        spent += EVALUATIONS
        middle, leapt = stride.middle, max(leapt, stride.leapt)
        largest = StateError(
            max(largest.height, abs(stride.error.height)), max(largest.velocity, abs(stride.error.velocity))
        )
        if i == 0 or i == parts - 1:  # all steps of a tick are alike
            ratio = local_ratio(
                scene, load, stride.state, largest, before, stride.end.stage.force, middle.stiffness, middle.damping,
                leapt, part, start.impact_speed > 0.0,
            )  # fmt: skip
        if stride.crossing.boundary != NOWHERE or not ratio <= 1.0:
            return not_smooth(start, spent)
        error = carry_on(
            error, slope.stiffness, middle.stiffness, stride.end.stiffness, middle.damping, scene.mass, part
        )
        error = with_step(error, stride.error, UNKNOWN, held)
        error = curved(error, stride.end.stage.depth, middle.stiffness, middle.damping, scene.mass, part)
        state, slope = stride.state, stride.end

    factor = 0.9 / math.sqrt(math.sqrt(max(ratio, 1e-4)))
    end = slope.stage
    error, held = bounded(error), holding(slope.stiffness, slope.damping, scene.mass)
    return TickResult(
        run_state=RunState(
            state=state, error=error, try_step=max(start.try_step, part * factor) if parts == 1 else part * factor,
            impact_speed=start.impact_speed, impact_error=start.impact_error, fidelity=DYNAMIC,
            stiffness=slope.stiffness, damping=slope.damping, excess=scene.mass * slope.acceleration,
            sinking=end.rate / slope.cosine, depth=end.depth, adrift=start.adrift,
        ),
        depth=end.depth, rate=end.rate, force=end.force if scene.modes.allow_tension else max(end.force, 0.0),
        error_estimate=reach(error, held),
        force_error_estimate=force_reach(error, slope.stiffness, slope.damping, 0.0, held) / slope.cosine,
        evaluations=spent, reached=h, converged=True, height=state.height, fidelity=DYNAMIC,
    )  # fmt: skip


@in_kernel
def not_smooth(start: RunState, spent: int) -> TickResult:
    """Word that a tick is none of this kind, with what it has cost."""
    return TickResult(
        run_state=start, depth=0.0, rate=0.0, force=0.0, error_estimate=0.0, force_error_estimate=0.0,
        evaluations=spent, reached=0.0, converged=False, height=0.0, fidelity=DYNAMIC,
    )  # fmt: skip
