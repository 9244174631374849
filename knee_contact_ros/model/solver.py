"""One tick of forward dynamics, from top to bottom: M ÿ = -L(t) + n_y F(δ, δ̇) (Eq. 13), with error control and events.

Between two samples load and flexion angle are linear in time, and the height y of the femur is the only free
coordinate. `advance` integrates it over that interval, mode by mode (`contact.py`). A pressing contact takes explicit
Runge-Kutta steps if it is not stiff for the step, and implicit ones otherwise (`steps.py`); in the other modes the
femur flies, which is solved exactly. A step that crosses a boundary of its mode is shortened to end on it
(`events.py`), and the next mode continues from there, so no step crosses a kink or a jump of the force. The estimated
error is propagated too (`error_estimate.py`).

The constants are checked in random scenes against an independent reference (`studies.honesty`).
"""

import math
from typing import NamedTuple

from .compiler import in_kernel, inlined
from .contact import (
    DEPTH_ROUNDING,
    FORCE_ZERO,
    LAYER_END,
    NO_BOUNDARY,
    FemurState,
    Interval,
    KneeConstants,
    Mode,
    Motion,
    Result,
    Stage,
    distance_inside,
    load_at,
    stage_at,
    stage_in,
)
from .error_estimate import (
    SAFETY_FACTOR,
    SPREAD_FACTOR,
    TINY,
    Error,
    beside_delay,
    eigenvalues,
    force_bound,
    height_bound,
    limited,
    mapped,
    propagated,
    relaxation_rate,
    response,
    saltation,
    velocity_bound,
    with_bound,
    with_curvature,
    with_independent_bound,
    with_step_error,
)
from .events import end_on_boundary, probe_flight, smooth_stretch, touch_delay
from .laws import APART, BEGIN, DAMPING, EXPONENT, force_at, layer_at
from .step_control import error_ratio, unresolved_motion
from .steps import (
    MAX_EXPLICIT_STEP,
    SINGULAR_ERROR_FACTOR,
    STEP_RESERVE,
    Step,
    doubled_step,
    explicit_step,
    flight_step,
)

MAX_EXPLICIT_STEPS = 6.0
"""Number of explicit steps that cost less than an implicit step with its halves"""
DURATION_SHARE = 0.9
"""Part of the duration that would just meet the tolerance, which the next step tries. Usual in the literature."""
MAX_SHRINKING = 0.1
"""Smallest factor on the duration of a step that is repeated. Usual in the literature."""
LEAST_ERROR_RATIO = 1e-4
"""Error ratio below which a step is not made longer still: a factor of 9 at most. Usual in the literature."""
MISSED_SHARE = 0.3
"""Largest part of a jump of the force within a step that the weights of a method miss: Fehlberg's 0.29, two ESDIRK
halves 0.20"""
MAX_EVENTS = 1000
"""Number of crossed boundaries after which a tick is given up"""


class Touch(NamedTuple):
    """How the present contact began, and the last landing."""

    speed: float
    """Penetration rate [m/s] at which the contact began, 0 at rest; NaN while the surfaces are apart"""
    error: float
    """Estimated error of that speed [m/s]"""
    latest: float
    """Time of the interval [s] by which the exact femur has landed too; 0 if it was in contact from the start"""
    landing_rate: float
    """Penetration rate [m/s] of the last landing"""


