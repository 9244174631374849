"""One tick after another: what the samples prescribe, the level's answer, and what is told about it.

What a run keeps and its answers lie in records that the caller keeps, so that a tick allocates nothing.
"""

from __future__ import annotations

import math
from typing import Any, get_type_hints

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.core.adrift import FOUND, NONE, Adrift
from knee_contact_ros.core.backlog import BACKLOG, in_doubt, interval_of, take_on, work_off
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
from knee_contact_ros.core.types import Rows, Status

Floats = NDArray[np.float64]


def _fields(kind: type) -> np.dtype[Any]:
    """A record with the fields of a named tuple."""
    kinds = {float: np.dtype(np.float64), int: np.dtype(np.int64)}
    return np.dtype([(name, kinds.get(hint) or _fields(hint)) for name, hint in get_type_hints(kind).items()])


PROGRESS = _fields(Progress)
MEMORY = np.dtype([
    ("begun", np.int64), ("angle", np.float64), ("load", np.float64), ("progress", PROGRESS), ("backlog", BACKLOG),
])  # fmt: skip
"""What a run keeps from tick to tick: whether it has begun, the last tick's angle [rad] and load [N], and where it
stands; all zeros before the first tick"""
Memory = NDArray[Any]
"""Of one run: an array of `MEMORY`, shape (1,)"""
Record = Any
"""An element of an array of records"""
NOT_CONVERGED, IMPLAUSIBLE = int(Status.NOT_CONVERGED), int(Status.IMPLAUSIBLE)
LARGEST_FORCE_ERROR = 1e12
"""[N]"""
NEARLY_STRAIGHT = 0.05
"""Part of the depth up to which an error of it makes one of the force by the slope alone"""


@in_kernel
def run(
    scene: Scene, memory: Memory, durations: Floats, angles: Floats, loads: Floats, heights: Floats, answers: Rows
) -> None:
    """Take ticks one after another: advance by durations [s] to angles [rad], loads [N] and prescribed heights [m].

    All arrays have shape (n,); `answers` is filled. A height that is not prescribed is not a number. The duration of
    the first tick does not count: it is answered with the contact at rest.
    """
    kept = memory[0]
    begun, last_angle, last_load = kept["begun"] != 0, float(kept["angle"]), float(kept["load"])
    progress, backlog = read_progress(kept["progress"]), kept["backlog"]
    for i in range(len(durations)):
        angle, load, height, angle_rate = float(angles[i]), float(loads[i]), float(heights[i]), 0.0
        if not begun:
            advance = start(scene, angle, load, height)
        else:
            interval = interval_between(scene, float(durations[i]), last_angle, last_load, angle, load, height)
            if math.isnan(progress.state.velocity):
                progress = following_surface(interval, progress)
            angle_rate = interval.angle_rate
            calm = backlog["count"] == 0 and progress.adrift.stage == NONE
            calm = calm and not in_doubt(scene, interval, progress)
            spent, again = 0, True
            if not calm:
                interval, progress, spent = take_on(scene, backlog, progress, interval)
            while again:
                advance = scene.level.advance(scene, interval, progress, spent)
                if calm and advance.converged:
                    break
                calm = False
                advance, again = work_off(scene, backlog, interval, progress, advance)
                if again:
                    interval, progress = interval_of(scene, backlog, 0), advance.progress
                    spent = advance.evaluations
        begun, last_angle, last_load, progress = True, angle, load, advance.progress
        write_answer(answers[i], scene, angle, angle_rate, load, advance)
    kept["begun"], kept["angle"], kept["load"] = begun, last_angle, last_load
    write_progress(kept["progress"], progress)


