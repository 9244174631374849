"""Ticks whose motion could not be resolved within their budget: their rest is done in the next ones.

A run then lies behind its stamps. Its answers are static ones, in doubt by all that the femur's energy allows since
where the motion has come to; nothing is lost, and once the run has caught up nothing is in doubt any more. A run that
falls behind by more than `MOST` ticks, or does not move at all, gives the motion up: it goes on from the static
contact, lost (`adrift.py`) until that has been forgotten.
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
    Range,
    bounds_near,
    calmed,
    error_within,
    exceeds,
    loses,
    pushed,
    range_of,
)
from knee_contact_ros.core.error_estimate import EXACT, CarriedError, holding, reach
from knee_contact_ros.core.integrators.base import FemurState
from knee_contact_ros.core.kernel_source import aside, in_kernel
from knee_contact_ros.core.prescribed import Interval, load_at, touch_at
from knee_contact_ros.core.scene import DYNAMIC, Advance, Progress, Scene
from knee_contact_ros.core.statics import ANSWER, static_contact
from knee_contact_ros.core.types import Fidelity

MOST = 16
"""Ticks that a run may lie behind"""
BACKLOG = np.dtype([
    ("count", np.int64), ("moved", np.int64), ("angle", np.float64), ("load", np.float64),
    ("durations", np.float64, (MOST + 1,)), ("angles", np.float64, (MOST + 1,)), ("loads", np.float64, (MOST + 1,)),
])  # fmt: skip
"""How many intervals are to be done, and whether the tick has come forward; angle [rad] and load [N] where the motion
has come to; every interval's duration [s], and angle and load at its end"""
Backlog = Any
"""A record of `BACKLOG`"""
STANDING = int(Fidelity.QUASI_STATIC)
"""The level of such an answer"""


@aside
def take_on(scene: Scene, backlog: Backlog, start: Progress, last: Interval) -> tuple[Interval, Progress, int]:
    """Add an interval to the backlog; return its first one, the progress that it begins with, and the evaluations."""
    count = int(backlog["count"])
    if count == 0:
        backlog["angle"], backlog["load"] = last.angle, last.start_load
    backlog["durations"][count] = last.duration
    backlog["angles"][count] = last.angle + last.angle_rate * last.duration
    backlog["loads"][count] = load_at(last, last.duration)
    backlog["count"], backlog["moved"] = count + 1, 0
    interval = interval_of(scene, backlog, 0)
    progress, evaluations = looked_after(scene, interval, start)
    return interval, progress, evaluations


@aside
def work_off(
    scene: Scene, backlog: Backlog, interval: Interval, start: Progress, advance: Advance
) -> tuple[Advance, bool]:
    """What a level has made of the backlog's first interval; and whether another one is to be done in this tick.

    If there is not, the answer is that of the tick.
    """
    if backlog["count"] == 0:
        take_on(scene, backlog, start, interval)
    count = int(backlog["count"])
    durations, angles, loads = backlog["durations"], backlog["angles"], backlog["loads"]
    if not advance.converged:
        moved = backlog["moved"] > 0 or advance.reached > 0.0
        backlog["angle"] = interval.angle + interval.angle_rate * advance.reached
        backlog["load"] = load_at(interval, advance.reached)
        durations[0] = interval.duration - advance.reached
        return behind(scene, backlog, advance, start.adrift, count > MOST or not moved), False
    advance = watched(scene, interval, start, advance)
    backlog["angle"], backlog["load"] = angles[0], loads[0]
    for i in range(count - 1):
        durations[i], angles[i], loads[i] = durations[i + 1], angles[i + 1], loads[i + 1]
    backlog["count"], backlog["moved"] = count - 1, 1
    if count == 1:
        return advance, False
    if scene.budget > 0 and advance.evaluations >= scene.budget - RESERVE:
        return behind(scene, backlog, advance, advance.progress.adrift, count - 1 > MOST), False
    progress, evaluations = looked_after(scene, interval_of(scene, backlog, 0), advance.progress)
    return gone_on(advance, progress, evaluations), True


@in_kernel
def interval_of(scene: Scene, backlog: Backlog, index: int) -> Interval:
    """An interval by its index: each begins where the motion has come to when it is next to be done."""
    angle, load = float(backlog["angle"]), float(backlog["load"])
    if index > 0:
        angle, load = float(backlog["angles"][index - 1]), float(backlog["loads"][index - 1])
    duration = float(backlog["durations"][index])
    return Interval(
        scene.pair, scene.mechanism, duration, angle, (float(backlog["angles"][index]) - angle) / duration, load,
        (float(backlog["loads"][index]) - load) / duration, float("nan"),
    )  # fmt: skip


