"""One tick after another: what the samples prescribe, the level's answer, and what is told about it.

A run's state and its answer lie in arrays of numbers that the caller keeps, so that a tick allocates nothing.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.core.adrift import FOUND, NONE, Adrift
from knee_contact_ros.core.backlog import SIZE, in_doubt, interval_of, take_on, work_off
from knee_contact_ros.core.contact_laws.base import layer_at
from knee_contact_ros.core.contact_pairs.base import Closest
from knee_contact_ros.core.error_estimate import (
    EXACT,
    LARGEST_HEIGHT_ERROR,
    CarriedError,
    velocity_reach,
)
from knee_contact_ros.core.integrators.base import FemurState
from knee_contact_ros.core.kernel_source import aside, in_kernel
from knee_contact_ros.core.prescribed import Interval, touch_at
from knee_contact_ros.core.scene import DYNAMIC, Advance, Progress, Scene, at_height
from knee_contact_ros.core.statics import NO_LIMIT, START_HEIGHT, static_contact
from knee_contact_ros.core.types import NUMBERS, Status

Floats = NDArray[np.float64]

PROGRESS = 3
"""Where the progress begins in a run's memory: behind whether the run has begun, the last angle and the last load"""
BACKLOG = PROGRESS + 26
"""Where the backlog begins"""
MEMORY = BACKLOG + SIZE
"""Numbers that a run keeps from tick to tick"""
TOLD = len(NUMBERS)
"""Numbers of an answer that its message tells"""
ANSWER = TOLD + 3
"""Numbers of an answer, in the order of `write_answer`"""
PLACING = slice(TOLD, ANSWER)
"""Those of them that the message does not have: x of the reference point, and the tibial normal (x, y)"""
NOT_CONVERGED, IMPLAUSIBLE = int(Status.NOT_CONVERGED), int(Status.IMPLAUSIBLE)
LARGEST_FORCE_ERROR = 1e12
"""[N]"""
NEARLY_STRAIGHT = 0.05
"""Part of the depth up to which an error of it makes one of the force by the slope alone"""


@in_kernel
def run(
    scene: Scene, memory: Floats, durations: Floats, angles: Floats, loads: Floats, heights: Floats, answers: Floats
) -> None:
    """Take ticks one after another: advance by durations [s] to angles [rad], loads [N] and prescribed heights [m].

    All arrays have shape (n,), `answers` (n, `ANSWER`), which is filled; a height that is not prescribed is not a
    number. `memory`, shape (`MEMORY`,), is all zeros before the first tick, whose duration does not count: it is
    answered with the contact at rest.
    """
    for i in range(len(durations)):
        angle, load, height, angle_rate = float(angles[i]), float(loads[i]), float(heights[i]), 0.0
        if float(memory[0]) == 0.0:
            advance = start(scene, angle, load, height)
        else:
            interval = interval_behind(scene, memory, float(durations[i]), angle, load, height)
            progress = progress_behind(interval, memory)
            angle_rate = interval.angle_rate
            calm = float(memory[BACKLOG]) == 0.0 and progress.adrift.stage == NONE
            calm = calm and not in_doubt(scene, interval, progress)
            spent, again = 0, True
            if not calm:
                interval, progress, spent = take_on(scene, memory[BACKLOG:], progress, interval)
            while again:
                advance = scene.level.advance(scene, interval, progress, spent)
                if calm and advance.converged:
                    break
                calm = False
                advance, again = work_off(scene, memory[BACKLOG:], interval, progress, advance)
                if again:
                    interval, progress = interval_of(scene, memory[BACKLOG:], 0), advance.progress
                    spent = advance.evaluations
        memory[0], memory[1], memory[2] = 1.0, angle, load
        write_progress(memory, advance.progress)
        write_answer(answers[i], scene, angle, angle_rate, load, advance)


