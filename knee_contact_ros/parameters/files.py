"""Reads parameters from ROS 2 parameter files and mappings.

The node, the commands and the functions for notebooks read them here in the same way. A source is a parameter file, a
mapping, or several of these; later ones override earlier ones.
"""

import difflib
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar, overload

from pydantic import ValidationError

from ..joint_reaction.leg import GRAVITY
from ..system.errors import UsageError, suggest
from ..system.files import (
    parameter_file,
    shipped_parameter_files,
)
from ..system.ros_files import (
    Sections,
    add_sections,
    flatten,
    matches_node,
    merge_sections,
    read_sections,
    values_for,
)
from .schema import (
    LATERAL_PREFIX,
    Parameters,
)
from .sections import (
    Declaration,
    NodeSection,
    Section,
    declaration_of,
    first_error,
    shortened,
)

STANDARD_PARAMETERS = ("use_sim_time", "start_type_description_service")
"""Parameters that every ROS 2 node has, besides QoS overrides (`qos_overrides.…`)."""
SAME_WEIGHT = 0.01
"""Largest relative difference of body weights that count as equal"""
ParameterPart = NodeSection | Mapping[str, Any] | str | Path
ParameterSource = ParameterPart | Sequence[ParameterPart]
"""Source of parameters: a file, a mapping, or several of these; later ones override earlier ones"""
_NUMBERS = {
    int: re.compile(r"[-+]?\d{1,18}"),
    float: re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?"),
}
"""Texts that are numbers of a type"""
_Schema = TypeVar("_Schema", bound=NodeSection)


@cache  # collecting them takes longer than checking values
def known_parameters(schema: type[NodeSection] = Parameters) -> Mapping[str, Declaration]:
    """Return the declarations of all parameters of a node, by dotted name."""

    def declared(section: type[Section], before: str) -> Iterator[tuple[str, Declaration]]:
        for name, field in section.model_fields.items():
            if isinstance(field.default, Section):
                yield from declared(type(field.default), f"{before}{name}.")
            else:
                yield before + name, declaration_of(section, name)

    return MappingProxyType(dict(declared(schema, "")))


def dotted(values: Mapping[str, Any]) -> dict[str, Any]:
    """Flatten a mapping with nested or dotted names to dotted names."""
    return dict(flatten(values))


def all_values(parameters: Section) -> dict[str, Any]:
    """Return all values by dotted name."""
    return dotted(parameters.model_dump())


def flat_parameters(parameters: NodeSection) -> dict[str, Any]:
    """Return all values by dotted name, without lateral ones that equal the medial ones: in an overlay they follow."""
    values = all_values(parameters)
    return {
        name: value
        for name, value in values.items()
        if not name.startswith(LATERAL_PREFIX)
        or value != values[name.removeprefix(LATERAL_PREFIX)]
    }


@overload
def load_parameters(source: ParameterSource, *, namespace: str = "") -> Parameters: ...


@overload
def load_parameters(
    source: ParameterSource, schema: type[_Schema], namespace: str = ""
) -> _Schema: ...


def load_parameters(source: Any, schema: Any = Parameters, namespace: str = "") -> Any:
    """Read the parameters of a node, by default the contact node, from a source.

    A name that is not found in the working folder is looked up among the package's own (`parameter_file`). A mapping
    may be nested, dotted (`{"contact.damping": 0.0}`) or have a parameter file's full form. From a file, the values for
    a node in `namespace` are read (`system/ros_files.py`).

    Raises:
        UsageError: a file cannot be read, or a name is unknown, a type wrong or a value outside its range.
    """
    if isinstance(source, schema):
        return source
    is_list = isinstance(source, Sequence) and not isinstance(source, str)
    merged: dict[str, Any] = {}
    # ROS takes the sections of files that follow each other together: they override what came before the first of them.
    before: dict[str, Any] = {}
    sections: Sections = {}
    # Profiles, by bone, beside which a part does not set the bone's geometry
    profiles: dict[str, Any] = {}
    for part in source if is_list else [source]:
        if isinstance(part, (str, Path)) and part != "":
            given = values_set_in(part, schema, namespace)
            merge_sections(sections, sections_in(parameter_file(str(part))))
            merged = before | _values_in(sections, schema, namespace, f"{part}: ")
        else:
            given = _values_of(part, schema, namespace)
            before = merged = merged | given
            sections = {}
        for bone in ("femur", "tibia"):
            if given.get(f"{bone}.profile") and f"{bone}.geometry" not in given:
                profiles[bone] = given[f"{bone}.profile"]
    for bone, profile in profiles.items():
        if merged.get(f"{bone}.geometry") != "profile":
            raise UsageError(
                f"parameter {bone}.profile: {profile!r} is not used; set {bone}.geometry to profile, too"
            )
    return _validated(merged, "", schema)


