"""Ticks whose motion could not be resolved within their budget: their rest is done in the next ones.

A run then lies behind its stamps. Its answers are static ones, in doubt by all that the femur's energy allows since
where the motion has come to; nothing is lost, and once the run has caught up nothing is in doubt any more. A run that
falls behind by more than `MOST` ticks, or does not move at all, gives the motion up: it goes on from the static
contact, adrift (`adrift.py`) until that has provably been forgotten.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.core.adrift import (
    FOUND,
    RESERVE,
    Adrift,
    calmed,
    error_near,
    found_again,
    loses,
    pushed,
    range_of,
    set_adrift,
)
from knee_contact_ros.core.contact_laws.base import static_force
from knee_contact_ros.core.error_estimate import EXACT, CarriedError, force_reach, holding, reach
from knee_contact_ros.core.integrators.base import FemurState
from knee_contact_ros.core.kernel_source import aside, in_kernel
from knee_contact_ros.core.prescribed import Interval, load_at, touch_at
from knee_contact_ros.core.scene import DYNAMIC, Advance, Progress, Scene
from knee_contact_ros.core.statics import ANSWER, static_contact
from knee_contact_ros.core.types import Fidelity

Floats = NDArray[np.float64]

MOST = 16
"""Ticks that a run may lie behind"""
MOVED = 3 * (MOST + 2)
"""Where it stands whether the tick has come forward"""
SIZE = MOVED + 1
"""Numbers of a backlog: how many intervals, angle and load where the motion has come to; duration, angle and load at
the end of each; and the one above
"""
STANDING = int(Fidelity.QUASI_STATIC)
"""The level of such an answer"""


@aside
def take_on(scene: Scene, backlog: Floats, start: Progress, last: Interval) -> tuple[Interval, Progress, int]:
    """Add an interval to the backlog; return its first one, the progress that it begins with, and the evaluations."""
    count = int(backlog[0]) + 1
    if count == 1:
        backlog[1], backlog[2] = last.angle, last.start_load
    backlog[0], backlog[3 * count] = count, last.duration
    backlog[3 * count + 1] = last.angle + last.angle_rate * last.duration
    backlog[3 * count + 2] = load_at(last, last.duration)
    backlog[MOVED] = 0.0
    interval = interval_of(scene, backlog, 0)
    progress, evaluations = looked_after(scene, interval, start)
    return interval, progress, evaluations


@aside
def work_off(
    scene: Scene, backlog: Floats, interval: Interval, start: Progress, advance: Advance
) -> tuple[Advance, bool]:
    """What a level has made of the backlog's first interval; and whether another one is to be done in this tick.

    If there is not, the answer is that of the tick.
    """
    if float(backlog[0]) == 0.0:
        take_on(scene, backlog, start, interval)
    count = int(backlog[0])
    if not advance.converged:
        moved = float(backlog[MOVED]) > 0.0 or advance.reached > 0.0
        backlog[1] = interval.angle + interval.angle_rate * advance.reached
        backlog[2] = load_at(interval, advance.reached)
        backlog[3] = interval.duration - advance.reached
        return behind(scene, backlog, advance, start.adrift, count > MOST or not moved), False
    advance = watched(scene, interval, start, advance)
    backlog[1], backlog[2] = float(backlog[4]), float(backlog[5])
    for i in range(3, 3 * count):
        backlog[i] = backlog[i + 3]
    backlog[0], backlog[MOVED] = count - 1, 1.0
    if count == 1:
        return advance, False
    if scene.budget > 0 and advance.evaluations >= scene.budget - RESERVE:
        return behind(scene, backlog, advance, advance.progress.adrift, count - 1 > MOST), False
    progress, evaluations = looked_after(scene, interval_of(scene, backlog, 0), advance.progress)
    return gone_on(advance, progress, evaluations), True


@in_kernel
def interval_of(scene: Scene, backlog: Floats, index: int) -> Interval:
    """One of the intervals: the first begins where the motion has come to, and so does each that is next to be done."""
    angle, load = float(backlog[1]), float(backlog[2])
    if index > 0:
        angle, load = float(backlog[3 * index + 1]), float(backlog[3 * index + 2])
    duration = float(backlog[3 * index + 3])
    return Interval(
        scene.pair, scene.mechanism, duration, angle, (float(backlog[3 * index + 4]) - angle) / duration, load,
        (float(backlog[3 * index + 5]) - load) / duration, float("nan"),
    )  # fmt: skip


@in_kernel
def looked_after(scene: Scene, interval: Interval, start: Progress) -> tuple[Progress, int]:
    """The progress that an interval begins with: adrift where the exact solution may be anywhere from here on.

    The second number is that of evaluations.
    """
    if start.adrift.energy > 0.0 or not lost(interval, start):
        return start, 0
    elastic, _, _ = static_force(scene.regions.law, start.depth)
    adrift = set_adrift(start.depth, start.sinking, elastic, interval.start_load, start.error, scene.mass)
    return with_bounds(start, adrift), 1 if start.depth > 0.0 else 0


@aside
def watched(scene: Scene, interval: Interval, start: Progress, advance: Advance) -> Advance:
    """The same answer, with what is left to know where the exact solution has been lost."""
    if start.adrift.energy == 0.0:
        return advance
    adrift = pushed(interval, start.adrift, kick_of(interval, start), scene.mass)
    load = load_at(interval, interval.duration)
    adrift, evaluations = calmed(scene.regions, min(load, interval.start_load), adrift, scene.mass)
    depth, evaluations = max(advance.depth, 0.0), evaluations + advance.evaluations
    progress = advance.progress
    if found_again(adrift, depth, load):
        held = holding(progress.stiffness, progress.damping, scene.mass)
        error = error_near(depth, held)
        force_error = force_reach(error, progress.stiffness, progress.damping, 0.0, held)
        return Advance(
            with_error(with_bounds(progress, FOUND), error), advance.depth, advance.rate, advance.force,
            reach(error, held), max(force_error, advance.force), evaluations, advance.reached, True,
            advance.height, advance.fidelity,
        )  # fmt: skip
    limits = range_of(scene.regions, interval, adrift, depth, scene.mass)
    return Advance(
        with_bounds(progress, adrift),
        advance.depth,
        advance.rate,
        advance.force,
        max(limits.depth - advance.depth, advance.depth + limits.height),
        max(limits.force - advance.force, advance.force),
        evaluations + limits.evaluations,
        advance.reached,
        True,
        advance.height,
        advance.fidelity,
    )


@in_kernel
def lost(interval: Interval, start: Progress) -> bool:
    """Whether the exact solution may be anywhere from here on; see `loses`."""
    return loses(interval, start.depth, start.excess + interval.start_load, start.fidelity != DYNAMIC, start.error)


@in_kernel
def kick_of(interval: Interval, start: Progress) -> float:
    """Change [m/s] of the rate at which the surface carries the femur: at the interval's beginning, and within it."""
    _, begin, cosine = touch_at(interval, 0.0).touch(start.state.height)
    _, end, _ = touch_at(interval, interval.duration).touch(start.state.height)
    return abs(begin / cosine - start.sinking - start.state.velocity) + abs(end - begin) / cosine