@in_kernel
def interval_behind(
    scene: Scene, memory: Floats, duration: float, angle: float, load: float, height: float
) -> Interval:
    """The interval from the last tick to one with this angle [rad], load [N] and, if it is prescribed, height [m]."""
    last_angle, last_load = float(memory[1]), float(memory[2])
    return Interval(
        scene.pair, scene.mechanism, duration, last_angle, (angle - last_angle) / duration, last_load,
        (load - last_load) / duration, height,
    )  # fmt: skip


@in_kernel
def progress_behind(interval: Interval, memory: Floats) -> Progress:
    """The progress that the last tick has left in a run's memory."""
    progress = read_progress(memory)
    return following_surface(interval, progress) if math.isnan(progress.state.velocity) else progress


@aside
def start(scene: Scene, angle: float, load: float, height: float) -> Advance:
    """Contact at rest: under the load, or at the prescribed height; the penetration rate is 0."""
    x, _ = scene.mechanism.translation(angle)
    touch = scene.pair.at(angle, 0.0, x, 0.0)
    if not math.isnan(height):
        depth, _, _ = touch.touch(height)
        return at_height(scene, height, 0.0, depth, 0.0, 0.0 if depth > 0.0 else math.nan)
    most = scene.budget - 2 if scene.budget > 0 else NO_LIMIT
    static = static_contact(scene.regions.law, touch, load, START_HEIGHT, 0.0, 0.0, most)
    _, _, cosine = touch.touch(static.height)
    progress = Progress(
        FemurState(static.height, math.nan), EXACT, math.inf, 0.0, 0.0, DYNAMIC,
        cosine * cosine * static.stiffness, cosine * cosine * static.damping, 0.0, 0.0, static.depth, FOUND,
    )  # fmt: skip
    return Advance(
        progress, static.depth, 0.0, static.force, 0.0, 0.0, static.evaluations, math.inf, static.evaluations < most,
        static.height, DYNAMIC,
    )  # fmt: skip


@aside
def following_surface(interval: Interval, progress: Progress) -> Progress:
    """The progress behind the static start: the femur follows its turning surface."""
    _, rate, cosine = touch_at(interval, 0.0).touch(progress.state.height)
    return Progress(
        FemurState(progress.state.height, rate / cosine), progress.error, progress.try_step, progress.impact_speed,
        progress.impact_error, progress.fidelity, progress.stiffness, progress.damping, progress.excess,
        progress.sinking, progress.depth, progress.adrift,
    )  # fmt: skip


@in_kernel
def read_progress(memory: Floats) -> Progress:
    """Take the progress out of a run's memory."""
    return Progress(
        FemurState(float(memory[3]), float(memory[4])),
        CarriedError(float(memory[5]), float(memory[6]), float(memory[7]), float(memory[8]), float(memory[9])),
        float(memory[10]),
        float(memory[11]),
        float(memory[12]),
        int(memory[13]),
        float(memory[14]),
        float(memory[15]),
        float(memory[16]),
        float(memory[17]),
        float(memory[18]),
        Adrift(
            float(memory[19]),
            float(memory[20]),
            float(memory[21]),
            float(memory[22]),
            float(memory[23]),
            float(memory[24]),
            float(memory[25]),
            float(memory[26]),
            float(memory[27]),
            float(memory[28]),
        ),
    )


@in_kernel
def write_progress(memory: Floats, progress: Progress) -> None:
    """Put the progress into a run's memory."""
    error, adrift = progress.error, progress.adrift
    memory[3], memory[4] = progress.state.height, progress.state.velocity
    memory[5], memory[6] = error.height, error.velocity
    memory[7], memory[8], memory[9] = error.hh, error.hv, error.vv
    memory[10] = progress.try_step
    memory[11], memory[12] = progress.impact_speed, progress.impact_error
    memory[13] = progress.fidelity
    memory[14], memory[15] = progress.stiffness, progress.damping
    memory[16], memory[17], memory[18] = progress.excess, progress.sinking, progress.depth
    memory[19], memory[20], memory[21], memory[22] = adrift.stage, adrift.energy, adrift.height, adrift.load
    memory[23], memory[24], memory[25] = adrift.rest, adrift.stored, adrift.pressed
    memory[26], memory[27], memory[28] = adrift.least, adrift.begun, adrift.impact


