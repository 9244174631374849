"""Ticks of a flight so high above the tibia that nothing can touch: the surfaces are evaluated only at the end.

The surfaces come closer by no more than the femur moves: its height by load and velocity, and each point of its
surface by the translation and by the rotation about the reference point.
"""

from __future__ import annotations

import math

from knee_contact_ros.core.error_estimate import bounded, propagated_in_flight, reach, with_bound
from knee_contact_ros.core.integrators.free_flight import flight, launch_rounding
from knee_contact_ros.core.kernel_source import in_kernel, never_inlined
from knee_contact_ros.core.prescribed import Interval, load_at, touch_at
from knee_contact_ros.core.scene import DYNAMIC, RunState, TickResult

AIRBORNE = 1.25
"""Safety factor on the published error of a flight: it is that of one velocity, and not a mean over many steps"""


@in_kernel
def flies_freely(interval: Interval, start: RunState, mass: float) -> bool:
    """Whether femur and tibia are apart at the beginning of the interval and cannot meet in it."""
    if not math.isnan(start.impact_speed):
        return False
    h, load = interval.duration, max(abs(interval.start_load), abs(load_at(interval, interval.duration)))
    fallen = h * (abs(start.state.velocity) + 0.5 * load * h / mass)
    carried = abs(interval.angle_rate) * h * (interval.pair.largest_radius() + interval.mechanism.largest_slope())
    return -start.depth > fallen + carried


@never_inlined
def flying_tick(interval: Interval, start: RunState, mass: float, spent: int) -> TickResult:
    """Carry the femur in free flight over the interval; `spent` is the number of evaluations taken so far."""
    h = interval.duration
    state = flight(interval, mass, 0.0, start.state, h)
    error = bounded(with_bound(propagated_in_flight(start.error, h), launch_rounding(start.state, state), 0.0))
    depth, surface_rate, cosine = touch_at(interval, h).touch(state.height)
    rate = surface_rate - cosine * state.velocity
    return TickResult(
        run_state=start._replace(
            state=state, error=error, fidelity=DYNAMIC, stiffness=0.0, damping=0.0, excess=-load_at(interval, h),
            sinking=rate / cosine, depth=depth,
        ),
        depth=depth, rate=rate, force=0.0, error_estimate=AIRBORNE * reach(error, math.inf), force_error_estimate=0.0,
        evaluations=spent, reached=h, converged=True, height=state.height, fidelity=DYNAMIC,
    )  # fmt: skip
