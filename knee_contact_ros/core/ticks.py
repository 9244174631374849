"""One tick after another: what the samples prescribe, the level's answer, and what is told about it.

A run's state and its answer lie in arrays of numbers that the caller keeps, so that a tick allocates nothing.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.core.contact_pairs.base import Closest
from knee_contact_ros.core.integrators.base import NO_ERROR, FemurState, StateError
from knee_contact_ros.core.kernel_source import aside, in_kernel, inlined
from knee_contact_ros.core.prescribed import Interval, touch_at
from knee_contact_ros.core.scene import DYNAMIC, Advance, Progress, Scene, at_height
from knee_contact_ros.core.statics import START_HEIGHT, static_contact
from knee_contact_ros.core.types import NUMBERS, Status

Floats = NDArray[np.float64]

MEMORY = 17
"""Numbers that a run keeps from tick to tick: whether it has begun, the last angle and load, and its progress"""
TOLD = len(NUMBERS)
"""Numbers of an answer that its message tells"""
ANSWER = TOLD + 3
"""Numbers of an answer, in the order of `write_answer`"""
PLACING = slice(TOLD, ANSWER)
"""Those of them that the message does not have: x of the reference point, and the tibial normal (x, y)"""
NOT_CONVERGED, IMPLAUSIBLE = int(Status.NOT_CONVERGED), int(Status.IMPLAUSIBLE)


@in_kernel
def run(
    scene: Scene, memory: Floats, durations: Floats, angles: Floats, loads: Floats, heights: Floats, answers: Floats
) -> None:
    """Take ticks one after another; see `tick`. All arrays have shape (n,), `answers` (n, `ANSWER`)."""
    for i in range(len(durations)):
        duration, angle, load, height = float(durations[i]), float(angles[i]), float(loads[i]), float(heights[i])
        tick(scene, memory, duration, angle, load, height, answers[i])


@inlined
def tick(
    scene: Scene, memory: Floats, duration: float, angle: float, load: float, height: float, answer: Floats
) -> None:
    """Advance by `duration` [s] to an angle [rad], a load [N] and, if it is prescribed, a femoral height [m].

    `memory`, shape (`MEMORY`,), is all zeros before the first tick, whose duration does not count: it is answered with
    the contact at rest. `answer`, shape (`ANSWER`,), is filled.
    """
    if float(memory[0]) == 0.0:
        angle_rate = 0.0
        advance = start(scene, angle, load, height)
    else:
        last_angle, last_load = float(memory[1]), float(memory[2])
        angle_rate = (angle - last_angle) / duration
        interval = Interval(
            scene.pair, scene.mechanism, duration, last_angle, angle_rate, last_load, (load - last_load) / duration,
            height,
        )  # fmt: skip
        progress = read_progress(memory)
        if math.isnan(progress.state.velocity):
            progress = following_surface(interval, progress)
        advance = scene.level.advance(scene, interval, progress)
    memory[0], memory[1], memory[2] = 1.0, angle, load
    write_progress(memory, advance.progress)
    write_answer(answer, scene, angle, angle_rate, load, advance)


@aside
def start(scene: Scene, angle: float, load: float, height: float) -> Advance:
    """Contact at rest: under the load, or at the prescribed height; the penetration rate is 0."""
    x, _ = scene.mechanism.translation(angle)
    touch = scene.pair.at(angle, 0.0, x, 0.0)
    if not math.isnan(height):
        depth, _, _ = touch.touch(height)
        return at_height(scene, height, 0.0, depth, 0.0, 0.0 if depth > 0.0 else math.nan)
    static = static_contact(scene.regions.law, touch, load, START_HEIGHT, 0.0, 0.0)
    _, _, cosine = touch.touch(static.height)
    progress = Progress(
        FemurState(static.height, math.nan), NO_ERROR, math.inf, 0.0, 0.0, DYNAMIC, 0.0,
        cosine * cosine * static.stiffness, cosine * cosine * static.damping, 0.0, 0.0,
        static.depth,
    )  # fmt: skip
    return Advance(progress, static.depth, 0.0, static.force, 0.0, 0.0, static.evaluations, True)


@aside
def following_surface(interval: Interval, progress: Progress) -> Progress:
    """The progress behind the static start: the femur follows its turning surface."""
    _, rate, cosine = touch_at(interval, 0.0).touch(progress.state.height)
    return Progress(
        FemurState(progress.state.height, rate / cosine), progress.error, progress.try_step, progress.impact_speed,
        progress.impact_error, progress.fidelity, progress.unrest, progress.stiffness, progress.damping,
        progress.excess, progress.sinking, progress.depth,
    )  # fmt: skip


@in_kernel
def read_progress(memory: Floats) -> Progress:
    """Take the progress out of a run's memory."""
    return Progress(
        FemurState(float(memory[3]), float(memory[4])),
        StateError(float(memory[5]), float(memory[6])),
        float(memory[7]),
        float(memory[8]),
        float(memory[9]),
        int(memory[10]),
        float(memory[11]),
        float(memory[12]),
        float(memory[13]),
        float(memory[14]),
        float(memory[15]),
        float(memory[16]),
    )


@in_kernel
def write_progress(memory: Floats, progress: Progress) -> None:
    """Put the progress into a run's memory."""
    memory[3], memory[4] = progress.state.height, progress.state.velocity
    memory[5], memory[6] = progress.error.height, progress.error.velocity
    memory[7] = progress.try_step
    memory[8], memory[9] = progress.impact_speed, progress.impact_error
    memory[10], memory[11] = progress.fidelity, progress.unrest
    memory[12], memory[13] = progress.stiffness, progress.damping
    memory[14], memory[15], memory[16] = progress.excess, progress.sinking, progress.depth


@in_kernel
def write_answer(answer: Floats, scene: Scene, angle: float, angle_rate: float, load: float, advance: Advance) -> None:
    """Put the answer to a tick into the terms of the message, in the order of `types.NUMBERS` and then `PLACING`.

    `angle` [rad] is that at the tick, `angle_rate` [rad/s] that of the interval before it.
    """
    depth, height = max(0.0, advance.depth), advance.progress.state.height
    layers = scene.regions.law.layers
    bone = max(0.0, depth - layers[1 if len(layers) > 1 else 0].begin) if len(layers) > 1 else 0.0
    x, x_slope = scene.mechanism.translation(angle)
    closest = scene.pair.closest(angle, x, height)
    point_x, point_y = closest.point(x, height)
    answer[0], answer[1] = angle, load
    answer[2] = advance.force
    answer[3], answer[4] = depth, max(0.0, -advance.depth)
    answer[5] = advance.rate
    answer[6] = sliding_velocity(closest, x_slope, angle_rate, advance.progress.state.velocity)
    answer[7], answer[8] = point_x, point_y
    answer[9] = height
    answer[10], answer[11] = depth - bone, bone
    answer[12] = 2 if bone > 0.0 else 1 if depth > 0.0 else 0
    answer[13] = advance.progress.fidelity
    missed, absurd = not is_exact_enough(scene, advance), depth > scene.plausible_depth
    answer[14] = (NOT_CONVERGED if missed else 0) | (IMPLAUSIBLE if absurd else 0)
    answer[15], answer[16] = advance.error_estimate, advance.force_error_estimate
    answer[17] = advance.evaluations
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
def is_exact_enough(scene: Scene, advance: Advance) -> bool:
    """Whether an answer keeps the tolerances; one whose error is not a number keeps none."""
    force_kept = scene.force_tolerance == 0.0 or advance.force_error_estimate <= scene.force_tolerance
    return advance.converged and advance.error_estimate <= scene.tolerance and force_kept
