"""Curves that parameters name: CSV files with two columns, comments after # and one line of column names or none."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.core.model import LARGEST_ANGLE
from knee_contact_ros.errors import UsageError
from knee_contact_ros.parameters import Parameters
from knee_contact_ros.resources import find_file

Columns = tuple[NDArray[np.float64], NDArray[np.float64]]


def curve_texts(parameters: Parameters, known: Mapping[str, str]) -> dict[str, str]:
    """Contents of the files that parameters name and that their model needs, by parameter; as in `known` if there.

    Raises:
        UsageError: one cannot be read.
    """
    femur, tibia, translation = parameters.femur, parameters.tibia, parameters.translation
    names = {}
    if femur.geometry == "profile":
        names["femur.profile"] = femur.profile
    if tibia.geometry == "profile":
        names["tibia.profile"] = tibia.profile
    if translation.mechanism == "table":
        names["translation.table"] = translation.table
    return {
        parameter: known[parameter] if parameter in known else _text(parameter, find_file(name))
        for parameter, name in names.items()
    }


def read_profile(parameter: str, name: str, texts: Mapping[str, str]) -> tuple[Path, Columns]:
    """Read the profile that a parameter names: columns x, y [m]; from `texts` if that has it (see `curve_texts`).

    Raises:
        UsageError: no such file, not two columns of numbers, or not in m.
    """
    path, points = _read(parameter, name, texts, ("x", "y"))
    if points.size and np.abs(points).max() > 1.0:
        raise UsageError(f"parameter {parameter}: {path} reaches {np.abs(points).max():g}; x and y must be in m")
    return path, (points[:, 0], points[:, 1])


def read_translation(parameter: str, name: str, texts: Mapping[str, str]) -> tuple[Path, Columns]:
    """Read the table that a parameter names: columns flexion_angle [rad], x [m]; likewise.

    Raises:
        UsageError: no such file, not two columns of numbers, or not in rad.
    """
    path, points = _read(parameter, name, texts, ("flexion_angle", "x"))
    if points.size and np.abs(points[:, 0]).max() > LARGEST_ANGLE:
        reached = np.abs(points[:, 0]).max()
        raise UsageError(
            f"parameter {parameter}: {path} reaches {reached:g} rad; flexion angles must be in rad, not deg"
        )
    return path, (points[:, 0], points[:, 1])


def _text(parameter: str, path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")  # spreadsheets put a mark before the first letter
    except OSError as error:
        raise UsageError(f"parameter {parameter}: cannot read {path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise UsageError(f"parameter {parameter}: cannot read {path}: it is not a text file in UTF-8") from None


def _read(
    parameter: str, name: str, texts: Mapping[str, str], columns: tuple[str, str]
) -> tuple[Path, NDArray[np.float64]]:
    path = find_file(name)
    text = texts[parameter] if parameter in texts else _text(parameter, path)
    lines = [line.strip() for line in text.splitlines() if line.strip() and not line.strip().startswith("#")]
    names = tuple(entry.strip() for entry in lines[0].split(",")[:2]) if lines else ()
    rows = lines[1:] if names == columns else lines
    try:
        points = np.array([[float(value) for value in row.split(",")[:2]] for row in rows]).reshape(-1, 2)
    except ValueError:
        wanted = ", ".join(columns)
        raise UsageError(f"parameter {parameter}: {path} must hold two columns {wanted} of numbers") from None
    return path, points
