"""The parameters, declared here once with type, range, default and meaning.

The node, the offline commands and `load_model` all come through here, so a value means the same everywhere.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from knee_contact_ros.compartments import COMPARTMENTS
from knee_contact_ros.core.contact_laws import CONTACT_LAWS
from knee_contact_ros.core.contact_pairs import TIBIAL_GEOMETRIES
from knee_contact_ros.core.geometries import GEOMETRIES
from knee_contact_ros.core.levels import LEVELS
from knee_contact_ros.core.mechanisms import MECHANISMS
from knee_contact_ros.errors import UsageError
from knee_contact_ros.yaml_file import read_mapping

NODE_NAME = "knee_contact"
LONGEST_VALUE = 80
"""Characters of a value that an error shows"""
STANDARD_PARAMETERS = ("use_sim_time", "start_type_description_service")
"""Parameters that every ROS 2 node has; QoS overrides (`qos_overrides.…`) come on top."""


def one_of(*allowed: str | float) -> AfterValidator:
    """Allow these values only."""

    def check(value: Any) -> Any:
        if value not in allowed:
            raise ValueError(f"allowed: {', '.join(map(str, allowed))}")
        return value

    return AfterValidator(check)


def _budget(value: int) -> int:
    if 0 < value < 100 or value < 0:
        raise ValueError("allowed: 0 (no limit) or an integer >= 100")
    return value


def _off_or_at_least(least: float) -> AfterValidator:
    """Allow 0, which means off, and values from `least` on."""

    def check(value: float) -> float:
        if 0.0 < value < least or value < 0.0:
            raise ValueError(f"allowed: 0 (off) or a number >= {least:g}")
        return value

    return AfterValidator(check)


def _off(value: object) -> object:
    """ROS 2 parameter files take a bare `off` for the truth value false (YAML 1.1)."""
    return "off" if value is False else value


class Section(BaseModel):
    """A group of parameters; names and types are strict, numbers finite."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)


class Knee(Section):
    """Which joint, and how its position becomes the flexion angle: flexion_sign x position + flexion_offset."""

    joint_name: str = Field("knee", min_length=1, description="joint in joint_states")
    flexion_sign: Annotated[float, one_of(1.0, -1.0)] = Field(
        1.0, description="1 if the position grows in flexion, or -1"
    )
    flexion_offset: float = Field(0.0, description="[rad] added to the signed position")
    height_joint_name: str = Field(
        "knee_height", min_length=1, description="drive displacement: joint whose position is the femoral height [m]"
    )


class Load(Section):
    """Which part of the axial joint reaction drives the compartment."""

    compartment: Annotated[str, one_of(*COMPARTMENTS)] = Field("fixed_share", description=", ".join(COMPARTMENTS))
    share: float = Field(0.5, gt=0.0, le=1.0, description="medial share of the axial joint reaction; fixed_share")
    compartment_spacing: float = Field(
        0.04, ge=0.005, le=0.2, description="[m] from the medial to the lateral compartment; moment_balance"
    )


class Pairing(Section):
    """How angle and force samples are brought together by their stamps."""

    wait: float = Field(
        0.1, ge=0.0, le=10.0, description="[s] how long a force waits for an angle at or after its stamp"
    )
    max_gap: float = Field(
        0.1, gt=0.0, le=3600.0, description="[s] largest gap between stamps that is not flagged stale"
    )
    queue: int = Field(
        20_000, ge=100, le=10**7, description="samples of a stream that may wait for the other one, at most"
    )


class Femur(Section):
    """The femur: its mass and the surface that touches."""

    mass: float = Field(9.3014, ge=1e-4, le=1e3, description="[kg] that follows the reference point")
    geometry: Annotated[str, one_of(*GEOMETRIES)] = Field("circle", description=" or ".join(GEOMETRIES))
    radius: float = Field(0.034, gt=0.0, le=1.0, description="[m] of the circle")
    profile: str = Field("", description="CSV of x, y [m] in the femur frame, ordered along the curve")
    scale: float = Field(1.0, ge=0.1, le=10.0, description="of the profile's points")


class Tibia(Section):
    """The plateau."""

    geometry: Annotated[str, one_of(*TIBIAL_GEOMETRIES)] = Field("plane", description=" or ".join(TIBIAL_GEOMETRIES))
    slope: float = Field(
        0.0, ge=-0.7, le=0.7, description="[rad] of the plane, > 0 when the anterior edge is the higher one"
    )
    radius: float = Field(0.095, gt=0.0, le=10.0, description="[m] of the concave circle")
    profile: str = Field("", description="CSV of x, y [m] in the tibia frame, from posterior to anterior")
    scale: float = Field(1.0, ge=0.1, le=10.0, description="of the profile's points")


class Translation(Section):
    """Anterior-posterior translation of the femur."""

    mechanism: Annotated[str, one_of(*MECHANISMS)] = Field("hinge", description=", ".join(MECHANISMS))
    table: str = Field("", description="CSV of flexion_angle [rad], x [m] of the femoral reference point")


