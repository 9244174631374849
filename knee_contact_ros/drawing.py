"""What a viewer is given of the knee and of its answers: plain numbers, so that it needs no model."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.answer import Answer
from knee_contact_ros.core.model import KneeModel

PLATEAU_REACH = 0.04
"""How far [m] the tibial surface is drawn to both sides."""


class Drawing(NamedTuple):
    """What does not change."""

    femur: NDArray[np.float64]
    """Points of the femoral surface, shape (n, 2) [m], femur frame"""
    tibia: NDArray[np.float64]
    """Points of the tibial surface under the femur, shape (n, 2) [m], tibia frame"""
    second_layer: float
    """[m] penetration depth at which it begins; infinite or not a number if there is none"""
    body_weight: float
    """[N] unit of the forces shown"""


class Shown(NamedTuple):
    """What is shown of an answer."""

    stamp: int
    """[ns]"""
    flexion_angle: float
    """[rad]"""
    load: float
    """[N]"""
    contact_force: float
    """[N]"""
    penetration_depth: float
    """[m]"""
    gap: float
    """[m]"""
    point_x: float
    """[m] of the contact point, tibia frame"""
    point_y: float
    """[m]"""
    femoral_x: float
    """[m] of the femoral reference point, tibia frame"""
    femoral_height: float
    """[m]"""
    normal_x: float
    """Of the tibial surface at the contact point, from tibia to femur"""
    normal_y: float


def drawing_of(model: KneeModel, body_weight: float) -> Drawing:
    """The outlines of a model; forces will be shown in units of `body_weight` [N]."""
    return Drawing(
        model.pair.femur.outline(), model.pair.outline(PLATEAU_REACH), model.cartilage_thickness, body_weight
    )


def shown_row(answer: Answer) -> tuple[Any, ...]:
    """A `Shown` of an answer as a plain tuple, which is quick to make and to send."""
    contact, (point_x, point_y, _) = answer.contact, answer.contact.contact_point
    return (
        answer.stamp, contact.flexion_angle, contact.load, contact.contact_force, contact.penetration_depth,
        contact.gap, point_x, point_y, answer.femoral_x, contact.femoral_height, *answer.normal,
    )  # fmt: skip
