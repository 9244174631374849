"""The parameters that a bag is computed with: given ones, those of a recording, or those of a person's subject file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from operator import attrgetter
from pathlib import Path
from typing import Any

from pydantic import Field, ValidationError

from knee_contact_ros.bags.bag import Bag
from knee_contact_ros.bags.provenance import Provenance, read_provenance, with_values
from knee_contact_ros.joint_reaction.leg import GRAVITY
from knee_contact_ros.parameters.curves import curve_texts
from knee_contact_ros.parameters.files import (
    SAME_WEIGHT,
    ParameterSource,
    dotted,
    first_error,
    load_parameters,
    own_names,
)
from knee_contact_ros.parameters.load_schema import LoadParameters
from knee_contact_ros.parameters.schema import Parameters, constants_of
from knee_contact_ros.parameters.sections import Section
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.files import DEFAULT_PARAMETERS, expand_user, find_file, read_mapping

FEMORAL_SHARE = 9.3014 / 75.16
"""Ratio of the masses of the femur's segment and the body in OpenSim's model gait2354, which scales both alike"""


def resolved_parameters(basis: Parameters | Provenance) -> Parameters:
    """Return the parameters that a bag is computed with: given ones, or those of a recording."""
    return basis.parameters if isinstance(basis, Provenance) else basis


def file_contents(basis: Parameters | Provenance) -> Mapping[str, str]:
    """Return the contents of the files that parameters name, by parameter.

    Raises:
        UsageError: a file cannot be read, or its contents are not in the recording.
    """
    return basis.file_contents() if isinstance(basis, Provenance) else curve_texts(basis, {})


def basis_of(
    bag: Bag,
    params: ParameterSource | None,
    values: Mapping[str, Any],
    person: Subject | None,
    namespace: str = "",
) -> Parameters | Provenance:
    """Return the parameters to compute a bag with: the given ones, else those in a recording, else the healthy knee.

    `values`, by dotted names, override `params`, and `params` override the subject file of a `person`. Of parameter
    files, the sections for a node in `namespace` are used.

    Raises:
        UsageError: parameters or the recording cannot be used; see `load_parameters` and `read_provenance`.
    """
    stored = read_provenance(bag) if params is None and person is None else None
    if stored:
        return with_values(stored, values)
    if params is None:
        params = () if person else DEFAULT_PARAMETERS
    given = params if isinstance(params, Sequence) and not isinstance(params, str) else [params]
    sources = [*(person.sources() if person else ()), *given, values]
    parameters: Parameters = parameters_for(bag, sources, namespace)
    if person and person.content.thickness is not None:
        law = parameters.contact.law
        if "layer_depth" not in constants_of(law):
            raise UsageError(
                f"subject file {person.path}: thickness: {person.content.thickness:g} is not used "
                f"by contact.law {law}"
            )
    return parameters


def parameters_for(
    bag: Bag, sources: Sequence[Any], namespace: str = "", schema: Any = Parameters
) -> Any:
    """Load parameters for a bag: the body weight that it was imported with is used, unless the sources set another one.

    Raises:
        UsageError: as for `load_parameters`.
    """
    return with_body_weight(sources, bag.body_weight, namespace, schema)


def with_body_weight(
    sources: Sequence[Any], weight: float | None, namespace: str = "", schema: Any = Parameters
) -> Any:
    """Load parameters for a body weight [N], unless the sources set another one; see `parameters_for`."""
    parameters = load_parameters(list(sources), schema, namespace)
    if weight is None:
        return parameters
    values = {"body_weight": weight}
    if schema is LoadParameters:
        values = {"person.mass": weight * (1.0 / GRAVITY)}
    (name,) = values
    value_of = attrgetter(name)
    is_given = any(
        isinstance(each, Mapping) and name in own_names(dotted(each), schema) for each in sources
    )
    if is_given or value_of(parameters) != value_of(load_parameters([], schema)):
        return parameters
    return load_parameters([*sources, values], schema, namespace)


def unset_person(parameters: Parameters | LoadParameters) -> str:
    """Return a phrase if nobody has set the person's weight or mass, so that the default is used; else it is empty."""
    name = next(iter(parameters.about_person))
    *section, inner = name.split(".")
    part = getattr(parameters, section[0]) if section else parameters
    return "" if inner in part.model_fields_set else f", which nobody has set (-p {name}:=...)"


