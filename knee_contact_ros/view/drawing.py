"""What a viewer is given of the knee and of its answers: plain numbers, so that it needs no model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.core.model import KneeModel
from knee_contact_ros.messages.answer import Answer

PLATEAU_REACH = 0.04
"""How far [m] the tibial surface is drawn to both sides."""
FLEXIONS = np.radians(np.arange(0.0, 81.0, 5.0))
"""Angles [rad] between which a walking knee's contact is looked for"""
Floats = NDArray[np.float64]


class Drawing(NamedTuple):
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


class Shown(NamedTuple):
    """What is shown of answers: one per element, all of shape (n,)."""

    stamp: NDArray[np.int64]
    """[ns]"""
    flexion_angle: Floats
    """[rad]"""
    load: Floats
    """[N]"""
    contact_force: Floats
    """[N]"""
    penetration_depth: Floats
    """[m]"""
    gap: Floats
    """[m]"""
    sliding_velocity: Floats
    """[m/s]; not a number in recordings that were made before it was added"""
    point_x: Floats
    """[m] of the contact point, tibia frame"""
    point_y: Floats
    """[m]"""
    femoral_x: Floats
    """[m] of the femoral reference point, tibia frame"""
    femoral_height: Floats
    """[m]"""
    normal_x: Floats
    """Of the tibial surface at the contact point, from tibia to femur"""
    normal_y: Floats
    contact_state: Floats
    """`ContactState`"""
    fidelity: Floats
    """`Fidelity`"""
    status: Floats
    """Set of `Status` bits"""
    error_estimate: Floats
    """[m]"""
    force_error_estimate: Floats
    """[N]; not a number likewise"""
    evaluations: Floats
    """Contact law evaluations"""
    latency: Floats
    """[s] from a load's arrival to its answer's publication; not a number if it was not measured"""

    def chosen(self, which: NDArray[Any] | slice) -> Shown:
        """Some of the answers."""
        return Shown(self.stamp[which], *(column[which] for column in self[1:]))


def drawing_of(model: KneeModel, knee: str, body_weight: float) -> Drawing:
    """The outlines of a model; forces will be shown in units of `body_weight` [N]."""
    femur, tibia = model.pair.femur.outline(), model.pair.outline(PLATEAU_REACH)
    return Drawing(knee, femur, tibia, model.cartilage_thickness, contact_range(model), body_weight)


def contact_range(model: KneeModel) -> tuple[float, float]:
    """Lowest and highest x [m] of the contact in a walking knee."""
    found = []
    for angle in FLEXIONS.tolist():
        x, _ = model.mechanism.translation(angle)
        height = model.pair.femur.support(angle)[0]
        found.append(model.pair.closest(angle, x, height).point(x, height)[0])
    return min(found), max(found)


def shown_row(answer: Answer) -> tuple[Any, ...]:
    """What `shown` needs of an answer, as a plain tuple, which is quick to make and to send."""
    contact, (point_x, point_y, _) = answer.contact, answer.contact.contact_point
    return (
        answer.stamp, contact.flexion_angle, contact.load, contact.contact_force, contact.penetration_depth,
        contact.gap, contact.sliding_velocity, point_x, point_y, answer.femoral_x, contact.femoral_height,
        *answer.normal, contact.contact_state, contact.fidelity, contact.status, contact.error_estimate,
        contact.force_error_estimate, contact.evaluations, answer.latency,
    )  # fmt: skip


def shown(rows: Sequence[tuple[Any, ...]]) -> Shown:
    """Columns of rows that `shown_row` gives; at least one."""
    stamps, *columns = zip(*rows, strict=True)
    return Shown(np.array(stamps, dtype=np.int64), *np.array(columns, dtype=np.float64))
