"""What one step of an integrator is: from a state, over a duration, under one smooth formula of the contact law."""

from __future__ import annotations

from typing import NamedTuple


class FemurState(NamedTuple):
    """The one free coordinate: height of the femoral reference point [m] and its velocity [m/s], superior positive."""

    height: float
    velocity: float


class StateError(NamedTuple):
    """Error of a femur state: height [m] and velocity [m/s]."""

    height: float
    velocity: float


NO_ERROR = StateError(0.0, 0.0)


class Stage(NamedTuple):
    """The contact at a point inside a step or at its end; read to find out which boundary the step has crossed."""

    fraction: float
    """Part of the step, 0 to 1"""
    depth: float
    """[m] signed: < 0 apart"""
    rate: float
    """[m/s]"""
    force: float
    """[N] of the layer's formula, not clamped"""
    stiffness: float = 0.0
    """Slope of the force over depth there [N/m]; in steps under contact force only"""
    surface_rate: float = 0.0
    """Rate of the depth [m/s] if the height were held; likewise"""


class Step(NamedTuple):
    """A step's end, its estimated local error and its stages (the last one is its end)."""

    state: FemurState
    error: StateError
    """Estimated local error; 0 where the step is exact or its error is estimated elsewhere"""
    begin: Stage
    """The contact at its beginning"""
    stages: tuple[Stage, ...]
    stiffness: float
    """Slope of the force over depth [N/m], typical of the step: it carries errors over it"""
    damping: float
    """Slope of the force over rate [N s/m], likewise"""
    evaluations: int
    solved: bool
    """False if a stage's equation was not solved; the step must then be repeated with a smaller duration."""
