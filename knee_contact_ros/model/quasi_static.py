"""The quasi-static level: the static contact at the end of a tick, and the error of the motion that it leaves out.

With x = static height - dynamic height, M ẍ + C ẋ + K x = M ÿ_static - C δ̇_static, by the contact linearised with K
and C, its slopes along the height. The answer costs a few evaluations; most of the code here is its error estimate.
"""

import math
from typing import NamedTuple

from .closest import next_kink, touch
from .compiler import in_kernel
from .contact import FemurState, Interval, KneeConstants, Result, Stage, load_at
from .error_estimate import (
    CURVATURE_FACTOR,
    SAFETY_FACTOR,
    SPREAD_FACTOR,
    TINY,
    Error,
    eigenvalues,
    force_bound,
    height_bound,
    limited,
    propagated,
    relaxation_rate,
    response,
    with_bound,
    with_curvature,
)
from .laws import APART, BEGIN, DAMPING, EXPONENT, force_at, law_force, layer_at
from .statics import MAX_ANSWER_EVALUATIONS, static_contact
from .steps import NEWTON_TOLERANCE_SHARE

UNKNOWN_MOTION = 0.05
"""Unknown part of the motion beside the static contact and of what it changes by in a tick, as the linearised contact
is not constant. Tuned; `studies.honesty scenes` would notice: 2 % fewer of the quasi-static ticks are flagged without
it."""
MAX_PHASE_ERROR = 0.5
"""Phase error [rad] of an oscillation in a tick up to which its phase counts as known. Tuned; `studies.honesty changes`
would notice: 0.3 % fewer of the ticks are flagged without it."""
SOFT_LAYER_PHASE = 2.0 * math.pi
"""Phase [rad] of a swing in the layer above, in which the static contact's deviation becomes smaller by a factor e.
Tuned; `studies.honesty changes` (seed 6001, plan 1382) would notice."""

LONGEST_TURN = 0.1
"""Turn [rad] in which the rate of a smooth surface changes evenly: gait at 100 Hz turns less in a tick"""
MEMORY = 3.0
"""Decay times of the contact after which it has forgotten how the surface moved"""


class Linear(NamedTuple):
    """The linearised contact at one end of a tick."""

    rest: float
    """Where the deviation of the static contact would come to rest [m]"""
    stiffness: float
    """Slopes of the force along the height over the height [N/m]"""
    damping: float
    """and over the velocity [N s/m]"""


@in_kernel
def quasi_static(
    knee: KneeConstants, tick: Interval, start: FemurState, stiffness: float, damping: float
) -> Result:
    """Return the static contact at the end of an interval, with the error of the motion that it leaves out.

    `stiffness` and `damping` are the slopes at the beginning. A turn over several points of a measured surface is cut
    into parts: the rate of the surface changes from point to point, and so does the motion that is left out.
    """
    turn = abs(tick.angle_rate) * tick.duration
    parts = int(0.5 + min(turn, math.tau) / min(knee.surfaces.knot_spacing, LONGEST_TURN))
    if parts < 3:  # gait at 100 Hz
        return static_end(knee, tick, start, stiffness, damping)
    h, s, used, known, femur = tick.duration / parts, 0.0, 0, True, start
    for _ in range(parts - 1):
        result = static_end(knee, part_of(tick, s, h), femur, stiffness, damping)
        used += result.evaluations
        if not result.converged or used + 2 * MAX_ANSWER_EVALUATIONS > knee.budget:
            known = False  # what the femur does until the end of the tick
            break
        s += h
        femur, stiffness, damping = result.femur, result.stage.stiffness, result.stage.damping
    last = static_end(knee, part_of(tick, s, tick.duration - s), femur, stiffness, damping)
    end, stage, force, estimate, force_estimate, evaluations, converged = last
    used += evaluations
    return Result(end, stage, force, estimate, force_estimate, used, known and converged)


@in_kernel
def part_of(tick: Interval, s: float, h: float) -> Interval:
    """Return the part of an interval that begins at s [s] and lasts `h` [s]."""
    angle = tick.angle + tick.angle_rate * s
    return Interval(h, angle, tick.angle_rate, load_at(tick, s), tick.load_rate, tick.rounding)


