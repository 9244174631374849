"""Parameters from ROS 2 parameter files and from mappings, for the node, the commands and `load_model` alike."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import ValidationError

from knee_contact_ros.parameters.compartments import BOTH
from knee_contact_ros.parameters.lateral import (
    LATERAL,
    has_both,
    lateral_knee,
    own_and_rest,
    with_medial_values,
    without_medial_values,
)
from knee_contact_ros.parameters.limits import Limits, limits_of
from knee_contact_ros.parameters.schema import Parameters, Section
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.resources import parameter_file, shipped_parameter_files
from knee_contact_ros.system.yaml_file import read_mapping

NODE_NAME = "knee_contact"
Part = Parameters | Mapping[str, Any] | str | Path
Source = Part | Sequence[Part]
"""Where parameters come from; of several, the later one wins"""
ALLOWED = "a parameter file's name, a mapping of parameters, or a list of these"
LONGEST_VALUE = 80
"""Characters of a value that an error shows"""
STANDARD_PARAMETERS = ("use_sim_time", "start_type_description_service")
"""Parameters that every ROS 2 node has; QoS overrides (`qos_overrides.…`) come on top."""


class Declaration(NamedTuple):
    """What is declared of a parameter."""

    default: Any
    description: str
    limits: Limits


def known_parameters() -> dict[str, Declaration]:
    """Every parameter by its dotted name."""
    return dict(_declared(Parameters, ""))


def _declared(section: type[Section], before: str) -> Iterator[tuple[str, Declaration]]:
    for name, field in section.model_fields.items():
        if isinstance(field.default, Section):
            yield from _declared(type(field.default), f"{before}{name}.")
        else:
            yield before + name, Declaration(field.default, field.description or "", limits_of(field))


def all_values(parameters: Parameters) -> dict[str, Any]:
    """All values by their dotted names."""
    return dotted(parameters.model_dump())


def flat_parameters(parameters: Parameters) -> dict[str, Any]:
    """The same without those of the lateral compartment that are the medial one's, and follow them in an overlay."""
    return without_medial_values(all_values(parameters))


def load_parameters(
    source: Source,
) -> Parameters:
    """Read parameters from a ROS 2 parameter file, from a mapping, or from several of these (the later one wins).

    A name that is not found in the working folder is looked up among the package's own (`parameter_file`). A mapping
    may be nested, dotted (`{"contact.damping": 0.0}`) or have a parameter file's full form.

    Raises:
        UsageError: a file that cannot be read, or an unknown name, a wrong type or a value outside its range.
    """
    if isinstance(source, Parameters):
        return source
    parts = source if isinstance(source, Sequence) and not isinstance(source, str) else [source]
    merged: dict[str, Any] = {}
    for part in parts:
        if not isinstance(part, (Parameters, Mapping, str, Path)) or part == "":
            raise UsageError(f"parameters: {_short(repr(part))} is not allowed; {ALLOWED}")
        if isinstance(part, Parameters):
            merged |= flat_parameters(part)
            continue
        merged |= dotted(_section_of_node(part, "the mapping")) if isinstance(part, Mapping) else values_set_in(part)
    return _validated(merged, "")


def variations_of(parameters: Parameters) -> Callable[[Mapping[str, Any]], Parameters]:
    """What makes other parameters of these, given some values: as `load_parameters` does, in a tenth of its time.

    Sections that no value belongs to have been checked, and are taken as they are. Lateral values that follow medial
    ones do so where both compartments are modelled; elsewhere nothing asks for them.
    """
    flat, known = flat_parameters(parameters), known_parameters()
    following = [name for name in known if name.startswith(LATERAL) and name not in flat and has_both(parameters)]

    def varied(values: Mapping[str, Any]) -> Parameters:
        if "load.compartment" in values:
            return load_parameters(flat | dict(values))
        given = with_medial_values(values, following)
        return _checked(_with_values(parameters, _nested(given, known, "")), "")

    return varied


