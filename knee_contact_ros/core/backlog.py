"""Ticks whose motion could not be resolved within their budget: the rest of it is computed in the next ticks.

A run then lags behind its stamps. Its answers are static ones, whose error is bounded by the energy of the femur where
the motion has come to; once the run has caught up, its answers are as exact as before. A run that lags behind by more
than `MOST` ticks, or makes no progress at all, gives the motion up: it continues from the static contact, and the exact
solution is lost (`adrift.py`) until that has been forgotten.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from knee_contact_ros.core.adrift import (
    CALMING,
    FOUND,
    LOST,
    NONE,
    NOTED,
    RESERVE,
    WATCHED,
    Adrift,
    Drive,
    Enclosure,
    bounds_near,
    calmed,
    enclosure_of,
    error_within,
    exceeds,
    loses,
    pushed,
)
from knee_contact_ros.core.error_estimate import EXACT, holding, reach
from knee_contact_ros.core.integrators.base import FemurState
from knee_contact_ros.core.kernel_source import in_kernel, never_inlined
from knee_contact_ros.core.prescribed import Interval, load_at, touch_at
from knee_contact_ros.core.scene import DYNAMIC, RunState, Scene, TickResult
from knee_contact_ros.core.statics import ANSWER, static_contact
from knee_contact_ros.core.types import Fidelity

MOST = 16
"""Largest number of ticks that a run may lag behind"""
BACKLOG = np.dtype([
    ("count", np.int64), ("moved", np.int64), ("angle", np.float64), ("load", np.float64),
    ("durations", np.float64, (MOST + 1,)), ("angles", np.float64, (MOST + 1,)), ("loads", np.float64, (MOST + 1,)),
])  # fmt: skip
"""Number of intervals to be computed, and whether this tick has made progress; angle [rad] and load [N] where the
motion has come to; the duration [s] of every interval, and angle and load at its end"""
Backlog = Any
"""The backlog of a run: a record of `BACKLOG`"""
STANDING = int(Fidelity.QUASI_STATIC)
"""Level of an answer that is static because its motion was not resolved"""


@never_inlined
def take_on(scene: Scene, backlog: Backlog, start: RunState, last: Interval) -> tuple[Interval, RunState, int]:
    """Add an interval to the backlog; return its first interval, the state that it begins with, and evaluations."""
    count = int(backlog["count"])
    if count == 0:
        backlog["angle"], backlog["load"] = last.angle, last.start_load
    backlog["durations"][count] = last.duration
    backlog["angles"][count] = last.angle + last.angle_rate * last.duration
    backlog["loads"][count] = load_at(last, last.duration)
    backlog["count"], backlog["moved"] = count + 1, 0
    interval = interval_of(scene, backlog, 0)
    run_state, evaluations = looked_after(scene, interval, start)
    return interval, run_state, evaluations


@never_inlined
def work_off(
    scene: Scene, backlog: Backlog, interval: Interval, start: RunState, result: TickResult
) -> tuple[TickResult, bool]:
    """Take the result of a level for the first interval of the backlog, and tell whether the tick is to continue.

    If it is not, the returned result is the answer to the tick; else the next interval is to be computed.
    """
    if backlog["count"] == 0:
        take_on(scene, backlog, start, interval)
    count = int(backlog["count"])
    durations, angles, loads = backlog["durations"], backlog["angles"], backlog["loads"]
    if not result.converged:
        moved = backlog["moved"] > 0 or result.reached > 0.0
        backlog["angle"] = interval.angle + interval.angle_rate * result.reached
        backlog["load"] = load_at(interval, result.reached)
        durations[0] = interval.duration - result.reached
        adrift, extra = start.adrift, 0
        if adrift.stage != NONE and result.reached > 0.0:
            drive = drive_of(scene, interval._replace(duration=result.reached), start)
            adrift, extra = pushed(scene.modes.law, adrift, drive, max(result.depth, 0.0))
        result = result._replace(evaluations=result.evaluations + extra)
        return behind(scene, backlog, result, adrift, count > MOST or not moved), False
    result = watched(scene, interval, start, result)
    backlog["angle"], backlog["load"] = angles[0], loads[0]
    for i in range(count - 1):
        durations[i], angles[i], loads[i] = durations[i + 1], angles[i + 1], loads[i + 1]
    backlog["count"], backlog["moved"] = count - 1, 1
    if count == 1:
        return result, False
    if scene.budget > 0 and result.evaluations >= scene.budget - RESERVE:
        return behind(scene, backlog, result, result.run_state.adrift, count - 1 > MOST), False
    run_state, evaluations = looked_after(scene, interval_of(scene, backlog, 0), result.run_state)
    return result._replace(run_state=run_state, evaluations=result.evaluations + evaluations), True


@in_kernel
def interval_of(scene: Scene, backlog: Backlog, index: int) -> Interval:
    """Return an interval of the backlog; the first one begins where the motion has come to."""
    angle, load = float(backlog["angle"]), float(backlog["load"])
    if index > 0:
        angle, load = float(backlog["angles"][index - 1]), float(backlog["loads"][index - 1])
    duration = float(backlog["durations"][index])
    return Interval(
        pair=scene.pair, mechanism=scene.mechanism, duration=duration, angle=angle,
        angle_rate=(float(backlog["angles"][index]) - angle) / duration, start_load=load,
        load_rate=(float(backlog["loads"][index]) - load) / duration, end_height=float("nan"),
    )  # fmt: skip


@in_kernel
def looked_after(scene: Scene, interval: Interval, start: RunState) -> tuple[RunState, int]:
    """Return the state that an interval begins with, with bounds if the exact solution is lost, or may be soon.

    The second number is that of evaluations.
    """
    stage = LOST if lost(interval, start) else WATCHED
    if start.adrift.stage >= stage or (start.adrift.stage == NONE and stage == WATCHED and not doubtful(scene, start)):
        return start, 0
    adrift, evaluations = start.adrift, 0
    if adrift.stage == NONE:
        adrift, evaluations = bounds_of(scene, interval, start)
    return start._replace(adrift=adrift._replace(stage=stage)), evaluations


@in_kernel
def bounds_of(scene: Scene, interval: Interval, start: RunState) -> tuple[Adrift, int]:
    """Return bounds of the exact solution by the error that an interval begins with; and evaluations."""
    touch = touch_at(interval, 0.0)
    _, _, cosine = touch.touch(start.state.height)
    rate, load, mass = cosine * start.sinking, interval.start_load / cosine, scene.mass / (cosine * cosine)
    return bounds_near(scene.modes.law, start.depth, rate, start.error, fastest_impact(start), load, mass)


@never_inlined
def watched(scene: Scene, interval: Interval, start: RunState, result: TickResult) -> TickResult:
    """Return the answer with updated bounds, if there are any, and with the errors that they allow for."""
    if start.adrift.stage == NONE:
        return result
    law, run_state, depth = scene.modes.law, result.run_state, max(result.depth, 0.0)
    drive = drive_of(scene, interval, start)
    adrift, extra = pushed(law, start.adrift, drive, depth)
    evaluations = result.evaluations + extra
    if scene.budget == 0 or evaluations + CALMING + RESERVE <= scene.budget:
        adrift, extra = calmed(law, adrift, drive.mass)
        evaluations += extra
    if adrift.stage == WATCHED:
        if depth > 0.0 and not counts(scene, run_state):
            return result._replace(run_state=run_state._replace(adrift=FOUND), evaluations=evaluations)
        impact = fastest_impact(run_state)
        near, extra = bounds_near(law, result.depth, result.rate, run_state.error, impact, drive.load, drive.mass)
        evaluations += extra
        if near.energy < adrift.energy:
            adrift = near
    limits = enclosure_of(law, adrift, drive.mass)
    return within(scene, result, adrift, limits, evaluations + limits.evaluations, math.sqrt(scene.mass / drive.mass))


@in_kernel
def within(
    scene: Scene, result: TickResult, adrift: Adrift, limits: Enclosure, evaluations: int, cosine: float
) -> TickResult:
    """Return the answer with its exact solution within limits, which may be narrow enough to continue from."""
    run_state = result.run_state
    error, held = error_within(limits, result.depth, result.rate, cosine), math.inf
    estimate = max(limits.most - result.depth, result.depth - limits.least)
    force_error = max(limits.force - result.force, result.force)
    if run_state.stiffness > 0.0:
        held = holding(run_state.stiffness, run_state.damping, scene.mass)
    if adrift.stage == LOST and limits.least > 0.0 and estimate < result.depth:
        adrift = adrift._replace(stage=WATCHED)
        run_state = run_state._replace(error=error, impact_error=max(run_state.impact_error, adrift.impact))
    elif adrift.stage == WATCHED:
        if limits.least > 0.0 and reach(error, held) < reach(run_state.error, held):
            run_state = run_state._replace(error=error)
        estimate, force_error = min(estimate, result.error_estimate), min(force_error, result.force_error_estimate)
    return result._replace(
        run_state=run_state._replace(adrift=adrift), error_estimate=estimate, force_error_estimate=force_error,
        evaluations=evaluations,
    )  # fmt: skip


@in_kernel
def lost(interval: Interval, start: RunState) -> bool:
    """Whether the error estimate does not hold from here on; see `loses`."""
    return loses(interval, start.depth, start.excess + interval.start_load, start.fidelity != DYNAMIC, start.error)


@in_kernel
def in_doubt(scene: Scene, interval: Interval, start: RunState) -> bool:
    """Whether the exact solution is lost in an interval, or may be soon, which is seldom."""
    return exceeds(start.error, NOTED * max(start.depth, 0.0)) and (lost(interval, start) or doubtful(scene, start))


@in_kernel
def counts(scene: Scene, run_state: RunState) -> bool:
    """Whether the error is significant: beyond the tolerance and not small against the depth."""
    return exceeds(run_state.error, max(NOTED * run_state.depth, scene.tolerance))


@in_kernel
def doubtful(scene: Scene, start: RunState) -> bool:
    """Whether the error may grow until the exact solution is lost; that of a simpler level does not do so by itself."""
    return start.fidelity == DYNAMIC and start.depth > 0.0 and counts(scene, start)


@in_kernel
def drive_of(scene: Scene, interval: Interval, start: RunState) -> Drive:
    """Return what moves the femur in an interval, along the normal."""
    _, begin, cosine = touch_at(interval, 0.0).touch(start.state.height)
    _, end, _ = touch_at(interval, interval.duration).touch(start.state.height)
    carried = cosine * (start.sinking + start.state.velocity)
    mass = scene.mass / (cosine * cosine)
    inertia = mass * (end - carried) / interval.duration
    first, last = interval.start_load / cosine + inertia, load_at(interval, interval.duration) / cosine + inertia
    before, least = start.adrift.load, min(first, last)
    rise, fall = max(first - before, 0.0) + max(last - first, 0.0), max(before - first, 0.0) + max(first - last, 0.0)
    return Drive(
        mass=mass, load=last, rise=rise, fall=fall, least=least, largest=max(first, last), kick=abs(begin - carried),
        duration=interval.duration,
    )  # fmt: skip


@never_inlined
def behind(scene: Scene, backlog: Backlog, result: TickResult, adrift: Adrift, give_up: bool) -> TickResult:
    """The static contact at the end of the backlog, with the errors that the femur's energy allows for until then.

    If the motion is given up, the run continues from there, else from where `advance` has come to.
    """
    run_state, law = result.run_state, scene.modes.law
    known, evaluations = adrift, result.evaluations
    interval = interval_of(scene, backlog, 0)
    if adrift.stage == NONE:
        adrift, extra = bounds_of(scene, interval, run_state)
        evaluations += extra
    drive = drive_of(scene, interval, run_state._replace(adrift=adrift))
    _, _, cosine = touch_at(interval, 0.0).touch(run_state.state.height)
    for i in range(1, int(backlog["count"])):
        following = interval_of(scene, backlog, i)
        turn = abs(following.angle_rate - interval.angle_rate) * scene.pair.largest_radius()
        interval = following
        drive = driven_on(drive, load_at(interval, interval.duration) / cosine, turn, interval.duration)
    touch, load = touch_at(interval, interval.duration), load_at(interval, interval.duration)
    near = min(max(run_state.depth, 0.0), scene.plausible_depth)
    room = ANSWER
    if scene.budget > 0:  # What bounds before this have taken is not there for the answer, which needs far less.
        room = max(1, min(ANSWER, scene.budget - evaluations - (RESERVE - ANSWER)))
    static = static_contact(law, touch, load, run_state.state.height, near, 0.0, room)
    adrift, extra = pushed(law, adrift._replace(stage=LOST), drive, static.depth)
    _, surface_rate, cosine = touch.touch(static.height)
    limits = enclosure_of(law, adrift, drive.mass)
    evaluations += extra
    if give_up:
        backlog["count"] = 0
        run_state = RunState(
            state=FemurState(static.height, surface_rate / cosine), error=EXACT, try_step=run_state.try_step,
            impact_speed=0.0, impact_error=0.0, fidelity=STANDING, stiffness=cosine * cosine * static.stiffness,
            damping=cosine * cosine * static.damping, excess=0.0, sinking=0.0, depth=static.depth, adrift=adrift,
        )  # fmt: skip
    else:
        run_state = run_state._replace(adrift=known)
    return TickResult(
        run_state=run_state, depth=static.depth, rate=0.0, force=static.force,
        error_estimate=max(limits.most - static.depth, static.depth - limits.least),
        force_error_estimate=max(limits.force - static.force, static.force),
        evaluations=evaluations + static.evaluations + limits.evaluations, reached=interval.duration, converged=False,
        height=static.height, fidelity=STANDING,
    )  # fmt: skip


@in_kernel
def driven_on(drive: Drive, load: float, kick: float, duration: float) -> Drive:
    """Return a drive that continues for a `duration` [s], to a load [N] along the normal, after a kick [m/s]."""
    change = load - drive.load
    return drive._replace(
        load=load, rise=drive.rise + max(change, 0.0), fall=drive.fall + max(-change, 0.0),
        least=min(drive.least, load), largest=max(drive.largest, load), kick=drive.kick + kick,
        duration=drive.duration + duration,
    )  # fmt: skip


@in_kernel
def fastest_impact(run_state: RunState) -> float:
    """Return the largest penetration rate [m/s] at which the contact may have begun; 0 while apart."""
    return 0.0 if math.isnan(run_state.impact_speed) else abs(run_state.impact_speed) + run_state.impact_error
