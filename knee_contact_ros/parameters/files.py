"""Reads parameters from ROS 2 parameter files and mappings, and the files that parameters name.

The node, the commands and the functions for notebooks read them here in the same way. A source is a parameter file, a
mapping, or several of these; later ones override earlier ones.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar, overload

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from knee_contact_ros.joint_reaction.compartments import ShareTable
from knee_contact_ros.model.knee import LARGEST_ANGLE
from knee_contact_ros.parameters.schema import (
    LATERAL_PREFIX,
    Parameters,
    has_two_compartments,
    lateral_knee,
)
from knee_contact_ros.parameters.sections import Declaration, NodeSection, Section, declaration_of
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.files import (
    find_file,
    parameter_file,
    read_regular,
    shipped_parameter_files,
)
from knee_contact_ros.system.ros_files import (
    Sections,
    add_sections,
    flatten,
    matches_node,
    read_sections,
    values_for,
)

_ALLOWED = "a parameter file's name, a mapping of parameters, or a list of these"
LONGEST_VALUE = 80
"""Largest number of characters of a value that an error shows"""
STANDARD_PARAMETERS = ("use_sim_time", "start_type_description_service")
"""Parameters that every ROS 2 node has, besides QoS overrides (`qos_overrides.…`)."""
_MAX_SIZE = 2**20
"""Largest size of a file that a parameter names [B], and of its text [characters]"""
_MAX_POINTS = 2000
"""Largest number of rows of such a file; the curves of this package have 120.

