"""Answers while the exact solution is lost: bounds of where the femur may be, until the contact has forgotten it.

The exact solution is lost where a tick could not be resolved, or where its error may be larger than any depth: the
linearised contact would make that small at once, while the exact femur still flies.
"""

import math

from .closest import touch
from .compiler import in_kernel
from .contact import FemurState, Interval, KneeConstants, Result, load_at
from .error_estimate import (
    LARGEST_ERROR,
    eigenvalues,
    height_bound,
    relaxation_rate,
    velocity_bound,
    with_bound,
)
from .laws import DAMPING, force_at, law_force, layer_at
from .run_state import (
    AT_LOAD_IMPULSE,
    AT_LOST_DISTANCE,
    AT_LOST_SPEED,
    AT_RELAXATION_TIMES,
    AT_STATIC_VELOCITY,
    AT_STIFFNESS,
    AT_STRONGEST_LOAD,
)
from .step_control import LOCAL_ERROR_SHARE
from .types import Fidelity, Floats

QUASI_STATIC = int(Fidelity.QUASI_STATIC)
LEAST_LOST_SPEED = 1e-9
"""Smallest bound of a speed [m/s] while the exact solution is lost; 0 means that the solution is known"""


@in_kernel
def answer_while_lost(
    knee: KneeConstants,
    tick: Interval,
    state: Floats,
    start: FemurState,
    result: Result,
    solved: bool,
) -> Result:
    """Return the answer to a tick while the exact solution is lost, and find out whether it has been forgotten.

    Two bounds of the exact femur are kept, of its speed and of its distance: what it had, what the contact had stored,
    and what load and surfaces have added. It is forgotten in two steps. First the load must press without a break for
    longer than all flights take: the first one starts at that distance and speed, and each landing leaves the fraction
    `deep_restitution` of the speed. Then as many relaxation times of the contact must pass as the tolerance asks for.
    Where a layer has no dashpot, or the law depends on the impact speed, nothing is forgotten until a reset. The impact
    speed stays unknown until the next touch; that matters if the law is then changed to one that depends on it.
    """
    mass, stage, h = knee.mass, result.stage, tick.duration
    load = load_at(tick, h)
    least_load, largest_load = min(tick.load, load), max(abs(tick.load), abs(load))
    deepest, speed = max(stage.depth, 0.0), float(state[AT_LOST_SPEED])
    velocity, begin_velocity = result.femur.velocity, start.velocity
    if knee.level == QUASI_STATIC:
        # The static contact follows surface and load, whose rates jump between two ticks.
        _, rate, cosine = touch(knee.surfaces, tick.angle, tick.angle_rate, start.height)
        begin_velocity = rate / cosine
        if state[AT_STIFFNESS] > 0.0:
            begin_velocity -= tick.load_rate / state[AT_STIFFNESS]
    if math.isnan(velocity):
        end_angle = tick.angle + tick.angle_rate * h
        _, end_rate, cosine = touch(knee.surfaces, end_angle, tick.angle_rate, result.femur.height)
        velocity = end_rate / cosine
    if speed > 0.0:
        # The speed is counted from the answer's own, which jumps between two ticks with the rate of the surface.
        speed += abs(begin_velocity - state[AT_STATIC_VELOCITY])
    if not solved:
        if speed == 0.0:
            depth, rate, cosine = touch(knee.surfaces, tick.angle, tick.angle_rate, start.height)
            error_before = height_bound(start.error, math.inf)
            deepest = max(deepest, depth + error_before)
            state[AT_LOST_DISTANCE] = abs(depth) + error_before
            speed = abs(rate / cosine - start.velocity) + velocity_bound(start.error)
            speed += LEAST_LOST_SPEED
        # Force times depth is more than the spring has stored, for every law: its force grows with the depth.
        stored = deepest * abs(law_force(knee.law, deepest, 0.0, 0.0)[0])
        speed = math.sqrt(speed * speed + 2.0 * stored / mass)
    velocity_change = abs(velocity - begin_velocity)
    # Without a dashpot in one of its layers a contact swings for ever, and nothing of the lost solution decays.
    forgets = solved and not knee.remembers_impact
    for i in range(1, len(knee.law) - 1):
        forgets = forgets and knee.law[i, DAMPING] > 0.0
    if not forgets or least_load <= 0.0 or stage.depth <= 0.0:
        # A load that has pressed until now has let it fall, and it may have bounced since.
        speed = fallen_speed(state, speed, mass) + largest_load * h / mass + velocity_change
        # The femur may fly again from here on, so the count begins anew.
        state[AT_LOAD_IMPULSE] = 0.0
        state[AT_STRONGEST_LOAD] = 0.0
        state[AT_RELAXATION_TIMES] = 0.0
    else:
        speed += abs(load - tick.load) / math.sqrt(stage.stiffness * mass) + velocity_change
        restitution = deep_restitution(knee, stage.depth, stage.stiffness, speed)
        state[AT_LOAD_IMPULSE] += 0.5 * (tick.load + load) * h / mass
        state[AT_STRONGEST_LOAD] = max(state[AT_STRONGEST_LOAD], largest_load)
        landing = landing_speed(state, speed, mass)
        # Impulse of the load, over the mass [m/s], that ends all flights: a geometric series of landings
        flights = speed + landing * (1.0 + restitution) / (1.0 - restitution)
        if state[AT_LOAD_IMPULSE] > flights:
            decay, _ = eigenvalues(stage.stiffness, stage.damping, mass)
            state[AT_RELAXATION_TIMES] += h * decay
            swing = max(stage.depth, speed * math.sqrt(mass / stage.stiffness))
            wanted = math.log(1.0 + swing / (LOCAL_ERROR_SHARE * knee.tolerance))
            if state[AT_RELAXATION_TIMES] > wanted:
                return known_again(knee, state, result, landing)
    state[AT_LOST_SPEED] = min(speed, LARGEST_ERROR)
    state[AT_STATIC_VELOCITY] = velocity
    state[AT_LOST_DISTANCE] = min(state[AT_LOST_DISTANCE] + deepest + speed * h, LARGEST_ERROR)
    return Result(
        result.femur,
        stage,
        result.force,
        max(result.estimate, float(state[AT_LOST_DISTANCE])),
        result.force_estimate,
        result.evaluations + 2,  # of the stored energy, and of the deep contact
        False,
    )