@in_kernel
def static_end(
    knee: KneeConstants, tick: Interval, start: FemurState, stiffness: float, damping: float
) -> Result:
    """Return the static contact at the end of an interval in which the rate of the surface changes evenly.

    It holds only while the load presses the surfaces together and the femur can follow: else it is not `converged`.
    """
    h, mass, load = tick.duration, knee.mass, load_at(tick, tick.duration)
    end_angle = tick.angle + tick.angle_rate * h
    depth, surface_rate, cosine = touch(knee.surfaces, tick.angle, tick.angle_rate, start.height)
    sinking = tick.load_rate / stiffness if stiffness > 0.0 else 0.0
    near = max(0.0, depth + cosine * sinking * h)
    resolution = NEWTON_TOLERANCE_SHARE * knee.tolerance
    height, end_depth, force, k, c, end_cosine, used = static_contact(
        knee.surfaces, knee.law, end_angle, load, start.height, near, resolution, knee.budget
    )
    fastest_impact = start.impact_speed + start.impact_error
    if knee.remembers_impact and fastest_impact > 0.0:
        # The contact has begun faster than at rest, and damps less.
        _, _, c = law_force(knee.law, end_depth, 0.0, fastest_impact)
    _, end_surface_rate, _ = touch(knee.surfaces, end_angle, tick.angle_rate, height)
    square = end_cosine * end_cosine
    k, c = square * k, square * c
    # A curved tibia tilts under the femur, and its force changes under a constant load.
    tilt = load * (1.0 / end_cosine - 1.0 / cosine) / h
    sinking += cosine * tilt / stiffness if stiffness > 0.0 else 0.0
    end_sinking = (tick.load_rate + end_cosine * tilt) / k if k > 0.0 else 0.0
    begin_velocity = surface_rate / cosine - sinking
    velocity = end_surface_rate / end_cosine - end_sinking
    inertia, uneven = mass * (velocity - begin_velocity) / h, 0.0
    decay, _ = eigenvalues(k, c, mass)
    at = h - min(max(MEMORY / max(decay, TINY), 1e-3 * h), 0.5 * h)
    if at > 0.5 * h or abs(tick.angle_rate) * h > knee.surfaces.knot_spacing:
        # The rate of the surface may change in one part of the tick, and not in the other.
        angle = tick.angle + tick.angle_rate * at
        _, rate, n_y = touch(knee.surfaces, angle, tick.angle_rate, 0.5 * (start.height + height))
        begin_rate, end_rate = surface_rate / cosine, end_surface_rate / end_cosine
        mean, rate = (end_rate - begin_rate) / h, rate / n_y
        early, late = (rate - begin_rate) / at - mean, (end_rate - rate) / (h - at) - mean
        uneven = mass * max(abs(early), abs(late))
    layer = layer_at(knee.law, end_depth)
    in_layer, exponent = 0.0, 1.0
    if layer > APART:
        in_layer = end_depth - float(knee.law[layer, BEGIN])
        exponent = float(knee.law[layer, EXPONENT])
    least_load = min(tick.load, load)
    pressed = least_load > 0.0 and least_load + inertia > uneven and min(stiffness, k) > 0.0
    error, relaxation = limited(start.error), relaxation_rate(k, c, mass)
    if pressed:
        before = Error(
            error.height,
            error.velocity + begin_velocity - start.velocity,
            error.hh,
            error.hv,
            error.vv,
        )
        begin = Linear((inertia - damping * sinking) / stiffness, stiffness, damping)
        end = Linear((inertia - c * end_sinking) / k, k, c)
        growth = exponent if knee.remembers_impact else 0.0
        error = static_deviation(before, begin, end, in_layer, growth, mass, h)
        before_bound = height_bound(before, relaxation)
        begin_layer = layer_at(knee.law, depth)
        if layer > 1 and before_bound > in_layer:
            # Half of its swing may lie in the layer above, which is softer: it decays no faster than a swing there. A
            # tick that ends below that layer has been in it before.
            below = min(1.0, in_layer / (end_depth - depth)) if begin_layer < layer else 1.0
            _, soft, _ = force_at(knee.law, layer - 1, end_depth, 0.0, 0.0)
            frequency = math.sqrt(square * soft / mass)
            kept = before_bound * math.exp(-h * below / SOFT_LAYER_PHASE * frequency)
            least = max(0.0, kept - height_bound(error, relaxation))
            error = with_bound(error, least, least * relaxation)
        beyond = float(knee.law[layer + 1, BEGIN]) - end_depth
        dashpot = float(knee.law[layer + 1, DAMPING])
        if dashpot > 0.0 and before_bound > beyond:
            # The femur may creep in the layer below, which is soft where it begins: there nothing more than what the
            # force on its edge is too large by brings it back.
            least = before_bound - beyond * k / dashpot * h - height_bound(error, relaxation)
            if least > 0.0:
                error = with_bound(error, least, least * relaxation)
        left = min(resolution, 1e-3 * end_depth)
        unknown = left * left / max(end_depth, TINY)
        if begin_layer != layer:
            # A layer begins softly, or with another dashpot: the dynamic femur may stay behind.
            behind = max(depth, end_depth) - float(knee.law[max(begin_layer, layer), BEGIN])
            unknown += behind
            if damping > c:
                # The dashpot lets go late; then the femur swings about where the load has left it.
                load_rate, way = abs(tick.load_rate), behind + height_bound(before, math.inf)
                late = math.sqrt(2.0 * damping * way / max(load_rate, TINY))
                unknown += min(abs(depth - end_depth), load_rate * min(late, h) / k)
        # Of the inertia that is left out, only means are known, over a tick and over two parts of it. Within a part it
        # may change by as much as between the two.
        push = abs(inertia) + 2.0 * uneven
        if in_layer > 0.0:
            # The depth x in a layer goes with the nth root of its force. Where that ends, it falls faster and faster:
            # by n - 1 times the square of its rate over x.
            bend = (exponent - 1.0) * end_sinking * end_sinking * end_cosine / in_layer
            push += mass * abs(bend + (end_sinking - sinking) / h)
        way, speed = response(push, k, c, mass, h)
        if knee.surfaces.non_convex > 0.0 or not math.isnan(
            next_kink(knee.surfaces, tick.angle, end_angle)
        ):
            # The rate of the surface jumps in the tick, when the contact leaps to another bump or at a kink. Each jump
            # gives the femur a velocity. There may be three: two of them, and one right at the end.
            jump = 3.0 * abs(velocity - begin_velocity)
            way += jump / relaxation
            speed += jump
        error = limited(with_bound(error, unknown + way, speed))
        # The linearised contact must not pull the femur with more than the load, as no contact does.
        pull = stiffness * before.height + damping * before.velocity
        swing = math.sqrt(stiffness * mass)
        if damping < 2.0 * swing:  # what is a velocity now pulls later
            rebound = swing * before.velocity
            pull = math.sqrt(pull * pull + rebound * rebound)
        pressed = abs(pull) < least_load
        # A contact that has let go and begun again has another impact speed.
        if knee.remembers_impact and height_bound(error, relaxation) >= in_layer:
            pressed = False
    end_rate = end_cosine * end_sinking
    stage = Stage(end_depth, end_rate, force, k, c, end_surface_rate, end_cosine, 0.0)
    femur = FemurState(height, velocity, error, math.inf, start.impact_speed, start.impact_error)
    force_estimate = force_bound(error, k, c, c * end_sinking, relaxation) / end_cosine
    estimate = height_bound(error, relaxation)
    return Result(femur, stage, force, estimate, force_estimate, used, pressed)


