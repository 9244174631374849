"""Ticks in order: the interval between two samples, its answer at the requested level, and its row.

`quasi_static` answers with the static contact, and estimates the motion that this leaves out. `dynamic` (also called
`auto`) answers with the solver. With a prescribed height the force follows from the depth. A tick that needs more
evaluations than it may take is answered with the static contact, from which the run continues. The exact solution is
then lost, and no answer is OK until the contact has forgotten the difference (`lost_state.py`).

The state of a run and its answers lie in arrays of the caller, so that a tick allocates nothing.
"""

import math

from .answers import write_answer
from .closest import touch
from .compiler import in_kernel, inlined
from .contact import FORCE_ROUNDING, FemurState, Interval, KneeConstants, Result, Stage
from .error_estimate import EXACT
from .events import last_touch, led_contact
from .laws import law_force
from .lost_state import answer_while_lost
from .quasi_static import quasi_static
from .run_state import (
    AT_ANGLE,
    AT_BEGUN,
    AT_DAMPING,
    AT_LOAD,
    AT_LOST_SPEED,
    AT_SETTLING,
    AT_STIFFNESS,
    femur_in,
    keep_state,
)
from .solver import advance
from .statics import MAX_ANSWER_EVALUATIONS, START_HEIGHT, static_contact
from .types import MAX_SURFACE_GAP, Bytes, Counts, Fidelity, Floats

QUASI_STATIC = int(Fidelity.QUASI_STATIC)
DYNAMIC = int(Fidelity.DYNAMIC)
PRESCRIBED_HEIGHT = 3
"""Level of a knee whose femoral height is prescribed; its answers have the fidelity `DYNAMIC`"""
LEVELS = {"quasi_static": QUASI_STATIC, "dynamic": DYNAMIC, "auto": DYNAMIC}
"""Levels of the model by the names that the parameter `fidelity.level` uses"""
SETTLING_TIME = 0.1
"""Time of contact [s] in which the femur settles after a flight that is too far for a knee, and stays `IMPLAUSIBLE`: 27
decay times of the paper's healthy knee, 2 x 9.3 kg over 5 kN s/m"""


@in_kernel
def run(
    knee: KneeConstants,
    state: Floats,
    samples: Floats,
    words: Floats,
    codes: Bytes,
    counts: Counts,
) -> None:
    """Compute ticks in order into rows of answers, which are passed as their words, bytes and half words.

    `state` has shape (`STATE_SIZE`,), `samples` (n, 4): time since the last tick [s], flexion angle [rad], load [N] and
    prescribed height [m] or NaN. The duration of the first tick of a run has no effect: that tick is answered with the
    contact at rest.
    """
    for i in range(len(samples)):
        duration, angle = float(samples[i, 0]), float(samples[i, 1])
        load, height = float(samples[i, 2]), float(samples[i, 3])
        angle_rate, fidelity = 0.0, DYNAMIC
        if state[AT_BEGUN] == 0.0:
            result = at_rest(knee, angle, load, height, knee.budget, 0)
        else:
            last_angle, last_load = float(state[AT_ANGLE]), float(state[AT_LOAD])
            angle_rate = (angle - last_angle) / duration
            load_rate = (load - last_load) / duration
            rounding = FORCE_ROUNDING * max(1.0, abs(load), abs(last_load))
            tick = Interval(duration, last_angle, angle_rate, last_load, load_rate, rounding)
            if knee.level == PRESCRIBED_HEIGHT:
                result = move_to(knee, tick, femur_in(state), height)
            else:
                result, fidelity = tick_under_load(knee, tick, angle, load, state)
        keep_state(state, angle, load, result)
        depth = result.stage.depth
        far = -depth > MAX_SURFACE_GAP
        if far and knee.level != PRESCRIBED_HEIGHT:
            state[AT_SETTLING] = SETTLING_TIME
        elif depth > 0.0:
            state[AT_SETTLING] = max(0.0, state[AT_SETTLING] - duration)
        far = far or state[AT_SETTLING] > 0.0
        write_answer(knee, angle, angle_rate, load, fidelity, result, far, words, codes, counts, i)