def _values_of(part: Any, schema: type[NodeSection], namespace: str) -> dict[str, Any]:
    """Return the values that parameters or a mapping of them set for a node in a namespace, by dotted name.

    Raises:
        UsageError: it is neither, or its sections are for other nodes.
    """
    if isinstance(part, schema):
        return flat_parameters(part)
    if not isinstance(part, Mapping):
        allowed = "a parameter file's name, a mapping of parameters, or a list of these"
        raise UsageError(f"parameters: {shortened(repr(part))} is not allowed; {allowed}")
    sections: Sections = {}
    add_sections(sections, part)
    return _own_values(sections, "the mapping", schema, namespace)


def values_set_in(
    name: str | Path, schema: type[NodeSection] = Parameters, namespace: str = ""
) -> dict[str, Any]:
    """Return the values that a parameter file sets for a node in a namespace, by dotted name; they are checked.

    Raises:
        UsageError: as for `load_parameters`.
    """
    path = parameter_file(str(name))
    if not path.exists() and str(path.parent) in (".", schema.folder):
        files = shipped_parameter_files(schema.folder)
        shipped = {each.stem: str(Path(schema.folder, each.stem)) for each in files}
        near = difflib.get_close_matches(path.stem, shipped, n=1, cutoff=0.5)
        letters = ".*".join(map(re.escape, path.stem))
        near += sorted((each for each in shipped if re.match(letters, each)), key=len)  # as oa
        reason = f"there is no such file, and it is not one of the package's own ({', '.join(shipped.values())})"
        reason += f"; did you mean {shipped[near[0]]}?" if near else ""
        raise UsageError(f"{shortened(str(name))}: cannot read the parameter file: {reason}")
    values = _own_values(sections_in(path), str(name), schema, namespace)
    _validated(values, f"{name}: ", schema)
    return values


def sections_in(path: Path) -> Sections:
    """Return the sections of a parameter file, or those that a subject file stands for.

    Raises:
        UsageError: it cannot be read or used, or is no such file.
    """
    sections = read_sections(path)
    if not is_subject(sections):
        return sections
    from .subjects import (
        Subject,  # and with it the load node's sections, which a knee alone does not need
    )

    person = Subject(path)
    given = dict[str, Any]()
    for file in person.parameter_files:
        given |= values_set_in(file)
    return person.sections(load_parameters(given), given)


def is_subject(sections: Sections) -> bool:
    """Whether the sections that were read from a file are the content of a subject file: a mass, and no node."""
    return [*sections] == ["/**"] and "mass" in sections["/**"]


def _node_name(schema: type[NodeSection], namespace: str) -> str:
    """Return the absolute name of a node in a namespace."""
    return _full_name(schema.node, namespace)


def _full_name(node: str, namespace: str) -> str:
    return f"/{namespace.strip('/')}/{node}".replace("//", "/")


def _own_values(
    sections: Sections, name: str, schema: type[NodeSection], namespace: str
) -> dict[str, Any]:
    """Return the values of the node in the sections of a file or mapping with this name.

    Raises:
        UsageError: no section is for the node.
    """
    node = _node_name(schema, namespace)
    names = [each for each in sections if each.endswith(f"/{schema.node}")]
    space = names[0].rpartition("/")[0].removeprefix("/") if names else ""
    hint = f"; say --namespace {space}" if space and "*" not in space else ""
    check_used(sections, name, [node], hint)
    return _values_in(sections, schema, namespace, f"{name}: ")


def _values_in(
    sections: Sections, schema: type[NodeSection], namespace: str, where: str
) -> dict[str, Any]:
    """Return the values of a node in sections, and those that its companion's section gives for both."""
    own = values_for(sections, _node_name(schema, namespace))
    theirs = values_for(sections, _full_name(schema.companion, namespace))
    return with_companions(own, theirs, schema, where)


def with_companions(
    own: Mapping[str, Any], theirs: Mapping[str, Any], schema: type[NodeSection], where: str = ""
) -> dict[str, Any]:
    """Return the values of a node, and those of its companion that hold for both and that it lacks.

    That is the person, and the encoder with its sign unless the two have different ones: they are entered once.

    Raises:
        UsageError: both give the body's mass or weight, and they differ; the error begins with `where`.
    """
    named = own_names(own, schema, where)
    encoder = {
        name: value for name, value in own_names(theirs, schema).items() if name in schema.encoder
    }
    if any(named.get(name, value) != value for name, value in encoder.items()):
        encoder = {}
    person = {
        given: value
        for given, value in theirs.items()
        if schema.other_names.get(given, (given,))[0] in schema.about_person
    }
    return own_names(encoder | person | named, schema, where)


def own_names(
    values: Mapping[str, Any], schema: type[NodeSection], where: str = ""
) -> dict[str, Any]:
    """Return dotted values under the names that a node has, from those that it or its companion has.

    Raises:
        UsageError: both units of the body's mass are given, and they differ; the error begins with `where`.
    """
    own = dict(values)
    for other, (name, factor) in schema.other_names.items():
        if other not in own:
            continue
        given = value = own.pop(other)
        is_mass = factor != 1.0 and type(given) in (int, float)
        if is_mass:
            value = factor * given
        used = own.setdefault(name, value)
        if is_mass and type(used) in (int, float) and abs(used - value) > SAME_WEIGHT * abs(value):
            raise UsageError(
                f"{where}parameter {name}: {used:.7g} is not allowed beside {other} {given:.7g}, which makes it "
                f"{value:.7g} (1 kg weighs {GRAVITY} N): give one of them"
            )
    return own


