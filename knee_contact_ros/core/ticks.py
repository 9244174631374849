"""Ticks one after another: the interval that two samples prescribe, the answer of a level, and the row that reports it.

The state of a run and its answers lie in records of the caller, so that a tick allocates nothing.
"""

from __future__ import annotations

import math
from typing import Any, get_type_hints

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.core.adrift import FOUND, NONE, Adrift
from knee_contact_ros.core.arrays import Floats
from knee_contact_ros.core.backlog import BACKLOG, in_doubt, interval_of, take_on, work_off
from knee_contact_ros.core.contact_laws.base import layer_at
from knee_contact_ros.core.contact_pairs.base import Closest
from knee_contact_ros.core.error_estimate import (
    EXACT,
    LARGEST_HEIGHT_ERROR,
    PropagatedError,
    velocity_reach,
)
from knee_contact_ros.core.integrators.base import FemurState
from knee_contact_ros.core.kernel_source import in_kernel, never_inlined
from knee_contact_ros.core.levels.advance import advance
from knee_contact_ros.core.prescribed import Interval, touch_at
from knee_contact_ros.core.scene import DYNAMIC, RunState, Scene, TickResult, at_height
from knee_contact_ros.core.statics import NO_LIMIT, START_HEIGHT, static_contact
from knee_contact_ros.core.types import Rows, Status


def _fields(kind: type) -> np.dtype[Any]:
    """Return a NumPy record type with the fields of a named tuple, nested ones included."""
    kinds = {float: np.dtype(np.float64), int: np.dtype(np.int64)}
    return np.dtype([(name, kinds.get(hint) or _fields(hint)) for name, hint in get_type_hints(kind).items()])


RUN_STATE = _fields(RunState)
MEMORY = np.dtype([
    ("begun", np.int64), ("angle", np.float64), ("load", np.float64), ("run_state", RUN_STATE), ("backlog", BACKLOG),
])  # fmt: skip
"""State of a run between two ticks: whether it has begun, angle [rad] and load [N] of the last tick, `RunState` and
backlog; all zeros before the first tick"""
Memory = NDArray[Any]
"""State of one run: an array of `MEMORY`, shape (1,)"""
Record = Any
"""An element of an array of NumPy records"""
NOT_CONVERGED, IMPLAUSIBLE = int(Status.NOT_CONVERGED), int(Status.IMPLAUSIBLE)
LARGEST_FORCE_ERROR = 1e12
"""Largest published error estimate of the contact force [N]"""
NEARLY_STRAIGHT = 0.05
"""Part of the depth up to which an error of the depth changes the force in proportion to the stiffness"""


@in_kernel
def run(
    scene: Scene, memory: Memory, durations: Floats, angles: Floats, loads: Floats, heights: Floats, answers: Rows
) -> None:
    """Compute ticks one after another: advance by durations [s] to angles [rad], loads [N] and prescribed heights [m].

    All arrays have shape (n,); `answers` is filled. A height that is not prescribed is NaN. The duration of the first
    tick of a run has no effect: that tick is answered with the contact at rest.
    """
    kept = memory[0]
    begun, last_angle, last_load = kept["begun"] != 0, float(kept["angle"]), float(kept["load"])
    run_state, backlog = read_run_state(kept["run_state"]), kept["backlog"]
    for i in range(len(durations)):
        angle, load, height, angle_rate = float(angles[i]), float(loads[i]), float(heights[i]), 0.0
        if not begun:
            result = start(scene, angle, load, height)
        else:
            interval = interval_between(scene, float(durations[i]), last_angle, last_load, angle, load, height)
            if math.isnan(run_state.state.velocity):
                run_state = following_surface(interval, run_state)
            angle_rate = interval.angle_rate
            calm = backlog["count"] == 0 and is_calm(scene, interval, run_state)
            spent, again = 0, True
            if not calm:
                interval, run_state, spent = take_on(scene, backlog, run_state, interval)
            while again:
                result = advance(scene, interval, run_state, spent)
                if calm and result.converged:
                    break
                calm = False
                result, again = work_off(scene, backlog, interval, run_state, result)
                if again:
                    interval, run_state = interval_of(scene, backlog, 0), result.run_state
                    spent = result.evaluations
        begun, last_angle, last_load, run_state = True, angle, load, result.run_state
        write_answer(answers[i], scene, angle, angle_rate, load, result)
    kept["begun"], kept["angle"], kept["load"] = begun, last_angle, last_load
    write_run_state(kept["run_state"], run_state)


@in_kernel
def is_calm(scene: Scene, interval: Interval, run_state: RunState) -> bool:
    """Whether the error estimate bounds the exact solution before an interval and is expected to do so throughout."""
    return run_state.adrift.stage == NONE and not in_doubt(scene, interval, run_state)


