"""Parameter files and values as ROS 2 reads them (rcl's parser in C, and rclpy's choice of sections), without ROS.

A file maps names of nodes, with wildcards, to `ros__parameters`. Names may be nested: `left: {knee_contact: ...}` is
`/left/knee_contact`. All sections that fit a node are used, in the order in which their names first appear, and a later
one wins: a `/**` behind a section of the node's own name wins over that. Scalars are those of YAML 1.1, but numbers are
C's: `010` is 8. ROS 2 knows no null. A name that a file gives twice in one place is refused.
"""

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from itertools import takewhile
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML, events

from .errors import UsageError
from .files import (
    MAX_DEPTH,
    MAX_FILE_SIZE,
    SURROGATE,
    TOO_DEEP,
    bracket_depth,
    read_regular,
    split_rule,
)

Sections = dict[str, dict[str, Any]]
"""Values by dotted name, by the name of a node as it is written, which may have wildcards; in order of appearance"""
PARAMETERS_KEY = "ros__parameters"
TRUE_TEXTS = ("Y", "y", "yes", "Yes", "YES", "true", "True", "TRUE", "on", "On", "ON")
FALSE_TEXTS = ("N", "n", "no", "No", "NO", "false", "False", "FALSE", "off", "Off", "OFF")
INTEGER = re.compile(r"[+-]?(?:0[xX][0-9a-fA-F]+|0[0-7]*|[1-9][0-9]*)")
FLOAT = re.compile(
    r"[+-]?(?:(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?|(?:inf(?:inity)?|nan)|"
    r"0x(?:[0-9a-f]+\.?[0-9a-f]*|\.[0-9a-f]+)(?:p[+-]?[0-9]+)?)",
    re.IGNORECASE,
)
SPECIAL = re.compile(r"[+-]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)")
MIN_INTEGER = -(2**63)
MAX_INTEGER = 2**63 - 1
MAX_INTEGER_LENGTH = 1000
"""Largest number of characters of an integer: Python refuses to convert longer ones"""
RANKED_KINDS = (bool, int, float, str, list, type(None))
"""Kinds of values; if two files give a section's name different kinds, rcl keeps the one that comes first here"""
NAME_PART = re.compile(r"\*{1,2}|[A-Za-z_][A-Za-z0-9_]*")
WILDCARD_PATTERNS = {"**": r"(?:/\w+)*", "*": r"/\w+"}
"""Regular expressions of wildcards in names of nodes: any number of names, and one"""


def parse_scalar(text: str) -> Any:
    """Return the value of a scalar without quotes in a parameter file."""
    if text in TRUE_TEXTS or text in FALSE_TEXTS:
        return text in TRUE_TEXTS
    if len(text) <= MAX_INTEGER_LENGTH and INTEGER.fullmatch(text):
        digits = text.lstrip("+-")
        value = int(
            text, 16 if digits[:2] in ("0x", "0X") else 8 if digits.startswith("0") else 10
        )
        if MIN_INTEGER <= value <= MAX_INTEGER:
            return value
    if SPECIAL.fullmatch(text):
        return float(text.replace(".", ""))
    if FLOAT.fullmatch(text):
        with suppress(OverflowError):
            number = float.fromhex(text) if "x" in text.lower() else float(text)
            # Infinity and NaN have an n; a number that is too large for a float stays a text.
            if math.isfinite(number) or "n" in text.lower():
                return number
    return text


def _content(event: Any, more: Iterator[Any]) -> Any:
    """Return the content that begins with an event of a YAML text and takes `more` of them."""
    if isinstance(event, events.AliasEvent):
        raise UsageError(f"ROS 2 reads no aliases (*{event.anchor})")
    if isinstance(event, events.ScalarEvent):
        quoted = event.style in ("'", '"') or str(event.tag).endswith(":str")
        if not quoted and not event.value:
            raise ValueError(f"no value at line {event.start_mark.line + 1}")
        if SURROGATE.search(event.value):
            raise ValueError("it has half a character, which cannot be written")
        return event.value if quoted else parse_scalar(event.value)
    inner = takewhile(lambda each: not isinstance(each, events.CollectionEndEvent), more)
    if isinstance(event, events.SequenceStartEvent):
        return [_content(each, more) for each in inner]
    mapping: dict[str, Any] = {}
    for key in inner:
        if not isinstance(key, events.ScalarEvent):
            raise UsageError("a name is no text")
        if key.value in mapping:
            raise UsageError(f"{key.value} is given twice")
        mapping[str(key.value)] = _content(next(more), more)
    return mapping