@in_kernel
def landing_speed(state: Floats, speed: float, mass: float) -> float:
    """Return the largest landing speed [m/s] of a lost femur that had a `speed` [m/s] when the load began to press.

    A femur that starts at its distance and speed lands no faster, whatever the load did in between.
    """
    fall = 2.0 * state[AT_STRONGEST_LOAD] / mass * state[AT_LOST_DISTANCE]
    return math.sqrt(speed * speed + fall)


@in_kernel
def fallen_speed(state: Floats, speed: float, mass: float) -> float:
    """Return the largest speed [m/s] until now of a lost femur that had a `speed` [m/s] before the load pressed."""
    return min(landing_speed(state, speed, mass), speed + float(state[AT_LOAD_IMPULSE]))


@in_kernel
def deep_restitution(knee: KneeConstants, depth: float, stiffness: float, speed: float) -> float:
    """Return the coefficient of restitution of a landing at a speed [m/s] in a contact at a depth [m].

    A landing deeper in the contact meets a stiffer spring, whose dashpot damps less: the linear oscillator there has
    the damping ratio ζ and leaves exp(-π ζ/√(1 - ζ²)) of the speed after half a period.
    """
    below = depth + speed * math.sqrt(knee.mass / stiffness)
    _, k, c = force_at(knee.law, layer_at(knee.law, below), below, 0.0, 0.0)
    damping_ratio = min(0.5 * c / math.sqrt(max(k, stiffness) * knee.mass), 0.99)
    return math.exp(-math.pi * damping_ratio / math.sqrt(1.0 - damping_ratio * damping_ratio))


@in_kernel
def known_again(knee: KneeConstants, state: Floats, result: Result, landing: float) -> Result:
    """Return the answer to a tick by which the lost solution is forgotten.

    The impact speed stays unknown by `landing` [m/s].
    """
    state[AT_LOST_SPEED] = 0.0
    state[AT_LOST_DISTANCE] = 0.0
    state[AT_LOAD_IMPULSE] = 0.0
    state[AT_STRONGEST_LOAD] = 0.0
    state[AT_RELAXATION_TIMES] = 0.0
    femur, stage, left = result.femur, result.stage, LOCAL_ERROR_SHARE * knee.tolerance
    relaxation = relaxation_rate(stage.stiffness, stage.damping, knee.mass)
    error = with_bound(femur.error, left, left * relaxation)
    return Result(
        FemurState(
            femur.height, femur.velocity, error, femur.try_step, femur.impact_speed, landing
        ),
        stage,
        result.force,
        result.estimate + left,
        result.force_estimate,
        result.evaluations,
        True,
    )


def throw_lost(state: Floats, law: Floats, depth: float, mass: float, mass_before: float) -> None:
    """Count that law, mass or surfaces change while the exact solution is lost.

    It lies beside the contact, at a `depth` [m] in the changed surfaces, and flies off with what a changed law stores
    there. Nothing has been forgotten then. `state` is that of the contact before the change.
    """
    speed = fallen_speed(state, float(state[AT_LOST_SPEED]), mass_before)
    stiffness = float(state[AT_STIFFNESS])
    beside = float(state[AT_LOST_DISTANCE])
    if stiffness > 0.0:
        beside = min(beside, speed * math.sqrt(mass_before / stiffness))
    deepest = max(depth + beside * math.exp(-state[AT_RELAXATION_TIMES]), 0.0)
    stored = deepest * abs(law_force(law, deepest, 0.0, 0.0)[0])
    state[AT_LOST_SPEED] = min(math.sqrt(speed * speed + 2.0 * stored / mass), LARGEST_ERROR)
    state[AT_LOAD_IMPULSE] = 0.0
    state[AT_STRONGEST_LOAD] = 0.0
    state[AT_RELAXATION_TIMES] = 0.0
