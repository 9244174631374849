"""How accurate a step must be, and what even an accurate implicit step does not see.

The tolerance is one of the published depth. A step may use a part of it that depends on how long its error will count:
a damped contact forgets, an undamped one adds up the errors of many steps, and a flight multiplies that of its launch.
"""

import math
import sys

from .compiler import in_kernel, inlined
from .contact import Mode, Motion, load_at
from .error_estimate import TINY, VELOCITY_HORIZON, eigenvalues, relaxation_rate
from .laws import BEGIN, DAMPING
from .steps import Step

LOCAL_ERROR_SHARE = 0.1
"""Share of the tolerance that the errors of all steps together may use while the contact remembers them, and that is
left of a lost solution when it counts as forgotten. Tuned; `studies.honesty scenes` would notice."""
MAX_MEMORY_PHASE = 1.4e4
"""Phase [rad] of an oscillation for which an error counts where nothing damps it: half a minute of a ringing knee.
Tuned; `studies.honesty scenes` would notice: evaluations rise by a third without it."""
STEP_ROUNDING = 4.0 * sys.float_info.epsilon
"""Relative error of a height or velocity below which it is rounding, which no smaller step can cure."""
RELEASE_STEPS = 8.0
"""A falling force, load or layer counts as about to end if it will within this number of steps. Tuned; `studies.honesty
scenes` would notice: 2.5 % more of the ticks are flagged without it."""
REBOUND_FORCE_RATIO = 2.0
"""Contact force over the load above which the femur is expected to rebound into the air. Tuned; `studies.honesty
scenes` would notice: 1 % more of the ticks are flagged without it."""
FLIGHT_TOLERANCE_FACTOR = 64.0
"""How much stricter the tolerance is for steps whose errors go into a flight, where they grow. Tuned; `studies.honesty
scenes` would notice: without it 2.9 % more of the ticks are flagged, and evaluations fall by a fifth."""
MAX_OSCILLATION_ERROR = 0.02
"""Largest error of an undamped oscillation, relative to it: beyond it the phase is lost. Tuned; `studies.honesty
scenes` would notice: 0.7 % more of the ticks are flagged without it."""
DAMPED_PHASE = 5.0
"""Phase [rad] of the contact's oscillation in a step above which the implicit method damps it away. Tuned;
`studies.honesty scenes` would notice: 590 of 0.14 million depths are not covered without it, and one is wrong."""

TRANSIENT_ERROR_FRACTION = 0.3
"""Error of a step that does not resolve a transient, over the way of the transient. Tuned; `studies.honesty scenes`
would notice: 0.2 % more of the ticks are flagged without it."""


