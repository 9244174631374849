"""The scene, which is the same for all ticks of a run, and the state that one tick hands to the next."""

from __future__ import annotations

import math
from typing import NamedTuple

from knee_contact_ros.core.adrift import FOUND, Adrift
from knee_contact_ros.core.contact_laws.base import law_force
from knee_contact_ros.core.contact_modes import ContactModes
from knee_contact_ros.core.contact_pairs.base import ContactPair
from knee_contact_ros.core.error_estimate import EXACT, PropagatedError, velocity_reach
from knee_contact_ros.core.integrators.base import FemurState
from knee_contact_ros.core.kernel_source import in_kernel
from knee_contact_ros.core.mechanisms.base import Mechanism
from knee_contact_ros.core.types import Fidelity

QUASI_STATIC, FIRST_ORDER, DYNAMIC = int(Fidelity.QUASI_STATIC), int(Fidelity.FIRST_ORDER), int(Fidelity.DYNAMIC)
AUTO = 3
"""Level: the cheapest one that meets the tolerance, picked for each tick"""
PRESCRIBED_HEIGHT = 4
"""Level of the displacement drive, whose femoral height is prescribed"""


class Scene(NamedTuple):
    """A knee and how exactly it is to be solved: the constants of a run."""

    pair: ContactPair
    mechanism: Mechanism
    modes: ContactModes
    mass: float
    """Mass of the femur [kg]"""
    tolerance: float
    """Tolerated error of the depth [m]"""
    force_tolerance: float
    """Tolerated error of the contact force [N]; 0: any"""
    budget: int
    """Largest number of contact law evaluations in a tick; 0: no limit"""
    level: int
    """The equations that a tick solves: a `Fidelity`, `AUTO` or `PRESCRIBED_HEIGHT`"""
    plausible_depth: float = math.inf
    """Depth [m] beyond which an answer is `IMPLAUSIBLE`"""


class RunState(NamedTuple):
    """State of a run: all that one tick hands to the next."""

    state: FemurState
    """Height and velocity of the femur; the velocity is NaN at the static start: the femur follows its turning
    surface"""
    error: PropagatedError
    """Estimated error of the state, or its deviation from the dynamic one where a simpler level computed it"""
    try_step: float
    """Duration [s] that the next step should try"""
    impact_speed: float
    """Penetration rate [m/s] at which the present contact began; NaN while the surfaces are apart"""
    impact_error: float
    """Estimated error of the impact speed [m/s]"""
    fidelity: int
    """The level that computed the last tick"""
    stiffness: float
    """Slope of the contact force along the height over the height [N/m] at the end of the last tick"""
    damping: float
    """Slope of the contact force along the height over the velocity [N s/m] at the end of the last tick"""
    excess: float
    """Contact force along the height less the load [N] at the end of the last tick"""
    sinking: float
    """Penetration rate divided by n_y [m/s] at the end of the last tick"""
    depth: float
    """Signed depth [m] at the end of the last tick"""
    adrift: Adrift
    """Bounds of the exact solution where its error estimate no longer holds"""


class TickResult(NamedTuple):
    """The contact at the end of a tick."""

    run_state: RunState
    depth: float
    """Signed depth [m]: < 0 apart"""
    rate: float
    """Rate of the depth [m/s]"""
    force: float
    """Normal contact force [N]"""
    error_estimate: float
    """Estimated error of the depth [m]"""
    force_error_estimate: float
    """Estimated error of the force [N]"""
    evaluations: int
    reached: float
    """Time [s] in the interval that the motion has reached; the answer is always for the end of the interval"""
    converged: bool
    """False if the motion was not resolved, so that the answer is the static contact"""
    height: float
    """Height of the femoral reference point [m]"""
    fidelity: int
    """The level that computed the answer"""


@in_kernel
def impact_of(start: RunState) -> tuple[float, float]:
    """Impact speed [m/s] and its error for a level that never flies: those of the present contact, else at rest."""
    if math.isnan(start.impact_speed):
        return 0.0, velocity_reach(start.error)
    return start.impact_speed, start.impact_error


@in_kernel
def begin_with(state: FemurState, impact_speed: float, depth: float) -> RunState:
    """Return the state of a run that begins here; `impact_speed` [m/s] is NaN when apart, `depth` [m] is signed."""
    return RunState(
        state=state, error=EXACT, try_step=math.inf, impact_speed=impact_speed, impact_error=0.0, fidelity=DYNAMIC,
        stiffness=0.0, damping=0.0, excess=0.0, sinking=0.0, depth=depth, adrift=FOUND,
    )  # fmt: skip


@in_kernel
def at_height(
    scene: Scene, height: float, velocity: float, depth: float, rate: float, impact_speed: float
) -> TickResult:
    """The contact at a prescribed height [m] and velocity [m/s], given the depth [m] and its rate [m/s] there."""
    force, _, _ = law_force(scene.modes.law, depth, rate, 0.0 if math.isnan(impact_speed) else impact_speed)
    run_state = begin_with(FemurState(height, velocity), impact_speed, depth)
    exerted = force if scene.modes.allow_tension else max(force, 0.0)
    return TickResult(
        run_state=run_state, depth=depth, rate=rate, force=exerted, error_estimate=0.0, force_error_estimate=0.0,
        evaluations=1 if depth > 0.0 else 0, reached=math.inf, converged=True, height=height, fidelity=DYNAMIC,
    )  # fmt: skip
