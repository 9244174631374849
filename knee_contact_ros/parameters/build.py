"""Builds models from parameters: the only place where names become laws, surfaces and mechanisms."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from types import MappingProxyType
from typing import Any, cast

from knee_contact_ros.model.knee import KneeModel
from knee_contact_ros.model.laws import CONTACT_LAWS, ContactLaw, check, hertz_stiffness, relative_radius
from knee_contact_ros.model.mechanisms import MECHANISMS, Mechanism
from knee_contact_ros.model.profiles import Circle, Profile
from knee_contact_ros.model.readouts import POINT_CONTACT, SPREADS, ContactPatch
from knee_contact_ros.model.surfaces import TIBIAL_GEOMETRIES, ContactPair
from knee_contact_ros.model.ticks import LEVELS
from knee_contact_ros.parameters.curves import curve_texts, profile_points, translation_points
from knee_contact_ros.parameters.plausibility import doubts_about
from knee_contact_ros.parameters.reading import Source, load_parameters
from knee_contact_ros.parameters.schema import ContactParameters, Femur, Parameters, Translation, constants_of
from knee_contact_ros.results import Results
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.resources import DEFAULT_PARAMETERS


def load_model(
    source: Source = DEFAULT_PARAMETERS,
    *,
    compiled: bool | None = None,
    curves: Mapping[str, str] = MappingProxyType({}),
) -> KneeModel:
    """Build the model that a parameter file (or several, or mappings) describes. Needs no ROS.

    Without an argument it is the healthy knee. Names have the same meaning as on the command line: a file as given or
    one of the package's own, as `"osteoarthritis"`. Of several, the later one wins:
    `["osteoarthritis", "mri_femur", {"femur.mass": 8.0}]`.

    The compiled model computes the same bits some hundred times faster. It is compiled once, for every kind of knee, in
    some 10 s, and kept: then it takes half a second to load. Without `compiled` the model uses it for a run where that
    is faster altogether, and for a stream where it is kept; with `compiled` True always, with False never. Where Numba
    cannot be used, a warning says so once, and the plain model computes.

    `curves` has the contents of files that parameters name, by parameter, in place of the files. Implausible parameters
    (a stiffness or a body weight that must be in other units) cause a warning.

    Raises:
        UsageError: a parameter file cannot be read, a parameter is unknown or not allowed (see `load_parameters`), or a
            profile or a table cannot be used.
    """
    parameters = load_parameters(source)
    plain = build_model(parameters, curves=curve_texts(parameters, curves))
    model = replace(plain, compiled=compiled, results=Results)
    for doubt in doubts_about(parameters, model).about_parameters:
        warnings.warn(doubt, stacklevel=2)
    return model


def build_model(
    parameters: Parameters, *, curves: Mapping[str, str] | None = None, pair: ContactPair | None = None
) -> KneeModel:
    """Build a model from parameters, which is not compiled, and without warnings.

    `curves` has the contents of all files that are needed, by parameter; with it no file is opened. With `pair` no
    surface is made.

    Raises:
        UsageError: a file cannot be read, or a profile, a table or the contact law cannot be used.
    """
    if pair is None:
        pair = contact_pair(parameters, curve_texts(parameters, {}) if curves is None else curves)
    return KneeModel(pair, height_prescribed=parameters.drive == "displacement", **_numbers(parameters))


def retuned(model: KneeModel, parameters: Parameters) -> KneeModel:
    """Copy of a model with the numbers of other parameters; surfaces, mechanism and drive stay.

    Raises:
        UsageError: the contact law cannot be used.
    """
    return replace(model, **_numbers(parameters))


def _numbers(parameters: Parameters) -> dict[str, Any]:
    """Fields of a model that need no surface, by name: law, mass, level, tolerances, budget and patch."""
    law, fidelity = contact_law(parameters.contact), parameters.fidelity
    return {
        "law": law, "allow_tension": parameters.contact.allow_tension, "mass": parameters.femur.mass,
        "tolerance": fidelity.tolerance, "force_tolerance": fidelity.force_tolerance, "budget": fidelity.budget,
        "level": LEVELS[fidelity.level], "patch": contact_patch(parameters.contact, law),
    }  # fmt: skip


def contact_law(contact: ContactParameters) -> ContactLaw:
    """Contact law by its name, with the parameters that are the arguments of its factory.

    Raises:
        UsageError: the law breaks what `ContactLaw` asks for.
    """
    constants = {name: getattr(contact, name) for name in constants_of(contact.law)}
    if contact.stiffness_from == "material":
        constants |= {name: value for name, value in material_stiffness(contact).items() if name in constants}
    try:
        law = CONTACT_LAWS[contact.law](**constants)
        check(law)
    except ValueError as error:
        raise UsageError(f"parameter contact.law: {contact.law}: {error}") from None
    return law


def material_stiffness(contact: ContactParameters) -> dict[str, float]:
    """Hertz stiffness of both layers [N/m^1.5], by parameter, from modulus, Poisson's ratio and radii."""
    radius = relative_radius(contact.femoral_radius, contact.tibial_radius)
    return {
        "stiffness": hertz_stiffness(contact.youngs_modulus, contact.poissons_ratio, radius),
        "stiffness_2": hertz_stiffness(contact.youngs_modulus_2, contact.poissons_ratio_2, radius),
    }


