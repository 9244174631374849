"""The model's answers to a scene."""

from __future__ import annotations

from typing import Any

import numpy as np

from knee_contact_ros.compiled.kernel import compiled
from knee_contact_ros.core.contact_laws import CONTACT_LAWS
from knee_contact_ros.core.contact_modes import ContactModes
from knee_contact_ros.core.contact_pairs import OnPlane
from knee_contact_ros.core.levels import LEVELS
from knee_contact_ros.core.mechanisms import Hinge
from knee_contact_ros.core.model import KneeModel
from studies.ellipse import Ellipse
from studies.honesty.scenes import Scene


def knee(scene: Scene, level: str, tolerance: float, budget: int = 0, force_tolerance: float = 0.0) -> KneeModel:
    """Compiled model of a scene at a level of `LEVELS`; tolerances are in [m] and, unless it is 0, in [N]."""
    model = KneeModel(
        pair=OnPlane(Ellipse(*map(float, scene.half_axes)), scene.slope),
        mechanism=Hinge(),
        modes=ContactModes(CONTACT_LAWS[scene.law](**scene.arguments), scene.allow_tension),
        mass=scene.mass,
        tolerance=tolerance,
        budget=budget,
        level=LEVELS[level],
        force_tolerance=force_tolerance,
    )
    return compiled(model)


def model(
    scene: Scene, level: str, tolerance: float, budget: int = 0, force_tolerance: float = 0.0
) -> np.recarray[Any, Any]:
    """Answers of the model to a scene, one per tick."""
    return knee(scene, level, tolerance, budget, force_tolerance).run(scene.time, scene.angle, scene.load)
