"""Builds models from parameters: the only place where names become laws, surfaces, mechanisms and load rules."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, cast

from ..joint_reaction.compartments import LoadRule, MeasuredShare
from ..model.knee import KneeModel
from ..model.laws import (
    CONTACT_LAWS,
    ContactLaw,
    check,
    hertz_stiffness,
    relative_radius,
)
from ..model.mechanisms import MECHANISMS
from ..model.profiles import Circle, Profile
from ..model.readouts import POINT_CONTACT, SPREADS, ContactPatch
from ..model.surfaces import TIBIAL_GEOMETRIES, ContactPair
from ..model.ticks import LEVELS
from ..system.errors import UsageError
from .curves import (
    SHARE_FILE,
    curve_points,
    curve_texts,
    read_share_table,
)
from .schema import ContactSection, Parameters, constants_of


def build_model(
    parameters: Parameters,
    *,
    curves: Mapping[str, str] | None = None,
    pair: ContactPair | None = None,
) -> KneeModel:
    """Build a model from parameters, not compiled, and without warnings.

    `curves` has the contents of all needed files, by parameter; then no file is opened. With `pair` no surface is made.

    Raises:
        UsageError: a file cannot be read, or a profile, a table or the contact law cannot be used.
    """
    if pair is None:
        pair = contact_pair(parameters, curve_texts(parameters, {}) if curves is None else curves)
    return KneeModel(
        pair, height_prescribed=parameters.drive == "displacement", **_numbers(parameters)
    )


def retuned(model: KneeModel, parameters: Parameters) -> KneeModel:
    """Return a copy of a model with the numbers of other parameters; surfaces, mechanism and drive are kept.

    Raises:
        UsageError: the contact law cannot be used.
    """
    return replace(model, **_numbers(parameters))


def _numbers(parameters: Parameters) -> dict[str, Any]:
    """Return the fields of a model that need no surface, by name: law, mass, level, tolerances, budget and patch."""
    law, fidelity = contact_law(parameters.contact), parameters.fidelity
    return {
        "law": law,
        "allow_tension": parameters.contact.allow_tension,
        "mass": parameters.femur.mass,
        "tolerance": fidelity.tolerance,
        "force_tolerance": fidelity.force_tolerance,
        "budget": fidelity.budget,
        "level": LEVELS[fidelity.level],
        "patch": contact_patch(parameters.contact, law),
    }


def contact_law(contact: ContactSection) -> ContactLaw:
    """Make a contact law by its name, with the parameters that are the arguments of its factory.

    Raises:
        UsageError: the law does not fulfil what `ContactLaw` requires.
    """
    try:
        law = CONTACT_LAWS[contact.law](**law_constants(contact))
        check(law)
    except ValueError as error:
        raise UsageError(f"parameter contact.law: {contact.law}: {error}") from None
    return law


def law_constants(contact: ContactSection) -> dict[str, Any]:
    """Return the constants of the contact law by parameter, a stiffness from the material computed."""
    constants = {name: getattr(contact, name) for name in constants_of(contact.law)}
    if contact.stiffness_from == "material":
        stiffness = material_stiffness(contact)
        constants |= {name: stiffness[name] for name in constants.keys() & stiffness.keys()}
    return constants


def material_stiffness(contact: ContactSection) -> dict[str, float]:
    """Return Hertz' stiffness of both layers [N/m^1.5], by parameter, from modulus, Poisson's ratio and radii."""
    radius = relative_radius(contact.femoral_radius, contact.tibial_radius)
    return {
        "stiffness": hertz_stiffness(contact.youngs_modulus, contact.poissons_ratio, radius),
        "stiffness_2": hertz_stiffness(contact.youngs_modulus_2, contact.poissons_ratio_2, radius),
    }


def contact_patch(contact: ContactSection, law: ContactLaw) -> ContactPatch | None:
    """Return the contact patch from the radii and the cartilage's thickness; None if the radii do not fit each other.

    The thickness is that of the law's first layer; for a law with one layer it is `contact.foundation_thickness`.
    """
    try:
        radius = relative_radius(contact.femoral_radius, contact.tibial_radius)
    except ValueError:
        return None
    layers = law.layers
    thickness = layers[1].begin if len(layers) > 1 else contact.foundation_thickness
    return ContactPatch(SPREADS.get(contact.law, POINT_CONTACT), radius, thickness)


def contact_pair(parameters: Parameters, texts: Mapping[str, str]) -> ContactPair:
    """Make both surfaces and the mechanism of some parameters; `texts` has the contents of files by parameter."""
    femur, tibia, translation = parameters.femur, parameters.tibia, parameters.translation

    def from_file(make: Callable[..., Any], by: str, name: str, scale: float = 1.0) -> Any:
        points = curve_points(by, name, texts[by])
        try:
            return make(*(scale * column for column in points))
        except ValueError as error:
            raise UsageError(f"parameter {by}: {name}: {error}") from None

    if femur.geometry == "profile":
        femoral = from_file(Profile, "femur.profile", femur.profile, femur.scale)
    else:
        femoral = Circle(femur.radius)
    if translation.mechanism == "table":
        moved = from_file(MECHANISMS["table"], "translation.table", translation.table)
    else:
        moved = MECHANISMS[translation.mechanism]()
    make = cast("Callable[..., Any]", TIBIAL_GEOMETRIES[tibia.geometry])
    if tibia.geometry == "profile":
        plateau = from_file(make, "tibia.profile", tibia.profile, tibia.scale)
    else:
        plateau = make(tibia.slope if tibia.geometry == "plane" else tibia.radius)
    return ContactPair(femoral, plateau, moved)


def load_rule(parameters: Parameters, texts: Mapping[str, str]) -> LoadRule:
    """Make the rule for the load of the medial (or only) compartment; `texts` has the contents of files by parameter.

    Raises:
        UsageError: the table of shares cannot be used.
    """
    load = parameters.load
    weight = parameters.body_weight
    measured = None
    if load.rule == "measured_share":
        table = read_share_table(load.share_file, texts[SHARE_FILE])
        measured = MeasuredShare(table, weight)
    return LoadRule(load.rule, load.share, load.compartment_spacing, measured, weight)
