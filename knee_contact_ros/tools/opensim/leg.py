"""What a leg's sensors would have told of a gait: hip and ankle by OpenSim, the ground's force about the ankle."""

from __future__ import annotations

import json
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

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
"""Mean x of the direction in which the pelvis points: within 45 degrees of x"""


class LegJoints(NamedTuple):
    """A leg's joints in a model."""

    side: str
    hip: str
    knee: str
    ankle: str

    @property
    def names(self) -> tuple[str, str, str]:
        """Hip, knee, ankle."""
        return self.hip, self.knee, self.ankle


class LegGait(NamedTuple):
    """What a leg's sensors would have told, and where it comes from."""

    leg: Leg
    columns: str
    """Of the ground's forces"""
    notes: tuple[str, ...]
    """What was converted or left out"""


class Places(NamedTuple):
    """Where a leg is, in ground (x forward, y up, z to the right)."""

    stamps: Stamps
    """[ns], of the kinematics; shape (n,)"""
    hip: Floats
    """[m] the joint's centre, shape (n, 3); likewise the others"""
    knee: Floats
    ankle: Floats
    forward: Floats
    """The pelvis's x axis, shape (n, 3)"""
    toes_up: Floats
    """[rad] of the foot's x axis above the shank's, shape (n,)"""


def read_leg(
    ground: GroundFile, kinematics: Storage, degrees: bool, model: Path, joints: LegJoints, work: Path
) -> LegGait:
    """What the sensors of a leg would have told.

    Args:
        ground: the forces on its foot.
        kinematics: coordinates of the model over time.
        degrees: whether angles of it are in degrees.
        model: the model's file.
        joints: of the leg.
        work: a folder for a process of OpenSim, with its log.

    Raises:
        UsageError: OpenSim is not installed or fails, or a file cannot be used or does not fit the others.
    """
    check_opensim()
    check_upright(ground)
    ground = during(ground, kinematics.stamps)
    places = places_of(kinematics, degrees, model, joints, work)
    check_heading(kinematics, places)
    ankle = np.column_stack([interpolated(ground.data.stamps, places.stamps, column) for column in places.ankle.T])
    told = about_ankle(ground, ankle)
    notes = [
        f"hip and ankle: by OpenSim, of {', '.join(joints.names)} of {model.name}",
        "ground: moved from the centre of pressure to the ankle",
        *ground.notes,
    ]
    if not all(force.torque for force in ground.forces):
        notes.append("ground: no free moment in the file")
    if joints.side == LEFT:
        told = mirrored(told)
        notes.append("ground: left leg mirrored to a right one (force z, torque x and y turned)")
    hip, ankle_angle = (Angles(places.stamps, angle, None) for angle in (thigh_angle(places), places.toes_up))
    columns = ", ".join(force.told for force in ground.forces)
    return LegGait(Leg(hip, ankle_angle, told), columns, tuple(notes))


def thigh_angle(places: Places) -> Floats:
    """Angle [rad] between thigh and vertical in the sagittal plane, positive when the knee is ahead; shape (n,)."""
    thigh = places.knee - places.hip
    return np.asarray(np.arctan2(thigh[:, 0], -thigh[:, 1]))


def mirrored(ground: GroundForces) -> GroundForces:
    """A left leg's as a right one's."""
    return GroundForces(*knee_gait.mirrored(knee_gait.Reactions(*ground)))


def leg_joints(model: Path, side: str, coordinate: str | None) -> LegJoints:
    """The joints in a model's file; the knee is the one with the coordinate.

    Raises:
        UsageError: it is no model, or one of them is not there or not unique.
    """
    joints = [e for e in read_xml(model, "Model").iter() if e.tag.endswith("Joint") and e.get("name")]
    knees = [e for e in joints if any(c.get("name") == coordinate for c in e.iter("Coordinate"))]
    return LegJoints(
        side,
        the_one(model, f"{side} hip", named(joints, "hip", side)),
        the_one(model, f"coordinate {coordinate}", [knee.get("name", "") for knee in knees]),
        the_one(model, f"{side} ankle", named(joints, "ankle", side)),
    )


def named(joints: list[ET.Element], part: str, side: str) -> list[str]:
    """Names that have a word and a side."""
    names = [joint.get("name", "") for joint in joints]
    return [name for name in names if part in words(name) and words(name) & SIDE_WORDS[side]]


def the_one(model: Path, what: str, names: list[str]) -> str:
    """The only name.

    Raises:
        UsageError: there are more, or none.
    """
    found = list(dict.fromkeys(names))
    if len(found) != 1:
        having = f"the joints {', '.join(found)}" if found else "no joint"
        raise UsageError(f"{model} has {having} of the {what}, and one is needed")
    return found[0]


def places_of(kinematics: Storage, degrees: bool, model: Path, joints: LegJoints, work: Path) -> Places:
    """Where OpenSim's model has the leg at the rows of the kinematics.

    Raises:
        UsageError: a number is not finite, or OpenSim fails.
    """
    known = {e.get("name") for e in read_xml(model, "Model").iter("Coordinate")}
    columns = {coordinate_of(name): name for name in kinematics.names}
    coordinates = {name: kinematics.column(column).tolist() for name, column in columns.items() if name in known}
    asked, answer, log = (work / name for name in ("leg_asked.json", "leg_answer.json", "leg.log"))
    where = {"model": str(model.absolute()), "joints": joints.names, "degrees": degrees}
    asked.write_text(json.dumps(where | {"coordinates": coordinates}), encoding="utf-8")
    if code := run_python(leg_step.__name__, (asked.name, answer.name), work, log):
        raise UsageError(f"OpenSim failed with {model}, code {code}: {last_words(log)}")
    table = np.array(json.loads(answer.read_text(encoding="utf-8")))
    hip, knee, ankle, forward = np.split(table[:, :12], 4, axis=1)
    return Places(kinematics.stamps, hip, knee, ankle, forward, table[:, 12])


def check_heading(kinematics: Storage, places: Places) -> None:
    """Check that the person faces in the direction of x.

    Raises:
        UsageError: they do not.
    """
    x, _, z = places.forward.mean(axis=0)
    if x < AHEAD:
        raise UsageError(
            f"{kinematics.path}: the pelvis points to x {x:.2f}, z {z:.2f} on average, and a leg's sensors have x "
            "forward: turn markers and ground reactions about y, so that the person walks towards x"
        )