def contact_patch(contact: ContactParameters, law: ContactLaw) -> ContactPatch | None:
    """Contact patch from the radii and the cartilage's thickness; None if the radii do not fit each other.

    The cartilage is as thick as the law's first layer; if the law has one layer, as `contact.foundation_thickness`.
    """
    try:
        radius = relative_radius(contact.femoral_radius, contact.tibial_radius)
    except ValueError:
        return None
    layers = law.layers
    thickness = layers[1].begin if len(layers) > 1 else contact.foundation_thickness
    return ContactPatch(SPREADS.get(contact.law, POINT_CONTACT), radius, thickness)


def femoral_geometry(femur: Femur, texts: Mapping[str, str]) -> Circle | Profile:
    """Femoral surface by the name of its geometry; `texts` has the contents of files by parameter."""
    if femur.geometry == "circle":
        return Circle(femur.radius)
    points = profile_points("femur.profile", femur.profile, texts["femur.profile"])
    with _naming("femur.profile", femur.profile):
        return Profile(*(femur.scale * column for column in points))


def contact_pair(parameters: Parameters, texts: Mapping[str, str]) -> ContactPair:
    """Both surfaces and the mechanism of some parameters; `texts` has the contents of files by parameter."""
    femur, moved = femoral_geometry(parameters.femur, texts), mechanism(parameters.translation, texts)
    tibia, make = parameters.tibia, cast("Callable[..., Any]", TIBIAL_GEOMETRIES[parameters.tibia.geometry])
    if tibia.geometry != "profile":
        return ContactPair(femur, make(tibia.slope if tibia.geometry == "plane" else tibia.radius), moved)
    points = profile_points("tibia.profile", tibia.profile, texts["tibia.profile"])
    with _naming("tibia.profile", tibia.profile):
        return ContactPair(femur, make(*(tibia.scale * column for column in points)), moved)


def mechanism(translation: Translation, texts: Mapping[str, str]) -> Mechanism:
    """Knee mechanism by its name."""
    if translation.mechanism != "table":
        return MECHANISMS[translation.mechanism]()
    columns = translation_points("translation.table", translation.table, texts["translation.table"])
    with _naming("translation.table", translation.table):
        return MECHANISMS["table"](*columns)


@contextmanager
def _naming(parameter: str, file: str) -> Iterator[None]:
    """Turn a ValueError into a UsageError that begins with a parameter and the file that it names."""
    try:
        yield
    except ValueError as error:
        raise UsageError(f"parameter {parameter}: {file}: {error}") from None
