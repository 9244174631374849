"""Curves that parameters name: CSV files with two columns, comments after # and one line of column names or none."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.core.model import LARGEST_ANGLE
from knee_contact_ros.parameters.lateral import LATERAL, has_both, lateral_knee
from knee_contact_ros.parameters.measured_share import PARAMETER as SHARE_FILE
from knee_contact_ros.parameters.schema import Femur, Parameters, Tibia
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.regular_file import read_regular
from knee_contact_ros.system.resources import find_file

Columns = tuple[NDArray[np.float64], NDArray[np.float64]]
LARGEST = 2**20
"""[B] of a file, and characters of a text"""
MOST_POINTS = 2000
"""Of a curve; those of this package have 120, and at 2000 the points of a condyle are 0.05 mm apart.

What a profile takes to build grows with their square: 0.8 GB here.
"""


def curve_files(parameters: Parameters) -> dict[str, str]:
    """Files that the answers with some parameters need, by the parameter that names them."""
    names = _surfaces(parameters, "")
    if has_both(parameters):
        names |= _surfaces(lateral_knee(parameters), LATERAL)
    if parameters.translation.mechanism == "table":
        names["translation.table"] = parameters.translation.table
    if parameters.load.rule == "measured_share":
        names[SHARE_FILE] = parameters.load.share_file
    return names


def _surfaces(parameters: Parameters, before: str) -> dict[str, str]:
    """Files of a compartment's surfaces; the names of its parameters begin with `before`."""
    surfaces: dict[str, Femur | Tibia] = {"femur.profile": parameters.femur, "tibia.profile": parameters.tibia}
    return {before + name: bone.profile for name, bone in surfaces.items() if bone.geometry == "profile"}


def curve_texts(parameters: Parameters, known: Mapping[str, str]) -> dict[str, str]:
    """Contents of the files that a user's parameters name, by parameter; as in `known` if there.

    Raises:
        UsageError: one cannot be read.
    """
    return {
        parameter: known[parameter] if parameter in known else read_curve(parameter, name)
        for parameter, name in curve_files(parameters).items()
    }


def stored_texts(parameters: Parameters, stored: Mapping[str, str], recording: Path | str) -> dict[str, str]:
    """Texts of the curves of parameters that a recording tells, from what it holds: no file that it names is opened.

    Raises:
        UsageError: it does not hold one.
    """
    names = curve_files(parameters)
    for parameter, name in names.items():
        if parameter not in stored:
            raise UsageError(
                f"{recording} does not hold the file that its parameter {parameter} names ({name}): give your own "
                f"with -p {parameter}:=FILE, or all parameters with --params"
            )
    return {parameter: stored[parameter] for parameter in names}


def read_curve(parameter: str, name: str) -> str:
    """The text of the file that a parameter names.

    Raises:
        UsageError: it cannot be read.
    """
    path = find_file(name)
    try:
        return read_regular(path, LARGEST).decode("utf-8-sig")  # spreadsheets put a mark before the first letter
    except OSError as error:
        raise UsageError(f"parameter {parameter}: cannot read {path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise UsageError(f"parameter {parameter}: cannot read {path}: it is not a text file in UTF-8") from None


def profile_points(parameter: str, name: str, text: str) -> Columns:
    """Columns x, y [m] of the profile that a parameter names.

    Raises:
        UsageError: not two columns of numbers, too many points, or not in m.
    """
    points = _points(parameter, name, text, ("x", "y"))
    if points.size and np.abs(points).max() > 1.0:
        raise UsageError(f"parameter {parameter}: {name} reaches {np.abs(points).max():g}; x and y must be in m")
    return points[:, 0], points[:, 1]


def translation_points(parameter: str, name: str, text: str) -> Columns:
    """Columns flexion_angle [rad], x [m] of the table that a parameter names; likewise.

    Raises:
        UsageError: not two columns of numbers, too many points, or not in rad.
    """
    points = _points(parameter, name, text, ("flexion_angle", "x"))
    if points.size and np.abs(points[:, 0]).max() > LARGEST_ANGLE:
        reached = np.abs(points[:, 0]).max()
        raise UsageError(
            f"parameter {parameter}: {name} reaches {reached:g} rad; flexion angles must be in rad, not deg"
        )
    return points[:, 0], points[:, 1]


def _points(parameter: str, name: str, text: str, columns: tuple[str, str]) -> NDArray[np.float64]:
    if len(text) > LARGEST:
        raise UsageError(f"parameter {parameter}: {name} has {len(text)} characters; at most {LARGEST} are allowed")
    lines = [line.strip() for line in text.splitlines() if line.strip() and not line.strip().startswith("#")]
    names = tuple(entry.strip() for entry in lines[0].split(",")[:2]) if lines else ()
    rows = lines[1:] if names == columns else lines
    if len(rows) > MOST_POINTS:
        raise UsageError(f"parameter {parameter}: {name} has {len(rows)} points; at most {MOST_POINTS} are allowed")
    try:
        return np.array([[float(value) for value in row.split(",")[:2]] for row in rows]).reshape(-1, 2)
    except ValueError:
        wanted = ", ".join(columns)
        raise UsageError(f"parameter {parameter}: {name} must hold two columns {wanted} of numbers") from None
