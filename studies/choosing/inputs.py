"""The effect of uncertain inputs on the answer: the same scene with one input changed, on the measured knee."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from knee_contact_ros.parameters.build import load_model
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.parameters.schema import Parameters
from studies.choosing.errors import Answer, Apart, answer_of, apart
from studies.choosing.geometries import BASE, CONFIG
from studies.choosing.scenes import Floats, Scene

Files = tuple[Path, Path]
FINE = {"fidelity": {"level": "dynamic", "tolerance": 1e-9}}
"""Fidelity so fine that nothing but the input differs"""
KNEE: Files = (BASE, CONFIG / "mri_knee.yaml")
LAYERED: Files = (CONFIG / "osteoarthritis.yaml", CONFIG / "mri_knee.yaml")


class Change(NamedTuple):
    """A change of an input that is not well known."""

    name: str
    why: str
    parameters: dict[str, dict[str, float]]
    """Values that change, by section of the parameters"""
    load: float = 1.0
    """Factor of the load"""
    angle: float = 0.0
    """Angle [rad] that is added to the flexion angle"""
    files: Files = KNEE


class Effect(NamedTuple):
    """Effect of a change on a scene."""

    change: Change
    scene: str
    peak_depth: float
    """Change of the largest depth [m]"""
    peak_depth_percent: float
    peak_force: float
    """Change of the largest force [N]"""
    peak_force_percent: float
    worst: Apart
    """Largest difference at any tick"""


def changes() -> list[Change]:
    """List the changes."""
    share, stiffness, layer = 0.7 / 0.5, 7.905694e7, 5e-4
    return [
        Change("medial share 0.5 → 0.7", "in vivo 0.6 to 0.8 of the whole load", {}, load=share),
        Change("body mass + 10 %", "load and femur in proportion", {"femur": {"mass": 1.1 * 9.3014}}, load=1.1),
        Change("stiffness − 20 %", "", {"contact": {"stiffness": 0.8 * stiffness}}),
        Change("stiffness + 20 %", "", {"contact": {"stiffness": 1.2 * stiffness}}),
        Change("femoral size − 10 %", "radius of the condyle: `femur.scale`", {"femur": {"scale": 0.9}}),
        Change("femoral size + 10 %", "the same", {"femur": {"scale": 1.1}}),
        Change("flexion angle + 5°", "`knee.flexion_offset`: markers, neutral pose", {}, angle=math.radians(5.0)),
        Change("layer depth − 20 %", "of the 0.5 mm of osteoarthritis.yaml",
               {"contact": {"layer_depth": 0.8 * layer}}, files=LAYERED),
        Change("layer depth + 20 %", "the same", {"contact": {"layer_depth": 1.2 * layer}}, files=LAYERED),
    ]  # fmt: skip


def effects(scene: Scene) -> list[Effect]:
    """Effects of all changes on a scene."""
    bases = {files: answer(load_parameters(list(files)), scene.angle, scene) for files in (KNEE, LAYERED)}
    return [effect(change, scene, bases[change.files]) for change in changes()]


def effect(change: Change, scene: Scene, base: Answer) -> Effect:
    """Effect of one change on a scene."""
    changed = changed_parameters(change)
    found = answer(changed, scene.angle + change.angle, scene._replace(load=change.load * scene.load))
    depth, force = base.depth.max(), base.force.max()
    deeper, stronger = float(found.depth.max() - depth), float(found.force.max() - force)
    return Effect(change, scene.name, deeper, 100.0 * deeper / depth, stronger, 100.0 * stronger / force,
                  apart(base, found))  # fmt: skip


def changed_parameters(change: Change) -> Parameters:
    """Parameters of the file with the values of a change."""
    parameters = load_parameters(list(change.files))
    sections: dict[str, Any] = {
        name: getattr(parameters, name).model_copy(update=values) for name, values in change.parameters.items()
    }
    return parameters.model_copy(update=sections)


def answer(parameters: Parameters, angle: Floats, scene: Scene) -> Answer:
    """Outputs that a user reads, with parameters, a change of the angle [rad] and a scene."""
    fidelity = parameters.fidelity.model_copy(update=FINE["fidelity"])
    model = load_model(parameters.model_copy(update={"fidelity": fidelity}), compiled=True)
    return answer_of(model.run(scene.time, np.asarray(angle), scene.load))