@inlined
def tick_under_load(
    knee: KneeConstants, tick: Interval, angle: float, load: float, state: Floats
) -> tuple[Result, int]:
    """Return the contact at an angle [rad] under a load [N] at the end of an interval, and the fidelity of it."""
    fidelity, start = knee.level, femur_in(state)
    if math.isnan(start.velocity):
        # After a static start the femur follows its turning surface.
        _, rate, cosine = touch(knee.surfaces, tick.angle, tick.angle_rate, start.height)
        start = FemurState(
            start.height,
            rate / cosine,
            start.error,
            start.try_step,
            start.impact_speed,
            start.impact_error,
        )
    if knee.level == QUASI_STATIC:
        stiffness, damping = float(state[AT_STIFFNESS]), float(state[AT_DAMPING])
        result = quasi_static(knee, tick, start, stiffness, damping)
    else:
        # The answer to a tick that is given up must fit into the budget, too.
        result = advance(knee, tick, start, knee.budget - MAX_ANSWER_EVALUATIONS - 3)
        if not result.converged:
            spent = max(1, result.evaluations)
            result = at_rest(knee, angle, load, math.nan, MAX_ANSWER_EVALUATIONS - 4, spent)
            fidelity = QUASI_STATIC
    # If the dynamic solution's error exceeds any plausible depth, its state is unknown from here on. The static
    # solution has no state to lose.
    beyond = knee.level == DYNAMIC and result.estimate > knee.plausible_depth
    if not result.converged or beyond or state[AT_LOST_SPEED] > 0.0:
        solved = result.converged and not beyond
        result = answer_while_lost(knee, tick, state, start, result, solved)
    return result, fidelity


@in_kernel
def at_rest(
    knee: KneeConstants, angle: float, load: float, height: float, most: int, spent: int
) -> Result:
    """Return the contact at rest, under the load [N] or at the prescribed height [m], by about `most` evaluations.

    It answers the first tick of a run, or one that has been given up after it has `spent` some evaluations.
    """
    if not math.isnan(height):
        depth, _, _ = touch(knee.surfaces, angle, 0.0, height)
        impact = 0.0 if depth > 0.0 else math.nan
        return at_height(knee, height, 0.0, depth, 0.0, impact, 0.0, 0)
    height, depth, force, stiffness, damping, cosine, used = static_contact(
        knee.surfaces, knee.law, angle, load, START_HEIGHT, 0.0, 0.0, most
    )
    square = cosine * cosine
    stage = Stage(depth, 0.0, force, square * stiffness, square * damping, 0.0, cosine, 0.0)
    femur = FemurState(height, math.nan, EXACT, math.inf, 0.0, 0.0)
    return Result(femur, stage, force, 0.0, 0.0, spent + used, spent == 0)


@in_kernel
def at_height(
    knee: KneeConstants,
    height: float,
    velocity: float,
    depth: float,
    rate: float,
    impact: float,
    impact_error: float,
    spent: int,
) -> Result:
    """Return the contact at a prescribed height [m] and velocity [m/s], given depth [m] and rate [m/s] there.

    `impact` is the impact speed [m/s] with its error, and `spent` the evaluations until then.
    """
    force, _, _ = law_force(knee.law, depth, rate, 0.0 if math.isnan(impact) else impact)
    force = force if knee.allow_tension else max(force, 0.0)
    stage = Stage(depth, rate, force, 0.0, 0.0, 0.0, 1.0, 0.0)
    femur = FemurState(height, velocity, EXACT, math.inf, impact, impact_error)
    known = impact_error == 0.0 or not knee.remembers_impact
    used = spent + (1 if depth > 0.0 else 0)
    return Result(femur, stage, force, 0.0, 0.0, used, known)


@in_kernel
def move_to(knee: KneeConstants, tick: Interval, start: FemurState, end_height: float) -> Result:
    """Return the contact at the end of an interval in which the height changes linearly to the prescribed one [m].

    It is exact: pose and velocity are prescribed. A law that depends on the impact speed is given that of the last
    touch inside the interval, or of an earlier one if femur and tibia stay in contact.
    """
    velocity = (end_height - start.height) / tick.duration
    depth, rate = led_contact(knee, tick, end_height, velocity, tick.duration)
    if depth <= 0.0:
        return at_height(knee, end_height, velocity, depth, rate, math.nan, 0.0, 0)
    impact, searched, probes = last_touch(knee, tick, start.height, velocity, depth, rate)
    error = 0.0
    if math.isnan(impact):
        # It is not known until the next touch, if an end of the contact may have been missed.
        impact = 0.0 if math.isnan(start.impact_speed) else start.impact_speed
        error = start.impact_error if searched else math.inf
    return at_height(knee, end_height, velocity, depth, rate, impact, error, probes)
