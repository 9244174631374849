"""Simulated sensors of a leg: hip and ankle angles by OpenSim's kinematics, and the ground's force about the ankle."""

from __future__ import annotations

import json
from pathlib import Path
from typing import NamedTuple

import numpy as np

from knee_contact_ros.offline.gait_files import knee_gait
from knee_contact_ros.offline.gait_files.knee_gait import Angles
from knee_contact_ros.offline.gait_files.leg_gait import GroundForces, Leg, interpolated
from knee_contact_ros.offline.gait_files.storage import Floats, Stamps, Storage
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.tools.opensim import leg_step
from knee_contact_ros.tools.opensim.columns import LEFT, SIDE_WORDS, coordinate_of, words
from knee_contact_ros.tools.opensim.external_loads import GroundFile
from knee_contact_ros.tools.opensim.ground import about_ankle, check_upright, during
from knee_contact_ros.tools.opensim.model_file import read_xml
from knee_contact_ros.tools.opensim.opensim_process import check_opensim, last_words, run_python

AHEAD = 0.7
"""Smallest mean x component of the pelvis's forward direction: within 45 degrees of x"""


class LegJoints(NamedTuple):
    """Names of a leg's joints in a model."""

    side: str
    hip: str
    knee: str
    ankle: str

    @property
    def names(self) -> tuple[str, str, str]:
        """Names of hip, knee and ankle."""
        return self.hip, self.knee, self.ankle


class LegGait(NamedTuple):
    """Measurements of a leg's simulated sensors, with their origin."""

    leg: Leg
    columns: str
    """Names of the columns of the ground's forces"""
    notes: tuple[str, ...]
    """What was converted or left out, as sentences"""


class Places(NamedTuple):
    """Positions of a leg in the ground frame (x forward, y up, z to the right)."""

    stamps: Stamps
    """Stamps of the kinematics [ns], shape (n,)"""
    hip: Floats
    """Centre of the hip joint [m], shape (n, 3)"""
    knee: Floats
    """Centre of the knee joint [m], shape (n, 3)"""
    ankle: Floats
    """Centre of the ankle joint [m], shape (n, 3)"""
    forward: Floats
    """Direction of the pelvis's x axis, shape (n, 3)"""
    toes_up: Floats
    """Angle of the foot's x axis above the shank's [rad], shape (n,)"""


def read_leg(
    ground: GroundFile, kinematics: Storage, degrees: bool, model: Path, joints: LegJoints, work: Path
) -> LegGait:
    """Simulate the sensors of a leg.

    Args:
        ground: ground reactions on the foot.
        kinematics: coordinates of the model over time.
        degrees: whether angles in the kinematics are in degrees.
        model: file of the model.
        joints: joints of the leg in the model.
        work: folder for a process of OpenSim and its log.

    Raises:
        UsageError: OpenSim is not installed or fails, or a file cannot be used or does not fit the others.
    """
    check_opensim()
    check_upright(ground)
    ground = during(ground, kinematics.stamps)
    places = places_of(kinematics, degrees, model, joints, work)
    check_heading(kinematics, places)
    ankle = np.column_stack([interpolated(ground.data.stamps, places.stamps, column) for column in places.ankle.T])
    forces = about_ankle(ground, ankle)
    notes = [
        f"hip and ankle: by OpenSim, of {', '.join(joints.names)} of {model.name}",
        "ground: moved from the centre of pressure to the ankle",
        *ground.notes,
    ]
    if not all(force.torque for force in ground.forces):
        notes.append("ground: no free moment in the file")
    if joints.side == LEFT:
        forces = GroundForces(*knee_gait.mirrored(knee_gait.Reactions(*forces)))
        notes.append("ground: left leg mirrored to a right one (force z, torque x and y turned)")
    hip, ankle_angle = (Angles(places.stamps, angle, None) for angle in (thigh_angle(places), places.toes_up))
    columns = ", ".join(force.columns for force in ground.forces)
    return LegGait(Leg(hip, ankle_angle, forces), columns, tuple(notes))


def thigh_angle(places: Places) -> Floats:
    """Angle [rad] between thigh and vertical in the sagittal plane, positive when the knee is ahead; shape (n,)."""
    thigh = places.knee - places.hip
    return np.asarray(np.arctan2(thigh[:, 0], -thigh[:, 1]))


def leg_joints(model: Path, side: str, coordinate: str | None) -> LegJoints:
    """Find the joints of a leg in a model's file; the knee is the joint with the coordinate.

    Raises:
        UsageError: the file is no model, or a joint is not there or not unique.
    """
    joints = [e for e in read_xml(model, "Model").iter() if e.tag.endswith("Joint") and e.get("name")]
    knees = [e.get("name", "") for e in joints if any(c.get("name") == coordinate for c in e.iter("Coordinate"))]
    names = [name for name in (e.get("name", "") for e in joints) if words(name) & SIDE_WORDS[side]]
    return LegJoints(
        side,
        only(model, f"{side} hip", [name for name in names if "hip" in words(name)]),
        only(model, f"coordinate {coordinate}", knees),
        only(model, f"{side} ankle", [name for name in names if "ankle" in words(name)]),
    )


def only(model: Path, what: str, names: list[str]) -> str:
    """Return the only name, whose repetitions do not count; `what` describes it in messages.

    Raises:
        UsageError: there are other names, or none.
    """
    different = list(dict.fromkeys(names))
    if len(different) != 1:
        having = f"the joints {', '.join(different)}" if different else "no joint"
        raise UsageError(f"{model} has {having} of the {what}, and one is needed")
    return different[0]


def places_of(kinematics: Storage, degrees: bool, model: Path, joints: LegJoints, work: Path) -> Places:
    """Compute the positions of a leg at the rows of the kinematics, with OpenSim in a process of its own.

    Raises:
        UsageError: a number is not finite, or OpenSim fails.
    """
    known = {e.get("name") for e in read_xml(model, "Model").iter("Coordinate")}
    columns = {coordinate_of(name): name for name in kinematics.names}
    coordinates = {name: kinematics.column(column).tolist() for name, column in columns.items() if name in known}
    request, answer, log = (work / name for name in ("leg_request.json", "leg_answer.json", "leg.log"))
    content = {"model": str(model.absolute()), "joints": joints.names, "degrees": degrees, "coordinates": coordinates}
    request.write_text(json.dumps(content), encoding="utf-8")
    if code := run_python(leg_step.__name__, (request.name, answer.name), work, log):
        raise UsageError(f"OpenSim failed with {model}, code {code}: {last_words(log)}")
    table = np.array(json.loads(answer.read_text(encoding="utf-8")))
    hip, knee, ankle, forward = np.split(table[:, :12], 4, axis=1)
    return Places(kinematics.stamps, hip, knee, ankle, forward, table[:, 12])


def check_heading(kinematics: Storage, places: Places) -> None:
    """Check that the person faces towards x.

    Raises:
        UsageError: the person does not.
    """
    x, _, z = places.forward.mean(axis=0)
    if x < AHEAD:
        raise UsageError(
            f"{kinematics.path}: the pelvis points to x {x:.2f}, z {z:.2f} on average, and a leg's sensors have x "
            "forward: turn markers and ground reactions about y, so that the person walks towards x"
        )
