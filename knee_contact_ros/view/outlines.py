"""What a viewer is given of the knee: plain numbers, so that its process needs no model."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.core.contact_laws.base import ContactLaw
from knee_contact_ros.core.model import KneeModel
from knee_contact_ros.core.readouts import ContactPatch
from knee_contact_ros.messages.topics import KNEE_CONTACT, LATERAL, MEDIAL, compartment_name, knee_name
from knee_contact_ros.sinks.protocol import Job, Knee, Sink
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.view.anatomy import Anatomy, anatomy_of
from knee_contact_ros.view.window import executable

VIEWER = "knee_contact_ros.view.output"
"""Imported by its process alone: Rerun is large"""
NICENESS = 10
"""A viewer may wait for all others. A recorder may not: what it has not written yet is lost with the node."""
FILE_GATHER, LIVE_GATHER = 0.25, 0.05
"""How long [s] answers are gathered for a viewer: nobody looks at a file that is written"""
PLATEAU_REACH = 0.04
"""How far [m] the tibial surface is drawn to both sides."""
NEWTONS_PER_MM = 50.0
"""Scale of the force arrow"""
FLEXIONS = np.radians(np.arange(0.0, 81.0, 5.0))
"""Angles [rad] between which a walking knee's contact is looked for"""
STILL = 1e-5
"""Less of a way [m] is none"""
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
    anatomy: Anatomy
    """What is drawn of bones and cartilage"""
    law: ContactLaw
    patch: ContactPatch | None
    """What tells pressure and patch; None: not known"""
    height_prescribed: bool
    """Whether the femoral height drives, and no load"""

    @property
    def has_bone(self) -> bool:
        """Whether the contact law has a second layer."""
        return math.isfinite(self.second_layer)

    @property
    def point_moves(self) -> bool:
        """Whether the contact of a walking knee moves along the plateau: that of a circle on a hinge stands still."""
        low, high = self.contact_range
        return high - low > STILL


class Serving(NamedTuple):
    """How a scene is served to viewers."""

    port: int
    """Of this machine's loopback interface"""
    window: bool
    """Whether a viewer is opened on this machine"""
    knees: tuple[str, ...] = ()
    """Names of all knees that share the viewer, this one's among them; none: it has the viewer for itself"""


def sink_for(knee: Knee) -> Sink | None:
    """A process that writes a Rerun file or serves a scene; see `output.py`.

    Raises:
        UsageError: Rerun is not installed, or the knee's name is none of those that share the viewer.
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
    """The outlines of a knee's compartments, the only one or medial and lateral; see `drawing_of`."""
    names = [compartment_name(knee, of) for of in (MEDIAL, LATERAL)] if len(models) > 1 else [knee]
    return tuple(drawing_of(model, name, body_weight) for model, name in zip(models, names, strict=True))


def drawing_of(model: KneeModel, knee: str, body_weight: float) -> KneeOutlines:
    """The outlines of a model; forces will be shown in units of `body_weight` [N]."""
    femur, tibia = model.pair.femur.outline(), model.pair.outline(PLATEAU_REACH)
    reach = contact_range(model)
    return KneeOutlines(
        knee, femur, tibia, model.cartilage_thickness, reach, body_weight, anatomy_of(model, reach), model.modes.law,
        model.patch, model.height_prescribed,
    )  # fmt: skip


def contact_range(model: KneeModel) -> tuple[float, float]:
    """Lowest and highest x [m] of the contact in a walking knee."""
    found = []
    for angle in FLEXIONS.tolist():
        x, _ = model.mechanism.translation(angle)
        height = model.pair.femur.support(angle)[0]
        found.append(model.pair.closest(angle, x, height).point(x, height)[0])
    return min(found), max(found)