@inlined
def advance(knee: KneeConstants, tick: Interval, start: FemurState, most: int) -> Result:
    """Carry the femur over the interval with at most `most` evaluations of the contact."""
    mode = Mode(knee, tick, APART, False, 0.0)
    motion = Motion(
        0.0, start.height, start.velocity, stage_at(mode, 0.0, start.height, start.velocity)
    )
    touch = Touch(start.impact_speed, start.impact_error, 0.0, 0.0)
    error, try_step = start.error, start.try_step
    stretch_end, next_stretch, used, events, given_up = 0.0, 0.0, 0, 0, False
    while motion.time < tick.duration and not given_up:
        if motion.time >= stretch_end:
            if next_stretch > motion.time:
                motion = over_kink(mode, motion, next_stretch)
                used += 1
            stretch_end, next_stretch = tick.duration, tick.duration
            if len(knee.surfaces.kinks) > 0:
                stretch_end, next_stretch = smooth_stretch(knee, tick, motion.time)
            mode, motion, touch = begin_stretch(mode, motion, error, touch)
            if mode.layer > APART:
                used += 1
        # A tick is given up between two steps: a step that is not finished has no state to answer with.
        if used + STEP_RESERVE >= most:
            break
        begin, factor = motion, 1.0
        if mode.pressing:
            step, h, boundary, try_step, evaluations, given_up, factor = pressed_step(
                mode, begin, stretch_end, try_step, most - used
            )
        else:
            step, h, boundary, evaluations, given_up = flight(
                mode, begin, stretch_end, most - used
            )
        used += evaluations
        if given_up:
            break
        end = begin.time + h
        if h == stretch_end - begin.time:
            end = stretch_end  # exactly, whatever the rounding of the sum
        _, height, velocity, stage = begin
        # A step of length 0 goes straight across its boundary, and leaves height, velocity and error as they are.
        if h > 0.0:
            height, velocity, stage = step.height, step.velocity, step.end
            if step.implicit:
                # `solve_stage` leaves a force that follows the last correction along the tangent.
                stage = stage_at(mode, begin.time + h, height, velocity)
                used += 1
            error = error_after_step(mode, begin, step, h, error, factor)
            if knee.remembers_impact and mode.pressing:
                error, touch = with_impact_doubt(mode, begin, step, stage, h, error, touch)
                # The doubt of the force takes two evaluations of the law at each end of the step.
                if touch.error > 0.0:
                    used += 4
        motion = Motion(end, height, velocity, stage)
        if boundary != NO_BOUNDARY:
            mode, motion, error, touch = cross(mode, motion, boundary, error, touch)
            if mode.layer > APART and boundary != FORCE_ZERO:
                used += 1
            events += 1
            given_up = events >= MAX_EVENTS
    return result_at(mode, motion, error, try_step, touch, used)


@in_kernel
def over_kink(mode: Mode, motion: Motion, s: float) -> Motion:
    """Return the motion on the other side of a kink, at s [s], in the mode of surfaces that are apart.

    The way across is 4e-12 rad long, so the acceleration before it serves for all of it.
    """
    height, velocity = motion.height, motion.velocity
    gap, knee = s - motion.time, mode.knee
    pull = -load_at(mode.tick, motion.time) * knee.per_mass
    if mode.pressing:
        pull = motion.stage.acceleration
    height += gap * (velocity + 0.5 * gap * pull)
    velocity += gap * pull
    apart = Mode(knee, mode.tick, APART, False, 0.0)
    return Motion(s, height, velocity, stage_at(apart, s, height, velocity))


@in_kernel
def begin_stretch(
    mode: Mode, motion: Motion, error: Error, touch: Touch
) -> tuple[Mode, Motion, Touch]:
    """Return mode, motion and touch at the beginning of a smooth stretch, where the rate of the surface has jumped."""
    knee, stage = mode.knee, motion.stage
    # Exactly on a boundary the direction of the rate decides on which side the contact goes on.
    ahead = stage.depth + math.copysign(DEPTH_ROUNDING, stage.rate)
    if math.isnan(touch.speed):
        if ahead >= 0.0:
            touch = Touch(stage.rate, velocity_bound(error), touch.latest, touch.landing_rate)
    elif stage.rate > 0.0 and stage.depth <= height_bound(error, math.inf):
        # The exact surfaces may be apart, and touch now: at this rate, and not at that of the present contact.
        another = abs(stage.rate - touch.speed) + velocity_bound(error)
        touch = Touch(touch.speed, max(touch.error, another), touch.latest, touch.landing_rate)
    impact_speed = 0.0 if math.isnan(touch.speed) else touch.speed
    layer = layer_at(knee.law, ahead)
    mode = Mode(knee, mode.tick, layer, layer > APART, impact_speed)
    if layer > APART:
        mode, motion = entered(mode, motion)
    return mode, motion, touch


@inlined
def entered(mode: Mode, motion: Motion) -> tuple[Mode, Motion]:
    """Return a pressing mode and the motion in it; where the layer's formula pulls, it is released."""
    knee, tick, motion = mode.knee, mode.tick, restaged(mode, motion)
    if not (knee.allow_tension or motion.stage.force >= -tick.rounding):
        mode = Mode(knee, tick, mode.layer, False, mode.impact_speed)
    return mode, motion


@in_kernel
def restaged(mode: Mode, motion: Motion) -> Motion:
    """Return a motion whose contact is in another mode."""
    s, height, velocity, stage = motion
    again = stage_in(mode, s, stage.depth, stage.rate, stage.surface_rate, stage.cosine)
    return Motion(s, height, velocity, again)