@in_kernel
def static_deviation(
    error: Error,
    begin: Linear,
    end: Linear,
    in_layer: float,
    growth: float,
    mass: float,
    h: float,
) -> Error:
    """Return the deviation of the static contact from the dynamic one after a tick of `h` [s].

    Where it would come to rest moves linearly from the beginning to the end; `in_layer` [m] is the depth in the layer
    at the end, and `growth` is as in `with_curvature`.
    """
    spring, dashpot = 0.5 * (begin.stiffness + end.stiffness), 0.5 * (begin.damping + end.damping)
    drift = (end.rest - begin.rest) / h
    lag = dashpot / spring * drift
    x, u = error.height - begin.rest + lag, error.velocity - drift
    beside = Error(x, u, error.hh, error.hv, error.vv)
    relaxation, frequency = relaxation_rate(spring, dashpot, mass), math.sqrt(spring / mass)
    swing = abs(u) / relaxation
    detuning = abs(math.sqrt(end.stiffness / mass) - frequency) + UNKNOWN_MOTION * frequency
    oscillates = dashpot < 2.0 * frequency * mass
    if h * min(frequency, detuning) > MAX_PHASE_ERROR and oscillates:
        # Its phase at the end of the tick is not known, so that nothing of it is expected and all of it is spread.
        energy = x * x + u * u / (frequency * frequency)
        added = SAFETY_FACTOR * SAFETY_FACTOR / (SPREAD_FACTOR * SPREAD_FACTOR) * energy
        faster = added * frequency * frequency
        beside = Error(0.0, 0.0, error.hh + added, error.hv, error.vv + faster)
    moved = propagated(beside, spring, spring, spring, dashpot, mass, h)
    behind = moved.velocity / relaxation
    expected = math.sqrt(moved.height * moved.height + behind * behind)
    variance = moved.hh + moved.vv / (relaxation * relaxation)
    doubted = SPREAD_FACTOR * math.sqrt(max(variance, 0.0))
    moved = Error(
        moved.height + end.rest - lag, moved.velocity + drift, moved.hh, moved.hv, moved.vv
    )
    size = abs(moved.height) + abs(error.height)
    unknown = max(UNKNOWN_MOTION * expected - doubted, 0.0)
    unknown += UNKNOWN_MOTION * (abs(end.rest - begin.rest) + size)
    unknown += CURVATURE_FACTOR * size * min(1.0, size / max(in_layer, TINY))
    if swing > in_layer:
        # The surfaces come apart meanwhile, and touch again at an unknown time.
        unknown += swing
    way, speed = response(spring * unknown, spring, dashpot, mass, h)
    return with_curvature(
        with_bound(moved, way, speed), math.inf, in_layer, spring, dashpot, growth, mass, h
    )
