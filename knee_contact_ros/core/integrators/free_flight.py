"""The femur without contact force: exact, for the load is linear in time."""

from __future__ import annotations

import itertools
from collections.abc import Callable

from knee_contact_ros.core.contact_laws.base import LayerForce
from knee_contact_ros.core.integrators.base import FemurState, Stage, StateError, Step
from knee_contact_ros.core.prescribed import Interval

FRACTIONS = (0.0, 0.25, 0.5, 0.75, 1.0)
MAX_PEAK = 12
"""Tries to find the highest point between two stages."""
PEAK_RATE = 1e-9
"""Rate [m/s] at which it is found."""

LAUNCH_ROUNDING = 2e-12
"""Part of the way flown that the rounding of the event before it may amount to."""


def free_flight_step(
    interval: Interval, law: LayerForce | None, mass: float, s: float, state: FemurState, h: float
) -> Step:
    """Fly for `h` [s]. With `law`, the force that the contact would give is watched; when apart there is none.

    The surfaces may meet and part again between two stages (a turning profile brushes the plateau): where the depth has
    a maximum between them, it becomes a stage too.
    """

    def stage(fraction: float) -> Stage:
        t = fraction * h
        height, velocity = flight(interval, mass, s, state, t)
        depth, rate, cosine = interval.touch(s + t)(height)
        rate -= cosine * velocity
        return Stage(fraction, depth, rate, law(depth, rate)[0] if law else 0.0)

    stages = [stage(fraction) for fraction in FRACTIONS]
    peaks = []
    for before, after in itertools.pairwise(stages):
        if before.rate > 0.0 > after.rate:
            peaks += _towards_peak(stage, before, after)
    visited = [*stages[1:], *peaks]
    end = flight(interval, mass, s, state, h)
    return Step(
        state=end,
        error=StateError(LAUNCH_ROUNDING * abs(end.height - state.height), 0.0),
        begin=stages[0],
        stages=tuple(sorted(visited, key=lambda stage: stage.fraction)),
        stiffness=0.0,
        damping=0.0,
        evaluations=1 + len(visited) if law else 0,
        solved=True,
    )


def flight(interval: Interval, mass: float, s: float, state: FemurState, t: float) -> FemurState:
    """Height and velocity after flying for `t` [s]."""
    load, load_rate = interval.load(s), interval.load_rate
    return FemurState(
        state.height + t * (state.velocity - t * (0.5 * load + load_rate * t / 6.0) / mass),
        state.velocity - t * (load + 0.5 * load_rate * t) / mass,
    )


def _towards_peak(stage: Callable[[float], Stage], before: Stage, after: Stage) -> list[Stage]:
    """Stages that close in on the maximum of the depth between two, where the rate changes its sign (Illinois)."""
    low, high = before.fraction, after.fraction
    rising, falling = before.rate, after.rate
    found: list[Stage] = []
    last = 0.0
    for _ in range(MAX_PEAK):
        middle = low + (high - low) * rising / (rising - falling)
        if not low < middle < high:
            break
        found.append(stage(middle))
        rate = found[-1].rate
        if abs(rate) <= PEAK_RATE:
            break
        again = rate * last > 0.0  # the other end has been kept twice: count it half
        if rate > 0.0:
            low, rising, falling = middle, rate, 0.5 * falling if again else falling
        else:
            high, falling, rising = middle, rate, 0.5 * rising if again else rising
        last = rate
    return found