@inlined
def pressed_step(
    mode: Mode, begin: Motion, until: float, try_step: float, room: int
) -> tuple[Step, float, int, float, int, bool, float]:
    """Find a step towards `until` [s] whose error fits, and end it on the boundary that it crosses, if any.

    Of many explicit tries across a knot of a spline the first one fits whose estimate is small by chance: after a
    failure estimates count `SINGULAR_ERROR_FACTOR` times. Returns the step, its duration [s], the boundary, the
    duration that the next step should try, the evaluations, whether the tick must be given up, and the factor on the
    step's estimate.
    """
    surfaces, stage, remaining = mode.knee.surfaces, begin.stage, until - begin.time
    _, radius = eigenvalues(stage.stiffness, stage.damping, mode.knee.mass)
    h, used, boundary, factor = min(try_step, remaining), 0, NO_BOUNDARY, 1.0
    if abs(mode.tick.angle_rate) * h > surfaces.knot_spacing:
        h = surfaces.knot_spacing / abs(mode.tick.angle_rate)  # a step sees one knot of a spline
    stiff = radius * h > MAX_EXPLICIT_STEP
    if stiff and radius * remaining <= MAX_EXPLICIT_STEPS * MAX_EXPLICIT_STEP:
        # Equal steps, as a short last one would cost as much as the others.
        h = remaining / math.ceil(radius * remaining / MAX_EXPLICIT_STEP)
    while True:
        if radius * h <= MAX_EXPLICIT_STEP:
            step = explicit_step(mode, NO_BOUNDARY, begin, h)
        else:
            step = doubled_step(mode, NO_BOUNDARY, begin, h, room - used - STEP_RESERVE)
        used += step.evaluations
        ratio = factor * error_ratio(mode, begin, step, h)
        # The local error goes with h⁵, and its share of the tolerance with h, so their ratio with h⁴.
        change = DURATION_SHARE / math.sqrt(math.sqrt(max(ratio, LEAST_ERROR_RATIO)))
        if ratio <= 1.0:
            break
        h *= max(MAX_SHRINKING, change)
        has_knots = surfaces.non_convex > 0.0 or surfaces.knot_spacing < math.inf
        if has_knots and not step.implicit:
            factor = SINGULAR_ERROR_FACTOR
        # Below the rounding of the time no shorter step can be better.
        if used + STEP_RESERVE >= room or not until + h > until:
            return step, h, NO_BOUNDARY, try_step, used, True, factor
    # A step that only the end of the stretch has limited says nothing against longer ones.
    try_step = h * change if h < remaining else max(try_step, h * change)
    given_up = False
    # Ended on one boundary, a step may have crossed another before: a dashpot pulls before the surfaces part.
    # Steps are shortened by the boundary after their error has been accepted: a shorter step is more accurate still.
    while NO_BOUNDARY < step.boundary != boundary and h > 0.0 and not given_up:
        given_up = used + STEP_RESERVE >= room
        if not given_up:
            step, h, boundary, evaluations = end_on_boundary(
                mode, begin, 0.0, step.fraction * h, stage, step.boundary, room - used
            )
            used += evaluations
            given_up = used + STEP_RESERVE >= room
    return step, h, boundary, try_step, used, given_up, factor


@inlined
def flight(
    mode: Mode, begin: Motion, until: float, room: int
) -> tuple[Step, float, int, int, bool]:
    """Fly towards `until` [s] and end on the first boundary.

    Returns the step, its duration [s], the boundary, the evaluations, and whether the tick must be given up. A probe
    counts as an evaluation also where the surfaces are apart: on measured surfaces their distance is most of the work.
    """
    h, limit = until - begin.time, room - STEP_RESERVE
    low, high, before, boundary, used = probe_flight(mode, begin, h, limit)
    if boundary == NO_BOUNDARY or used >= limit:
        return flight_step(mode, begin, h), h, NO_BOUNDARY, used, used >= limit
    step, h, boundary, evaluations = end_on_boundary(
        mode, begin, low, high, before, boundary, room - used
    )
    return step, h, boundary, used + evaluations, False


