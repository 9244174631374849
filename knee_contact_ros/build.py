"""From parameters to a model: names become laws and geometries here, and nowhere else."""

from __future__ import annotations

import inspect
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.core.contact_laws import CONTACT_LAWS
from knee_contact_ros.core.geometries import Circle, FemoralGeometry, Profile
from knee_contact_ros.core.model import KneeModel
from knee_contact_ros.core.regions import Regions
from knee_contact_ros.errors import UsageError
from knee_contact_ros.parameters import ContactParameters, Femur, Parameters, load_parameters
from knee_contact_ros.resources import find_file


def load_model(source: Parameters | Mapping[str, Any] | str | Path | Sequence[str | Path]) -> KneeModel:
    """Build the model that a parameter file (or several, or a mapping) describes. Needs no ROS.

    Raises:
        UsageError: see `load_parameters`; also a femoral profile that cannot be used.
    """
    parameters = load_parameters(source)
    law = contact_law(parameters.contact)
    return KneeModel(
        geometry=femoral_geometry(parameters.femur),
        regions=law,
        mass=parameters.femur.mass,
        plateau_slope=parameters.tibia.slope,
        cartilage_thickness=law.law.layers[1].begin if len(law.law.layers) > 1 else math.inf,
        tolerance=parameters.fidelity.tolerance,
        budget=parameters.fidelity.budget,
    )


def contact_law(contact: ContactParameters) -> Regions:
    """The contact law by its name, with the parameters that its signature asks for."""
    factory = CONTACT_LAWS[contact.law]
    law = factory(**{name: getattr(contact, name) for name in inspect.signature(factory).parameters})
    return Regions(law, contact.allow_tension)


def femoral_geometry(femur: Femur) -> FemoralGeometry:
    """The femoral surface by its name."""
    if femur.geometry == "circle":
        return Circle(femur.radius)
    path = find_file(femur.profile)
    x, y = read_profile(path)
    try:
        return Profile(x, y)
    except ValueError as error:
        raise UsageError(f"parameter femur.profile: {path}: {error}") from None


def read_profile(path: Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Read a profile: CSV with columns x and y [m], comments after #, and one line of column names or none."""
    try:
        lines = [line for line in path.read_text(encoding="utf-8").splitlines() if line.strip() and line[0] != "#"]
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"parameter femur.profile: cannot read {path}: {error}") from None
    names = [name.strip() for name in lines[0].split(",")] if lines else []
    rows = lines[1:] if names[:2] == ["x", "y"] else lines
    try:
        points = np.array([[float(value) for value in row.split(",")[:2]] for row in rows]).reshape(-1, 2)
    except ValueError:
        raise UsageError(f"parameter femur.profile: {path} must hold two columns x, y of numbers in m") from None
    if points.size and np.abs(points).max() > 1.0:
        raise UsageError(f"parameter femur.profile: {path} reaches {np.abs(points).max():g}; x and y must be in m")
    return points[:, 0], points[:, 1]
