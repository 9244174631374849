"""Reads the parameters of a node from ROS 2 parameter files and from mappings, by dotted names."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, Generic, NamedTuple, TypeVar

from pydantic import ValidationError

from knee_contact_ros.parameters.limits import Limits, limits_of
from knee_contact_ros.parameters.sections import Section
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.resources import parameter_file, shipped_parameter_files
from knee_contact_ros.system.yaml_file import read_mapping

ALLOWED = "a parameter file's name, a mapping of parameters, or a list of these"
LONGEST_VALUE = 80
"""Largest number of characters of a value that an error shows"""
STANDARD_PARAMETERS = ("use_sim_time", "start_type_description_service")
"""Parameters that every ROS 2 node has; QoS overrides (`qos_overrides.…`) come on top."""
P = TypeVar("P", bound=Section)


class Declaration(NamedTuple):
    """Declaration of a parameter."""

    default: Any
    description: str
    limits: Limits


def declared(section: type[Section], before: str = "") -> Iterator[tuple[str, Declaration]]:
    """Names and declarations of all parameters of a section and its subsections; `before` begins the dotted names."""
    for name, field in section.model_fields.items():
        if isinstance(field.default, Section):
            yield from declared(type(field.default), f"{before}{name}.")
        else:
            yield before + name, Declaration(field.default, field.description or "", limits_of(field))


@cache
def declarations(schema: type[Section]) -> Mapping[str, Declaration]:
    """Declarations of all parameters of a schema, by dotted name; to collect them takes longer than to check values."""
    return MappingProxyType(dict(declared(schema)))


def dotted(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Flatten a mapping with nested or dotted names to dotted names, which begin with `prefix`."""
    flat: dict[str, Any] = {}
    for key, value in values.items():
        if isinstance(value, Mapping):
            flat |= dotted(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = value
    return flat


def all_values(parameters: Section) -> dict[str, Any]:
    """All values by dotted name."""
    return dotted(parameters.model_dump())


def _same(values: Mapping[str, Any]) -> Mapping[str, Any]:
    return values


@dataclass(frozen=True)
class NodeReading(Generic[P]):
    """Reader of the parameters of one kind of node."""

    node: str
    """Name of the node"""
    schema: type[P]
    """Section with all parameters"""
    check: Callable[[P, str], None]
    """Refuses combinations of values that are not allowed, with a `UsageError` that begins with the given text"""
    completed: Callable[[Mapping[str, Any]], Mapping[str, Any]] = _same
    """Adds to dotted values those that follow from them"""
    reduced: Callable[[Mapping[str, Any]], Mapping[str, Any]] = _same
    """Inverse of `completed`: removes from all dotted values those that follow from others"""
    listed: Callable[[Mapping[str, Any]], list[str]] = list
    """Lists the names of parameters for a person"""
    folder: str = ""
    """Folder of the package's own parameter files for the node, within `config`"""

    def known(self) -> dict[str, Declaration]:
        """Declarations of all parameters, by dotted name."""
        return dict(declarations(self.schema))

    def load(self, source: Any) -> P:
        """Read parameters from a parameter file, a mapping, or several of these (the later one wins).

        A name that is not found in the working folder is looked up among the package's own (`parameter_file`). A
        mapping may be nested, dotted (`{"contact.damping": 0.0}`) or have a parameter file's full form.

        Raises:
            UsageError: a file cannot be read, or a name is unknown, a type wrong or a value outside its range.
        """
        if isinstance(source, self.schema):
            return source
        parts = source if isinstance(source, Sequence) and not isinstance(source, str) else [source]
        merged: dict[str, Any] = {}
        for part in parts:
            if isinstance(part, self.schema):
                merged |= self.flat(part)
            elif isinstance(part, Mapping):
                merged |= dotted(self._section(part, "the mapping"))
            elif isinstance(part, (str, Path)) and part != "":
                merged |= self.set_in(part)
            else:
                raise UsageError(f"parameters: {short(repr(part))} is not allowed; {ALLOWED}")
        return self.validated(merged, "")

    def flat(self, parameters: P) -> dict[str, Any]:
        """All values by dotted name, without those that follow from others."""
        return dict(self.reduced(all_values(parameters)))

    def set_in(self, name: str | Path) -> dict[str, Any]:
        """Values that a parameter file sets, by dotted name; they are checked.

        Raises:
            UsageError: as for `load`.
        """
        values = dotted(self._section(_read(name, self.folder), str(name)))
        self.validated(values, f"{name}: ")
        return values

    def check_file(self, path: Path) -> None:
        """Check a file that ROS will read; sections of other nodes are ignored.

        Raises:
            UsageError: as for `load`.
        """
        sections = self._sections(read_mapping(path), str(path))
        for_all = {
            name: value
            for key, section in sections.items() if not self._is_own(key)
            for name, value in dotted(section).items()
        }  # fmt: skip
        own = [dotted(section) for key, section in sections.items() if self._is_own(key)]
        for values in own or [{}]:  # nodes in several namespaces may share a file
            self.validated(for_all | values, f"{path}: ")

    def validated(self, values: Mapping[str, Any], where: str) -> P:
        """Parameters from dotted values, checked each alone and in combination; errors begin with `where`."""
        return self.checked(self.nested(self.completed(values), where), where)

    def nested(self, values: Mapping[str, Any], where: str, known: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Dotted values by section and name, without those that every ROS 2 node has; errors begin with `where`.

        `known` has the declared parameters; given, it saves the time to collect them.
        """
        known, nested = known or self.known(), dict[str, Any]()
        for name, value in values.items():
            if name in STANDARD_PARAMETERS or name.startswith("qos_overrides."):
                continue
            if name not in known:
                near = difflib.get_close_matches(short(name), known, n=1, cutoff=0.5)
                hint = f"did you mean {near[0]}?" if near else f"known are {', '.join(self.listed(known))}"
                raise UsageError(f"{where}unknown parameter {short(name)}; {hint}")
            *sections, inner = name.split(".")
            place = nested
            for section in sections:
                place = place.setdefault(section, {})
            place[inner] = value
        return nested

    def made(self, nested: Mapping[str, Any], where: str) -> P:
        """Parameters from values by section and name, each checked alone; errors begin with `where`."""
        try:
            return self.schema.model_validate(nested)
        except ValidationError as error:
            raise UsageError(f"{where}parameter {first_error(error)}") from None

    def checked(self, nested: Mapping[str, Any], where: str) -> P:
        """Parameters from values by section and name, checked alone and in combination; errors begin with `where`."""
        parameters = self.made(nested, where)
        self.check(parameters, where)
        return parameters

    def _section(self, content: Mapping[str, Any], name: str) -> Mapping[str, Any]:
        """Parameters of the node in the content of a parameter file, or the content itself if it has no node names."""
        ours = self._sections(content, name)
        if ours:
            merged: dict[str, Any] = {}
            for section in ours.values():
                merged |= dotted(section)
            return merged
        if any(isinstance(value, Mapping) and "ros__parameters" in value for value in content.values()):
            raise UsageError(f"{name}: no parameters for node {self.node}; found {short(', '.join(map(str, content)))}")
        return content

    def _sections(self, content: Mapping[str, Any], name: str) -> dict[str, Mapping[str, Any]]:
        """Sections of a parameter file for the node, by key; wildcards first, so that the node's own section wins."""
        ours = [
            key
            for key, value in content.items()
            if isinstance(value, Mapping) and "ros__parameters" in value
            and str(key).rsplit("/", 1)[-1] in (self.node, "*", "**")
        ]  # fmt: skip
        sections = {}
        for key in sorted(ours, key=self._is_own):
            section = content[key]["ros__parameters"] or {}
            if not isinstance(section, Mapping):
                raise UsageError(f"{name}: {key}: ros__parameters must map names to values, got {short(repr(section))}")
            sections[key] = section
        return sections

    def _is_own(self, key: object) -> bool:
        """Whether the key of a section names this node, and not every node."""
        return str(key).endswith(self.node)


def _read(name: str | Path, folder: str) -> Mapping[str, Any]:
    """Read a parameter file; `folder` has the package's own files for the node."""
    path = parameter_file(str(name))
    if not path.exists() and str(path.parent) in (".", folder):
        shipped = {each.stem: str(Path(folder, each.stem)) for each in shipped_parameter_files(folder)}
        near = difflib.get_close_matches(path.stem, shipped, n=1, cutoff=0.5)
        reason = f"it is neither there nor one of the package's own ({', '.join(shipped.values())})"
        reason += f"; did you mean {shipped[near[0]]}?" if near else ""
        raise UsageError(f"{short(str(name))}: cannot read the parameter file: {reason}")
    return read_mapping(path)


def first_error(error: ValidationError) -> str:
    """First error of a validation in one line: name, value, and what is allowed."""
    first = error.errors()[0]
    name = ".".join(map(str, first["loc"]))
    reason = first["msg"].removeprefix("Value error, ").replace("Input should be", "it should be")
    if first["type"] in ("missing", "extra_forbidden"):
        return f"{name}: {'is missing' if first['type'] == 'missing' else 'is not known'}"
    return f"{name}: {short(repr(first['input']))} is not allowed; {reason}"


def short(text: str) -> str:
    """Cut a text to the length that an error can show."""
    return text if len(text) <= LONGEST_VALUE else f"{text[:LONGEST_VALUE]}..."