@inlined
def error_after_step(
    mode: Mode, begin: Motion, step: Step, h: float, error: Error, factor: float
) -> Error:
    """Return the error after a step of `h` [s] to a contact: the propagated one and the step's own, times `factor`."""
    if not mode.pressing:
        # No spring and no dashpot: the error of the velocity moves the height, and nothing decays.
        flown = mapped(error, 1.0, h, 0.0, 1.0)
        return with_independent_bound(flown, step.height_error, 0.0)
    mass, k, c = mode.knee.mass, step.stiffness, step.damping
    relaxation = relaxation_rate(k, c, mass)
    # From the edge of a layer on, the stiffness rises as xⁿ⁻¹: at once if n is near 1. With this much on the edge
    # instead of 0, Simpson's rule gives the mean.
    exponent = float(mode.knee.law[mode.layer, EXPONENT])
    rest = max(2.0 - exponent, 0.0)
    least = rest * rest * k
    begin_k, end_k = max(begin.stage.stiffness, least), max(step.end.stiffness, least)
    error = propagated(error, begin_k, k, end_k, c, mass, h)
    beside = beside_delay(error, step.end.rate, step.end.acceleration, relaxation)
    error = with_step_error(
        error,
        factor * step.height_error,
        factor * step.velocity_error,
        2.0 * SAFETY_FACTOR if step.implicit else SAFETY_FACTOR,
        relaxation,
        beside,
    )
    in_layer = max(begin.stage.depth, step.end.depth) - float(mode.knee.law[mode.layer, BEGIN])
    growth = exponent if mode.knee.remembers_impact else 0.0
    error = with_curvature(error, beside, in_layer, k, c, growth, mass, h)
    if step.leap > 0.0:
        # Between which stages the contact leaps is known, but not when.
        jump = step.leap * (c + k * h)
        height, velocity = response(MISSED_SHARE * jump, k, c, mass, h)
        error = with_independent_bound(error, height, velocity)
    if begin.stage.rate > 0.0 > step.end.rate:
        error = with_independent_bound(error, missed_graze(mode, begin.stage, step.end, h), 0.0)
    if step.implicit:
        crept, swung = unresolved_motion(mode, begin, step, h)
        if crept + swung > 0.0:
            # An oscillation at an unknown phase is a height as well as a velocity.
            swung *= SAFETY_FACTOR * math.sqrt(0.5)
            error = with_bound(error, crept + swung / relaxation, swung)
    return error


@in_kernel
def missed_graze(mode: Mode, begin: Stage, end: Stage, h: float) -> float:
    """Return the height [m] that a femur loses if it turns round within the next layer between the stages of a step.

    By a parabola through the step, the depth x beyond the layer and the time t up to there: the other dashpot takes
    4/3 c t/m of x, at most all.
    """
    law, slowing = mode.knee.law, (begin.rate - end.rate) / h
    rise = 0.5 * begin.rate * begin.rate / slowing
    beyond = begin.depth + rise - float(law[mode.layer + 1, BEGIN])
    if beyond <= 0.0:
        return 0.0
    change = abs(float(law[mode.layer + 1, DAMPING]) - float(law[mode.layer, DAMPING]))
    return beyond * min(
        1.0, 4.0 / 3.0 * change / mode.knee.mass * math.sqrt(2.0 * beyond / slowing)
    )


@in_kernel
def with_impact_doubt(
    mode: Mode, begin: Motion, step: Step, stage: Stage, h: float, error: Error, touch: Touch
) -> tuple[Error, Touch]:
    """Return error and touch after a step, for a law of restitution: its force depends on the impact speed."""
    one = begin.stage
    if one.rate < 0.0 < stage.rate:
        # The exact surfaces may have parted and met again meanwhile, which would be another impact. The depth is convex
        # between the two ends, so it is no less than where their tangents meet.
        back = (one.depth - stage.depth + h * stage.rate) / (stage.rate - one.rate)
        least = min(one.depth + max(back, 0.0) * one.rate, stage.depth)
        if least <= height_bound(error, math.inf):
            again = abs(touch.speed) + max(-one.rate, stage.rate) + velocity_bound(error)
            touch = Touch(touch.speed, max(touch.error, again), touch.latest, touch.landing_rate)
    if touch.error > 0.0:
        doubt = max(impact_doubt(mode, one, touch.error), impact_doubt(mode, stage, touch.error))
        # A contact that has begun faster damps less, maybe next to nothing.
        height, velocity = response(doubt, step.stiffness, 0.0, mode.knee.mass, h)
        error = with_independent_bound(error, height, velocity)
    return error, touch


@in_kernel
def impact_doubt(mode: Mode, stage: Stage, impact_error: float) -> float:
    """Return the change of a force [N] if its contact began faster or slower by an error [m/s]."""
    law, layer, speed = mode.knee.law, mode.layer, mode.impact_speed
    faster, _, _ = force_at(law, layer, stage.depth, stage.rate, speed + impact_error)
    slower, _, _ = force_at(law, layer, stage.depth, stage.rate, max(0.0, speed - impact_error))
    return max(abs(faster - stage.force), abs(slower - stage.force))


