"""Reads foreign YAML within bounds on the number of nodes, their depth and the size of numbers."""

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
"""Largest size of a file [B] by default: one with all parameters has some 3000"""
LARGEST_METADATA = 2**20
"""Largest size [B] of the `metadata.yaml` of a rosbag2 folder: a thousand topics, or some thousand files"""
MOST_NODES = 100_000
"""Largest number of texts, numbers, lists and mappings; what an alias repeats counts at each place"""
DEEPEST = 50
"""Largest depth of nested lists and mappings"""
MOST_BITS = 64
"""Largest number of bits of an integer"""
TOO_DEEP = f"it is nested deeper than {DEEPEST} levels"
BRACKETS = re.compile(r"[\[\]{}]")
MERGE = re.compile(r"""<<['"]?\s*:""")
"""Merge key, which inserts the entries of other mappings: the parser does so before they can be counted"""
HALF = re.compile("[\ud800-\udfff]")
"""Surrogate, which an escape may give: UTF-8 has none"""
END = object()


class BadYamlError(ValueError):
    """A text is no YAML, or beyond the bounds; the text of the error is one line."""


def read_yaml(path: Path, most: int = LARGEST) -> Any:
    """Read a YAML file of at most `most` bytes.

    Raises:
        OSError: it cannot be read, is no regular file or too long.
        BadYamlError: it is no YAML in UTF-8, or beyond the bounds.
    """
    try:
        return parse_yaml(read_regular(path, most).decode("utf-8"))
    except UnicodeDecodeError as error:
        raise BadYamlError(str(error)) from None


def parse_yaml(text: str) -> Any:
    """Parse a YAML text.

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
    """Read a YAML file that holds a mapping; errors call it a `kind` that must map `what`.

    Raises:
        UsageError: it cannot be read, or holds no mapping.
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
    """Largest number of brackets that are open at a time, also within texts."""
    return max(accumulate(1 if bracket in "[{" else -1 for bracket in BRACKETS.findall(text)), default=0)


def _check(content: Any) -> None:
    """Refuse content beyond the bounds, which would take long to process; aliases count at each place."""
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
    """Keys and values of a mapping, or elements of a list."""
    for entry in node:
        yield entry
        if isinstance(node, Mapping):
            yield node[entry]
