"""The quasi-static level: n_y F(δ, 0) = max(L, 0), an equation for the depth at the tick's end and nothing else."""

from __future__ import annotations

import math
from typing import NamedTuple

from knee_contact_ros.core.error_estimate import SAFETY
from knee_contact_ros.core.integrators.base import FemurState, StateError
from knee_contact_ros.core.kernel_source import aside, in_kernel
from knee_contact_ros.core.levels.deviation import Deviation, LeftOut, deviate, deviation_of_depth
from knee_contact_ros.core.prescribed import Interval, load_at, touch_at
from knee_contact_ros.core.scene import Advance, Progress, Scene, impact_of
from knee_contact_ros.core.statics import static_contact
from knee_contact_ros.core.stepping import NEWTON_SHARE
from knee_contact_ros.core.types import Fidelity

QUASI_STATIC = int(Fidelity.QUASI_STATIC)


class QuasiStatic(NamedTuple):
    """The level as a part of a scene."""

    rank: int = QUASI_STATIC

    def advance(self, scene: Scene, interval: Interval, start: Progress) -> Advance:
        """See `Level`."""
        return quasi_static_tick(scene, interval, start, 0)


@aside
def quasi_static_tick(scene: Scene, interval: Interval, start: Progress, spent: int) -> Advance:
    """The static contact at the end of an interval, in doubt by the motion that it leaves out."""
    h, load_rate = interval.duration, interval.load_rate
    begin_depth, surface_rate, cosine = touch_at(interval, 0.0).touch(start.state.height)
    begin_sinking = load_rate / start.stiffness if start.stiffness > 0.0 else 0.0
    begin_velocity = surface_rate / cosine - begin_sinking

    touch, load = touch_at(interval, h), load_at(interval, h)
    near = max(0.0, begin_depth + cosine * begin_sinking * h)
    resolution = NEWTON_SHARE * scene.tolerance
    static = static_contact(scene.regions.law, touch, load, start.state.height, near, resolution)
    _, surface_rate, cosine = touch.touch(static.height)
    stiffness, damping = cosine * cosine * static.stiffness, cosine * cosine * static.damping
    sinking = load_rate / stiffness if stiffness > 0.0 else 0.0
    velocity = surface_rate / cosine - sinking

    mean_damping = 0.5 * (start.damping + damping)
    left_out = LeftOut(
        0.5 * (start.stiffness + stiffness),
        mean_damping,
        (velocity - begin_velocity) / h,
        mean_damping * 0.5 * (begin_sinking + sinking),
        load_at(interval, 0.0),
        load,
        static.depth / cosine,
    )
    impact_speed, impact_error = impact_of(start)
    deviation = deviate(deviation_at_start(start, begin_velocity), left_out, scene.mass, h)
    error = deviation_of_depth(deviation, stiffness, damping, scene.mass)
    return Advance(
        Progress(
            FemurState(static.height, velocity), deviation.state, math.inf, impact_speed, impact_error, QUASI_STATIC,
            deviation.unrest,
            stiffness, damping, damping * sinking, sinking, static.depth,
        ),
        static.depth,
        cosine * sinking,
        static.force,
        SAFETY * error,
        math.nan,
        spent + static.evaluations,
        True,
    )  # fmt: skip


@in_kernel
def deviation_at_start(start: Progress, velocity: float) -> Deviation:
    """Deviation of this level at a tick's beginning, where it has a `velocity` [m/s].

    The state there may be another level's: its elastic force tells how far it is from the static one.
    """
    lag = (start.excess - start.damping * start.sinking) / start.stiffness if start.stiffness > 0.0 else 0.0
    error = StateError(lag + start.error.height, velocity - start.state.velocity + start.error.velocity)
    return Deviation(error, start.unrest)
