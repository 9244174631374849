"""The model's answers to a scene."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from knee_contact_ros.model.knee import KneeModel
from knee_contact_ros.model.laws import CONTACT_LAWS
from knee_contact_ros.model.mechanisms import hinge
from knee_contact_ros.model.surfaces import ContactPair, Plane
from knee_contact_ros.model.ticks import LEVELS
from studies.ellipse import Ellipse, SmoothFemur
from studies.honesty.scenes import Scene


@lru_cache(maxsize=8)
def pair(half_axes: tuple[float, float], slope: float) -> ContactPair:
    """An ellipse, its half axes in [m], on a plane: its table is made once for all models of a scene."""
    return ContactPair(
        SmoothFemur(closed_form=Ellipse(*map(float, half_axes)).support), Plane(slope), hinge()
    )


def knee(
    scene: Scene, level: str, tolerance: float, budget: int = 0, force_tolerance: float = 0.0
) -> KneeModel:
    """Compiled model of a scene at a level of `LEVELS`; tolerances are in [m] and, unless it is 0, in [N]."""
    return KneeModel(
        pair=pair(scene.half_axes, scene.slope),
        law=CONTACT_LAWS[scene.law](**scene.arguments),
        mass=scene.mass,
        tolerance=tolerance,
        budget=budget,
        force_tolerance=force_tolerance,
        allow_tension=scene.allow_tension,
        level=LEVELS[level],
        compiled=True,
    )


def model(
    scene: Scene, level: str, tolerance: float, budget: int = 0, force_tolerance: float = 0.0
) -> np.recarray[Any, Any]:
    """Answers of the model to a scene, one per tick."""
    return knee(scene, level, tolerance, budget, force_tolerance).run(
        scene.time, scene.angle, scene.load
    )
