"""Curves that parameters name: CSV files of surfaces, of the translation and of shares."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.model.knee import LARGEST_ANGLE
from knee_contact_ros.parameters.columns import LARGEST, read_columns
from knee_contact_ros.parameters.lateral import LATERAL, has_both, lateral_knee
from knee_contact_ros.parameters.measured_share import PARAMETER as SHARE_FILE
from knee_contact_ros.parameters.schema import Femur, Parameters, Tibia
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.regular_file import read_regular
from knee_contact_ros.system.resources import find_file

Columns = tuple[NDArray[np.float64], NDArray[np.float64]]


def curve_files(parameters: Parameters) -> dict[str, str]:
    """Names of the files that a computation with these parameters needs, by the parameter that names them."""
    names = _surfaces(parameters, "")
    if has_both(parameters):
        names |= _surfaces(lateral_knee(parameters), LATERAL)
    if parameters.translation.mechanism == "table":
        names["translation.table"] = parameters.translation.table
    if parameters.load.rule == "measured_share":
        names[SHARE_FILE] = parameters.load.share_file
    return names


def _surfaces(parameters: Parameters, before: str) -> dict[str, str]:
    """Names of the files of a compartment's surfaces, by parameter; `before` begins the names of its parameters."""
    surfaces: dict[str, Femur | Tibia] = {"femur.profile": parameters.femur, "tibia.profile": parameters.tibia}
    return {before + name: bone.profile for name, bone in surfaces.items() if bone.geometry == "profile"}


def curve_texts(parameters: Parameters, known: Mapping[str, str]) -> dict[str, str]:
    """Contents of the files that parameters name, by parameter; those in `known` are not read.

    Raises:
        UsageError: a file cannot be read.
    """
    return {
        parameter: known[parameter] if parameter in known else read_curve(parameter, name)
        for parameter, name in curve_files(parameters).items()
    }


def stored_texts(parameters: Parameters, stored: Mapping[str, str], recording: Path | str) -> dict[str, str]:
    """Contents of the files that the parameters of a recording name, by parameter, as the recording holds them.

    No file is opened.

    Args:
        parameters: Parameters of the recording.
        stored: Contents that the recording holds, by parameter.
        recording: Name of the recording, for errors.

    Raises:
        UsageError: the recording does not hold one of the files.
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
    """Read the text of the file `name` that a parameter names.

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
    """Read the columns x, y [m] of a profile, each of shape (n,), from the text of the file that a parameter names.

    Raises:
        UsageError: not two columns of numbers, too many points, or not in m.
    """
    points = read_columns(parameter, name, text, ("x", "y"), further_columns=True)
    if points.size and np.abs(points).max() > 1.0:
        raise UsageError(f"parameter {parameter}: {name} reaches {np.abs(points).max():g}; x and y must be in m")
    return points[:, 0], points[:, 1]


def translation_points(parameter: str, name: str, text: str) -> Columns:
    """Read the columns flexion_angle [rad], x [m] of a table, each of shape (n,), from the text of the file.

    Raises:
        UsageError: not two columns of numbers, too many points, or not in rad.
    """
    points = read_columns(parameter, name, text, ("flexion_angle", "x"), further_columns=True)
    if points.size and np.abs(points[:, 0]).max() > LARGEST_ANGLE:
        reached = np.abs(points[:, 0]).max()
        raise UsageError(
            f"parameter {parameter}: {name} reaches {reached:g} rad; flexion angles must be in rad, not deg"
        )
    return points[:, 0], points[:, 1]
