"""The outlines of a knee as plain numbers, so that the process of a viewer needs no model."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.messages.topics import KNEE_CONTACT, LATERAL, MEDIAL, compartment_name, knee_name
from knee_contact_ros.model.knee import KneeModel
from knee_contact_ros.model.laws import ContactLaw
from knee_contact_ros.model.readouts import ContactPatch
from knee_contact_ros.sinks.protocol import Job, Knee, Sink
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.view.anatomy import Anatomy, anatomy_of
from knee_contact_ros.view.window import executable

VIEWER = "knee_contact_ros.view.output"
"""Module that only the process of the viewer imports: Rerun is large"""
NICENESS = 10
"""Niceness of a viewer's process: it may wait for all others, unlike a recorder, whose unwritten data can be lost"""
FILE_GATHER, LIVE_GATHER = 0.25, 0.05
"""Time [s] for which answers are gathered before they are sent to the viewer's process, for a file and live"""
PLATEAU_REACH = 0.04
"""Half the length [m] of the drawn tibial surface"""
NEWTONS_PER_MM = 50.0
"""Scale of the force arrow [N/mm]"""
FLEXIONS = np.radians(np.arange(0.0, 81.0, 5.0))
"""Flexion angles [rad] of a walking knee at which its contact is looked for"""
STILL = 1e-5
"""Movement [m] of the contact point below which it counts as standing still"""
Floats = NDArray[np.float64]


class KneeOutlines(NamedTuple):
    """Parts of a knee's scene that do not change."""

    knee: str
    """Name of the knee or the compartment"""
    femur: Floats
    """Points of the femoral surface, shape (n, 2) [m], femur frame"""
    tibia: Floats
    """Points of the tibial surface under the femur, shape (n, 2) [m], tibia frame"""
    second_layer: float
    """Penetration depth [m] at which the second layer begins; infinite or NaN if there is none"""
    contact_range: tuple[float, float]
    """Lowest and highest x [m] of the contact of a walking knee"""
    body_weight: float
    """Body weight [N], the unit of the forces shown"""
    anatomy: Anatomy
    """Polygons of bones and cartilage"""
    law: ContactLaw
    """Contact law, for pressure and patch"""
    patch: ContactPatch | None
    """Contact patch from which pressure is computed; None: not known"""
    height_prescribed: bool
    """Whether the femoral height drives the model, and not a load"""

    @property
    def has_bone(self) -> bool:
        """Whether the contact law has a second layer."""
        return math.isfinite(self.second_layer)

    @property
    def point_moves(self) -> bool:
        """Whether the contact of a walking knee moves along the plateau; that of a circle on a hinge does not."""
        low, high = self.contact_range
        return high - low > STILL


class Serving(NamedTuple):
    """Options of serving a scene to viewers."""

    port: int
    """Port of this machine's loopback interface"""
    window: bool
    """Whether a viewer is opened on this machine"""
    knees: tuple[str, ...] = ()
    """Names of all knees that share the viewer, with this one's; empty: this knee has the viewer for itself"""


def sink_for(knee: Knee) -> Sink | None:
    """Describe the process that writes a Rerun file or serves a scene (`output.py`); None if drawing is off.

    Raises:
        UsageError: Rerun is not installed, or the knee's name is not among those that share the viewer.
    """
    rerun, name = knee.parameters.rerun, knee_name(knee.names[KNEE_CONTACT])
    models = tuple(knee.models.values())
    if rerun.mode == "off":
        return None
    executable(f"parameter rerun.mode: {rerun.mode}: ")
    knees = tuple(one.strip() for one in rerun.knees.split(",")) if rerun.knees else ()
    if knees and (name not in knees or "" in knees):
        raise UsageError(
            f"parameter rerun.knees: {rerun.knees!r} is not allowed; this knee, {name}, must be one of them"
        )
    path = Path(rerun.path) if rerun.mode == "file" else None
    if len(models) > 1:  # each is a knee of its own to a viewer
        knees = tuple(compartment_name(one, of) for one in knees or (name,) for of in (MEDIAL, LATERAL))
    serving = Serving(rerun.port, rerun.mode == "spawn", knees)
    job = Job(VIEWER, (path, serving, drawings_of(models, name, knee.parameters.body_weight)))
    kind = "Rerun recording" if path else f"Rerun scene on port {serving.port}"
    gather = FILE_GATHER if path else LIVE_GATHER
    return Sink("viewer", kind, str(path or ""), job, "row", gaps_allowed=True, niceness=NICENESS, gather=gather)


def drawings_of(models: Sequence[KneeModel], knee: str, body_weight: float) -> tuple[KneeOutlines, ...]:
    """Make the outlines of a knee's compartments, the only one or medial and lateral; see `drawing_of`."""
    names = [compartment_name(knee, of) for of in (MEDIAL, LATERAL)] if len(models) > 1 else [knee]
    return tuple(drawing_of(model, name, body_weight) for model, name in zip(models, names, strict=True))


def drawing_of(model: KneeModel, knee: str, body_weight: float) -> KneeOutlines:
    """Make the outlines of a model; forces will be shown in units of `body_weight` [N]."""
    femur, tibia = model.pair.femur.outline(), model.pair.outline(PLATEAU_REACH)
    reach = contact_range(model)
    return KneeOutlines(
        knee, femur, tibia, model.cartilage_thickness, reach, body_weight, anatomy_of(model, reach), model.law,
        model.patch, model.height_prescribed,
    )  # fmt: skip


def contact_range(model: KneeModel) -> tuple[float, float]:
    """Return the lowest and the highest x [m] of the contact in a walking knee."""
    places = []
    for angle in FLEXIONS.tolist():
        x, _ = model.pair.mechanism.translation(angle)
        height = model.pair.femur.support(angle)[0]
        places.append(model.closest(angle, height).point(x, height)[0])
    return min(places), max(places)
