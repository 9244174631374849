"""Ticks in order: the interval between two samples, its answer at the requested level, and its row.

`quasi_static` answers with the static contact, and estimates the motion that this leaves out. `dynamic` (also called
`auto`) answers with the solver. With a prescribed height the force follows from the depth. A tick that needs more
evaluations than it may take is answered with the static contact, from which the run continues. The exact solution is
then lost, and no answer is OK until the contact has forgotten the difference (`remember`).

The state of a run and its answers lie in arrays of the caller, so that a tick allocates nothing.
"""

from __future__ import annotations

import math

from knee_contact_ros.model.closest import closest, next_kink, touch
from knee_contact_ros.model.compiler import in_kernel, inlined
from knee_contact_ros.model.error_estimate import (
    EXACT,
    LARGEST_ERROR,
    SPREAD,
    TINY,
    Error,
    bounded,
    curved,
    eigenvalues,
    force_reach,
    holding,
    over_step,
    pushed_by,
    reach,
    velocity_reach,
    with_bound,
)
from knee_contact_ros.model.laws import BEGIN, DAMPING, force_at, law_force, layer_at
from knee_contact_ros.model.mechanisms import translation
from knee_contact_ros.model.solver import (
    FORCE_ROUNDING,
    NEWTON_SHARE,
    FemurState,
    Interval,
    KneeConstants,
    Result,
    Stage,
    advance,
)
from knee_contact_ros.model.statics import ANSWER, START_HEIGHT, static_contact
from knee_contact_ros.model.types import (
    MAX_CONTACT_X,
    MAX_FLEXION,
    MAX_SURFACE_GAP,
    MIN_FLEXION,
    Bytes,
    Counts,
    Fidelity,
    Floats,
    Status,
    byte_offset,
    word_index,
)