def _with_values(section: Section, values: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of a section with other values, by section and name, which are still to be checked."""
    fields = dict(vars(section))
    for name, value in values.items():
        own = fields[name]
        fields[name] = _with_values(own, value) if isinstance(own, Section) else value
    return fields


def values_set_in(name: str | Path) -> dict[str, Any]:
    """What a parameter file sets, by dotted names; its own values are checked.

    Raises:
        UsageError: as `load_parameters`.
    """
    values = dotted(_section_of_node(_read(name), str(name)))
    _validated(values, f"{name}: ")
    return values


def _read(name: str | Path) -> Mapping[str, Any]:
    """The content of a parameter file."""
    path = parameter_file(str(name))
    if not path.exists() and path.name == str(name):
        shipped = [path.stem for path in shipped_parameter_files()]
        near = difflib.get_close_matches(path.stem, shipped, n=1, cutoff=0.5)
        reason = f"it is neither there nor one of the package's own ({', '.join(shipped)})"
        reason += f"; did you mean {near[0]}?" if near else ""
        raise UsageError(f"{_short(str(name))}: cannot read the parameter file: {reason}")
    return read_mapping(path)


def check_parameter_file(path: Path) -> None:
    """Check a file that ROS will read; sections of other nodes are none of our business.

    Raises:
        UsageError: as `load_parameters`.
    """
    sections = _sections_of_node(read_mapping(path), str(path))
    for_all = {
        name: value for key, section in sections.items() if not _is_own(key) for name, value in dotted(section).items()
    }
    own = [dotted(section) for key, section in sections.items() if _is_own(key)]
    for values in own or [{}]:  # knees in several namespaces may share a file
        _validated(for_all | values, f"{path}: ")


def _section_of_node(content: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    """Parameters of our node in a parameter file's content, or the content itself if it has no node names."""
    ours = _sections_of_node(content, name)
    if ours:
        merged: dict[str, Any] = {}
        for section in ours.values():
            merged |= dotted(section)
        return merged
    if any(isinstance(value, Mapping) and "ros__parameters" in value for value in content.values()):
        raise UsageError(f"{name}: no parameters for node {NODE_NAME}; found {_short(', '.join(map(str, content)))}")
    return content


def _sections_of_node(content: Mapping[str, Any], name: str) -> dict[str, Mapping[str, Any]]:
    """Our node's sections of a parameter file by their keys; wildcards first, so that the node's own section wins."""
    ours = [
        key
        for key, value in content.items()
        if isinstance(value, Mapping) and "ros__parameters" in value
        and str(key).rsplit("/", 1)[-1] in (NODE_NAME, "*", "**")
    ]  # fmt: skip
    sections = {}
    for key in sorted(ours, key=_is_own):
        section = content[key]["ros__parameters"] or {}
        if not isinstance(section, Mapping):
            raise UsageError(f"{name}: {key}: ros__parameters must map names to values, got {_short(repr(section))}")
        sections[key] = section
    return sections


def _is_own(key: object) -> bool:
    """Whether a section is for a node of our name, and not for every node."""
    return str(key).endswith(NODE_NAME)


def dotted(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested or dotted names to dotted names."""
    flat: dict[str, Any] = {}
    for key, value in values.items():
        if isinstance(value, Mapping):
            flat |= dotted(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = value
    return flat


def check_value(name: str, value: Any) -> None:
    """Refuse an unknown parameter, or a value that it may not have whatever the others are.

    Raises:
        UsageError: see above.
    """
    _made(_nested({name: value}, known_parameters(), ""), "")


def _validated(values: Mapping[str, Any], where: str) -> Parameters:
    """Check dotted values against the declarations."""
    known = known_parameters()
    return _checked(_nested(with_medial_values(values, known), known, where), where)


def _nested(values: Mapping[str, Any], known: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Dotted values by section and name; those that every node has are left out."""
    nested: dict[str, Any] = {}
    for name, value in values.items():
        if name in STANDARD_PARAMETERS or name.startswith("qos_overrides."):
            continue
        if name not in known:
            near = difflib.get_close_matches(_short(name), known, n=1, cutoff=0.5)
            hint = f"did you mean {near[0]}?" if near else f"known are {', '.join(own_and_rest(known))}"
            raise UsageError(f"{where}unknown parameter {_short(name)}; {hint}")
        *sections, inner = name.split(".")
        place = nested
        for section in sections:
            place = place.setdefault(section, {})
        place[inner] = value
    return nested


def _made(nested: Mapping[str, Any], where: str) -> Parameters:
    """Parameters from values by section and name, each checked alone."""
    try:
        return Parameters.model_validate(nested)
    except ValidationError as error:
        raise UsageError(f"{where}parameter {first_error(error)}") from None


def _checked(nested: Mapping[str, Any], where: str) -> Parameters:
    """The same, checked with each other, too."""
    parameters = _made(nested, where)
    _check_together(parameters, where)
    if has_both(parameters):
        if parameters.drive != "force":
            reason = f"{BOTH!r} is not allowed; drive {parameters.drive} has no load that could be split"
            raise UsageError(f"{where}parameter load.compartment: {reason}")
        _check_together(lateral_knee(parameters), where, LATERAL)
    return parameters


def _check_together(parameters: Parameters, where: str, before: str = "") -> None:
    """Refuse values that are allowed alone but not with each other; their names begin with `before`."""
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


def first_error(error: ValidationError) -> str:
    """The first of what is wrong, in one line: name, value, and what is allowed."""
    first = error.errors()[0]
    name = ".".join(map(str, first["loc"]))
    reason = first["msg"].removeprefix("Value error, ").replace("Input should be", "it should be")
    if first["type"] in ("missing", "extra_forbidden"):
        return f"{name}: {'is missing' if first['type'] == 'missing' else 'is not known'}"
    return f"{name}: {_short(repr(first['input']))} is not allowed; {reason}"


def _short(text: str) -> str:
    return text if len(text) <= LONGEST_VALUE else f"{text[:LONGEST_VALUE]}..."