@in_kernel
def looked_after(scene: Scene, interval: Interval, start: Progress) -> tuple[Progress, int]:
    """The progress that an interval begins with: bounded where the exact solution is lost from here on, or may be soon.

    The second number is that of evaluations.
    """
    stage = LOST if lost(interval, start) else WATCHED
    if start.adrift.stage >= stage or (start.adrift.stage == NONE and stage == WATCHED and not doubtful(scene, start)):
        return start, 0
    adrift, evaluations = start.adrift, 0
    if adrift.stage == NONE:
        adrift, evaluations = bounds_of(scene, interval, start)
    return with_bounds(start, at_stage(adrift, stage)), evaluations


@in_kernel
def bounds_of(scene: Scene, interval: Interval, start: Progress) -> tuple[Adrift, int]:
    """Bounds by the error that an interval begins with; and evaluations."""
    touch = touch_at(interval, 0.0)
    _, _, cosine = touch.touch(start.state.height)
    rate, load, mass = cosine * start.sinking, interval.start_load / cosine, scene.mass / (cosine * cosine)
    return bounds_near(scene.regions.law, start.depth, rate, start.error, fastest_impact(start), load, mass)


@aside
def watched(scene: Scene, interval: Interval, start: Progress, advance: Advance) -> Advance:
    """An answer with what is left to know where the exact solution has been lost, or may be soon."""
    if start.adrift.stage == NONE:
        return advance
    law, progress, depth = scene.regions.law, advance.progress, max(advance.depth, 0.0)
    drive = drive_of(scene, interval, start)
    adrift, looks = pushed(law, start.adrift, drive, depth)
    evaluations = advance.evaluations + looks
    if scene.budget == 0 or evaluations + CALMING + RESERVE <= scene.budget:
        adrift, looks = calmed(law, adrift, drive.mass)
        evaluations += looks
    if adrift.stage == WATCHED:
        if depth > 0.0 and not counts(scene, progress):
            return gone_on(advance, with_bounds(progress, FOUND), evaluations - advance.evaluations)
        impact = fastest_impact(progress)
        near, looks = bounds_near(law, advance.depth, advance.rate, progress.error, impact, drive.load, drive.mass)
        evaluations += looks
        if near.energy < adrift.energy:
            adrift = near
    limits = range_of(law, adrift, drive.mass)
    return within(scene, advance, adrift, limits, evaluations + limits.evaluations, math.sqrt(scene.mass / drive.mass))


@in_kernel
def within(scene: Scene, advance: Advance, adrift: Adrift, limits: Range, evaluations: int, cosine: float) -> Advance:
    """An answer whose exact solution lies within limits, by which it may be found again."""
    progress = advance.progress
    error, held = error_within(limits, advance.depth, advance.rate, cosine), math.inf
    estimate = max(limits.most - advance.depth, advance.depth - limits.least)
    force_error = max(limits.force - advance.force, advance.force)
    if progress.stiffness > 0.0:
        held = holding(progress.stiffness, progress.damping, scene.mass)
    if adrift.stage == LOST and limits.least > 0.0 and estimate < advance.depth:
        adrift, progress = at_stage(adrift, WATCHED), with_error(progress, error, adrift.impact)
    elif adrift.stage == WATCHED:
        if limits.least > 0.0 and reach(error, held) < reach(progress.error, held):
            progress = with_error(progress, error, 0.0)
        estimate, force_error = min(estimate, advance.error_estimate), min(force_error, advance.force_error_estimate)
    return Advance(
        with_bounds(progress, adrift), advance.depth, advance.rate, advance.force, estimate, force_error, evaluations,
        advance.reached, True, advance.height, advance.fidelity,
    )  # fmt: skip


@in_kernel
def lost(interval: Interval, start: Progress) -> bool:
    """Whether the exact solution may be anywhere from here on; see `loses`."""
    return loses(interval, start.depth, start.excess + interval.start_load, start.fidelity != DYNAMIC, start.error)


@in_kernel
def in_doubt(scene: Scene, interval: Interval, start: Progress) -> bool:
    """Whether the exact solution is lost in an interval, or may be soon: seldom."""
    return exceeds(start.error, NOTED * max(start.depth, 0.0)) and (lost(interval, start) or doubtful(scene, start))


@in_kernel
def counts(scene: Scene, progress: Progress) -> bool:
    """Whether the error is no small part of the depth."""
    return exceeds(progress.error, max(NOTED * progress.depth, scene.tolerance))


@in_kernel
def doubtful(scene: Scene, start: Progress) -> bool:
    """Whether the error may grow into one that is lost; that of a simpler level does not do so by itself."""
    return start.fidelity == DYNAMIC and start.depth > 0.0 and counts(scene, start)


@in_kernel
def drive_of(scene: Scene, interval: Interval, start: Progress) -> Drive:
    """What moves the femur in an interval."""
    _, begin, cosine = touch_at(interval, 0.0).touch(start.state.height)
    _, end, _ = touch_at(interval, interval.duration).touch(start.state.height)
    carried = cosine * (start.sinking + start.state.velocity)
    mass = scene.mass / (cosine * cosine)
    inertia = mass * (end - carried) / interval.duration
    first, last = interval.start_load / cosine + inertia, load_at(interval, interval.duration) / cosine + inertia
    before, least = start.adrift.load, min(first, last)
    rise, fall = max(first - before, 0.0) + max(last - first, 0.0), max(before - first, 0.0) + max(first - last, 0.0)
    return Drive(mass, last, rise, fall, least, max(first, last), abs(begin - carried), interval.duration)


