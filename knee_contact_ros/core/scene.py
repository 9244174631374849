"""The scene: what does not change from tick to tick; and what goes from one tick to the next."""

from __future__ import annotations

import math
from typing import NamedTuple

from knee_contact_ros.core.adrift import FOUND, Adrift
from knee_contact_ros.core.contact_modes import ContactModes
from knee_contact_ros.core.contact_pairs.base import ContactPair
from knee_contact_ros.core.error_estimate import EXACT, CarriedError, velocity_reach
from knee_contact_ros.core.integrators.base import FemurState
from knee_contact_ros.core.kernel_source import in_kernel
from knee_contact_ros.core.mechanisms.base import Mechanism
from knee_contact_ros.core.types import Fidelity

QUASI_STATIC, FIRST_ORDER, DYNAMIC = int(Fidelity.QUASI_STATIC), int(Fidelity.FIRST_ORDER), int(Fidelity.DYNAMIC)
AUTO = 3
"""The cheapest level that meets the tolerance, picked for each tick"""
PRESCRIBED_HEIGHT = 4
"""The displacement drive"""


class Scene(NamedTuple):
    """A knee, and how exactly to solve it."""

    pair: ContactPair
    mechanism: Mechanism
    modes: ContactModes
    mass: float
    """[kg]"""
    tolerance: float
    """Wanted error of the depth [m]"""
    force_tolerance: float
    """Wanted error of the contact force [N]; 0: any"""
    budget: int
    """Contact law evaluations a tick may cost; 0: no limit"""
    level: int
    """The equations that a tick solves: a `Fidelity`, or one of those below"""
    plausible_depth: float = math.inf
    """[m] beyond which a depth makes no sense"""


class RunState(NamedTuple):
    """Where a run stands: all that one tick hands to the next."""

    state: FemurState
    """Its velocity is not a number at the static start: the femur follows its turning surface"""
    error: CarriedError
    """Estimated error of the state, or its deviation from the dynamic one where a simpler level computed it"""
    try_step: float
    """Duration [s] that the next step should try"""
    impact_speed: float
    """Rate [m/s] at which the present contact began; not a number while apart"""
    impact_error: float
    """Its error [m/s]"""
    fidelity: int
    """The level that computed the last tick"""
    stiffness: float
    """Slope of the contact force along the height over the height [N/m] at the end of the last tick"""
    damping: float
    """The same over the velocity [N s/m]"""
    excess: float
    """Contact force along the height less the load [N] at the end of the last tick"""
    sinking: float
    """Rate of the depth over n_y [m/s] there"""
    depth: float
    """Signed depth [m] there"""
    adrift: Adrift
    """Bounds of the exact solution where its estimate has been lost"""


class TickResult(NamedTuple):
    """The contact at the end of a tick."""

    run_state: RunState
    depth: float
    """[m] signed: < 0 apart"""
    rate: float
    """[m/s]"""
    force: float
    """[N]"""
    error_estimate: float
    """[m]"""
    force_error_estimate: float
    """[N]"""
    evaluations: int
    reached: float
    """[s] of the interval up to which the progress has come; the answer is one at the interval's end all the same"""
    converged: bool
    """False if the tick was given up and the contact is the static one"""
    height: float
    """Of the femoral reference point [m] in the answer"""
    fidelity: int
    """The level that computed the answer"""


@in_kernel
def impact_of(start: RunState) -> tuple[float, float]:
    """How the contact of a level that never flies began [m/s], and its error: as the present one did, else at rest."""
    if math.isnan(start.impact_speed):
        return 0.0, velocity_reach(start.error)
    return start.impact_speed, start.impact_error


@in_kernel
def begin_with(state: FemurState, impact_speed: float, depth: float) -> RunState:
    """How a run begins in a state; `impact_speed` [m/s] is not a number apart, `depth` [m] is signed."""
    return RunState(
        state=state, error=EXACT, try_step=math.inf, impact_speed=impact_speed, impact_error=0.0, fidelity=DYNAMIC,
        stiffness=0.0, damping=0.0, excess=0.0, sinking=0.0, depth=depth, adrift=FOUND,
    )  # fmt: skip


@in_kernel
def at_height(
    scene: Scene, height: float, velocity: float, depth: float, rate: float, impact_speed: float
) -> TickResult:
    """The contact in a prescribed state: height [m] and velocity [m/s] with their depth [m] and its rate [m/s]."""
    layers = scene.modes.law.layers
    index = -1
    for layer in layers:
        if layer.begin < depth:
            index += 1
    force = 0.0
    if index >= 0:
        touched = 0.0 if math.isnan(impact_speed) else impact_speed
        force, _, _ = layers[index].formula.force_at(depth, rate, touched)
    run_state = begin_with(FemurState(height, velocity), impact_speed, depth)
    exerted = force if scene.modes.allow_tension else max(force, 0.0)
    return TickResult(
        run_state=run_state, depth=depth, rate=rate, force=exerted, error_estimate=0.0, force_error_estimate=0.0,
        evaluations=1 if depth > 0.0 else 0, reached=math.inf, converged=True, height=height, fidelity=DYNAMIC,
    )  # fmt: skip
