"""Scenes that the tests share."""

from dataclasses import replace

from knee_contact_ros.model.knee import KneeModel
from knee_contact_ros.model.laws import CONTACT_LAWS
from knee_contact_ros.model.mechanisms import MECHANISMS
from knee_contact_ros.model.profiles import Circle
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


def law(name, **changes):
    """A contact law with the constants of Table 1 and the parameters' defaults, or others."""
    return CONTACT_LAWS[name](**(LAW_ARGUMENTS[name] | changes))


def model(
    contact_law,
    tolerance=1e-8,
    geometry=None,
    mass=MASS,
    slope=0.0,
    budget=0,
    allow_tension=False,
    pair=None,
    mechanism=None,
    height_prescribed=False,
    level="dynamic",
):
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


def quick(knee):
    """The same knee, compiled where that is sooner: the same bits."""
    return replace(knee, compiled=None)