@inlined
def cross(
    mode: Mode, motion: Motion, boundary: int, error: Error, touch: Touch
) -> tuple[Mode, Motion, Error, Touch]:
    """Return mode, motion, error and touch beyond a boundary on which the motion is."""
    knee, tick, stage = mode.knee, mode.tick, motion.stage
    exerted = stage.force if mode.pressing else 0.0
    off = distance_inside(mode, boundary, stage)
    impact_speed, layer = mode.impact_speed, mode.layer
    if layer == APART:
        delay = touch_delay(tick, error, motion.time, stage.rate, knee.mass)
        # A femur that comes later has been sped up or slowed down by the load meanwhile, by what its velocity is off
        # now if it is merely late.
        most = velocity_bound(error) + abs(stage.acceleration) * delay
        late = stage.acceleration / max(abs(stage.rate), TINY)
        doubt = min(most, velocity_bound(mapped(error, 1.0, 0.0, late, 1.0)))
        if stage.rate * motion.time <= height_bound(error, math.inf):
            # The exact surfaces may not have parted before this tick: then their contact may have begun at rest.
            doubt = max(doubt, stage.rate)
        touch = Touch(stage.rate, doubt, motion.time + delay, stage.rate)
        impact_speed = stage.rate
    if boundary == FORCE_ZERO:
        mode, off = Mode(knee, tick, layer, not mode.pressing, impact_speed), 0.0
        motion = restaged(mode, motion)
    else:
        layer += 1 if boundary == LAYER_END else -1
        mode = Mode(knee, tick, layer, layer > APART, impact_speed)
        mode, motion = entered(mode, motion)
    if layer == APART:
        if knee.remembers_impact and touch.error > 0.0 and touch.speed > 0.0:
            # A contact that has begun faster keeps a smaller part e of its speed v: v de/dv is about -e (1 - e). The
            # linearised contact, which is that of one impact speed, knows only a part of this.
            kept = min(abs(stage.rate) / touch.speed, 1.0)
            own = kept * (1.0 - kept) * touch.error / SPREAD_FACTOR
            error = Error(error.height, error.velocity, error.hh, error.hv, error.vv + own * own)
        touch = Touch(math.nan, touch.error, touch.latest, touch.landing_rate)
    # What a femur that is late or early misses is the jump of the force, not the force (saltation).
    jump = (motion.stage.force if mode.pressing else 0.0) - exerted
    error = saltation(error, motion.stage.rate, jump, off, knee.mass, tick.duration)
    return mode, motion, limited(error), touch


@inlined
def result_at(
    mode: Mode, motion: Motion, error: Error, try_step: float, touch: Touch, used: int
) -> Result:
    """Return the contact at the end of the interval, or where the tick was given up after `used` evaluations."""
    knee, tick, stage, error = mode.knee, mode.tick, motion.stage, limited(error)
    law, layer = knee.law, mode.layer
    # What is added from here on belongs to this answer, and not to the state of the run.
    femur = FemurState(motion.height, motion.velocity, error, try_step, touch.speed, touch.error)
    if touch.latest > tick.duration:
        # The exact femur may touch only after the end of the tick: then it is still as fast as it was in flight.
        way = (touch.latest - tick.duration) * touch.landing_rate + max(stage.depth, 0.0)
        error = limited(with_bound(error, way, abs(touch.landing_rate - stage.rate)))
    force, force_estimate = 0.0, 0.0
    estimate = height_bound(error, math.inf)
    if mode.pressing:
        doubt, k, c = 0.0, stage.stiffness, stage.damping
        if knee.remembers_impact and touch.error > 0.0:
            doubt = impact_doubt(mode, stage, touch.error)
            used += 2
        relaxation = relaxation_rate(k, c, knee.mass)
        estimate = height_bound(error, relaxation)
        # Within the estimate the exact contact may be in the layer beside this one, which has another dashpot.
        beside = layer
        if float(law[layer + 1, BEGIN]) - stage.depth <= estimate:
            beside = layer + 1
        elif layer - 1 > APART and stage.depth - float(law[layer, BEGIN]) <= estimate:
            beside = layer - 1
        dashpot_change = float(law[beside, DAMPING]) - float(law[layer, DAMPING])
        left_out = abs(dashpot_change * stage.rate)
        force_estimate = force_bound(error, k, c, left_out, relaxation) / stage.cosine + doubt
        force = stage.force if knee.allow_tension else max(stage.force, 0.0)
    converged = motion.time >= tick.duration and abs(motion.height) < math.inf
    return Result(femur, stage, force, estimate, force_estimate, used, converged)