class ContactParameters(Section):
    """The contact law and its constants."""

    law: Annotated[str, one_of(*CONTACT_LAWS)] = Field("kelvin_voigt", description=", ".join(CONTACT_LAWS))
    stiffness: float = Field(7.905694e7, ge=1.0, le=1e15, description="[N/m^exponent] of the first layer")
    exponent: float = Field(1.5, ge=1.0, le=3.0, description="of the depth; 1.5 for two curved solids")
    damping: float = Field(5000.0, ge=0.0, le=1e9, description="[N s/m]")
    allow_tension: bool = Field(False, description="let the law pull instead of clamping it at 0")
    layer_depth: float = Field(5.0e-4, gt=0.0, le=0.1, description="[m] at which the second layer begins")
    stiffness_2: float = Field(3.112e9, ge=1.0, le=1e15, description="[N/m^exponent] of the second layer")
    damp_first_layer: bool = Field(False, description="two_layer_viscoelastic: put the dashpot into both layers")
    restitution: float = Field(0.5, ge=0.01, le=1.0, description="asked for; laws with impact damping")
    least_impact_speed: float = Field(
        0.1, ge=1e-6, le=100.0, description="[m/s] that slower touches, and the static start, count as"
    )
    stiffness_from: Annotated[str, one_of("value", "material")] = Field(
        "value", description="value, or material: Hertz from modulus, Poisson's ratio and radii (exponent 1.5)"
    )
    youngs_modulus: float = Field(24e6, ge=1.0, le=1e13, description="[Pa] of cartilage (first layer)")
    poissons_ratio: float = Field(0.38, ge=0.0, lt=0.5, description="of cartilage (first layer)")
    youngs_modulus_2: float = Field(17.2e9, ge=1.0, le=1e13, description="[Pa] of bone (second layer)")
    poissons_ratio_2: float = Field(0.39, ge=0.0, lt=0.5, description="of bone (second layer)")
    femoral_radius: float = Field(0.034, gt=0.0, le=10.0, description="[m] convex, for the stiffness only")
    tibial_radius: float = Field(0.095, gt=0.0, le=10.0, description="[m] concave, for the stiffness only")
    foundation_thickness: float = Field(
        4.4e-3, gt=0.0, le=0.1, description="[m] of both cartilages; elastic_foundation"
    )


class FidelityParameters(Section):
    """How exactly to solve, and how much that may cost."""

    level: Annotated[str, one_of(*LEVELS)] = Field("auto", description=", ".join(LEVELS) + " (which picks one)")
    tolerance: float = Field(1.0e-6, ge=1e-12, le=1e-3, description="[m] wanted error of the penetration depth")
    force_tolerance: Annotated[float, _off_or_at_least(1e-9)] = Field(
        0.0, le=1e6, description="[N] wanted error of the contact force; 0: off"
    )
    budget: Annotated[int, AfterValidator(_budget)] = Field(
        0, description="contact law evaluations a tick may cost; 0: no limit"
    )


def _queue(answers: int) -> Any:
    """Answers that may wait for an output's process."""
    return Field(answers, ge=100, le=10_000_000, description="answers that may wait for its process")


def _queue_size(size: float) -> Any:
    """The same in bytes."""
    return Field(size, ge=1.0, le=1e5, description="[MB] of memory that these may take")


class Record(Section):
    """Recording to MCAP."""

    path: str = Field("", description="MCAP file to write; empty: none")
    flush_period: float = Field(0.03, ge=0.001, le=60.0, description="[s] what a crash of the programs may lose")
    sync_period: Annotated[float, _off_or_at_least(0.05)] = Field(
        1.0, le=3600.0, description="[s] what a power failure may lose; 0: off"
    )
    max_size: Annotated[float, _off_or_at_least(0.1)] = Field(
        0.0, le=1e9, description="[MB] of a file, from which on the recording goes on in a new one; 0: off"
    )
    max_duration: Annotated[float, _off_or_at_least(1.0)] = Field(
        0.0, le=1e9, description="[s] of stamps in a file, from which on the recording goes on in a new one; 0: off"
    )
    min_free: float = Field(
        100.0, ge=0.0, le=1e9, description="[MB] that stay free on the disk: a recording ends before it takes them"
    )
    queue: int = _queue(30_000)
    queue_size: float = _queue_size(100.0)


class Rerun(Section):
    """The Rerun scene."""

    mode: Annotated[str, BeforeValidator(_off), one_of("off", "file", "serve", "spawn")] = Field(
        "off", description="off, file, serve (on this machine's loopback interface), spawn (a viewer beside it)"
    )
    path: str = Field("", description=".rrd file to write in mode file")
    port: int = Field(9876, ge=1024, le=65535, description="to serve on")
    knees: str = Field(
        "", description="names of the knees that share a viewer side by side, as left,right; empty: this knee alone"
    )
    queue: int = _queue(20_000)
    queue_size: float = _queue_size(64.0)


