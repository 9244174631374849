"""Answers of the reference and of the model, and the differences between them."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks import reference
from benchmarks.reference import Layers, kelvin_voigt
from knee_contact_ros.model.knee import KneeModel
from knee_contact_ros.parameters.build import load_model
from knee_contact_ros.parameters.files import load_parameters
from studies.choosing.geometries import BASE, Geometry
from studies.choosing.scenes import Floats, Scene

COARSER = 100.0
"""Ratio of the tolerance of a second reference solution, which shows the error of the first"""


class Answer(NamedTuple):
    """Outputs that a user reads at every tick, shape (n,) each."""

    depth: Floats
    """Signed depth [m]: penetration > 0, gap < 0"""
    force: Floats
    """Contact force [N]"""
    x: Floats
    """Position of the contact point along the plateau [m]"""


class Apart(NamedTuple):
    """Differences of two answers at the worst tick."""

    depth: float
    """Difference of the depth [m]"""
    force: float
    """Difference of the force [N]"""
    x: float
    """Difference of the contact point [m]"""


def apart(one: Answer, other: Answer) -> Apart:
    """The largest differences of any tick."""
    return Apart(*(float(np.abs(a - b).max()) for a, b in zip(one, other, strict=True)))


def exact(geometry: Geometry, scene: Scene, coarser: float = 1.0) -> Answer:
    """Solve a scene with a geometry by the reference: Eq. 13 of the paper, by code that is not the model's."""
    layers, mass = law_and_mass(BASE)
    asked = reference.Scene(scene.time, scene.angle, scene.load, layers, mass, geometry.femur,
                            relative_tolerance=coarser * geometry.relative_tolerance)  # fmt: skip
    found = reference.answers(asked)
    places = [geometry.contact_x(*each) for each in zip(scene.angle.tolist(), found.state.tolist(), strict=True)]
    return Answer(found.depth, found.force, np.array(places))


def law_and_mass(path: Path) -> tuple[Layers, float]:
    """Contact law of the reference, with the numbers of a parameter file, and the mass [kg]."""
    parameters = load_parameters(path)
    contact = parameters.contact
    return kelvin_voigt(contact.stiffness, contact.exponent, contact.damping), parameters.femur.mass


def model_of(geometry: Geometry, level: str, tolerance: float, compiled: bool = True) -> KneeModel:
    """Model with the surfaces of a geometry."""
    parameters = load_parameters(list(geometry.files))
    fidelity = parameters.fidelity.model_copy(update={"level": level, "tolerance": tolerance})
    return load_model(parameters.model_copy(update={"fidelity": fidelity}), compiled=compiled)


def run(model: KneeModel, scene: Scene) -> np.recarray[Any, Any]:
    """Run the model on a scene, and return its records."""
    return model.run(scene.time, scene.angle, scene.load)


def answer_of(series: np.recarray[Any, Any]) -> Answer:
    """Outputs that a user reads of the records."""
    return Answer(series.penetration_depth - series.gap, series.contact_force, series.contact_point["x"])
