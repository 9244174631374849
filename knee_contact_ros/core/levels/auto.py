"""The level that each tick picks by itself: the cheapest one that meets the tolerance, by estimates alone.

What a simpler level would leave out is foreseen from the slopes of the contact at the end of the last tick, at no
evaluation; only a level that promises enough is computed, and only if its own estimate then agrees is it the answer.
To a simpler level than the last tick's it goes only well inside the tolerance, so that it does not go to and fro.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from knee_contact_ros.core.error_estimate import SAFETY, swiftness
from knee_contact_ros.core.kernel_source import in_kernel
from knee_contact_ros.core.levels.dynamic import DYNAMIC, dynamic_tick
from knee_contact_ros.core.levels.first_order import FIRST_ORDER, first_order_tick
from knee_contact_ros.core.levels.quasi_static import QUASI_STATIC, quasi_static_tick
from knee_contact_ros.core.prescribed import Interval, load_at, stretch_from
from knee_contact_ros.core.scene import Advance, Progress, Scene
from knee_contact_ros.core.stepping import EXPLICIT, MOST_EXPLICIT

DESCEND = 0.25
"""Part of the tolerance within which a simpler level must promise to be, to be gone down to"""


class Auto(NamedTuple):
    """The level as a part of a scene."""

    rank: int = DYNAMIC

    def advance(self, scene: Scene, interval: Interval, start: Progress) -> Advance:
        """See `Level`."""
        return auto_tick(scene, interval, start)


@in_kernel
def auto_tick(scene: Scene, interval: Interval, start: Progress) -> Advance:
    """Carry the femur over the interval by the cheapest level that meets the tolerance."""
    spent = 0
    if bumpy(interval):
        return dynamic_tick(scene, interval, start, spent)
    allowed = allowed_for(scene, start, QUASI_STATIC)
    if SAFETY * quasi_static_leaves_out(scene, interval, start) <= allowed:
        advance = quasi_static_tick(scene, interval, start, spent)
        if advance.error_estimate <= allowed:
            return advance
        spent = advance.evaluations
    if dynamic_is_stiff(scene, interval, start):
        allowed = allowed_for(scene, start, FIRST_ORDER)
        if SAFETY * first_order_leaves_out(scene, interval, start) <= allowed:
            advance = first_order_tick(scene, interval, start, spent)
            if advance.converged and advance.error_estimate <= allowed:
                return advance
            spent = advance.evaluations
    return dynamic_tick(scene, interval, start, spent)


@in_kernel
def bumpy(interval: Interval) -> bool:
    """Whether the contact goes over bumps within the tick, which the simpler levels see at its ends only."""
    until, _ = stretch_from(interval, 0.0)
    return until < interval.duration or abs(interval.angle_rate) * interval.duration > interval.pair.grain()


@in_kernel
def allowed_for(scene: Scene, start: Progress, level: int) -> float:
    """Estimated error [m] up to which a level may answer."""
    return scene.tolerance if start.fidelity <= level else DESCEND * scene.tolerance


@in_kernel
def quasi_static_leaves_out(scene: Scene, interval: Interval, start: Progress) -> float:
    """Depth [m] by which the quasi-static level is foreseen to be wrong; infinite where that cannot be told."""
    if start.stiffness <= 0.0 or lets_go(interval):
        return math.inf
    speed = abs(interval.load_rate) / start.stiffness
    dashpot = start.damping * speed / start.stiffness
    swing = speed * math.sqrt(scene.mass / start.stiffness)
    return abs(start.error.height) + start.unrest + max(dashpot, min(swing, speed * interval.duration))


@in_kernel
def first_order_leaves_out(scene: Scene, interval: Interval, start: Progress) -> float:
    """Depth [m] by which the first-order level is foreseen to be wrong; infinite where inertia makes the knee swing."""
    if start.damping * start.damping <= 4.0 * start.stiffness * scene.mass or lets_go(interval):
        return math.inf
    inertia = scene.mass * abs(start.excess) / (start.damping * start.damping)
    return abs(start.error.height) + start.unrest + inertia


@in_kernel
def lets_go(interval: Interval) -> bool:
    """Whether the load lets the contact go in a tick: only the dynamic level flies."""
    return interval.start_load <= 0.0 or load_at(interval, interval.duration) <= 0.0


@in_kernel
def dynamic_is_stiff(scene: Scene, interval: Interval, start: Progress) -> bool:
    """Whether the dynamic level would need implicit steps, which cost more than those of the first-order level."""
    swift = swiftness(start.stiffness, start.damping, scene.mass)
    return swift * interval.duration > EXPLICIT * MOST_EXPLICIT
