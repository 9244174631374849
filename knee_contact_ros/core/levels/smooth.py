"""Smooth ticks of forward dynamics, which nearly all ticks are: in contact throughout, in one layer, and not stiff.

A few equal explicit steps carry the femur over the interval, with the error control of `dynamic.py` at the first and
the last of them. If the tick is not smooth after all, it is left to `dynamic.py`. Beginning, step and end are separate
functions, which `compiled/lanes.py` calls for several knees at a time.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from knee_contact_ros.core.adrift import RESERVE
from knee_contact_ros.core.contact_modes import NOWHERE, ContactMode, enter
from knee_contact_ros.core.error_estimate import (
    UNKNOWN,
    PropagatedError,
    bounded,
    curved,
    force_reach,
    holding,
    meets_straight,
    propagated_by_series,
    propagated_over_step,
    reach,
    spectral_radius,
    with_step,
)
from knee_contact_ros.core.integrators.base import FemurState, Motion, Stage, StateError
from knee_contact_ros.core.integrators.fehlberg import EVALUATIONS, Slope, fehlberg_stride
from knee_contact_ros.core.kernel_source import always_inlined, in_kernel
from knee_contact_ros.core.prescribed import Interval, stretch_from, touch_at
from knee_contact_ros.core.scene import DYNAMIC, RunState, Scene, TickResult
from knee_contact_ros.core.stepping import EXPLICIT, local_ratio

FINEST = 10.0
"""Largest number of steps of a smooth tick: implicit steps cost less than more"""


class SmoothTick(NamedTuple):
    """State of a smooth tick between two steps."""

    state: FemurState
    error: PropagatedError
    slope: Slope
    """Contact and acceleration in that state"""
    largest: StateError
    """The largest estimated errors of its steps so far"""
    leapt: float
    """Their largest leap [m/s]; see `Step`"""
    ratio: float
    """Error of the last checked step over its tolerance"""
    held: float
    """Rate [1/s] at which the contact of the beginning limits an error of the velocity; see `holding`"""
    part: float
    """Duration of a step [s]"""
    parts: float
    """Number of steps in the tick"""
    smooth: bool
    """Whether the tick is smooth so far"""


@always_inlined
def smooth_tick(scene: Scene, interval: Interval, start: RunState, spent: int) -> TickResult:
    """Carry the femur over the interval by explicit steps; the result is not `converged` if the tick is not smooth.

    `spent` is the number of evaluations that the tick has taken already.
    """
    until, _ = stretch_from(interval, 0.0)
    remembers = scene.modes.law.layers[0].formula.remembers_impact()
    if until < interval.duration or math.isnan(start.impact_speed) or remembers:
        return not_begun(start, spent)
    so_far, mode, extra = begin_smooth(scene, interval, start)
    spent += extra
    if not so_far.smooth:
        return not_begun(start, spent)
    parts = int(so_far.parts)
    if scene.budget > 0 and spent + parts * EVALUATIONS > scene.budget - RESERVE:
        return not_begun(start, spent)
    for i in range(parts):
        so_far = step_smooth(scene, interval, start, mode, so_far, float(i), False)
        spent += EVALUATIONS
        if not so_far.smooth:
            return not_begun(start, spent)
    return end_smooth(scene, interval, start, so_far, spent)


@always_inlined
def begin_smooth(scene: Scene, interval: Interval, start: RunState) -> tuple[SmoothTick, ContactMode, int]:
    """The tick at its beginning, with duration and number of its steps; the mode of its contact; and evaluations."""
    h, state = interval.duration, start.state
    depth, surface_rate, cosine = touch_at(interval, 0.0).touch(state.height)
    rate, load = surface_rate - cosine * state.velocity, interval.start_load
    entry = enter(scene.modes, depth, rate, load, start.impact_speed)
    stiffness, damping = cosine * cosine * entry.stiffness, cosine * cosine * entry.damping
    fastest = spectral_radius(stiffness, damping, scene.mass)
    parts = float(math.ceil(max(1.0, h * fastest / EXPLICIT, h / start.try_step)))
    begin = Stage(depth=depth, rate=rate, force=entry.force, stiffness=entry.stiffness, surface_rate=surface_rate)
    slope = Slope(
        acceleration=(cosine * entry.force - load) / scene.mass, stage=begin, stiffness=stiffness, damping=damping,
        cosine=cosine,
    )  # fmt: skip
    so_far = SmoothTick(
        state=state, error=start.error, slope=slope, largest=StateError(0.0, 0.0), leapt=0.0, ratio=0.0,
        held=holding(stiffness, damping, scene.mass), part=h / parts, parts=parts,
        smooth=entry.mode.pressing and parts <= FINEST,
    )  # fmt: skip
    return so_far, entry.mode, 1 if entry.mode.layer >= 0 else 0


@always_inlined
def step_smooth(
    scene: Scene, interval: Interval, start: RunState, mode: ContactMode, so_far: SmoothTick, number: float, plain: bool
) -> SmoothTick:
    """Return the tick after one more step, the one with this number, counted from 0.

    A `plain` step has hardly a branch: where its error needs more than a series, the tick counts as not smooth.
    """
    motion = Motion(
        interval=interval, modes=scene.modes, mode=mode, impact_speed=start.impact_speed, mass=scene.mass,
        known=NOWHERE,
    )  # fmt: skip
    h, slope, mass, ratio = so_far.part, so_far.slope, scene.mass, so_far.ratio
    stride = fehlberg_stride(motion, number * h, so_far.state, h, slope)
    middle, end, leapt = stride.middle, stride.end, max(so_far.leapt, stride.leapt)
    largest = StateError(
        max(so_far.largest.height, abs(stride.error.height)), max(so_far.largest.velocity, abs(stride.error.velocity))
    )
    if number == 0.0 or number == so_far.parts - 1.0:  # all steps of a tick are alike
        ratio = local_ratio(
            scene, interval.start_load, stride.state, largest, slope.stage.force, end.stage.force, middle.stiffness,
            middle.damping, leapt, h, start.impact_speed > 0.0,
        )  # fmt: skip
    error, known = propagated_by_series(
        so_far.error, slope.stiffness, middle.stiffness, end.stiffness, middle.damping, mass, h
    )
    if not (known or plain):
        error = propagated_over_step(
            so_far.error, slope.stiffness, middle.stiffness, end.stiffness, middle.damping, mass, h
        )
    error = with_step(error, stride.error, UNKNOWN, so_far.held)
    if plain:
        known = known and meets_straight(error, end.stage.depth)
    else:
        error = curved(error, end.stage.depth, middle.stiffness, middle.damping, mass, h)
    smooth = stride.crossing.boundary == NOWHERE and ratio <= 1.0 and (known or not plain)
    return so_far._replace(
        state=stride.state, error=error, slope=end, largest=largest, leapt=leapt, ratio=ratio, smooth=smooth
    )


@always_inlined
def end_smooth(scene: Scene, interval: Interval, start: RunState, so_far: SmoothTick, spent: int) -> TickResult:
    """Return the contact at the end of the interval."""
    factor = 0.9 / math.sqrt(math.sqrt(max(so_far.ratio, 1e-4)))
    slope, end, try_step = so_far.slope, so_far.slope.stage, so_far.part * factor
    error, held = bounded(so_far.error), holding(slope.stiffness, slope.damping, scene.mass)
    return TickResult(
        run_state=start._replace(
            state=so_far.state, error=error, fidelity=DYNAMIC,
            try_step=max(start.try_step, try_step) if so_far.parts == 1.0 else try_step,
            stiffness=slope.stiffness, damping=slope.damping, excess=scene.mass * slope.acceleration,
            sinking=end.rate / slope.cosine, depth=end.depth,
        ),
        depth=end.depth, rate=end.rate, force=end.force if scene.modes.allow_tension else max(end.force, 0.0),
        error_estimate=reach(error, held),
        force_error_estimate=force_reach(error, slope.stiffness, slope.damping, 0.0, held) / slope.cosine,
        evaluations=spent, reached=interval.duration, converged=True, height=so_far.state.height, fidelity=DYNAMIC,
    )  # fmt: skip


@in_kernel
def not_begun(start: RunState, spent: int) -> TickResult:
    """Return a result that is not `converged` and where nothing has moved, with the evaluations taken so far."""
    return TickResult(
        run_state=start, depth=start.depth, rate=0.0, force=0.0, error_estimate=math.inf,
        force_error_estimate=math.inf, evaluations=spent, reached=0.0, converged=False, height=0.0, fidelity=DYNAMIC,
    )  # fmt: skip