@in_kernel
def interval_between(
    scene: Scene, duration: float, last_angle: float, last_load: float, angle: float, load: float, height: float
) -> Interval:
    """Return the interval from the last tick's angle [rad] and load [N] to those of this tick, after a duration [s].

    `height` [m] is the prescribed height at its end, or NaN.
    """
    return Interval(
        pair=scene.pair, mechanism=scene.mechanism, duration=duration, angle=last_angle,
        angle_rate=(angle - last_angle) / duration, start_load=last_load, load_rate=(load - last_load) / duration,
        end_height=height,
    )  # fmt: skip


@never_inlined
def start(scene: Scene, angle: float, load: float, height: float) -> TickResult:
    """Return the contact at rest, under the load [N] or at the prescribed height [m]; the penetration rate is 0."""
    x, _ = scene.mechanism.translation(angle)
    touch = scene.pair.at(angle, 0.0, x, 0.0)
    if not math.isnan(height):
        depth, _, _ = touch.touch(height)
        return at_height(scene, height, 0.0, depth, 0.0, 0.0 if depth > 0.0 else math.nan)
    most = scene.budget - 2 if scene.budget > 0 else NO_LIMIT
    static = static_contact(scene.modes.law, touch, load, START_HEIGHT, 0.0, 0.0, most)
    _, _, cosine = touch.touch(static.height)
    run_state = RunState(
        state=FemurState(static.height, math.nan), error=EXACT, try_step=math.inf, impact_speed=0.0, impact_error=0.0,
        fidelity=DYNAMIC, stiffness=cosine * cosine * static.stiffness, damping=cosine * cosine * static.damping,
        excess=0.0, sinking=0.0, depth=static.depth, adrift=FOUND,
    )  # fmt: skip
    return TickResult(
        run_state=run_state, depth=static.depth, rate=0.0, force=static.force, error_estimate=0.0,
        force_error_estimate=0.0, evaluations=static.evaluations, reached=math.inf, converged=static.evaluations < most,
        height=static.height, fidelity=DYNAMIC,
    )  # fmt: skip


@never_inlined
def following_surface(interval: Interval, run_state: RunState) -> RunState:
    """Return the state after the static start, with the velocity at which the depth does not change."""
    _, rate, cosine = touch_at(interval, 0.0).touch(run_state.state.height)
    return run_state._replace(state=FemurState(run_state.state.height, rate / cosine))


@in_kernel
def read_run_state(kept: Record) -> RunState:
    """Read a run's state from a record of `RUN_STATE`."""
    state, error, adrift = kept["state"], kept["error"], kept["adrift"]
    return RunState(
        state=FemurState(float(state["height"]), float(state["velocity"])),
        error=PropagatedError(
            height=float(error["height"]), velocity=float(error["velocity"]), hh=float(error["hh"]),
            hv=float(error["hv"]), vv=float(error["vv"]),
        ),
        try_step=float(kept["try_step"]), impact_speed=float(kept["impact_speed"]),
        impact_error=float(kept["impact_error"]), fidelity=int(kept["fidelity"]), stiffness=float(kept["stiffness"]),
        damping=float(kept["damping"]), excess=float(kept["excess"]), sinking=float(kept["sinking"]),
        depth=float(kept["depth"]),
        adrift=Adrift(
            stage=float(adrift["stage"]), energy=float(adrift["energy"]), height=float(adrift["height"]),
            load=float(adrift["load"]), rest=float(adrift["rest"]), stored=float(adrift["stored"]),
            pressed=float(adrift["pressed"]), least=float(adrift["least"]), begun=float(adrift["begun"]),
            impact=float(adrift["impact"]),
        ),
    )  # fmt: skip


@in_kernel
def write_run_state(kept: Record, run_state: RunState) -> None:
    """Write a run's state into a record of `RUN_STATE`."""
    state, error, adrift = kept["state"], kept["error"], kept["adrift"]
    state["height"], state["velocity"] = run_state.state.height, run_state.state.velocity
    error["height"], error["velocity"] = run_state.error.height, run_state.error.velocity
    error["hh"], error["hv"], error["vv"] = run_state.error.hh, run_state.error.hv, run_state.error.vv
    kept["try_step"], kept["fidelity"] = run_state.try_step, run_state.fidelity
    kept["impact_speed"], kept["impact_error"] = run_state.impact_speed, run_state.impact_error
    kept["stiffness"], kept["damping"] = run_state.stiffness, run_state.damping
    kept["excess"], kept["sinking"], kept["depth"] = run_state.excess, run_state.sinking, run_state.depth
    adrift["stage"], adrift["energy"] = run_state.adrift.stage, run_state.adrift.energy
    adrift["height"], adrift["load"] = run_state.adrift.height, run_state.adrift.load
    adrift["rest"], adrift["stored"] = run_state.adrift.rest, run_state.adrift.stored
    adrift["pressed"], adrift["least"] = run_state.adrift.pressed, run_state.adrift.least
    adrift["begun"], adrift["impact"] = run_state.adrift.begun, run_state.adrift.impact