def weight_row(bag: Bag, parameters: Parameters) -> dict[str, str]:
    """Return a row for a summary that says where the body weight comes from, if the user has not set it."""
    weight, unset = f"{parameters.body_weight:.7g} N", unset_person(parameters)
    if bag.body_weight == parameters.body_weight:
        return {"body weight": f"{weight}, as {bag.path.name} was imported with"}
    return {"body weight": f"{weight}{unset}"} if unset else {}


def weight_doubt(bag: Bag, parameters: Parameters | LoadParameters) -> list[str]:
    """Return a sentence that a bag was imported with another body weight than that of the parameters, in a list."""
    if isinstance(parameters, LoadParameters):
        used = parameters.person.mass * GRAVITY
        given = f"person.mass {used / GRAVITY:.7g} kg"
    else:
        used = parameters.body_weight
        given = f"body_weight {used:.7g} N"
    weight = bag.body_weight
    if weight is None or abs(used - weight) <= SAME_WEIGHT * weight:
        return []
    return [f"{given} is used as you gave it, but bag {bag} was imported with {weight:.7g} N"]


class SubjectFile(Section):
    """Content of a subject file: properties of a person's knee, and the gait to compute."""

    name: str = ""
    """Name of the person; it is not used"""
    mass: float = Field(ge=1.0, le=500.0)
    """Mass of the body [kg]"""
    parameters: list[str] = Field([DEFAULT_PARAMETERS], min_length=1)
    """Parameter files; a later one overrides earlier ones"""
    profile: str = ""
    """CSV file of the femoral profile, x and y [m]; empty for none"""
    tibial_profile: str = ""
    """CSV file of the tibial profile, x and y [m]; empty for none"""
    scale: float = Field(1.0, ge=0.2, le=5.0)
    """Factor by which this knee is larger than the given surfaces"""
    thickness: float | None = Field(None, gt=0.0, le=0.1)
    """Thickness of the cartilage [m], at which the bone's stiffness begins; None keeps the parameter"""
    joint: str = ""
    """Name of the knee's joint in joint_states; empty keeps the parameter"""
    bag: str = ""
    """Bag with the gait; empty for none"""


class Subject:
    """Subject of a subject file; the files that it names are in its folder, or among the package's own."""

    def __init__(self, path: Path) -> None:
        """Read a subject file.

        Raises:
            UsageError: it cannot be read, or has an entry that is not allowed.
        """
        self.path = path
        mapping = read_mapping(path, "subject file", "names to values")
        try:
            self.content = SubjectFile.model_validate(dict(mapping))
        except ValidationError as error:
            raise UsageError(f"subject file {path}: {first_error(error)}") from None

    @property
    def bag(self) -> Path | None:
        """Gait bag that the file names; None if it names none."""
        return self._file(self.content.bag) if self.content.bag else None

    def sources(self) -> list[Path | Mapping[str, Any]]:
        """Return sources for `load_parameters`: the subject's parameter files, and its own values, which override them.

        Raises:
            UsageError: one of the parameter files cannot be used.
        """
        content = self.content
        files = [self._file(name) for name in content.parameters]
        before = load_parameters(files)
        values: dict[str, Any] = {
            "body_weight": content.mass * GRAVITY,
            "femur.mass": content.mass * FEMORAL_SHARE,
        }
        if content.thickness is not None:
            values["contact.layer_depth"] = content.thickness
        if content.joint:
            values["knee.joint_name"] = content.joint
        surfaces = (
            ("femur", content.profile, before.femur),
            ("tibia", content.tibial_profile, before.tibia),
        )
        for bone, profile, surface in surfaces:
            if profile:
                values |= {
                    f"{bone}.geometry": "profile",
                    f"{bone}.profile": str(self._file(profile)),
                }
            if profile or surface.geometry == "profile":
                values[f"{bone}.scale"] = content.scale
            elif surface.geometry == "circle":
                values[f"{bone}.radius"] = surface.radius * content.scale
        return [*files, values]

    def _file(self, name: str) -> Path:
        path = expand_user(name)
        beside = self.path.parent / path
        return path if path.is_absolute() else beside if beside.exists() else find_file(name)