QUASI_STATIC, DYNAMIC, PRESCRIBED_HEIGHT = int(Fidelity.QUASI_STATIC), int(Fidelity.DYNAMIC), 3
LEVELS = {"quasi_static": QUASI_STATIC, "dynamic": DYNAMIC, "auto": DYNAMIC}
"""Levels of the model by the names that the parameter `fidelity.level` uses"""
(
    BEGUN,
    ANGLE,
    LOAD,
    HEIGHT,
    VELOCITY,
    E_HEIGHT,
    E_VELOCITY,
    E_HH,
    E_HV,
    E_VV,
    TRY_STEP,
    IMPACT,
    IMPACT_ERROR,
    STIFFNESS,
    SLOPE_DAMPING,
    LOST,
    FOLLOWING,
    AWAY,
    IMPULSE,
    STRONGEST,
    QUIET,
    UNSETTLED,
    STATE_SIZE,
) = range(23)
"""Places in the state of a run, all 0 before the first tick: whether it has begun; angle and load of the last tick;
what `FemurState` has; slopes of the last contact along the height; what `remember` needs; and for how long [s] of
contact the answers are still those of a femur that has come from farther away than any"""
DURATION_IN, ANGLE_IN, LOAD_IN, HEIGHT_IN = range(4)
"""Columns of the samples: time since the last tick [s], flexion angle [rad], load [N], prescribed height [m] or NaN"""
LARGEST_FORCE_ERROR = 1e12
"""Largest published error estimate of the contact force [N]"""
NEARLY_STRAIGHT = 0.05
"""Fraction of the depth up to which a depth error changes the force in proportion to the stiffness"""
MOST_BISECTIONS = 60
"""Largest number of bisections to find the time of touch at a prescribed height"""
FORGOTTEN, REMAINS = 1e-4, 1e-2
"""Fraction of the tolerance to which a lost difference must decay, and the fraction that is assumed to remain then"""
TINY_SPEED = 1e-9
"""Smallest bound of a speed [m/s] while the exact solution is lost; 0 means that the solution is known"""
ROUGH, LOOSE, BENT_REST = 0.2, 0.03, 0.5
"""Unknown parts of the motion that the quasi-static level leaves out: of its change in a tick, of itself, and of its
part of the depth, as the linearised contact is not constant"""
ANOTHER = 1.0 / 3.0
"""Relative change of stiffness or damping in a tick above which errors are propagated by both values"""
IN_STEP, ANY_PHASE = 0.5, 2.5
"""Phase error of an oscillation [rad] up to which its phase counts as known; growth of others beyond it"""
SOFT_SWINGS = 2.0 * math.pi
"""Phase [rad] of a swing in the layer above, in which the static contact's deviation becomes smaller by a factor e"""
UNKNOWN_INERTIA = 0.8
"""Unknown part of the inertia that the quasi-static level leaves out, of which only the mean over a tick is known"""
SETTLING = 0.1
"""Time of contact [s] in which the femur settles after a flight that is too far for a knee"""
NOT_CONVERGED, IMPLAUSIBLE = int(Status.NOT_CONVERGED), int(Status.IMPLAUSIBLE)
(
    W_ANGLE,
    W_LOAD,
    W_FORCE,
    W_DEPTH,
    W_GAP,
    W_RATE,
    W_SLIDING,
    W_POINT,
    W_HEIGHT,
    W_CARTILAGE,
    W_BONE,
    W_ERROR,
    W_FORCE_ERROR,
    W_WRENCH,
    W_TORQUE_Z,
    W_X,
    W_NORMAL_X,
    W_NORMAL_Y,
) = map(
    word_index,
    (
        "flexion_angle",
        "load",
        "contact_force",
        "penetration_depth",
        "gap",
        "penetration_rate",
        "sliding_velocity",
        "contact_point_x",
        "femoral_height",
        "cartilage_depth",
        "bone_depth",
        "error_estimate",
        "force_error_estimate",
        "contact_wrench_force_x",
        "contact_wrench_torque_z",
        "femoral_x",
        "normal_x",
        "normal_y",
    ),
)
B_STATE, B_FIDELITY, B_STATUS = (
    byte_offset("contact_state"),
    byte_offset("fidelity"),
    byte_offset("status"),
)
C_EVALUATIONS = byte_offset("evaluations") // 4


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

    `state` has shape (`STATE_SIZE`,), `samples` (n, 4). The duration of the first tick of a run has no effect: that
    tick is answered with the contact at rest.
    """
    for i in range(len(samples)):
        duration, angle = float(samples[i, DURATION_IN]), float(samples[i, ANGLE_IN])
        load, height = float(samples[i, LOAD_IN]), float(samples[i, HEIGHT_IN])
        last_angle, last_load = float(state[ANGLE]), float(state[LOAD])
        fidelity, angle_rate = knee.level, 0.0
        if state[BEGUN] == 0.0:
            result, fidelity = at_rest(knee, angle, load, height, knee.budget, 0), DYNAMIC
        else:
            angle_rate = (angle - last_angle) / duration
            rounding = FORCE_ROUNDING * max(1.0, abs(load), abs(last_load))
            tick = Interval(
                duration,
                last_angle,
                angle_rate,
                last_load,
                (load - last_load) / duration,
                rounding,
            )
            error = Error(
                float(state[E_HEIGHT]),
                float(state[E_VELOCITY]),
                float(state[E_HH]),
                float(state[E_HV]),
                float(state[E_VV]),
            )
            start = FemurState(
                float(state[HEIGHT]),
                float(state[VELOCITY]),
                error,
                float(state[TRY_STEP]),
                float(state[IMPACT]),
                float(state[IMPACT_ERROR]),
            )
            if math.isnan(
                start.velocity
            ):  # after a static start the femur follows its turning surface
                _, rate, cosine = touch(knee.surfaces, last_angle, angle_rate, start.height)
                start = FemurState(
                    start.height,
                    rate / cosine,
                    start.error,
                    start.try_step,
                    start.impact_speed,
                    start.impact_error,
                )
            if knee.level == PRESCRIBED_HEIGHT:
                result, fidelity = follow(knee, tick, start, height), DYNAMIC
            else:
                if knee.level == QUASI_STATIC:
                    result = quasi_static(
                        knee, tick, start, float(state[STIFFNESS]), float(state[SLOPE_DAMPING])
                    )
                else:
                    result = advance(knee, tick, start, knee.budget - ANSWER - 3)
                    if not result.converged:
                        result = at_rest(
                            knee, angle, load, math.nan, ANSWER - 4, max(1, result.evaluations)
                        )
                        fidelity = QUASI_STATIC
                # A femur that was followed and may be farther off than any depth is lost; a static one tells nothing.
                beyond = knee.level == DYNAMIC and result.estimate > knee.plausible_depth
                if not result.converged or beyond or state[LOST] > 0.0:
                    result = remember(
                        knee, tick, state, start, result, result.converged and not beyond
                    )
        femur, error = result.femur, result.femur.error
        state[BEGUN], state[ANGLE], state[LOAD] = 1.0, angle, load
        state[HEIGHT], state[VELOCITY], state[TRY_STEP] = (
            femur.height,
            femur.velocity,
            femur.try_step,
        )
        state[E_HEIGHT], state[E_VELOCITY] = error.height, error.velocity
        state[E_HH], state[E_HV], state[E_VV] = error.hh, error.hv, error.vv
        state[IMPACT], state[IMPACT_ERROR] = femur.impact_speed, femur.impact_error
        state[STIFFNESS], state[SLOPE_DAMPING] = result.stage.stiffness, result.stage.damping
        far = -result.stage.depth > MAX_SURFACE_GAP
        if far and knee.level != PRESCRIBED_HEIGHT:
            state[UNSETTLED] = SETTLING
        elif result.stage.depth > 0.0:
            state[UNSETTLED] = max(0.0, state[UNSETTLED] - duration)
        far = far or state[UNSETTLED] > 0.0
        write_answer(knee, angle, angle_rate, load, fidelity, result, far, words, codes, counts, i)


@in_kernel
def at_rest(
    knee: KneeConstants, angle: float, load: float, height: float, most: int, spent: int
) -> Result:
    """Return the contact at rest, under the load [N] or at the prescribed height [m], by about `most` evaluations.

    It answers the first tick of a run, or one that has been given up after it has `spent` some evaluations.
    """
    if not math.isnan(height):
        depth, _, _ = touch(knee.surfaces, angle, 0.0, height)
        return at_height(knee, height, 0.0, depth, 0.0, 0.0 if depth > 0.0 else math.nan)
    height, depth, force, stiffness, damping, cosine, used = static_contact(
        knee.surfaces, knee.law, angle, load, START_HEIGHT, 0.0, 0.0, most
    )
    square = cosine * cosine
    stage = Stage(depth, 0.0, force, square * stiffness, square * damping, 0.0, cosine, 0.0)
    femur = FemurState(height, math.nan, EXACT, math.inf, 0.0, 0.0)
    return Result(femur, stage, force, 0.0, 0.0, spent + used, spent == 0)


@in_kernel
def at_height(
    knee: KneeConstants, height: float, velocity: float, depth: float, rate: float, impact: float
) -> Result:
    """Return the contact at a prescribed height [m] and velocity [m/s], given depth [m] and rate [m/s] there."""
    force, _, _ = law_force(knee.law, depth, rate, 0.0 if math.isnan(impact) else impact)
    force = force if knee.allow_tension else max(force, 0.0)
    stage = Stage(depth, rate, force, 0.0, 0.0, 0.0, 1.0, 0.0)
    femur = FemurState(height, velocity, EXACT, math.inf, impact, 0.0)
    return Result(femur, stage, force, 0.0, 0.0, 1 if depth > 0.0 else 0, True)


@in_kernel
def follow(knee: KneeConstants, tick: Interval, start: FemurState, end_height: float) -> Result:
    """Return the contact at the end of an interval in which the height changes linearly to the prescribed one [m].

    It is exact: pose and velocity are prescribed. A law that depends on the impact speed is given that of the touch
    inside the interval, if femur and tibia were apart at its beginning (bisection).
    """
    velocity, impact = (end_height - start.height) / tick.duration, start.impact_speed
    end = tick.angle + tick.angle_rate * tick.duration
    depth, rate, cosine = touch(knee.surfaces, end, tick.angle_rate, end_height)
    rate -= cosine * velocity
    if depth <= 0.0:
        impact = math.nan
    elif math.isnan(impact):
        low, high, impact = 0.0, tick.duration, rate
        for _ in range(MOST_BISECTIONS):
            middle = 0.5 * (low + high)
            if not low < middle < high:
                break
            angle, height = tick.angle + tick.angle_rate * middle, start.height + velocity * middle
            there, surface_rate, n_y = touch(knee.surfaces, angle, tick.angle_rate, height)
            if there > 0.0:
                high, impact = middle, surface_rate - n_y * velocity
            else:
                low = middle
    return at_height(knee, end_height, velocity, depth, rate, impact)


@in_kernel
def quasi_static(
    knee: KneeConstants, tick: Interval, start: FemurState, stiffness: float, damping: float
) -> Result:
    """Return the static contact at the end of an interval, with the error of the motion that it leaves out.

    With x = static height - dynamic height, M ẍ + C ẋ + K x = M ÿ_static - C δ̇_static, by the contact linearised with
    K and C, the slopes along the height: `stiffness` and `damping` at the beginning. It holds only while the load
    presses the surfaces together and the femur can follow: elsewhere the tick is not `converged`.
    """
    h, mass, load = tick.duration, knee.mass, tick.load + tick.load_rate * tick.duration
    end_angle = tick.angle + tick.angle_rate * h
    depth, surface_rate, cosine = touch(knee.surfaces, tick.angle, tick.angle_rate, start.height)
    sinking = tick.load_rate / stiffness if stiffness > 0.0 else 0.0
    begin_velocity = surface_rate / cosine - sinking
    near = max(0.0, depth + cosine * sinking * h)
    height, end_depth, force, k, c, end_cosine, used = static_contact(
        knee.surfaces,
        knee.law,
        end_angle,
        load,
        start.height,
        near,
        NEWTON_SHARE * knee.tolerance,
        knee.budget,
    )
    if (
        knee.remembers and start.impact_speed + start.impact_error > 0.0
    ):  # it has begun faster, and damps less
        _, _, c = law_force(knee.law, end_depth, 0.0, start.impact_speed + start.impact_error)
    _, end_surface_rate, _ = touch(knee.surfaces, end_angle, tick.angle_rate, height)
    square = end_cosine * end_cosine
    k, c = square * k, square * c
    end_sinking = tick.load_rate / k if k > 0.0 else 0.0
    velocity = end_surface_rate / end_cosine - end_sinking
    inertia = mass * (velocity - begin_velocity) / h
    pressed = (
        min(tick.load, load) > 0.0
        and min(tick.load, load) + inertia > 0.0
        and min(stiffness, k) > 0.0
    )
    error, held = bounded(start.error), holding(k, c, mass)
    if pressed:
        before = Error(
            error.height,
            error.velocity + begin_velocity - start.velocity,
            error.hh,
            error.hv,
            error.vv,
        )
        begin_rest = (inertia - damping * sinking) / stiffness
        end_rest = (inertia - c * end_sinking) / k
        begin_layer, layer = layer_at(knee.law, depth), layer_at(knee.law, end_depth)
        in_layer = end_depth - float(knee.law[max(layer, 1), BEGIN])
        error = left_behind(
            before, begin_rest, end_rest, stiffness, damping, k, c, in_layer, mass, h
        )
        if (
            layer > 1 and reach(before, held) > in_layer
        ):  # half of its swing may lie in the layer above
            _, soft, _ = force_at(knee.law, layer - 1, end_depth, 0.0, 0.0)
            kept = reach(before, held) * math.exp(
                -h / SOFT_SWINGS * math.sqrt(square * soft / mass)
            )
            least = max(0.0, kept - reach(error, held))
            error = with_bound(error, least, least * held)
        left = min(NEWTON_SHARE * knee.tolerance, 1e-3 * end_depth)
        unknown = left * left / max(end_depth, TINY)
        if (
            begin_layer != layer
        ):  # a layer begins softly, or with another dashpot: the dynamic femur may stay behind
            behind = max(depth, end_depth) - float(knee.law[max(begin_layer, layer), BEGIN])
            unknown += behind
            if damping > c:  # let go later, it swings about where the load has left it
                late = math.sqrt(
                    2.0
                    * damping
                    * (behind + reach(before, math.inf))
                    / max(abs(tick.load_rate), TINY)
                )
                unknown += min(abs(depth - end_depth), abs(tick.load_rate) * min(late, h) / k)
        way, speed = pushed_by(UNKNOWN_INERTIA * abs(inertia), k, c, mass, h)
        if knee.surfaces.non_convex > 0.0 or not math.isnan(
            next_kink(knee.surfaces, tick.angle, end_angle)
        ):
            # The contact leaps from bump to bump: the surface kicks the femur, maybe twice, maybe at the end.
            kick = 3.0 * abs(velocity - begin_velocity)
            way, speed = way + kick / held, speed + kick
        error = bounded(with_bound(error, unknown + way, speed))
        # The linearised contact must not pull the femur with more than the load, as no contact does.
        pull, swing = (
            stiffness * before.height + damping * before.velocity,
            math.sqrt(stiffness * mass),
        )
        if damping < 2.0 * swing:  # what is a velocity now pulls later
            rebound = swing * before.velocity
            pull = math.sqrt(pull * pull + rebound * rebound)
        pressed = abs(pull) < min(tick.load, load)
        # A contact that has let go and begun anew damps otherwise, if the law remembers how it began.
        pressed = pressed and not (knee.remembers and reach(error, held) >= in_layer)
    stage = Stage(
        end_depth, end_cosine * end_sinking, force, k, c, end_surface_rate, end_cosine, 0.0
    )
    femur = FemurState(height, velocity, error, math.inf, start.impact_speed, start.impact_error)
    force_estimate = force_reach(error, k, c, c * end_sinking, held) / end_cosine
    return Result(femur, stage, force, reach(error, held), force_estimate, used, pressed)


@in_kernel
def left_behind(
    error: Error,
    begin_rest: float,
    end_rest: float,
    stiffness: float,
    damping: float,
    k: float,
    c: float,
    in_layer: float,
    mass: float,
    h: float,
) -> Error:
    """Return the deviation of the static contact from the dynamic one after a tick of `h` [s].

    `begin_rest` and `end_rest` [m] are where it would come to rest, which moves linearly; the slopes are those at the
    beginning and, `k` and `c`, at the end; `in_layer` [m] is the depth in the layer at the end.
    """
    spring, dashpot = 0.5 * (stiffness + k), 0.5 * (damping + c)
    drift = (end_rest - begin_rest) / h
    lag = dashpot / spring * drift
    x, u = error.height - begin_rest + lag, error.velocity - drift
    away = Error(x, u, error.hh, error.hv, error.vv)
    held, frequency = holding(spring, dashpot, mass), math.sqrt(spring / mass)
    swing = abs(u) / held
    late = abs(math.sqrt(k / mass) - frequency) + LOOSE * frequency
    if h * min(frequency, late) > IN_STEP and dashpot < 2.0 * frequency * mass:
        # Its phase at the end of the tick is not known.
        added = (
            ANY_PHASE * ANY_PHASE * (x * x + u * u / (frequency * frequency)) / (SPREAD * SPREAD)
        )
        away = Error(
            0.0, 0.0, error.hh + added, error.hv, error.vv + added * frequency * frequency
        )
    moved = over_step(away, spring, spring, spring, dashpot, mass, h)
    if abs(k - spring) > ANOTHER * spring or abs(c - dashpot) > ANOTHER * dashpot:
        other = over_step(away, k, k, k, c, mass, h)
        wider = math.sqrt(max(other.hh, 0.0)) - math.sqrt(max(moved.hh, 0.0))
        faster = math.sqrt(max(other.vv, 0.0)) - math.sqrt(max(moved.vv, 0.0))
        moved = with_bound(
            moved,
            abs(other.height - moved.height) + SPREAD * max(wider, 0.0),
            abs(other.velocity - moved.velocity) + SPREAD * max(faster, 0.0),
        )
    behind = moved.velocity / held
    still = math.sqrt(moved.height * moved.height + behind * behind)
    doubted = SPREAD * math.sqrt(max(moved.hh + moved.vv / (held * held), 0.0))
    moved = Error(
        moved.height + end_rest - lag, moved.velocity + drift, moved.hh, moved.hv, moved.vv
    )
    size = abs(moved.height) + abs(error.height)
    unknown = max(ROUGH * still - doubted, 0.0) + ROUGH * abs(end_rest - begin_rest) + LOOSE * size
    unknown += BENT_REST * size * min(1.0, size / max(in_layer, TINY))
    if swing > in_layer:  # the surfaces come apart meanwhile, and land somehow
        unknown += swing
    way, speed = pushed_by(spring * unknown, spring, dashpot, mass, h)
    return curved(with_bound(moved, way, speed), in_layer, spring, dashpot, mass, h)


@in_kernel
def remember(
    knee: KneeConstants,
    tick: Interval,
    state: Floats,
    start: FemurState,
    result: Result,
    solved: bool,
) -> Result:
    """Return the answer to a tick while the exact solution is lost, and find out whether it has been forgotten.

    It is lost where a tick could not be resolved, or where its error may be larger than any depth: the linearised
    contact would make that small at once, while the exact femur still flies. From then on two bounds of the exact
    femur are kept, of its speed and of its distance: what it had, what the contact had stored, and what load and
    surfaces have added. It is forgotten when, without a break, the load has pressed for longer than all flights take,
    the first one from that distance at that speed and the others after landings, which leave a part of the speed; and
    then for as many relaxation times of the contact as the tolerance asks for. Where a layer has no dashpot, or the law
    remembers how its contact began, nothing is forgotten until a reset. How fast the contact has begun stays unknown
    until the next touch, for a law that is changed to.
    """
    mass, stage, h = knee.mass, result.stage, tick.duration
    load = tick.load + tick.load_rate * h
    pull, deepest, damped = (
        max(abs(tick.load), abs(load)),
        max(stage.depth, 0.0),
        not knee.remembers,
    )
    for i in range(1, len(knee.law) - 1):
        damped = damped and knee.law[i, DAMPING] > 0.0
    end_angle, speed, follows = (
        tick.angle + tick.angle_rate * h,
        float(state[LOST]),
        result.femur.velocity,
    )
    if math.isnan(follows):
        _, end_rate, cosine = touch(knee.surfaces, end_angle, tick.angle_rate, result.femur.height)
        follows = end_rate / cosine
    if speed > 0.0:
        speed += abs(start.velocity - state[FOLLOWING])
    if not solved:
        if speed == 0.0:
            depth, rate, cosine = touch(knee.surfaces, tick.angle, tick.angle_rate, start.height)
            deepest = max(deepest, depth + reach(start.error, math.inf))
            state[AWAY] = abs(depth) + reach(start.error, math.inf)
            speed = abs(rate / cosine - start.velocity) + velocity_reach(start.error) + TINY_SPEED
        stored = deepest * abs(law_force(knee.law, deepest, 0.0, 0.0)[0])
        speed = math.sqrt(speed * speed + 2.0 * stored / mass)
    moved = abs(follows - start.velocity)
    if not solved or not damped or min(tick.load, load) <= 0.0 or stage.depth <= 0.0:
        speed += pull * h / mass + moved
        state[IMPULSE], state[STRONGEST], state[QUIET] = 0.0, 0.0, 0.0
    else:
        # A landing deeper in the contact meets a stiffer spring, whose dashpot damps less.
        speed += abs(load - tick.load) / math.sqrt(stage.stiffness * mass) + moved
        below = stage.depth + speed * math.sqrt(mass / stage.stiffness)
        _, k, c = force_at(knee.law, layer_at(knee.law, below), below, 0.0, 0.0)
        damping_ratio = min(0.5 * c / math.sqrt(max(k, stage.stiffness) * mass), 0.99)
        kept = math.exp(-math.pi * damping_ratio / math.sqrt(1.0 - damping_ratio * damping_ratio))
        state[IMPULSE] += min(tick.load, load) * h / mass
        state[STRONGEST] = max(state[STRONGEST], pull)
        landing = math.sqrt(speed * speed + 2.0 * state[STRONGEST] / mass * state[AWAY])
        if state[IMPULSE] > speed + landing * (1.0 + kept) / (1.0 - kept):
            state[QUIET] += h * eigenvalues(stage.stiffness, stage.damping, mass)[0]
            away = max(stage.depth, speed * math.sqrt(mass / stage.stiffness))
            if state[QUIET] > math.log(1.0 + away / (FORGOTTEN * knee.tolerance)):
                state[LOST], state[AWAY], state[IMPULSE], state[STRONGEST], state[QUIET] = (
                    0.0,
                    0.0,
                    0.0,
                    0.0,
                    0.0,
                )
                femur, left = result.femur, REMAINS * knee.tolerance
                error = with_bound(
                    femur.error, left, left * holding(stage.stiffness, stage.damping, mass)
                )
                return Result(
                    FemurState(
                        femur.height,
                        femur.velocity,
                        error,
                        femur.try_step,
                        femur.impact_speed,
                        landing,
                    ),
                    stage,
                    result.force,
                    result.estimate + left,
                    result.force_estimate,
                    result.evaluations,
                    True,
                )
    state[LOST], state[FOLLOWING] = min(speed, LARGEST_ERROR), follows
    state[AWAY] = min(state[AWAY] + deepest + speed * h, LARGEST_ERROR)
    return Result(
        result.femur,
        stage,
        result.force,
        max(result.estimate, float(state[AWAY])),
        result.force_estimate,
        result.evaluations + 2,
        False,
    )


@inlined
def write_answer(
    knee: KneeConstants,
    angle: float,
    angle_rate: float,
    load: float,
    fidelity: int,
    result: Result,
    far: bool,
    words: Floats,
    codes: Bytes,
    counts: Counts,
    i: int,
) -> None:
    """Fill row i with the answer to a tick, except for stamp and latency, which the kernel does not know."""
    stage, height, depth = result.stage, result.femur.height, max(0.0, result.stage.depth)
    bone = max(0.0, depth - float(knee.law[2, BEGIN]))
    x, x_slope = translation(knee.surfaces.pieces, angle)
    overlap, extent, turning, normal_x, normal_y = closest(knee.surfaces, angle, x, height)
    along, across = -turning, overlap - extent
    point_x, point_y = (
        x + along * normal_y + across * normal_x,
        height - along * normal_x + across * normal_y,
    )
    estimate, force_estimate, evaluations = (
        result.estimate,
        result.force_estimate,
        result.evaluations,
    )
    if estimate > NEARLY_STRAIGHT * abs(stage.depth) and stage.depth + estimate > 0.0:
        # The law bends over the error of the depth: evaluate it at the deeper end.
        deeper, rate = stage.depth + estimate, stage.rate + velocity_reach(result.femur.error)
        impact = 0.0 if math.isnan(result.femur.impact_speed) else result.femur.impact_speed
        most, _, _ = force_at(knee.law, layer_at(knee.law, deeper), deeper, rate, impact)
        force_estimate = max(force_estimate, most - result.force, result.force)
        evaluations += 1
    force_kept = knee.force_tolerance == 0.0 or force_estimate <= knee.force_tolerance
    missed = not (result.converged and estimate <= knee.tolerance and force_kept)
    velocity = 0.0 if math.isnan(result.femur.velocity) else result.femur.velocity
    force_x, force_y = -result.force * normal_x, -result.force * normal_y
    words[i, W_ANGLE], words[i, W_LOAD], words[i, W_FORCE] = angle, load, result.force
    words[i, W_DEPTH], words[i, W_GAP], words[i, W_RATE] = (
        depth,
        max(0.0, -stage.depth),
        stage.rate,
    )
    # Second of Eqs. 6: velocity of the femur's deepest point along the anterior tangent t = (n_y, -n_x) of the tibia.
    words[i, W_SLIDING] = angle_rate * (x_slope * normal_y + extent) - velocity * normal_x
    words[i, W_POINT], words[i, W_POINT + 1] = point_x, point_y
    words[i, W_HEIGHT], words[i, W_X], words[i, W_NORMAL_X], words[i, W_NORMAL_Y] = (
        height,
        x,
        normal_x,
        normal_y,
    )
    words[i, W_CARTILAGE], words[i, W_BONE] = depth - bone, bone
    # Not a number is no estimate: it is published as the largest error.
    words[i, W_ERROR] = estimate if estimate < LARGEST_ERROR else LARGEST_ERROR
    words[i, W_FORCE_ERROR] = (
        force_estimate if force_estimate < LARGEST_FORCE_ERROR else LARGEST_FORCE_ERROR
    )
    words[i, W_WRENCH], words[i, W_WRENCH + 1] = force_x, force_y
    words[i, W_TORQUE_Z] = point_x * force_y - point_y * force_x
    codes[i, B_STATE] = 2 if bone > 0.0 else 1 if depth > 0.0 else 0
    codes[i, B_FIDELITY] = fidelity
    implausible = depth > knee.plausible_depth or far or not MIN_FLEXION <= angle <= MAX_FLEXION
    implausible = implausible or (depth > 0.0 and abs(point_x) > MAX_CONTACT_X)
    codes[i, B_STATUS] = (NOT_CONVERGED if missed else 0) | (IMPLAUSIBLE if implausible else 0)
    counts[i, C_EVALUATIONS] = evaluations