class Parameters(Section):
    """All parameters of the node and of the offline commands."""

    knee: Knee = Knee()
    load: Load = Load()
    pairing: Pairing = Pairing()
    drive: Annotated[str, one_of("force", "displacement")] = Field(
        "force", description="force: Eq. 13; displacement: the femoral height is prescribed, the force follows"
    )
    femur: Femur = Femur()
    tibia: Tibia = Tibia()
    translation: Translation = Translation()
    contact: ContactParameters = ContactParameters()
    fidelity: FidelityParameters = FidelityParameters()
    body_weight: float = Field(737.068, gt=0.0, le=1e5, description="[N] for reports in body weights")
    autostart: bool = Field(True, description="configure and activate without being asked")
    deadline: float = Field(
        0.02, gt=0.0, le=3600.0, description="[s] from a force to its answer; later ones are counted"
    )
    record: Record = Record()
    rerun: Rerun = Rerun()


def known_parameters() -> dict[str, tuple[Any, str]]:
    """Every parameter's dotted name, with default and description."""
    names: dict[str, tuple[Any, str]] = {}
    for name, field in Parameters.model_fields.items():
        if isinstance(field.default, Section):
            for inner, inner_field in type(field.default).model_fields.items():
                names[f"{name}.{inner}"] = (inner_field.default, inner_field.description or "")
        else:
            names[name] = (field.default, field.description or "")
    return names


def flat_parameters(parameters: Parameters) -> dict[str, Any]:
    """All values by their dotted names."""
    return _flat(parameters.model_dump())


def load_parameters(
    source: Parameters | Mapping[str, Any] | str | Path | Sequence[str | Path | Mapping[str, Any]],
) -> Parameters:
    """Read parameters from a ROS 2 parameter file, from a mapping, or from several of these (the later one wins).

    A mapping may be nested, dotted (`{"contact.damping": 0.0}`) or have a parameter file's full form.

    Raises:
        UsageError: a file that cannot be read, or an unknown name, a wrong type or a value outside its range.
    """
    if isinstance(source, Parameters):
        return source
    if isinstance(source, Mapping):
        return _validated(_flat(_section_of_node(source, "the mapping")), "")
    parts = [source] if isinstance(source, (str, Path)) else source
    merged: dict[str, Any] = {}
    for part in parts:
        if isinstance(part, Mapping):
            merged |= _flat(_section_of_node(part, "the mapping"))
            continue
        values = _flat(_section_of_node(read_mapping(Path(part)), str(part)))
        _validated(values, f"{part}: ")
        merged |= values
    return _validated(merged, "")


def check_parameter_file(path: Path) -> None:
    """Check a file that ROS will read; sections of other nodes are none of our business.

    Raises:
        UsageError: as `load_parameters`.
    """
    sections = _sections_of_node(read_mapping(path), str(path))
    for_all = {
        name: value for key, section in sections.items() if not _is_own(key) for name, value in _flat(section).items()
    }
    own = [_flat(section) for key, section in sections.items() if _is_own(key)]
    for values in own or [{}]:  # knees in several namespaces may share a file
        _validated(for_all | values, f"{path}: ")


def _section_of_node(content: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    """Parameters of our node in a parameter file's content, or the content itself if it has no node names."""
    ours = _sections_of_node(content, name)
    if ours:
        merged: dict[str, Any] = {}
        for section in ours.values():
            merged |= _flat(section)
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


def _flat(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested or dotted names to dotted names."""
    flat: dict[str, Any] = {}
    for key, value in values.items():
        if isinstance(value, Mapping):
            flat |= _flat(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = value
    return flat


def _validated(values: Mapping[str, Any], where: str) -> Parameters:
    """Check dotted values against the declarations."""
    known = known_parameters()
    nested: dict[str, Any] = {}
    for name, value in values.items():
        if name in STANDARD_PARAMETERS or name.startswith("qos_overrides."):
            continue
        if name not in known:
            near = difflib.get_close_matches(_short(name), known, n=1, cutoff=0.5)
            hint = f"did you mean {near[0]}?" if near else f"known are {', '.join(known)}"
            raise UsageError(f"{where}unknown parameter {_short(name)}; {hint}")
        section, _, inner = name.rpartition(".")
        (nested.setdefault(section, {}) if section else nested)[inner] = value
    try:
        parameters = Parameters.model_validate(nested)
    except ValidationError as error:
        raise UsageError(f"{where}parameter {first_error(error)}") from None
    _check_together(parameters, where)
    return parameters


def _check_together(parameters: Parameters, where: str) -> None:
    """Refuse values that are allowed alone but not with each other."""
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
            raise UsageError(f"{where}parameter {reason}")


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
