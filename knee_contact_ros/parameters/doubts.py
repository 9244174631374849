"""Parameters that no knee has: a likely wrong unit, a part that never bears, a wait that is too short.

Nothing is refused here: the user may model a rat. Each finding is one sentence.
"""

from __future__ import annotations

import math

from ..joint_reaction.estimator import body_weight_doubt
from ..joint_reaction.leg import GRAVITY
from ..model.knee import KneeModel
from ..model.types import MM
from .schema import FEMORAL_SHARE, ContactSection, Parameters, constants_of, without_effect

TYPICAL_SHARES = {"total": 1.0, "moment_balance": 0.5, "measured_share": 0.6}
"""Fraction of the body weight that loads a compartment in `parameter_doubts`, by the load's rule; else `load.share`"""
GAIT_ANGLES = tuple(math.radians(degrees) for degrees in range(0, 61, 5))
"""Flexion angles of gait [rad]"""
MAX_CONTACT_PLACE = 0.045
"""Largest distance [m] of a contact from the tibia's origin along x: half a plateau's length is about 25 mm"""
LEAST_DAMPING = 5.0
"""Decay rate [1/s] of an oscillation below which a damping is doubted: it is then a fiftieth of the paper's"""
HEAVIEST_FEMUR = 0.4
"""Mass of the moved femur, as a part of the body's, above which it is doubted: three times that of a thigh"""


def parameter_doubts(parameters: Parameters, model: KneeModel) -> list[str]:
    """Sentences about parameters in a likely wrong unit (kg, N/mm^n, MPa), and about a wait that is too short."""
    contact, pairing = parameters.contact, parameters.pairing
    doubts = [
        body_weight_doubt(parameters.body_weight),
        _stiffness_doubt(parameters, model),
        _place_doubt(parameters, model),
        _damping_doubt(parameters, model),
        _layer_doubt(parameters, model),
        _mass_doubt(parameters),
        without_effect(contact, set_values(contact)),
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


def set_values(contact: ContactSection) -> list[str]:
    """Names of the parameters `contact.*` that were set to other values than their defaults."""
    fields = type(contact).model_fields
    return [
        name
        for name in fields
        if name in contact.model_fields_set and getattr(contact, name) != fields[name].default
    ]


def _damping_doubt(parameters: Parameters, model: KneeModel) -> str:
    """Sentence about a damping that must be in N s/mm; empty if it is plausible."""
    contact = parameters.contact
    used = "damping" in constants_of(contact.law)
    if not used or not 0.0 < contact.damping < 2.0 * model.mass * LEAST_DAMPING:
        return ""
    return (
        f"contact.damping {contact.damping:g} N s/m hardly damps; {contact.damping:g} N s/mm would be "
        f"{MM * contact.damping:g} N s/m"
    )


def _layer_doubt(parameters: Parameters, model: KneeModel) -> str:
    """Sentence about a first layer that is thicker than any plausible depth; empty if it is plausible."""
    depth, limit = parameters.contact.layer_depth, model.plausible_depth
    if len(model.law.layers) < 2 or depth <= limit:
        return ""
    return (
        f"contact.layer_depth {depth:g} m is {MM * depth:.3g} mm, and bone is never reached, as that is "
        f"{beyond_words(model)}; {depth:g} cm would be {1e-2 * depth:g} m"
    )


def _mass_doubt(parameters: Parameters) -> str:
    """Sentence about a femur that is as heavy as the body; empty if its mass is plausible."""
    body, mass = parameters.body_weight / GRAVITY, parameters.femur.mass
    if mass <= HEAVIEST_FEMUR * body or body_weight_doubt(parameters.body_weight):
        return ""
    return (
        f"femur.mass {mass:g} kg is {100.0 * mass / body:.0f} % of the body's {body:.4g} kg: is it the body's? A femur "
        f"has some 12 %: {FEMORAL_SHARE * body:.3g} kg"
    )


def _place_doubt(parameters: Parameters, model: KneeModel) -> str:
    """Sentence about a femur that leaves the plateau in gait, such as one that turns about the hip; empty if none."""
    pair = model.pair
    places = [
        pair.mechanism.translation(angle)[0] - pair.femur.support(angle)[1]
        for angle in GAIT_ANGLES
    ]  # if level
    if max(map(abs, places)) <= MAX_CONTACT_PLACE:
        return ""
    return (
        f"femur.profile {parameters.femur.profile} touches the tibia at x = {MM * min(places):.0f} to "
        f"{MM * max(places):.0f} mm in 0 to 60 degrees of flexion, and a plateau ends before "
        f"{MM * MAX_CONTACT_PLACE:.0f} mm: is its origin the hip's or the scanner's, and not the "
        "joint's axis (fit-profile --origin)?"
    )


def _stiffness_doubt(parameters: Parameters, model: KneeModel) -> str:
    """Sentence about a stiffness or modulus that gives an implausible depth under the body weight; empty if it fits."""
    contact, share = parameters.contact, typical_share(parameters)
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
    what = (
        "the cartilage's thickness"
        if limit == model.law.thickness
        else "a fifth of the femoral radius"
    )
    return f"beyond {MM * limit:.3g} mm, {what}"


def _units(contact: ContactSection, stiffness: float, finding: str) -> str:
    """Phrase with a stiffness, a finding about it, and what it would be if it were meant in N/mm^n."""
    per_metre, per_millimetre = (f"N/{unit}^{contact.exponent:g}" for unit in ("m", "mm"))
    meant = f"{MM**contact.exponent * stiffness:.7g} {per_metre}"
    return (
        f"{stiffness:.7g} {per_metre} {finding}; {stiffness:.7g} {per_millimetre} would be {meant}"
    )


def typical_share(parameters: Parameters) -> float:
    """Part of the knee's load that the medial, or only, compartment usually bears; known for fixed_share and total."""
    return TYPICAL_SHARES.get(parameters.load.rule, parameters.load.share)
