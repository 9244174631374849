"""Builds models from parameters: the only place where names become laws, surfaces, mechanisms and load rules.

Implausible parameters are not refused, as the user may model a rat; `parameter_doubts` describes them.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any, cast

from knee_contact_ros.joint_reaction.compartments import LoadRule, MeasuredShare
from knee_contact_ros.joint_reaction.estimator import weight_doubt
from knee_contact_ros.model.knee import KneeModel
from knee_contact_ros.model.laws import CONTACT_LAWS, ContactLaw, check, hertz_stiffness, relative_radius
from knee_contact_ros.model.mechanisms import MECHANISMS
from knee_contact_ros.model.profiles import Circle, Profile
from knee_contact_ros.model.readouts import POINT_CONTACT, SPREADS, ContactPatch
from knee_contact_ros.model.surfaces import TIBIAL_GEOMETRIES, ContactPair
from knee_contact_ros.model.ticks import LEVELS
from knee_contact_ros.parameters.files import (
    SHARE_FILE,
    Source,
    curve_points,
    curve_texts,
    load_parameters,
    read_share_table,
)
from knee_contact_ros.parameters.schema import ContactParameters, Parameters, constants_of
from knee_contact_ros.results import Results
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.files import DEFAULT_PARAMETERS

SHARES = {"total": 1.0, "moment_balance": 0.5, "measured_share": 0.6}
"""Fraction of the body weight that loads a compartment in `parameter_doubts`, by the load's rule; else `load.share`"""
MM = 1e3
GAIT = tuple(math.radians(degrees) for degrees in range(0, 61, 5))
"""Flexion angles of gait [rad]"""
PLATEAU = 0.045
"""Largest distance [m] of a contact from the tibia's origin along x: half a plateau's length is about 25 mm"""


def load_model(
    source: Source = DEFAULT_PARAMETERS,
    *,
    compiled: bool | None = None,
    curves: Mapping[str, str] = MappingProxyType({}),
) -> KneeModel:
    """Build the model that a parameter file (or several, or mappings) describes. Needs no ROS.

    Without an argument it is the healthy knee. Names have the same meaning as on the command line: a file as given or
    one of the package's own, like `"osteoarthritis"`. Later ones override earlier ones:
    `["osteoarthritis", "mri_femur", {"femur.mass": 8.0}]`.

    The compiled model computes the same bits about a hundred times faster. It is compiled once for every kind of knee,
    in about 7 s, and kept; after that it loads in half a second. By default a run uses it if that is faster in total,
    and a stream uses it if it is already kept. `compiled` True means always, False never. If Numba cannot be used, a
    warning says so once, and the plain model computes.

    `curves` has the contents of files that parameters name, by parameter, instead of the files. Implausible parameters
    (a stiffness or a body weight that must be in other units) cause a warning.

    Raises:
        UsageError: a parameter file cannot be read, a parameter is unknown or not allowed (see `load_parameters`), or a
            profile or a table cannot be used.
    """
    parameters = load_parameters(source)
    plain = build_model(parameters, curves=curve_texts(parameters, curves))
    model = replace(plain, compiled=compiled, results=Results)
    for doubt in parameter_doubts(parameters, model):
        warnings.warn(doubt, stacklevel=2)
    return model


def build_model(
    parameters: Parameters, *, curves: Mapping[str, str] | None = None, pair: ContactPair | None = None
) -> KneeModel:
    """Build a model from parameters, not compiled, and without warnings.

    `curves` has the contents of all needed files, by parameter; then no file is opened. With `pair` no surface is made.

    Raises:
        UsageError: a file cannot be read, or a profile, a table or the contact law cannot be used.
    """
    if pair is None:
        pair = contact_pair(parameters, curve_texts(parameters, {}) if curves is None else curves)
    return KneeModel(pair, height_prescribed=parameters.drive == "displacement", **_numbers(parameters))