@in_kernel
def interval_between(
    scene: Scene, duration: float, last_angle: float, last_load: float, angle: float, load: float, height: float
) -> Interval:
    """The interval [s] from the last tick's angle [rad] and load [N] to these, and to a prescribed height [m]."""
    return Interval(
        scene.pair, scene.mechanism, duration, last_angle, (angle - last_angle) / duration, last_load,
        (load - last_load) / duration, height,
    )  # fmt: skip


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
def read_progress(kept: Record) -> Progress:
    """Take the progress out of a record of `PROGRESS`."""
    state, error, adrift = kept["state"], kept["error"], kept["adrift"]
    return Progress(
        FemurState(float(state["height"]), float(state["velocity"])),
        CarriedError(
            float(error["height"]), float(error["velocity"]), float(error["hh"]), float(error["hv"]), float(error["vv"])
        ),
        float(kept["try_step"]),
        float(kept["impact_speed"]),
        float(kept["impact_error"]),
        int(kept["fidelity"]),
        float(kept["stiffness"]),
        float(kept["damping"]),
        float(kept["excess"]),
        float(kept["sinking"]),
        float(kept["depth"]),
        Adrift(
            float(adrift["stage"]), float(adrift["energy"]), float(adrift["height"]), float(adrift["load"]),
            float(adrift["rest"]), float(adrift["stored"]), float(adrift["pressed"]), float(adrift["least"]),
            float(adrift["begun"]), float(adrift["impact"]),
        ),
    )  # fmt: skip


@in_kernel
def write_progress(kept: Record, progress: Progress) -> None:
    """Put the progress into a record of `PROGRESS`."""
    state, error, adrift = kept["state"], kept["error"], kept["adrift"]
    state["height"], state["velocity"] = progress.state.height, progress.state.velocity
    error["height"], error["velocity"] = progress.error.height, progress.error.velocity
    error["hh"], error["hv"], error["vv"] = progress.error.hh, progress.error.hv, progress.error.vv
    kept["try_step"], kept["fidelity"] = progress.try_step, progress.fidelity
    kept["impact_speed"], kept["impact_error"] = progress.impact_speed, progress.impact_error
    kept["stiffness"], kept["damping"] = progress.stiffness, progress.damping
    kept["excess"], kept["sinking"], kept["depth"] = progress.excess, progress.sinking, progress.depth
    adrift["stage"], adrift["energy"] = progress.adrift.stage, progress.adrift.energy
    adrift["height"], adrift["load"] = progress.adrift.height, progress.adrift.load
    adrift["rest"], adrift["stored"] = progress.adrift.rest, progress.adrift.stored
    adrift["pressed"], adrift["least"] = progress.adrift.pressed, progress.adrift.least
    adrift["begun"], adrift["impact"] = progress.adrift.begun, progress.adrift.impact


@in_kernel
def write_answer(answer: Record, scene: Scene, angle: float, angle_rate: float, load: float, advance: Advance) -> None:
    """Fill a row with the answer to a tick, but for stamp and latency, which no kernel knows."""
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
    missed = not (advance.converged and is_exact_enough(scene, error, force_error))
    answer["flexion_angle"], answer["load"] = angle, load
    answer["contact_force"], answer["penetration_rate"] = advance.force, advance.rate
    answer["penetration_depth"], answer["gap"] = depth, max(0.0, -advance.depth)
    answer["sliding_velocity"] = sliding_velocity(closest, x_slope, angle_rate, advance.progress.state.velocity)
    answer["contact_point"]["x"], answer["contact_point"]["y"] = point_x, point_y
    answer["femoral_height"], answer["femoral_x"] = height, x
    answer["cartilage_depth"], answer["bone_depth"] = depth - bone, bone
    answer["contact_state"] = 2 if bone > 0.0 else 1 if depth > 0.0 else 0
    answer["fidelity"] = advance.fidelity
    answer["status"] = (NOT_CONVERGED if missed else 0) | (IMPLAUSIBLE if depth > scene.plausible_depth else 0)
    # Not a number is no estimate: it is published as the largest error.
    answer["error_estimate"] = error if error < LARGEST_HEIGHT_ERROR else LARGEST_HEIGHT_ERROR
    answer["force_error_estimate"] = force_error if force_error < LARGEST_FORCE_ERROR else LARGEST_FORCE_ERROR
    answer["evaluations"] = evaluations
    answer["normal_x"], answer["normal_y"] = closest.normal_x, closest.normal_y
    force, torque = answer["contact_wrench"]["force"], answer["contact_wrench"]["torque"]
    force_x, force_y = -advance.force * closest.normal_x, -advance.force * closest.normal_y
    force["x"], force["y"], torque["z"] = force_x, force_y, point_x * force_y - point_y * force_x


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