def check_used(sections: Collection[str], name: str, nodes: Sequence[str], hint: str = "") -> None:
    """Check that a section of the file or rule `name` is for one of the nodes, which have absolute names.

    Raises:
        UsageError: none is; the error ends with `hint`.
    """
    if sections and not any(matches_node(each, node) for each in sections for node in nodes):
        wanted, found = " or ".join(node[1:] for node in nodes), shortened(", ".join(sections))
        raise UsageError(f"{name}: no parameters for node {wanted}; found {found}{hint}")


def check_file(path: Path, schema: type[NodeSection]) -> None:
    """Check a file that ROS will read, for the nodes that it names; sections of other nodes are ignored.

    Raises:
        UsageError: as for `load_parameters`.
    """
    sections = sections_in(path)
    names = [name for name in sections if name.split("/")[-1] in (schema.node, "*", "**")]
    for name in names or [f"/{schema.node}"]:
        # A wildcard stands for some name, or for none.
        spaces = [space for space in name.removeprefix("/").split("/")[:-1] if space != "**"]
        namespace = "/".join("x" if space == "*" else space for space in spaces)
        _validated(_values_in(sections, schema, namespace, f"{path}: "), f"{path}: ", schema)


def parameter_text(
    schema: type[NodeSection], comments: Iterable[str], lines: Iterable[str]
) -> str:
    """Return the text of a parameter file of a node, with comments above, from lines of YAML."""
    head = [
        *(f"# {' '.join(comment.split())}" for comment in comments),
        f"/**/{schema.node}:",
        "  ros__parameters:",
    ]
    return "\n".join([*head, *(f"    {line}" for line in lines), ""])


def check_value(name: str, value: Any) -> None:
    """Check a single value of the contact node, without its relation to other parameters.

    Raises:
        UsageError: the parameter is unknown, or the value is never allowed.
    """
    _checked(_nested({name: value}, "", Parameters), "", Parameters, together=False)


def variations_of(parameters: Parameters) -> Callable[[Mapping[str, Any]], Parameters]:
    """Return a function that changes some of these values, in a quarter of the time of `load_parameters`.

    Lateral values follow the medial ones unless they differ from them.
    """
    common = _nested(flat_parameters(parameters), "", Parameters)

    def overlaid(section: Mapping[str, Any], values: Mapping[str, Any]) -> dict[str, Any]:
        merged = {**section, **values}
        for name, inner in values.items():
            if isinstance(inner, Mapping):
                merged[name] = overlaid(section.get(name, {}), inner)
        return merged

    def varied(values: Mapping[str, Any]) -> Parameters:
        return _checked(overlaid(common, _nested(values, "", Parameters)), "", Parameters)

    return varied


def _validated(values: Mapping[str, Any], where: str, schema: type[_Schema]) -> _Schema:
    """Return parameters from dotted values, checked each alone and in combination; errors begin with `where`."""
    return _checked(_nested(values, where, schema), where, schema)


def _nested(values: Mapping[str, Any], where: str, schema: type[NodeSection]) -> dict[str, Any]:
    """Return dotted values by section and name, without those that every ROS 2 node has; errors begin with `where`."""
    known = known_parameters(schema)
    nested: dict[str, Any] = {}
    for name, value in own_names(values, schema, where).items():
        if name in STANDARD_PARAMETERS or name.startswith("qos_overrides."):
            continue
        if name not in known:
            two = "ros__parameters has two underscores" if "ros_parameters" in name else ""
            hint = two or suggest(shortened(name), known, cutoff=0.5)
            raise UsageError(f"{where}unknown parameter {shortened(name)}; {hint}")
        *sections, inner = name.split(".")
        value = number_in(value, known[name].default)  # noqa: PLW2901
        place = nested
        for section in sections:
            place = place.setdefault(section, {})
        place[inner] = value
    return nested


def number_in(value: Any, default: Any) -> Any:
    """Return the number in a text, such as `8e7`, where a parameter wants one like its default; else the value."""
    kind = type(default)
    if isinstance(value, str) and kind in _NUMBERS and _NUMBERS[kind].fullmatch(value):
        return kind(value)
    return value


def _checked(
    nested: Mapping[str, Any], where: str, schema: type[_Schema], together: bool = True
) -> _Schema:
    """Return parameters from values by section and name, checked each alone and, `together`, in combination."""
    try:
        parameters = schema.model_validate(nested)
    except ValidationError as error:
        raise UsageError(f"{where}parameter {first_error(error)}") from None
    if together and (problem := parameters.problem()):
        raise UsageError(f"{where}parameter {problem}")
    return parameters
