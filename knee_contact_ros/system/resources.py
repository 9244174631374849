"""Finds the files of the package: parameter files, bags, message definitions."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path

from knee_contact_ros.system.errors import UsageError

PACKAGE = "knee_contact_ros"
DEFAULT_PARAMETERS = "healthy.yaml"
"""Default parameter file"""


def share_folder() -> Path:
    """Share folder of the package: the source tree if this module runs from one, else that of an ament prefix.

    Raises:
        FileNotFoundError: the package is not installed completely.
    """
    source_tree = Path(__file__).resolve().parents[2]
    if (source_tree / "package.xml").is_file():
        return source_tree
    prefixes = [*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix]
    for prefix in filter(None, prefixes):
        share = Path(prefix) / "share" / PACKAGE
        if (share / "package.xml").is_file():
            return share
    raise FileNotFoundError(f"share/{PACKAGE} is in none of {prefixes}; install the package again")


def find_file(name: str) -> Path:
    """Path of a file that a parameter names: from the current folder, else in the package's config folder."""
    path = expanded(name)
    if path.is_absolute() or path.exists():
        return path
    packaged = share_folder() / "config" / path
    return packaged if packaged.exists() else path


def parameter_file(name: str) -> Path:
    """Path of a parameter file, found as by `find_file`; `.yaml` may be left out, as in `osteoarthritis`."""
    path = find_file(name)
    if path.suffix or path.is_file():
        return path
    with_suffix = find_file(f"{name}.yaml")
    return with_suffix if with_suffix.is_file() else path


def shipped_parameter_files(folder: str = "") -> list[Path]:
    """Parameter files of the package in a folder within `config`, the default first."""
    files = sorted((share_folder() / "config" / folder).glob("*.yaml"))
    return sorted(files, key=lambda path: path.name != DEFAULT_PARAMETERS)


def expanded(name: str) -> Path:
    """Path with `~` and `~user` expanded; unchanged if there is no such user."""
    try:
        return Path(name).expanduser()
    except RuntimeError:
        return Path(name)


def refuse_twice(paths: Sequence[Path], what: str = "") -> None:
    """Check that no file is given twice, under whatever names; `what` precedes the name in the error.

    Raises:
        UsageError: a file is given twice.
    """
    places = [path.resolve() for path in paths]
    for number, path in enumerate(paths):
        if places[number] in places[:number]:
            raise UsageError(f"{what}{path} is given twice")