@inlined
def error_ratio(mode: Mode, begin: Motion, step: Step, h: float) -> float:
    """Return the estimated error of a step of `h` [s] over its share of the tolerance, infinite if it is not solved."""
    if not step.solved:
        return math.inf
    knee, layer = mode.knee, mode.layer
    mass, k, c, load = knee.mass, step.stiffness, step.damping, load_at(mode.tick, begin.time)
    force, begin_force = step.end.force, begin.stage.force
    speed = abs(step.velocity) + h * abs(force) / mass
    # Rounding does not become smaller with the step, so it must not count against it.
    height_error = max(abs(step.height_error) - STEP_ROUNDING * abs(step.height), 0.0)
    velocity_error = max(abs(step.velocity_error) - STEP_ROUNDING * speed, 0.0)
    (decay, _), relaxation = eigenvalues(k, c, mass), relaxation_rate(k, c, mass)
    # All steps within the contact's memory share the tolerance. A leap happens once, so its error does not add up.
    part_of_memory = min(1.0, h * max(decay, relaxation / MAX_MEMORY_PHASE))
    # In the contact's energy norm, as height and velocity errors turn into each other.
    swing = velocity_error / relaxation
    error = math.sqrt(height_error * height_error + swing * swing)
    whole = error / part_of_memory
    if step.leap > 0.0:
        whole = error + h * step.leap
    left_in_layer = step.end.depth - float(knee.law[layer, BEGIN])
    ends = (
        left_in_layer < RELEASE_STEPS * (begin.stage.depth - step.end.depth)
        and knee.law[layer, DAMPING] > knee.law[layer - 1, DAMPING]
    )
    # A load that ends lets go of a dashpot whose force still grows. One that grows as fast may turn and end as soon.
    end_load = load_at(mode.tick, begin.time + h)
    unloads = end_load < RELEASE_STEPS * abs(load - end_load)
    if (
        ends
        or unloads
        or force < RELEASE_STEPS * (begin_force - force)
        or force > REBOUND_FORCE_RATIO * load
    ):
        # The error of the velocity is carried into a flight, or into a layer that damps it less.
        flown = velocity_error / (1.0 / VELOCITY_HORIZON)
        launch = math.sqrt(height_error * height_error + flown * flown)
        whole = max(whole, FLIGHT_TOLERANCE_FACTOR * launch)
    wanted = knee.tolerance
    if knee.force_tolerance > 0.0:
        # A creeping contact turns a depth into a rate by k/c, one that swings by the root of k/m.
        slope = k + c * k / (mass * relaxation)
        wanted = min(wanted, knee.force_tolerance / max(slope, TINY))
    allowed, lasts = wanted, decay * VELOCITY_HORIZON < 1.0
    if lasts and k > 0.0:
        # An undamped oscillation can be followed only as long as its error is small against its amplitude.
        swing = max(abs(begin_force), abs(force)) / k
        rate = step.end.rate / begin.stage.cosine
        amplitude = math.sqrt(swing * swing + rate * rate * mass / k)
        allowed = min(allowed, MAX_OSCILLATION_ERROR * amplitude)
    may_bounce = (lasts or len(knee.law) > 3) and not knee.allow_tension
    if mode.impact_speed > 0.0 and may_bounce:
        # The contact began with a landing, and may end with a launch: its error goes into the next flight, and into all
        # that follow, so twice as strictly. Of several layers another one may damp less than this one.
        allowed /= 2.0 * FLIGHT_TOLERANCE_FACTOR
    ratio = whole / (LOCAL_ERROR_SHARE * allowed)
    if step.implicit:
        crept, swung = unresolved_motion(mode, begin, step, h)
        swung /= relaxation
        ratio += math.sqrt(crept * crept + swung * swung) / (LOCAL_ERROR_SHARE * wanted)
    # NaN is not below infinity: a step that has left all numbers is repeated like one that is not solved.
    return ratio if ratio < math.inf else math.inf


@in_kernel
def unresolved_motion(mode: Mode, begin: Motion, step: Step, h: float) -> tuple[float, float]:
    """Return the way [m] and the speed [m/s] of motion in an implicit step of `h` [s] that its halves do not see.

    The way is that of a transient that is over in a small part of the step, when the femur creeps: a jump of the load
    or a landing at its beginning has decayed before its stages. The speed is that of an oscillation by several radians
    within the step about the quasi-static contact. An L-stable method damps it at once, although the contact does not;
    the contact's own damping accounts for a part of the loss.
    """
    one, end, mass, load_rate = begin.stage, step.end, mode.knee.mass, mode.tick.load_rate
    k, c, load = step.stiffness, step.damping, load_at(mode.tick, begin.time)
    crept, swung = 0.0, 0.0
    # A creeping femur: the transient at the beginning decays within mass/damping, long before the first stage.
    if c * h >= DAMPED_PHASE * mass and c * c >= 4.0 * k * mass:
        push = abs(one.cosine * one.force - load)
        crept = TRANSIENT_ERROR_FRACTION * push * mass / (c * c)
    half_rate, square = 0.5 * c / mass, k / mass
    oscillates = half_rate * half_rate < square
    if square * h * h >= DAMPED_PHASE * DAMPED_PHASE and oscillates:
        begin_k = one.stiffness / (one.cosine * one.cosine)
        end_k = end.stiffness / (end.cosine * end.cosine)
        if min(begin_k, end_k) < 0.25 * k:
            # As at first touch, where the linearised contact says nothing: all of the work may swing.
            work = abs((end.force - one.force) * (end.depth - one.depth))
            swung = math.sqrt(2.0 * work / mass)
        else:
            # The end lies on the quasi-static contact. What the beginning lies beside it is lost, too.
            pull, pull_rate = load / one.cosine, load_rate / one.cosine
            excess = (one.force - pull) / math.sqrt(begin_k * mass)
            rate = one.rate - pull_rate / begin_k
            before, fade = math.sqrt(rate * rate + excess * excess), math.exp(-half_rate * h)
            end_excess = (end.force - pull - pull_rate * h) / math.sqrt(end_k * mass)
            end_rate = end.rate - pull_rate / end_k
            after = math.sqrt(end_rate * end_rate + end_excess * end_excess)
            excess -= end_excess
            rate -= end_rate
            swung = max(before * fade - after, math.sqrt(rate * rate + excess * excess) * fade)
    return crept, swung
