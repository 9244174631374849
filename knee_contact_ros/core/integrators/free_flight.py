"""The femur without contact force: exact, for the load is linear in time."""

from __future__ import annotations

from knee_contact_ros.core.contact_laws.base import LayerForce
from knee_contact_ros.core.integrators.base import NO_ERROR, FemurState, Stage, Step
from knee_contact_ros.core.prescribed import Interval

FRACTIONS = (0.25, 0.5, 0.75, 1.0)


def free_flight_step(
    interval: Interval, law: LayerForce | None, mass: float, cosine: float, s: float, state: FemurState, h: float
) -> Step:
    """Fly for `h` [s]. With `law`, the force that the contact would give is watched; when apart there is none."""
    load = interval.load(s)
    stages = []
    for fraction in FRACTIONS:
        t = fraction * h
        height = state.height + t * (state.velocity - t * (0.5 * load + interval.load_rate * t / 6.0) / mass)
        velocity = state.velocity - t * (load + 0.5 * interval.load_rate * t) / mass
        surface, surface_rate = interval.surface(s + t)
        depth, rate = surface - cosine * height, surface_rate - cosine * velocity
        force = law(depth, rate)[0] if law else 0.0
        stages.append(Stage(fraction, depth, rate, force))
    return Step(
        state=FemurState(height, velocity),
        error=NO_ERROR,
        stages=tuple(stages),
        stiffness=0.0,
        damping=0.0,
        evaluations=len(FRACTIONS) if law else 0,
        solved=True,
    )