def read_sections(path: Path) -> Sections:
    """Read the sections of a parameter file; without node names: `/**`.

    Raises:
        UsageError: it cannot be read, or is not a parameter file.
    """
    try:
        text = read_regular(path, MAX_FILE_SIZE).decode("utf-8")
    except OSError as error:
        raise UsageError(f"{path}: cannot read the parameter file: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise UsageError(f"{path}: not a YAML file: {error}") from None
    own: Sections = {}
    try:
        for content in parse_documents(text):
            add_sections(own, content)
    except UsageError as error:
        raise UsageError(f"{path}: {error}") from None
    return own


def merge_sections(sections: Sections, later: Sections) -> None:
    """Add the sections of a later file to those of earlier ones, as ROS 2 does."""
    for node, values in later.items():
        before = sections.setdefault(node, {})
        before |= {
            name: value
            for name, value in values.items()
            if _rank(value) <= _rank(before.get(name))
        }


def parse_documents(text: str) -> list[Any]:
    """Return the contents of the documents of a YAML text.

    Raises:
        UsageError: it is not YAML, or nested too deep.
    """
    try:
        if bracket_depth(text) > MAX_DEPTH:
            raise ValueError(TOO_DEEP)
        parsed = iter(YAML(typ="safe", pure=True).parse(text))
        begins = (events.NodeEvent, events.CollectionStartEvent)
        return [_content(event, parsed) for event in parsed if isinstance(event, begins)]
    except RecursionError:
        raise UsageError(f"not a YAML file: {TOO_DEEP}") from None
    except Exception as error:  # the parser raises what it likes
        raise UsageError(
            f"not a YAML file: {' '.join(str(error).split()) or type(error).__name__}"
        ) from None


def add_sections(sections: Sections, content: Any) -> None:
    """Add the values in the content of a parameter file to sections; without names of nodes they are for `/**`.

    Raises:
        UsageError: it has not the form of a parameter file, or gives a name again.
    """
    if not isinstance(content, Mapping):
        raise UsageError("not a parameter file: it must map node names to ros__parameters")
    if _has_nodes(content):
        _add_nodes(sections, content, "")
    else:
        _add_values(sections.setdefault("/**", {}), content)


def _has_nodes(content: Any) -> bool:
    return isinstance(content, Mapping) and (
        PARAMETERS_KEY in content or any(map(_has_nodes, content.values()))
    )


def _add_nodes(sections: Sections, content: Mapping[str, Any], before: str) -> None:
    for name, value in content.items():
        if not isinstance(value, Mapping):
            where = f"{before or name}: ros__parameters" if name == PARAMETERS_KEY else name
            raise UsageError(f"{where} must map names to values, got {str(value)[:80]}")
        if name == PARAMETERS_KEY:
            if not all(map(NAME_PART.fullmatch, before.removeprefix("/").split("/"))):
                raise UsageError(f"{before!r} is not the name of a node")
            _add_values(sections.setdefault(before, {}), value)
        else:
            _add_nodes(
                sections,
                value,
                f"{before}{'' if not before or before.endswith('/') else '/'}{name}",
            )


def _add_values(values: dict[str, Any], content: Mapping[str, Any]) -> None:
    for name, value in flatten(content):
        if name in values:
            raise UsageError(f"{name} is given twice")
        if isinstance(value, list) and len({type(each) for each in value}) > 1:
            raise UsageError(f"{name}: a list must hold values of one kind")
        values[name] = value


def flatten(values: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    """Yield dotted names and values of a mapping with nested or dotted names; the names begin with `before`."""
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from flatten(value, f"{before}{name}.")
        else:
            yield f"{before}{name}", value


def _rank(value: Any) -> int:
    """Return the place of a value's kind in `RANKED_KINDS`."""
    return RANKED_KINDS.index(type(value)) if type(value) in RANKED_KINDS else len(RANKED_KINDS)


def values_for(sections: Sections, node: str) -> dict[str, Any]:
    """Return the values that a node with this absolute name gets, by dotted name."""
    merged: dict[str, Any] = {}
    for section, values in sections.items():
        if matches_node(section, node):
            merged |= values
    return merged


def matches_node(name: str, node: str) -> bool:
    """Return whether the name of a section, which may have wildcards, fits the absolute name of a node."""
    return bool(
        re.fullmatch(
            "".join(
                WILDCARD_PATTERNS.get(token, f"/{token}")
                for token in name.removeprefix("/").split("/")
            ),
            node,
        )
    )


def parameters_of(rules: Iterable[str]) -> dict[str, Any]:
    """Read parameters given as `-p NAME:=VALUE`, by name; values are read as in a parameter file.

    Raises:
        UsageError: a side of a rule is missing, or a value is not YAML.
    """
    values = {}
    for rule in rules:
        name, text = split_rule(rule, "-p")
        try:
            (value,) = parse_documents(text)
        except (UsageError, ValueError):
            raise UsageError(f"-p {rule!r}: the value is not YAML; put it in quotes") from None
        values[name] = value
    return values
