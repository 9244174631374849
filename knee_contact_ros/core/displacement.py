"""The displacement drive: the femoral height is prescribed, linear in time between two ticks, and the force follows."""

from __future__ import annotations

import math
from collections.abc import Callable

from knee_contact_ros.core.dynamics import Advance, Progress
from knee_contact_ros.core.integrators.base import NO_ERROR, FemurState
from knee_contact_ros.core.prescribed import Interval
from knee_contact_ros.core.regions import Regions

MAX_LOCATE = 60
"""Tries to find the moment of touch."""


def follow(regions: Regions, interval: Interval, start: Progress, end_height: float) -> Advance:
    """The contact at the end of an interval in which the height goes from the last one to `end_height` [m].

    Exact: pose and velocity are prescribed. A law that remembers its impact speed gets the one at the touch inside the
    interval, if femur and tibia were apart at its beginning.
    """
    velocity = (end_height - start.state.height) / interval.duration

    def contact(s: float) -> tuple[float, float]:
        depth, rate, cosine = interval.touch(s)(start.state.height + velocity * s)
        return depth, rate - cosine * velocity

    depth, rate = contact(interval.duration)
    impact_speed = start.impact_speed
    if depth <= 0.0:
        impact_speed = None
    elif impact_speed is None:
        impact_speed = contact(_moment_of_touch(lambda s: contact(s)[0], interval.duration))[1]
    state = FemurState(end_height, velocity)
    return contact_at(regions.after_impact(impact_speed or 0.0), state, depth, rate, impact_speed)


def contact_at(regions: Regions, state: FemurState, depth: float, rate: float, impact_speed: float | None) -> Advance:
    """The contact in a prescribed state."""
    force = 0.0
    if depth > 0.0:
        formula = regions.law.layers[sum(1 for layer in regions.law.layers if layer.begin < depth) - 1].force
        force = formula(depth, rate)[0]
    return Advance(
        progress=Progress(state, NO_ERROR, math.inf, impact_speed),
        depth=depth,
        rate=rate,
        force=force if regions.allow_tension else max(force, 0.0),
        error_estimate=0.0,
        evaluations=int(depth > 0.0),
        dynamic=True,
    )


def _moment_of_touch(depth: Callable[[float], float], duration: float) -> float:
    """When the depth [m] turns positive in an interval at whose end it is (bisection to rounding)."""
    low, high = 0.0, duration
    for _ in range(MAX_LOCATE):
        middle = 0.5 * (low + high)
        if not low < middle < high:
            break
        low, high = (low, middle) if depth(middle) > 0.0 else (middle, high)
    return high
