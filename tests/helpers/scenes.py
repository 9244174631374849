"""Scenes that the tests of the model share."""

from __future__ import annotations

import math
from functools import cache

from knee_contact_ros.compiled import shipped
from knee_contact_ros.compiled.kernel import compiled
from knee_contact_ros.compiled.layout import kind_of
from knee_contact_ros.core.contact_laws import CONTACT_LAWS
from knee_contact_ros.core.contact_laws.base import ContactLaw
from knee_contact_ros.core.contact_laws.kelvin_voigt import KelvinVoigtFormula
from knee_contact_ros.core.contact_laws.two_layer import SpringAndDashpot
from knee_contact_ros.core.contact_modes import ContactModes
from knee_contact_ros.core.contact_pairs.base import ContactPair
from knee_contact_ros.core.contact_pairs.on_plane import OnPlane
from knee_contact_ros.core.geometries import Circle, FemoralGeometry
from knee_contact_ros.core.integrators.base import FemurState
from knee_contact_ros.core.levels import LEVELS
from knee_contact_ros.core.levels.dynamic import dynamic_tick
from knee_contact_ros.core.mechanisms.base import Mechanism
from knee_contact_ros.core.mechanisms.hinge import Hinge
from knee_contact_ros.core.model import KneeModel
from knee_contact_ros.core.prescribed import Interval
from knee_contact_ros.core.scene import RunState, Scene, TickResult, begin_with
from knee_contact_ros.parameters.schema import Parameters, constants_of

RADIUS = 0.034
MASS = 9.3014
BODY_WEIGHT = 75.16 * 9.80665
STIFFNESS = 7.905694e7
DAMPING = 5000.0
LAYER_DEPTH = 5e-4
CONSTANTS = Parameters().contact
LAW_ARGUMENTS = {
    name: {constant: getattr(CONSTANTS, constant) for constant in constants_of(name)} for name in CONTACT_LAWS
}
"""Those of the parameters' defaults: Table 1's where it has them"""


def law(name: str, **changes: float) -> ContactLaw:
    """A contact law with the constants of Table 1 and the parameters' defaults, or others."""
    return CONTACT_LAWS[name](**(LAW_ARGUMENTS[name] | changes))


def model(
    contact_law: ContactLaw,
    tolerance: float = 1e-8,
    geometry: FemoralGeometry | None = None,
    mass: float = MASS,
    slope: float = 0.0,
    budget: int = 0,
    allow_tension: bool = False,
    pair: ContactPair | None = None,
    mechanism: Mechanism | None = None,
    height_prescribed: bool = False,
    level: str = "dynamic",
) -> KneeModel:
    """A knee like the paper's; `pair` takes the place of `geometry` on a plane with `slope`."""
    return KneeModel(
        pair=pair or OnPlane(geometry or Circle(RADIUS), slope),
        mechanism=mechanism or Hinge(),
        modes=ContactModes(contact_law, allow_tension),
        mass=mass,
        tolerance=tolerance,
        budget=budget,
        height_prescribed=height_prescribed,
        level=LEVELS[level],
    )


def quick(knee: KneeModel) -> KneeModel:
    """The same knee, compiled if its kernel comes with the package: the same bits in a hundredth of the time."""
    return compiled(knee) if comes_with_the_package(kind_of(knee.scene)) or needed_anyway(knee) else knee


comes_with_the_package = cache(shipped.is_there)


def needed_anyway(knee: KneeModel) -> bool:
    """Whether the node's tests compile its kernel where the model has been changed."""
    layers = {type(layer.formula) for layer in knee.modes.law.layers}
    simple = type(knee.pair) is OnPlane and type(knee.pair.femur) is Circle and type(knee.mechanism) is Hinge
    return simple and layers <= {KelvinVoigtFormula, SpringAndDashpot}


def advance(
    contact_law: ContactLaw,
    depth: float,
    rate: float,
    duration: float,
    load: float = 0.0,
    mass: float = 1.0,
    tolerance: float = 1e-10,
    allow_tension: bool = False,
) -> TickResult:
    """One long tick of a circular femur from a given contact, under a constant load."""
    pair, hinge = OnPlane(Circle(RADIUS)), Hinge()
    interval = Interval(pair, hinge, duration, 0.0, 0.0, load, 0.0, math.nan)
    scene = Scene(pair, hinge, ContactModes(contact_law, allow_tension), mass, tolerance, 0.0, 0, LEVELS["dynamic"])
    return dynamic_tick(scene, interval, moving(FemurState(RADIUS - depth, -rate)), 0)


def moving(state: FemurState) -> RunState:
    """A run that has come to a state without error, apart so far."""
    return begin_with(state, math.nan, 0.0)
