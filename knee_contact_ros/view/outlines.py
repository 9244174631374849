"""What a viewer is given of the knee: plain numbers, so that it needs no model."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.core.model import KneeModel

PLATEAU_REACH = 0.04
"""How far [m] the tibial surface is drawn to both sides."""
FLEXIONS = np.radians(np.arange(0.0, 81.0, 5.0))
"""Angles [rad] between which a walking knee's contact is looked for"""
Floats = NDArray[np.float64]


class KneeOutlines(NamedTuple):
    """What does not change."""

    knee: str
    """Its name"""
    femur: Floats
    """Points of the femoral surface, shape (n, 2) [m], femur frame"""
    tibia: Floats
    """Points of the tibial surface under the femur, shape (n, 2) [m], tibia frame"""
    second_layer: float
    """[m] penetration depth at which it begins; infinite or not a number if there is none"""
    contact_range: tuple[float, float]
    """x [m] between which the contact of a walking knee lies"""
    body_weight: float
    """[N] unit of the forces shown"""


class Serving(NamedTuple):
    """How a scene is served to viewers."""

    port: int
    """Of this machine's loopback interface"""
    window: bool
    """Whether a viewer is opened on this machine"""
    knees: tuple[str, ...] = ()
    """Names of all knees that share the viewer, this one's among them; none: it has the viewer for itself"""


def drawing_of(model: KneeModel, knee: str, body_weight: float) -> KneeOutlines:
    """The outlines of a model; forces will be shown in units of `body_weight` [N]."""
    femur, tibia = model.pair.femur.outline(), model.pair.outline(PLATEAU_REACH)
    return KneeOutlines(knee, femur, tibia, model.cartilage_thickness, contact_range(model), body_weight)


def contact_range(model: KneeModel) -> tuple[float, float]:
    """Lowest and highest x [m] of the contact in a walking knee."""
    found = []
    for angle in FLEXIONS.tolist():
        x, _ = model.mechanism.translation(angle)
        height = model.pair.femur.support(angle)[0]
        found.append(model.pair.closest(angle, x, height).point(x, height)[0])
    return min(found), max(found)