@in_kernel
def write_answer(
    answer: Record, scene: Scene, angle: float, angle_rate: float, load: float, result: TickResult
) -> None:
    """Fill a row with the answer to a tick, except for stamp and latency, which the kernel does not know."""
    depth, height = max(0.0, result.depth), result.height
    layers = scene.modes.law.layers
    bone = max(0.0, depth - layers[1 if len(layers) > 1 else 0].begin) if len(layers) > 1 else 0.0
    x, x_slope = scene.mechanism.translation(angle)
    closest = scene.pair.closest(angle, x, height)
    point_x, point_y = closest.point(x, height)
    error, force_error, evaluations = result.error_estimate, result.force_error_estimate, result.evaluations
    if error > NEARLY_STRAIGHT * abs(result.depth) and result.depth + error > 0.0:
        force_error = max(force_error, bent_force_error(scene, result))
        evaluations += 1
    missed = not (result.converged and is_exact_enough(scene, error, force_error))
    answer["flexion_angle"], answer["load"] = angle, load
    answer["contact_force"], answer["penetration_rate"] = result.force, result.rate
    answer["penetration_depth"], answer["gap"] = depth, max(0.0, -result.depth)
    answer["sliding_velocity"] = sliding_velocity(closest, x_slope, angle_rate, result.run_state.state.velocity)
    answer["contact_point"]["x"], answer["contact_point"]["y"] = point_x, point_y
    answer["femoral_height"], answer["femoral_x"] = height, x
    answer["cartilage_depth"], answer["bone_depth"] = depth - bone, bone
    answer["contact_state"] = 2 if bone > 0.0 else 1 if depth > 0.0 else 0
    answer["fidelity"] = result.fidelity
    answer["status"] = (NOT_CONVERGED if missed else 0) | (IMPLAUSIBLE if depth > scene.plausible_depth else 0)
    # Not a number is no estimate: it is published as the largest error.
    answer["error_estimate"] = error if error < LARGEST_HEIGHT_ERROR else LARGEST_HEIGHT_ERROR
    answer["force_error_estimate"] = force_error if force_error < LARGEST_FORCE_ERROR else LARGEST_FORCE_ERROR
    answer["evaluations"] = evaluations
    answer["normal_x"], answer["normal_y"] = closest.normal_x, closest.normal_y
    force, torque = answer["contact_wrench"]["force"], answer["contact_wrench"]["torque"]
    force_x, force_y = -result.force * closest.normal_x, -result.force * closest.normal_y
    force["x"], force["y"], torque["z"] = force_x, force_y, point_x * force_y - point_y * force_x


@in_kernel
def sliding_velocity(closest: Closest, x_slope: float, angle_rate: float, velocity: float) -> float:
    """Return the velocity [m/s] of the femur's deepest point along the anterior tangent t = (n_y, -n_x) of the tibia.

    The second of Eqs. 6, with the tangent reversed; the tibia is fixed. The femoral reference point moves by `x_slope`
    [m/rad] of the translation, the `angle_rate` [rad/s] and its `velocity` [m/s] along the height, which is NaN at
    rest.
    """
    along_height = 0.0 if math.isnan(velocity) else velocity
    return angle_rate * (x_slope * closest.normal_y + closest.extent) - along_height * closest.normal_x


@in_kernel
def is_exact_enough(scene: Scene, error: float, force_error: float) -> bool:
    """Whether estimated errors of depth [m] and force [N] are within the tolerances; NaN is not."""
    force_kept = scene.force_tolerance == 0.0 or force_error <= scene.force_tolerance
    return error <= scene.tolerance and force_kept


@never_inlined
def bent_force_error(scene: Scene, result: TickResult) -> float:
    """Return the error [N] of the force where that of the depth is large against the depth, by evaluating the law."""
    depth = result.depth + result.error_estimate
    rate = result.rate + velocity_reach(result.run_state.error)
    speed = 0.0 if math.isnan(result.run_state.impact_speed) else result.run_state.impact_speed
    force, _, _ = scene.modes.law.layers[layer_at(scene.modes.law, depth)].formula.force_at(depth, rate, speed)
    return max(force - result.force, result.force)