@aside
def behind(scene: Scene, backlog: Floats, advance: Advance, adrift: Adrift, give_up: bool) -> Advance:
    """The static contact at the end of the backlog, in doubt by all that the femur's energy allows until then.

    If the motion is given up the run goes on from there, else from where `advance` has come to.
    """
    progress, law = advance.progress, scene.regions.law
    known, evaluations = adrift, advance.evaluations
    if adrift.energy == 0.0:
        elastic, _, _ = static_force(law, progress.depth)
        evaluations += 1 if progress.depth > 0.0 else 0
        adrift = set_adrift(progress.depth, progress.sinking, elastic, float(backlog[2]), progress.error, scene.mass)
    interval = interval_of(scene, backlog, 0)
    adrift = pushed(interval, adrift, kick_of(interval, progress), scene.mass)
    for i in range(1, int(backlog[0])):
        following = interval_of(scene, backlog, i)
        turn = abs(following.angle_rate - interval.angle_rate) * scene.pair.farthest()
        interval = following
        adrift = pushed(interval, adrift, turn, scene.mass)
    touch, load = touch_at(interval, interval.duration), load_at(interval, interval.duration)
    near = max(progress.depth, 0.0)
    static = static_contact(law, touch, load, progress.state.height, near, 0.0, ANSWER)
    _, surface_rate, cosine = touch.touch(static.height)
    limits = range_of(scene.regions, interval, adrift, static.depth, scene.mass)
    if give_up:
        backlog[0] = 0
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
        max(limits.depth - static.depth, static.depth + limits.height),
        max(limits.force - static.force, static.force),
        evaluations + static.evaluations + limits.evaluations,
        interval.duration,
        False,
        static.height,
        STANDING,
    )


@in_kernel
def with_bounds(progress: Progress, adrift: Adrift) -> Progress:
    """The same progress with other bounds of the exact solution."""
    return Progress(
        progress.state, progress.error, progress.try_step, progress.impact_speed, progress.impact_error,
        progress.fidelity, progress.stiffness, progress.damping, progress.excess, progress.sinking, progress.depth,
        adrift,
    )  # fmt: skip


@in_kernel
def with_error(progress: Progress, error: CarriedError) -> Progress:
    """The same progress with another error."""
    return Progress(
        progress.state, error, progress.try_step, progress.impact_speed, progress.impact_error, progress.fidelity,
        progress.stiffness, progress.damping, progress.excess, progress.sinking, progress.depth, progress.adrift,
    )  # fmt: skip


@in_kernel
def gone_on(advance: Advance, progress: Progress, evaluations: int) -> Advance:
    """The same answer with another progress, and more evaluations."""
    return Advance(
        progress, advance.depth, advance.rate, advance.force, advance.error_estimate, advance.force_error_estimate,
        advance.evaluations + evaluations, advance.reached, advance.converged, advance.height, advance.fidelity,
    )  # fmt: skip
