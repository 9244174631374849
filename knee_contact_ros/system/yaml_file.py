"""YAML from elsewhere, read within bounds: what it is worth in nodes, how deep, how large its numbers."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from itertools import accumulate
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.regular_file import read_regular

LARGEST = 2**16
"""[B] of a file, if nothing else is said: that of all parameters has some 3000"""
LARGEST_METADATA = 2**20
"""[B] of a rosbag2 folder's `metadata.yaml`: a thousand topics, or some thousand files"""
MOST_NODES = 100_000
"""Texts, numbers, lists and mappings; what has several places by anchor and alias counts at each of them"""
DEEPEST = 50
"""Lists and mappings within each other"""
MOST_BITS = 64
"""Of an integer"""
TOO_DEEP = f"it is nested deeper than {DEEPEST} levels"
BRACKETS = re.compile(r"[\[\]{}]")
MERGE = re.compile(r"""<<['"]?\s*:""")
"""A key that brings in the entries of another mapping, or of many: they are made before anybody can count them"""
HALF = re.compile("[\ud800-\udfff]")
"""A surrogate, as an escape may spell it: UTF-8 has none"""
END = object()


class BadYamlError(ValueError):
    """A text is no YAML, or beyond the bounds; says in one line why."""


def read_yaml(path: Path, most: int = LARGEST) -> Any:
    """The content of a YAML file of at most `most` bytes.

    Raises:
        OSError: it cannot be read, is no regular file or too long.
        BadYamlError: it is no YAML in UTF-8, or beyond the bounds.
    """
    try:
        return parse_yaml(read_regular(path, most).decode("utf-8"))
    except UnicodeDecodeError as error:
        raise BadYamlError(str(error)) from None


def parse_yaml(text: str) -> Any:
    """What a YAML text says.

    Raises:
        BadYamlError: it is no YAML, or beyond the bounds.
    """
    if _opened(text) > DEEPEST:  # the parser would take seconds to find out
        raise BadYamlError(TOO_DEEP)
    if MERGE.search(text):
        raise BadYamlError("merge keys (<<) are not read")
    try:
        content = YAML(typ="safe", pure=True).load(text)
    except RecursionError:
        raise BadYamlError(TOO_DEEP) from None
    except Exception as error:  # dates that are none, numbers of thousands of digits: the parser raises what it likes
        raise BadYamlError(" ".join(str(error).split()) or type(error).__name__) from None
    _check(content)
    return content


def read_mapping(
    path: Path, kind: str = "parameter file", what: str = "node names to ros__parameters"
) -> Mapping[str, Any]:
    """The content of a YAML file that maps something; `kind` and `what` say in errors what it should be.

    Raises:
        UsageError: it cannot be read, or is none.
    """
    try:
        content = read_yaml(path)
    except OSError as error:
        raise UsageError(f"{path}: cannot read the {kind}: {error.strerror}") from None
    except BadYamlError as error:
        raise UsageError(f"{path}: not a YAML file: {error}") from None
    if not isinstance(content, Mapping):
        raise UsageError(f"{path}: not a {kind}: it must map {what}")
    return content


def _opened(text: str) -> int:
    """How many brackets are open at a time, wherever they stand."""
    return max(accumulate(1 if bracket in "[{" else -1 for bracket in BRACKETS.findall(text)), default=0)


def _check(content: Any) -> None:
    """Refuse what would take long to go through, for all its places."""
    branches, nodes = [iter([content])], 0
    while branches:
        node = next(branches[-1], END)
        if node is END:
            branches.pop()
            continue
        nodes += 1
        if nodes > MOST_NODES:
            raise BadYamlError(f"it has more than {MOST_NODES} nodes")
        if isinstance(node, int) and node.bit_length() > MOST_BITS:
            raise BadYamlError(f"it has a number of {node.bit_length()} bits; at most {MOST_BITS} are allowed")
        if isinstance(node, str) and HALF.search(node):
            raise BadYamlError("it has half a character, which cannot be written")
        if isinstance(node, (Mapping, list, tuple, set)):
            if len(branches) > DEEPEST:
                raise BadYamlError(TOO_DEEP)
            branches.append(_inside(node))


def _inside(node: Any) -> Iterator[Any]:
    """Keys and values, or elements."""
    for entry in node:
        yield entry
        if isinstance(node, Mapping):
            yield node[entry]
