"""Parses `NAME:=VALUE` as on ROS 2's command line, for the commands that need no ROS."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.yaml_file import BadYamlError, parse_yaml


def split(rule: str, option: str) -> tuple[str, str]:
    """Split a rule of an option into its two sides.

    Raises:
        UsageError: a side is missing.
    """
    left, separator, right = (part.strip() for part in rule.partition(":="))
    if not (left and separator and right):
        raise UsageError(f"{option} {rule!r}: it must be NAME:=VALUE, as on ROS 2's command line")
    return left, right


def parameters_of(rules: Iterable[str]) -> dict[str, Any]:
    """Parameters given as `-p NAME:=VALUE`, by name; values are read as in a parameter file.

    Raises:
        UsageError: a side of a rule is missing, or a value is no YAML.
    """
    values = {}
    for rule in rules:
        name, text = split(rule, "-p")
        try:
            values[name] = parse_yaml(text)
        except BadYamlError:
            raise UsageError(f"-p {rule!r}: the value is no YAML; put it in quotes") from None
    return values