With 2000 points, those of a condyle are 0.05 mm apart. The memory for building a profile grows with the square of their
number; here it is 0.8 GB.
"""
SHARE_FILE = "load.share_file"
"""Parameter that names the file with a table of shares"""
SHARE_COLUMNS = ("flexion_angle", "axial_load", "medial_share")
"""Columns of that file, in rad, body weights and 1"""
ParameterPart = NodeSection | Mapping[str, Any] | str | Path
ParameterSource = ParameterPart | Sequence[ParameterPart]
"""Source of parameters: a file, a mapping, or several of these; later ones override earlier ones"""
_Columns = tuple[NDArray[np.float64], NDArray[np.float64]]
_Schema = TypeVar("_Schema", bound=NodeSection)


@cache  # to collect them takes longer than to check values
def known_parameters(schema: type[NodeSection] = Parameters) -> Mapping[str, Declaration]:
    """Declarations of all parameters of a node, by dotted name."""

    def declared(section: type[Section], before: str) -> Iterator[tuple[str, Declaration]]:
        for name, field in section.model_fields.items():
            if isinstance(field.default, Section):
                yield from declared(type(field.default), f"{before}{name}.")
            else:
                yield before + name, declaration_of(field)

    return MappingProxyType(dict(declared(schema, "")))


def dotted(values: Mapping[str, Any]) -> dict[str, Any]:
    """Flatten a mapping with nested or dotted names to dotted names."""
    return dict(flatten(values))


def all_values(parameters: Section) -> dict[str, Any]:
    """All values by dotted name."""
    return dotted(parameters.model_dump())


def flat_parameters(parameters: NodeSection) -> dict[str, Any]:
    """All values by dotted name, without lateral ones that equal the medial ones, which they follow in an overlay."""
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
    merged: dict[str, Any] = {}
    before: dict[
        str, Any
    ] = {}  # the values before a row of files, whose sections ROS takes together
    sections: Sections = {}
    alone: dict[
        str, Any
    ] = {}  # profiles, by bone, beside which a part does not set the bone's geometry
    for part in (
        source if isinstance(source, Sequence) and not isinstance(source, str) else [source]
    ):
        if isinstance(part, (str, Path)) and part != "":
            given = values_set_in(part, schema, namespace)
            read_sections(parameter_file(str(part)), sections)
            merged = before | values_for(sections, _node(schema, namespace))
        else:
            if isinstance(part, schema):
                given = flat_parameters(part)
            elif isinstance(part, Mapping):
                of_nodes: Sections = {}
                add_sections(of_nodes, part)
                given = _own_values(of_nodes, "the mapping", schema, namespace)
            else:
                raise UsageError(f"parameters: {shortened(repr(part))} is not allowed; {_ALLOWED}")
            merged, sections = merged | given, {}
            before = merged
        for bone in ("femur", "tibia"):
            if given.get(f"{bone}.profile") and f"{bone}.geometry" not in given:
                alone[bone] = given[f"{bone}.profile"]
    for bone, profile in alone.items():
        if merged.get(f"{bone}.geometry") != "profile":
            raise UsageError(
                f"parameter {bone}.profile: {profile!r} is not used; set {bone}.geometry to profile, too"
            )
    return _validated(merged, "", schema)


def values_set_in(
    name: str | Path, schema: type[NodeSection] = Parameters, namespace: str = ""
) -> dict[str, Any]:
    """Values that a parameter file sets for a node in a namespace, by dotted name; they are checked.

    Raises:
        UsageError: as for `load_parameters`.
    """
    path = parameter_file(str(name))
    if not path.exists() and str(path.parent) in (".", schema.folder):
        shipped = {
            each.stem: str(Path(schema.folder, each.stem))
            for each in shipped_parameter_files(schema.folder)
        }
        near = difflib.get_close_matches(path.stem, shipped, n=1, cutoff=0.5)
        reason = f"there is no such file, and it is not one of the package's own ({', '.join(shipped.values())})"
        reason += f"; did you mean {shipped[near[0]]}?" if near else ""
        raise UsageError(f"{shortened(str(name))}: cannot read the parameter file: {reason}")
    values = _own_values(read_sections(path), str(name), schema, namespace)
    _validated(values, f"{name}: ", schema)
    return values


def _node(schema: type[NodeSection], namespace: str) -> str:
    """Absolute name of a node in a namespace."""
    return f"/{namespace.strip('/')}/{schema.node}".replace("//", "/")


def _own_values(
    sections: Sections, name: str, schema: type[NodeSection], namespace: str
) -> dict[str, Any]:
    """Values of the node in the sections of a file or mapping with this name.

    Raises:
        UsageError: no section is for the node.
    """
    node = _node(schema, namespace)
    spaces = [
        each.rpartition("/")[0].removeprefix("/")
        for each in sections
        if each.endswith(f"/{schema.node}")
    ]
    hint = (
        f"; say --namespace {spaces[0]}" if spaces and spaces[0] and "*" not in spaces[0] else ""
    )
    check_used(sections, name, [node], hint)
    return values_for(sections, node)


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
    sections = read_sections(path)
    spaces = [
        name.removeprefix("/").split("/")[:-1]
        for name in sections
        if name.split("/")[-1] in (schema.node, "*", "**")
    ]
    for names in spaces or [[]]:
        namespace = "/".join("x" if name == "*" else name for name in names if name != "**")
        _validated(values_for(sections, _node(schema, namespace)), f"{path}: ", schema)


def parameter_text(
    schema: type[NodeSection], comments: Iterable[str], lines: Iterable[str]
) -> str:
    """Text of a parameter file of a node, with comments above, from lines of YAML."""
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
    """Function that returns these parameters with some values changed, in a quarter of the time of `load_parameters`.

    Lateral values follow the medial ones unless they differ from them.
    """
    common = _nested(flat_parameters(parameters), "", Parameters)

    def overlaid(section: Mapping[str, Any], values: Mapping[str, Any]) -> dict[str, Any]:
        inner = {
            name: overlaid(section.get(name, {}), v)
            for name, v in values.items()
            if isinstance(v, Mapping)
        }
        return {**section, **values, **inner}

    return lambda values: _checked(
        overlaid(common, _nested(values, "", Parameters)), "", Parameters
    )


def _validated(values: Mapping[str, Any], where: str, schema: type[_Schema]) -> _Schema:
    """Parameters from dotted values, checked each alone and in combination; errors begin with `where`."""
    return _checked(_nested(values, where, schema), where, schema)


def _nested(values: Mapping[str, Any], where: str, schema: type[NodeSection]) -> dict[str, Any]:
    """Dotted values by section and name, without those that every ROS 2 node has; errors begin with `where`."""
    known, nested = known_parameters(schema), dict[str, Any]()
    for name, value in values.items():
        if name in STANDARD_PARAMETERS or name.startswith("qos_overrides."):
            continue
        if name not in known:
            near = difflib.get_close_matches(shortened(name), known, n=1, cutoff=0.5)
            names = [one for one in known if not one.startswith(LATERAL_PREFIX)]
            names += [f"{LATERAL_PREFIX}* (as for femur, tibia and contact)"] * (
                len(names) < len(known)
            )
            hint = f"did you mean {near[0]}?" if near else f"known are {', '.join(names)}"
            raise UsageError(f"{where}unknown parameter {shortened(name)}; {hint}")
        *sections, inner = name.split(".")
        place = nested
        for section in sections:
            place = place.setdefault(section, {})
        place[inner] = value
    return nested


def _checked(
    nested: Mapping[str, Any], where: str, schema: type[_Schema], together: bool = True
) -> _Schema:
    """Parameters from values by section and name, checked each alone and, `together`, in combination."""
    try:
        parameters = schema.model_validate(nested)
    except ValidationError as error:
        raise UsageError(f"{where}parameter {first_error(error)}") from None
    if together and (problem := parameters.problem()):
        raise UsageError(f"{where}parameter {problem}")
    return parameters


def first_error(error: ValidationError) -> str:
    """First error of a validation in one line: name, value, and what is allowed."""
    first = error.errors()[0]
    name = ".".join(map(str, first["loc"]))
    reason = first["msg"].removeprefix("Value error, ").replace("Input should be", "it should be")
    if first["type"] in ("missing", "extra_forbidden"):
        return f"{name}: {'is missing' if first['type'] == 'missing' else 'is not known'}"
    return f"{name}: {shortened(repr(first['input']))} is not allowed; {reason}"


def shortened(text: str) -> str:
    """Cut a text to the length that an error can show."""
    return text if len(text) <= LONGEST_VALUE else f"{text[:LONGEST_VALUE]}..."


# Files that parameters name: CSV files of surfaces, of the translation and of shares.


def curve_files(parameters: Parameters) -> dict[str, str]:
    """Names of the files that a computation with these parameters needs, by the parameter that names them."""
    names = {}
    for before in ("", LATERAL_PREFIX) if has_two_compartments(parameters) else ("",):
        knee = lateral_knee(parameters) if before else parameters
        for bone, surface in (("femur", knee.femur), ("tibia", knee.tibia)):
            if surface.geometry == "profile":
                names[f"{before}{bone}.profile"] = surface.profile
    if parameters.translation.mechanism == "table":
        names["translation.table"] = parameters.translation.table
    if parameters.load.rule == "measured_share":
        names[SHARE_FILE] = parameters.load.share_file
    return names


def curve_texts(parameters: Parameters, known: Mapping[str, str]) -> dict[str, str]:
    """Contents of the files that parameters name, by parameter; those in `known` are not read.

    Raises:
        UsageError: a file cannot be read.
    """
    return {
        by: known[by] if by in known else read_curve(by, name)
        for by, name in curve_files(parameters).items()
    }


def lateral_texts(texts: Mapping[str, str]) -> dict[str, str]:
    """Contents of the lateral compartment's files, under the names of the medial one's parameters.

    `texts` has the contents of the files of both compartments by parameter.
    """
    own = {
        name.removeprefix(LATERAL_PREFIX): text
        for name, text in texts.items()
        if name.startswith(LATERAL_PREFIX)
    }
    shared = {name: text for name, text in texts.items() if name.startswith("translation.")}
    return shared | own


def read_curve(by: str, name: str) -> str:
    """Read the text of the file `name` that a parameter names.

    Raises:
        UsageError: it cannot be read.
    """
    path = find_file(name)
    try:
        return read_regular(path, _MAX_SIZE).decode(
            "utf-8-sig"
        )  # spreadsheets put a mark before the first letter
    except OSError as error:
        raise UsageError(f"parameter {by}: cannot read {path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise UsageError(
            f"parameter {by}: cannot read {path}: it is not a text file in UTF-8"
        ) from None


def curve_points(by: str, name: str, text: str) -> _Columns:
    """Read the two columns of a curve, each of shape (n,), from the text of the file that a parameter names.

    Those of `translation.table` are flexion_angle [rad], x [m]; those of a profile x, y [m].

    Raises:
        UsageError: the text has not two columns of numbers, too many points, or other units.
    """
    is_table = by == "translation.table"
    points = _columns(by, name, text, ("flexion_angle", "x") if is_table else ("x", "y"))
    if not is_table and np.abs(points).max(initial=0.0) > 1.0:
        raise UsageError(
            f"parameter {by}: {name} reaches {np.abs(points).max():g}; x and y must be in m"
        )
    return points[:, 0], points[:, 1]


def read_share_table(name: str, text: str) -> ShareTable:
    """Read the table from the text of the file that `load.share_file` names.

    Comments begin with #; then come rows of flexion angle [rad], axial load [BW] and medial share [1], every angle with
    every load once, with one line of column names or none.

    Raises:
        UsageError: the text has anything else, or a value that is impossible for a knee; see `ShareTable.of`.
    """
    try:
        return ShareTable.of(_columns(SHARE_FILE, name, text, SHARE_COLUMNS))
    except ValueError as error:
        raise UsageError(f"parameter {SHARE_FILE}: {name} {error}") from None


def _columns(by: str, name: str, text: str, columns: tuple[str, ...]) -> NDArray[np.float64]:
    """Read the numbers in the text of a CSV file that a parameter names, shape (n, number of columns).

    Comments begin with #; the first line may have the names of the columns. Further columns are ignored.
    """
    if len(text) > _MAX_SIZE:
        raise UsageError(
            f"parameter {by}: {name} has {len(text)} characters; at most {_MAX_SIZE} are allowed"
        )
    rows = [
        line.split(",")[: len(columns)]
        for line in map(str.strip, text.splitlines())
        if line and line[0] != "#"
    ]
    if rows and tuple(map(str.strip, rows[0])) == columns:
        del rows[0]
    if len(rows) > _MAX_POINTS:
        raise UsageError(
            f"parameter {by}: {name} has {len(rows)} points; at most {_MAX_POINTS} are allowed"
        )
    try:
        numbers = np.array(rows, dtype=float).reshape(len(rows), len(columns))
        if not np.isfinite(numbers).all() or (by == SHARE_FILE and not rows):
            raise ValueError("not finite, or no table")
    except ValueError:
        count = {2: "two", 3: "three"}[len(columns)]
        words = f"must hold {count} columns {', '.join(columns)} of numbers"
        raise UsageError(f"parameter {by}: {name} {words}") from None
    angle = np.abs(numbers[:, 0]).max(initial=0.0) if columns[0] == "flexion_angle" else 0.0
    if angle > LARGEST_ANGLE:
        raise UsageError(
            f"parameter {by}: {name} reaches {angle:g} rad; flexion angles must be in rad, not deg"
        )
    return numbers
