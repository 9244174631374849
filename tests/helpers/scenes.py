"""Scenes that the tests share."""

from __future__ import annotations

from dataclasses import replace

from knee_contact_ros.model.knee import KneeModel
from knee_contact_ros.model.laws import CONTACT_LAWS, ContactLaw
from knee_contact_ros.model.mechanisms import MECHANISMS, Mechanism
from knee_contact_ros.model.profiles import Circle, Profile
from knee_contact_ros.model.surfaces import ContactPair, Plane
from knee_contact_ros.model.ticks import LEVELS
from knee_contact_ros.parameters.schema import Parameters, constants_of

RADIUS = 0.034
MASS = 9.3014
BODY_WEIGHT = 75.16 * 9.80665
STIFFNESS = 7.905694e7
DAMPING = 5000.0
LAYER_DEPTH = 5e-4
CONSTANTS = Parameters().contact
LAW_ARGUMENTS = {
    name: {constant: getattr(CONSTANTS, constant) for constant in constants_of(name)}
    for name in CONTACT_LAWS
}
"""Those of the parameters' defaults: Table 1's where it has them"""


def law(name: str, **changes: float) -> ContactLaw:
    """A contact law with the constants of Table 1 and the parameters' defaults, or others."""
    return CONTACT_LAWS[name](**(LAW_ARGUMENTS[name] | changes))


def model(
    contact_law: ContactLaw,
    tolerance: float = 1e-8,
    geometry: Circle | Profile | None = None,
    mass: float = MASS,
    slope: float = 0.0,
    budget: int = 0,
    allow_tension: bool = False,
    pair: ContactPair | None = None,
    mechanism: Mechanism | None = None,
    height_prescribed: bool = False,
    level: str = "dynamic",
) -> KneeModel:
    """A knee like the paper's; `pair` takes the place of `geometry` on a plane with `slope`, and of `mechanism`."""
    return KneeModel(
        pair=pair
        or ContactPair(
            geometry or Circle(RADIUS), Plane(slope), mechanism or MECHANISMS["hinge"]()
        ),
        law=contact_law,
        mass=mass,
        tolerance=tolerance,
        budget=budget,
        allow_tension=allow_tension,
        height_prescribed=height_prescribed,
        level=LEVELS[level],
    )


def quick(knee: KneeModel) -> KneeModel:
    """The same knee, compiled where that is sooner: the same bits."""
    return replace(knee, compiled=None)
