"""The displacement drive: the femoral height is prescribed, linear in time between two ticks, and the force follows."""

from __future__ import annotations

import math

from knee_contact_ros.core.kernel_source import in_kernel
from knee_contact_ros.core.prescribed import Interval, touch_at
from knee_contact_ros.core.scene import RunState, Scene, TickResult, at_height

MOST_BISECTIONS = 60
"""Largest number of bisections to find the time of touch."""


@in_kernel
def follow(scene: Scene, interval: Interval, start: RunState) -> TickResult:
    """Return the contact at the end of an interval in which the height changes linearly to the prescribed one.

    It is exact: pose and velocity are prescribed. A law that depends on the impact speed is given that of the touch
    inside the interval, if femur and tibia were apart at its beginning.
    """
    height = start.state.height
    velocity = (interval.end_height - height) / interval.duration
    depth, rate = contact_on_way(interval, height, velocity, interval.duration)
    impact_speed = start.impact_speed
    if depth <= 0.0:
        impact_speed = math.nan
    elif math.isnan(impact_speed):
        touched = moment_of_touch(interval, height, velocity)
        _, impact_speed = contact_on_way(interval, height, velocity, touched)
    return at_height(scene, interval.end_height, velocity, depth, rate, impact_speed)


@in_kernel
def contact_on_way(interval: Interval, height: float, velocity: float, s: float) -> tuple[float, float]:
    """The depth [m] and its rate [m/s] at s [s] for a motion from `height` [m] with constant `velocity` [m/s]."""
    depth, rate, cosine = touch_at(interval, s).touch(height + velocity * s)
    return depth, rate - cosine * velocity


@in_kernel
def moment_of_touch(interval: Interval, height: float, velocity: float) -> float:
    """Return the time [s] at which the depth becomes positive, which it is at the interval's end (bisection)."""
    low, high = 0.0, interval.duration
    for _ in range(MOST_BISECTIONS):
        middle = 0.5 * (low + high)
        if not low < middle < high:
            break
        depth, _ = contact_on_way(interval, height, velocity, middle)
        if depth > 0.0:
            high = middle
        else:
            low = middle
    return high
