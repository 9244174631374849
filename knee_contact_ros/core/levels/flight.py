"""Ticks of a flight so far above the tibia that nothing can touch on the way: no look at the surfaces before the end.

Neither surface can come closer than the femur moves: the height by what load and velocity do, and each point of the
surface by the translation and, about the reference point, by the turn.
"""

from __future__ import annotations

import math

from knee_contact_ros.core.error_estimate import SAFETY, carry_in_flight
from knee_contact_ros.core.integrators.base import StateError
from knee_contact_ros.core.integrators.free_flight import flight, launch_rounding
from knee_contact_ros.core.kernel_source import aside, in_kernel
from knee_contact_ros.core.prescribed import Interval, load_at, touch_at
from knee_contact_ros.core.scene import DYNAMIC, Advance, Progress


@in_kernel
def flies_freely(interval: Interval, start: Progress, mass: float) -> bool:
    """Whether femur and tibia, apart at the beginning, cannot meet in the interval."""
    if not math.isnan(start.impact_speed):
        return False
    h, load = interval.duration, max(abs(interval.start_load), abs(load_at(interval, interval.duration)))
    fallen = h * (abs(start.state.velocity) + 0.5 * load * h / mass)
    carried = abs(interval.angle_rate) * h * (interval.pair.farthest() + interval.mechanism.largest_slope())
    return -start.depth > fallen + carried


@aside
def flying_tick(interval: Interval, start: Progress, mass: float, spent: int) -> Advance:
    """Fly over the interval. `spent` are the evaluations that the tick has cost already."""
    h = interval.duration
    state = flight(interval, mass, 0.0, start.state, h)
    carried = carry_in_flight(start.error, h)
    error = StateError(carried.height + launch_rounding(start.state, state), carried.velocity)
    depth, surface_rate, cosine = touch_at(interval, h).touch(state.height)
    rate = surface_rate - cosine * state.velocity
    return Advance(
        Progress(
            state, error, start.try_step, start.impact_speed, start.impact_error, DYNAMIC, 0.0, 0.0, 0.0,
            -load_at(interval, h), rate / cosine, depth,
        ),
        depth,
        rate,
        0.0,
        SAFETY * abs(error.height),
        math.nan,
        spent,
        True,
    )  # fmt: skip
