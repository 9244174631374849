"""Fehlberg's pair for a contact without mass: n_y F(δ, δ̇) = L gives the velocity, where a dashpot answers it.

Every law is F₀(δ) + c(δ) δ̇, so the penetration rate is (L / n_y - F₀) / c; see `fehlberg.py` for the method.
"""

from __future__ import annotations

from typing import NamedTuple

from knee_contact_ros.core.integrators.base import (
    FemurState,
    Motion,
    Stage,
    StateError,
    Step,
    first_crossing,
    force_on,
)
from knee_contact_ros.core.integrators.fehlberg import C2, C3, C4, C6, EVALUATIONS, IN_ORDER, SINGULAR, begins_layer
from knee_contact_ros.core.integrators.tableaus import FEHLBERG, ahead, weighted
from knee_contact_ros.core.kernel_source import in_kernel, never_inlined
from knee_contact_ros.core.prescribed import load_at, touch_at

SIMPSON = 0.1
"""Least error of a step, as a part of its difference from Simpson's rule: the pair's own estimate passes through 0
between its two signs, and one step in ten errs by more than six times as much. Of 3000 steps none erred by more than
five times the larger of both."""


class Flow(NamedTuple):
    """Motion and contact of a femur without mass at a height."""

    velocity: float
    """Velocity of the femur [m/s]"""
    stage: Stage
    stiffness: float
    """Slope of the force along the height over the height [N/m]"""
    damping: float
    """Slope of the force along the height over the velocity [N s/m]"""


@never_inlined
def massless_step(motion: Motion, s: float, state: FemurState, h: float) -> Step:
    """Take one step of `h` [s] from s [s] on under one layer's formula; the velocity of `state` is not used."""
    y, m = state.height, FEHLBERG
    one = flow_at(motion, s, y)
    v = one.velocity
    two = flow_at(motion, s + C2 * h, ahead(y, h, m.second, (v,)))
    v2 = two.velocity
    three = flow_at(motion, s + C3 * h, ahead(y, h, m.third, (v, v2)))
    v3 = three.velocity
    four = flow_at(motion, s + C4 * h, ahead(y, h, m.fourth, (v, v2, v3)))
    v4 = four.velocity
    five = flow_at(motion, s + h, ahead(y, h, m.fifth, (v, v2, v3, v4)))
    v5 = five.velocity
    six = flow_at(motion, s + C6 * h, ahead(y, h, m.sixth, (v, v2, v3, v4, v5)))
    v6 = six.velocity
    height = ahead(y, h, m.weights, (v, v3, v4, v5))
    end = flow_at(motion, s + h, height)

    stages = (two.stage, three.stage, six.stage, four.stage, end.stage)
    crossing = first_crossing(motion, s, h, IN_ORDER, stages)
    least = min(one.damping, two.damping, three.damping, four.damping, five.damping, six.damping, end.damping)
    estimate = h * SINGULAR if begins_layer(motion, one.stage.depth, end.stage.depth) else h
    otherwise = y + h / 6.0 * (v + 4.0 * v6 + end.velocity) - height
    error = max(abs(estimate * weighted(m.error, (v, v3, v4, v5, v6))), SIMPSON * abs(otherwise))
    return Step(
        state=FemurState(height, end.velocity), error=StateError(error, 0.0), begin=one.stage, end=end.stage,
        crossing=crossing, stiffness=six.stiffness, damping=six.damping, cosine=1.0, leapt=0.0,
        evaluations=EVALUATIONS + 1, solved=least > 0.0,
    )  # fmt: skip


@in_kernel
def flow_at(motion: Motion, s: float, height: float) -> Flow:
    """Return the velocity at which the contact balances the load at s [s] and a height [m]."""
    depth, surface_rate, cosine = touch_at(motion.interval, s).touch(height)
    at_rest, stiffness, damping = force_on(motion, depth, 0.0)
    force = load_at(motion.interval, s) / cosine
    rate = (force - at_rest) / damping if damping > 0.0 else 0.0
    return Flow(
        (surface_rate - rate) / cosine,
        Stage(depth=depth, rate=rate, force=force, stiffness=stiffness, surface_rate=surface_rate),
        cosine * cosine * stiffness,
        cosine * cosine * damping,
    )