def retuned(model: KneeModel, parameters: Parameters) -> KneeModel:
    """Copy of a model with the numbers of other parameters; surfaces, mechanism and drive are kept.

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
        UsageError: the law does not fulfil what `ContactLaw` requires.
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
    """Both surfaces and the mechanism of some parameters; `texts` has the contents of files by parameter."""
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
    """Rule for the load of the medial (or only) compartment; `texts` has the contents of files by parameter.

    Raises:
        UsageError: the table of shares cannot be used.
    """
    load, table = parameters.load, None
    if load.rule == "measured_share":
        table = MeasuredShare(read_share_table(load.share_file, texts[SHARE_FILE]), parameters.body_weight)
    return LoadRule(load.rule, load.share, load.compartment_spacing, table, parameters.body_weight)


def parameter_doubts(parameters: Parameters, model: KneeModel) -> list[str]:
    """Sentences about parameters in a likely wrong unit (kg, N/mm^n, MPa), and about a wait that is too short."""
    contact, pairing = parameters.contact, parameters.pairing
    doubts = [
        weight_doubt(parameters.body_weight),
        _stiffness_doubt(parameters, model),
        _place_doubt(parameters, model),
    ]
    soft, hard = contact.stiffness, contact.stiffness_2
    if len(model.law.layers) > 1 and contact.stiffness_from == "value" and hard < soft:
        finding = f"is below contact.stiffness, {soft:.7g}: bone softer than cartilage"
        doubts.append(f"contact.stiffness_2 {_units(contact, hard, finding)}")
    if pairing.angle_delay > 0.0 and pairing.wait <= pairing.angle_delay:
        doubts.append(
            f"pairing.wait {pairing.wait:.7g} s does not exceed pairing.angle_delay {pairing.angle_delay:.7g} s: "
            "live, the node answers every force before its angle arrives (INPUT_HELD)"
        )
    return [doubt for doubt in doubts if doubt]


def _place_doubt(parameters: Parameters, model: KneeModel) -> str:
    """Sentence about a femur that leaves the plateau in gait, such as one that turns about the hip; empty if none."""
    pair = model.pair
    places = [pair.mechanism.translation(angle)[0] - pair.femur.support(angle)[1] for angle in GAIT]  # if level
    if max(map(abs, places)) <= PLATEAU:
        return ""
    return (
        f"femur.profile {parameters.femur.profile} touches the tibia at x = {MM * min(places):.0f} to "
        f"{MM * max(places):.0f} mm in 0 to 60 degrees of flexion, and a plateau ends before {MM * PLATEAU:.0f} mm: is "
        "its origin the hip's or the scanner's, and not the joint's axis (fit-profile --origin)?"
    )


def _stiffness_doubt(parameters: Parameters, model: KneeModel) -> str:
    """Sentence about a stiffness or modulus that gives an implausible depth under the body weight; empty if it fits."""
    contact, share = parameters.contact, SHARES.get(parameters.load.rule, parameters.load.share)
    load, limit = share * parameters.body_weight, model.plausible_depth
    depth = model.static_depth(load)
    if depth <= limit:
        return ""
    finding = f"gives {MM * depth:.3g} mm of depth under {load:.1f} N ({share:g} body weights), {beyond_words(model)}"
    if contact.stiffness_from == "material" or contact.law == "elastic_foundation":
        value = contact.youngs_modulus
        return f"contact.youngs_modulus {value:.7g} Pa {finding}; {value:.7g} MPa would be {1e6 * value:.7g} Pa"
    return f"contact.stiffness {_units(contact, contact.stiffness, finding)}"


def beyond_words(model: KneeModel) -> str:
    """Phrase for the largest plausible depth of a model."""
    limit = model.plausible_depth
    what = "the cartilage's thickness" if limit == model.law.thickness else "a fifth of the femoral radius"
    return f"beyond {MM * limit:.3g} mm, {what}"


def _units(contact: ContactParameters, stiffness: float, finding: str) -> str:
    """Phrase with a stiffness, a finding about it, and what it would be if it were meant in N/mm^n."""
    per_metre, per_millimetre = (f"N/{unit}^{contact.exponent:g}" for unit in ("m", "mm"))
    meant = f"{MM**contact.exponent * stiffness:.7g} {per_metre}"
    return f"{stiffness:.7g} {per_metre} {finding}; {stiffness:.7g} {per_millimetre} would be {meant}"