@aside
def behind(scene: Scene, backlog: Backlog, advance: Advance, adrift: Adrift, give_up: bool) -> Advance:
    """The static contact at the end of the backlog, in doubt by all that the femur's energy allows until then.

    If the motion is given up the run goes on from there, else from where `advance` has come to.
    """
    progress, law = advance.progress, scene.regions.law
    known, evaluations = adrift, advance.evaluations
    interval = interval_of(scene, backlog, 0)
    if adrift.stage == NONE:
        adrift, looks = bounds_of(scene, interval, progress)
        evaluations += looks
    drive = drive_of(scene, interval, with_bounds(progress, adrift))
    _, _, cosine = touch_at(interval, 0.0).touch(progress.state.height)
    for i in range(1, int(backlog["count"])):
        following = interval_of(scene, backlog, i)
        turn = abs(following.angle_rate - interval.angle_rate) * scene.pair.farthest()
        interval = following
        drive = driven_on(drive, load_at(interval, interval.duration) / cosine, turn, interval.duration)
    touch, load = touch_at(interval, interval.duration), load_at(interval, interval.duration)
    near = min(max(progress.depth, 0.0), scene.plausible_depth)
    static = static_contact(law, touch, load, progress.state.height, near, 0.0, ANSWER)
    adrift, looks = pushed(law, at_stage(adrift, LOST), drive, static.depth)
    _, surface_rate, cosine = touch.touch(static.height)
    limits = range_of(law, adrift, drive.mass)
    evaluations += looks
    if give_up:
        backlog["count"] = 0
        progress = Progress(
            FemurState(static.height, surface_rate / cosine), EXACT, progress.try_step, 0.0, 0.0, STANDING,
            cosine * cosine * static.stiffness, cosine * cosine * static.damping, 0.0, 0.0, static.depth, adrift,
        )  # fmt: skip
    else:
        progress = with_bounds(progress, known)
    return Advance(
        progress,
        static.depth,
        0.0,
        static.force,
        max(limits.most - static.depth, static.depth - limits.least),
        max(limits.force - static.force, static.force),
        evaluations + static.evaluations + limits.evaluations,
        interval.duration,
        False,
        static.height,
        STANDING,
    )


@in_kernel
def driven_on(drive: Drive, load: float, kick: float, duration: float) -> Drive:
    """A drive that goes on for a `duration` [s], up to a load [N] along the normal, after a kick [m/s]."""
    change = load - drive.load
    return Drive(
        drive.mass, load, drive.rise + max(change, 0.0), drive.fall + max(-change, 0.0), min(drive.least, load),
        max(drive.largest, load), drive.kick + kick, drive.duration + duration,
    )  # fmt: skip


@in_kernel
def at_stage(adrift: Adrift, stage: float) -> Adrift:
    """Bounds at another stage."""
    return Adrift(
        stage, adrift.energy, adrift.height, adrift.load, adrift.rest, adrift.stored, adrift.pressed, adrift.least,
        adrift.begun, adrift.impact,
    )  # fmt: skip


@in_kernel
def with_bounds(progress: Progress, adrift: Adrift) -> Progress:
    """A progress with other bounds of the exact solution."""
    return Progress(
        progress.state, progress.error, progress.try_step, progress.impact_speed, progress.impact_error,
        progress.fidelity, progress.stiffness, progress.damping, progress.excess, progress.sinking, progress.depth,
        adrift,
    )  # fmt: skip


@in_kernel
def with_error(progress: Progress, error: CarriedError, impact: float) -> Progress:
    """A progress with another error, and a contact that may have begun at up to `impact` [m/s]."""
    return Progress(
        progress.state, error, progress.try_step, progress.impact_speed, max(progress.impact_error, impact),
        progress.fidelity, progress.stiffness, progress.damping, progress.excess, progress.sinking, progress.depth,
        progress.adrift,
    )  # fmt: skip


@in_kernel
def fastest_impact(progress: Progress) -> float:
    """Largest rate [m/s] at which the contact may have begun; 0 while apart."""
    return 0.0 if math.isnan(progress.impact_speed) else abs(progress.impact_speed) + progress.impact_error


@in_kernel
def gone_on(advance: Advance, progress: Progress, evaluations: int) -> Advance:
    """An answer with another progress, and more evaluations."""
    return Advance(
        progress, advance.depth, advance.rate, advance.force, advance.error_estimate, advance.force_error_estimate,
        advance.evaluations + evaluations, advance.reached, advance.converged, advance.height, advance.fidelity,
    )  # fmt: skip
