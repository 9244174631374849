"""Reads the parameters of the contact node, in the same way for the node, the commands and `load_model`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from knee_contact_ros.parameters.compartments import BOTH
from knee_contact_ros.parameters.declared import Declaration, NodeReading, all_values, dotted, first_error
from knee_contact_ros.parameters.lateral import (
    LATERAL,
    has_both,
    lateral_knee,
    own_and_rest,
    with_medial_values,
    without_medial_values,
)
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.parameters.sections import Section
from knee_contact_ros.system.errors import UsageError

__all__ = ["Declaration", "all_values", "dotted", "first_error"]
Part = Parameters | Mapping[str, Any] | str | Path
Source = Part | Sequence[Part]
"""Source of parameters: a file, a mapping, or several of these, of which the later one wins"""


def known_parameters() -> dict[str, Declaration]:
    """Declarations of all parameters, by dotted name."""
    return READING.known()


def flat_parameters(parameters: Parameters) -> dict[str, Any]:
    """All values by dotted name, without lateral ones that equal the medial ones: in an overlay they follow these."""
    return READING.flat(parameters)


def load_parameters(source: Source) -> Parameters:
    """Read parameters from a ROS 2 parameter file, from a mapping, or from several of these (the later one wins).

    The forms of a source are described at `NodeReading.load`.

    Raises:
        UsageError: a file cannot be read, or a name is unknown, a type wrong or a value outside its range.
    """
    return READING.load(source)


def variations_of(parameters: Parameters) -> Callable[[Mapping[str, Any]], Parameters]:
    """Function that returns these parameters with some values changed, in a tenth of the time of `load_parameters`.

    Sections without a changed value are not checked again. Lateral values follow the medial ones where both
    compartments are modelled; elsewhere nothing uses them.
    """
    flat, known = flat_parameters(parameters), known_parameters()
    following = [name for name in known if name.startswith(LATERAL) and name not in flat and has_both(parameters)]

    def varied(values: Mapping[str, Any]) -> Parameters:
        if "load.compartment" in values:
            return load_parameters(flat | dict(values))
        given = with_medial_values(values, following)
        return READING.checked(_with_values(parameters, READING.nested(given, "", known)), "")

    return varied


def _with_values(section: Section, values: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of a section with some values replaced, given by section and name; they are still to be checked."""
    fields = dict(vars(section))
    for name, value in values.items():
        own = fields[name]
        fields[name] = _with_values(own, value) if isinstance(own, Section) else value
    return fields


def values_set_in(name: str | Path) -> dict[str, Any]:
    """Values that a parameter file sets, by dotted name; they are checked.

    Raises:
        UsageError: as for `load_parameters`.
    """
    return READING.set_in(name)


def check_value(name: str, value: Any) -> None:
    """Check a single value, without its relation to other parameters.

    Raises:
        UsageError: the parameter is unknown, or the value is not allowed whatever the others are.
    """
    READING.made(READING.nested({name: value}, ""), "")


def _completed(values: Mapping[str, Any]) -> dict[str, Any]:
    return with_medial_values(values, known_parameters())


def _check(parameters: Parameters, where: str) -> None:
    """Refuse combinations of values that are not allowed, for both compartments."""
    _check_together(parameters, where)
    if has_both(parameters):
        if parameters.drive != "force":
            reason = f"{BOTH!r} is not allowed; drive {parameters.drive} has no load that could be split"
            raise UsageError(f"{where}parameter load.compartment: {reason}")
        _check_together(lateral_knee(parameters), where, LATERAL)


def _check_together(parameters: Parameters, where: str, before: str = "") -> None:
    """Refuse combinations of values that are not allowed; `before` begins the names in the errors."""
    femur, tibia, contact, translation = parameters.femur, parameters.tibia, parameters.contact, parameters.translation
    material = contact.stiffness_from == "material"
    rules = (
        (femur.geometry == "profile" and not femur.profile,
         "femur.profile is empty; femur.geometry profile needs the name of a CSV file"),
        (tibia.geometry == "profile" and not tibia.profile,
         "tibia.profile is empty; tibia.geometry profile needs the name of a CSV file"),
        (femur.geometry != "profile" and femur.scale != 1.0,
         f"femur.scale: {femur.scale:g} is not allowed; only femur.geometry profile is scaled"),
        (tibia.geometry != "profile" and tibia.scale != 1.0,
         f"tibia.scale: {tibia.scale:g} is not allowed; only tibia.geometry profile is scaled"),
        (tibia.geometry != "plane" and tibia.slope != 0.0,
         f"tibia.slope: {tibia.slope:g} is not allowed; only tibia.geometry plane has a slope"),
        (tibia.geometry == "circle" and femur.geometry == "circle" and tibia.radius <= femur.radius,
         f"tibia.radius: {tibia.radius:g} is not allowed; it must exceed femur.radius, {femur.radius:g}"),
        (translation.mechanism == "table" and not translation.table,
         "translation.table is empty; translation.mechanism table needs the name of a CSV file"),
        (parameters.load.rule == "measured_share" and not parameters.load.share_file,
         "load.share_file is empty; load.compartment measured_share needs the name of a CSV file"),
        (material and contact.exponent != 1.5,
         f"contact.exponent: {contact.exponent:g} is not allowed; contact.stiffness_from material needs 1.5 (Hertz)"),
        ((material or contact.law == "elastic_foundation") and contact.tibial_radius <= contact.femoral_radius,
         f"contact.tibial_radius: {contact.tibial_radius:g} is not allowed; it must exceed contact.femoral_radius, "
         f"{contact.femoral_radius:g}"),
        (parameters.rerun.mode == "file" and not parameters.rerun.path,
         "rerun.path is empty; rerun.mode file needs the name of an .rrd file"),
    )  # fmt: skip
    for broken, reason in rules:
        if broken:
            raise UsageError(f"{where}parameter {before}{reason}")


READING = NodeReading("knee_contact", Parameters, _check, _completed, without_medial_values, own_and_rest)
