"""A tick at its level: the requested one or, with `AUTO`, the cheapest one that meets the tolerance.

That level is picked by error estimates alone. What a simpler level would leave out is predicted from the slopes of the
contact at the end of the last tick, without an evaluation. A level is computed only if its predicted error is small
enough, and its result is the answer only if its own estimate confirms that. What a simpler level has left out is the
error that the next tick begins with, at whichever level.
"""

from __future__ import annotations

import math

from knee_contact_ros.core.contact_laws.base import layer_at
from knee_contact_ros.core.error_estimate import EXPECTED, HORIZON, decay_rate, spectral_radius
from knee_contact_ros.core.kernel_source import always_inlined, in_kernel
from knee_contact_ros.core.levels.dynamic import dynamic_tick
from knee_contact_ros.core.levels.first_order import first_order_tick
from knee_contact_ros.core.levels.prescribed_height import follow
from knee_contact_ros.core.levels.quasi_static import quasi_static_tick
from knee_contact_ros.core.prescribed import Interval, load_at, stretch_from
from knee_contact_ros.core.scene import AUTO, FIRST_ORDER, PRESCRIBED_HEIGHT, QUASI_STATIC, RunState, Scene, TickResult
from knee_contact_ros.core.stepping import EXPLICIT, MOST_EXPLICIT, THROWN

DESCEND = 0.4
"""Part of the tolerance that a simpler level than the last one must meet, so that levels do not alternate"""

LASTING = 0.1
"""Part of the tolerance that a simpler level must meet where the contact never forgets an error"""
LAYERED = 0.1
"""Part of the tolerance that a simpler level must meet where another layer may not forget an error"""
SMALL = 0.05
"""Part of the depth up to which the linearised contact is trusted with an error"""
ABOUT_TO_END = 0.5
"""Part of its first load that the last load of a tick must exceed: how fast a contact ends decides on its flight"""


@always_inlined
def advance(scene: Scene, interval: Interval, start: RunState, spent: int) -> TickResult:
    """Carry the femur over an interval; `spent` is the number of evaluations that the tick has taken already."""
    level = scene.level
    if level == PRESCRIBED_HEIGHT:
        return follow(scene, interval, start)
    if tries_quasi_static(scene, interval, start):
        result = quasi_static_tick(scene, interval, start, spent)
        if level == QUASI_STATIC or meets(scene, start, result):
            return result
        spent = result.evaluations
    if tries_first_order(scene, interval, start):
        result = first_order_tick(scene, interval, start, spent)
        if level == FIRST_ORDER or (result.converged and meets(scene, start, result)):
            return result
        spent = result.evaluations
    return dynamic_tick(scene, interval, start, spent)


@in_kernel
def goes_straight_to_dynamic(scene: Scene, interval: Interval, start: RunState) -> bool:
    """Whether a tick that begins in contact is computed by the dynamic level without trying another one."""
    if scene.level == PRESCRIBED_HEIGHT or math.isnan(start.impact_speed):
        return False
    return not (tries_quasi_static(scene, interval, start) or tries_first_order(scene, interval, start))


@in_kernel
def tries_quasi_static(scene: Scene, interval: Interval, start: RunState) -> bool:
    """Whether the quasi-static level is to be computed: it is requested, or its predicted error is small enough."""
    if scene.level != AUTO:
        return scene.level == QUASI_STATIC
    return may_be_simpler(interval, start) and quasi_static_leaves_out(scene, interval, start) <= scene.tolerance


@in_kernel
def tries_first_order(scene: Scene, interval: Interval, start: RunState) -> bool:
    """Whether the first-order level is to be computed: it is requested, or its predicted error is small enough."""
    if scene.level != AUTO:
        return scene.level == FIRST_ORDER
    simpler = may_be_simpler(interval, start) and dynamic_is_stiff(scene, interval, start)
    return simpler and first_order_leaves_out(scene, start) <= scene.tolerance


@in_kernel
def may_be_simpler(interval: Interval, start: RunState) -> bool:
    """Whether the contact of an interval allows for a level simpler than the dynamic one."""
    return not (bumpy(interval) or lets_go(interval) or start.stiffness <= 0.0)


@in_kernel
def meets(scene: Scene, start: RunState, result: TickResult) -> bool:
    """Whether an answer meets the tolerances, by a margin if it is of a simpler level than the last one.

    What a simpler level leaves out of a contact that hardly forgets is an error of all later ticks, too; and another
    layer may not damp. No simpler level resolves how the contact passes from one layer to another.
    """
    law = scene.modes.law
    if len(law.layers) > 1 and layer_at(law, start.depth) != layer_at(law, result.depth):
        return False
    lasting = max(LASTING, HORIZON * decay_rate(start.stiffness, start.damping, scene.mass))
    forgets = min(LAYERED if len(law.layers) > 1 else 1.0, lasting)
    if result.error_estimate > SMALL * forgets * result.depth or abs(result.depth - start.depth) > start.depth:
        return False  # It is no small change of the contact, as what is left out is taken to be.
    share = forgets if start.fidelity <= result.fidelity else DESCEND * forgets
    share = share / THROWN if start.impact_speed > 0.0 and len(law.layers) > 1 else share
    if scene.force_tolerance > 0.0 and not result.force_error_estimate <= share * scene.force_tolerance:
        return False
    return result.error_estimate <= share * scene.tolerance


@in_kernel
def bumpy(interval: Interval) -> bool:
    """Whether the contact passes kinks or points of a profile in the tick, of which simpler levels see the ends."""
    until, _ = stretch_from(interval, 0.0)
    return until < interval.duration or abs(interval.angle_rate) * interval.duration > interval.pair.knot_spacing()


@in_kernel
def quasi_static_leaves_out(scene: Scene, interval: Interval, start: RunState) -> float:
    """Predict the error of the depth [m] of the quasi-static level, by the dashpot and by the present transient."""
    dashpot = start.damping * abs(interval.load_rate) / (start.stiffness * start.stiffness)
    lag = abs(start.excess - start.damping * start.sinking) / start.stiffness
    forgotten = 1.0 + interval.duration * decay_rate(start.stiffness, start.damping, scene.mass)
    return EXPECTED * max(dashpot, 0.25 * lag / (forgotten * forgotten))


@in_kernel
def first_order_leaves_out(scene: Scene, start: RunState) -> float:
    """Predict the error of the depth [m] of the first-order level; infinite where inertia makes the knee oscillate."""
    if start.damping * start.damping <= 4.0 * start.stiffness * scene.mass:
        return math.inf
    return EXPECTED * scene.mass * abs(start.excess) / (start.damping * start.damping)


@in_kernel
def lets_go(interval: Interval) -> bool:
    """Whether the load stops pressing in a tick or is about to: only the dynamic level has flights."""
    begin, end = interval.start_load, load_at(interval, interval.duration)
    return begin <= 0.0 or end <= ABOUT_TO_END * begin


@in_kernel
def dynamic_is_stiff(scene: Scene, interval: Interval, start: RunState) -> bool:
    """Whether the dynamic level would need implicit steps, which cost more than the steps of the first-order level."""
    fastest = spectral_radius(start.stiffness, start.damping, scene.mass)
    return fastest * interval.duration > EXPLICIT * MOST_EXPLICIT