@in_kernel
def write_answer(answer: Floats, scene: Scene, angle: float, angle_rate: float, load: float, advance: Advance) -> None:
    """Put the answer to a tick into the terms of the message, in the order of `types.NUMBERS` and then `PLACING`."""
    depth, height = max(0.0, advance.depth), advance.height
    layers = scene.regions.law.layers
    bone = max(0.0, depth - layers[1 if len(layers) > 1 else 0].begin) if len(layers) > 1 else 0.0
    x, x_slope = scene.mechanism.translation(angle)
    closest = scene.pair.closest(angle, x, height)
    point_x, point_y = closest.point(x, height)
    error, force_error, evaluations = advance.error_estimate, advance.force_error_estimate, advance.evaluations
    if error > NEARLY_STRAIGHT * abs(advance.depth) and advance.depth + error > 0.0:
        force_error = max(force_error, bent_force_error(scene, advance))
        evaluations += 1
    answer[0], answer[1] = angle, load
    answer[2] = advance.force
    answer[3], answer[4] = depth, max(0.0, -advance.depth)
    answer[5] = advance.rate
    answer[6] = sliding_velocity(closest, x_slope, angle_rate, advance.progress.state.velocity)
    answer[7], answer[8] = point_x, point_y
    answer[9] = height
    answer[10], answer[11] = depth - bone, bone
    answer[12] = 2 if bone > 0.0 else 1 if depth > 0.0 else 0
    answer[13] = advance.fidelity
    missed = not (advance.converged and is_exact_enough(scene, error, force_error))
    answer[14] = (NOT_CONVERGED if missed else 0) | (IMPLAUSIBLE if depth > scene.plausible_depth else 0)
    # Not a number is no estimate: it is published as the largest error.
    answer[15] = error if error < LARGEST_HEIGHT_ERROR else LARGEST_HEIGHT_ERROR
    answer[16] = force_error if force_error < LARGEST_FORCE_ERROR else LARGEST_FORCE_ERROR
    answer[17] = evaluations
    answer[18] = x
    answer[19], answer[20] = closest.normal_x, closest.normal_y


@in_kernel
def sliding_velocity(closest: Closest, x_slope: float, angle_rate: float, velocity: float) -> float:
    """Velocity [m/s] of the femur's deepest point along t = (n_y, -n_x), the anterior tangent; the tibia stands still.

    The second of Eqs. 6, with the tangent turned round. The femoral reference point moves by `x_slope` [m/rad] of the
    translation, the `angle_rate` [rad/s] and its `velocity` [m/s] along the height, which is not a number at rest.
    """
    along_height = 0.0 if math.isnan(velocity) else velocity
    return angle_rate * (x_slope * closest.normal_y + closest.extent) - along_height * closest.normal_x


@in_kernel
def is_exact_enough(scene: Scene, error: float, force_error: float) -> bool:
    """Whether estimated errors of depth [m] and force [N] keep the tolerances; what is not a number keeps none."""
    force_kept = scene.force_tolerance == 0.0 or force_error <= scene.force_tolerance
    return error <= scene.tolerance and force_kept


@aside
def bent_force_error(scene: Scene, advance: Advance) -> float:
    """By how much [N] the force may be wrong where that of the depth is large against it: the law itself tells."""
    depth = advance.depth + advance.error_estimate
    rate = advance.rate + velocity_reach(advance.progress.error)
    speed = 0.0 if math.isnan(advance.progress.impact_speed) else advance.progress.impact_speed
    force, _, _ = scene.regions.law.layers[layer_at(scene.regions.law, depth)].formula.force_at(depth, rate, speed)
    return max(force - advance.force, advance.force)
