"""Simulated sensors of a leg: hip and ankle angles by OpenSim's kinematics, and the ground's force about the ankle."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

import numpy as np

from knee_contact_ros.lab.gait_bag import Angles, GroundForces, Leg, Reactions, interpolated, mirrored
from knee_contact_ros.lab.opensim import child
from knee_contact_ros.lab.opensim.pipeline import (
    NOTHING,
    check_opensim,
    last_words,
    named_data,
    read_xml,
    run_python,
    text_in,
)
from knee_contact_ros.lab.opensim.results import LEFT, RIGHT, SIDE_WORDS, coordinate_of, is_part, words
from knee_contact_ros.lab.tables import Floats, Stamps, Storage, read_storage, some
from knee_contact_ros.streams.topics import NANOSECONDS
from knee_contact_ros.system.errors import UsageError

XML = ".xml"
GROUND = {"ground", "/ground", *NOTHING}
"""Names of the ground frame, which is also meant where none is named"""
FOOT = ("foot", "calc", "talus", "toe", "heel", "mtp", "midfoot", "forefoot", "hindfoot")
"""Beginnings of words in names of the bodies of a foot"""
FORCE = re.compile(r"(?P<stem>.*force.*_)vx", re.IGNORECASE)
"""Name of a force's first column, as `ground_force_vx`, `1_ground_force_vx`, `ground_force_r_vx`"""
EXAMPLES = {"ground_force_": RIGHT, "1_ground_force_": LEFT}
"""Side of each force plate in OpenSim's own examples, which name no foot"""
TURNS = ("torque", "moment")


class FootForce(NamedTuple):
    """Columns of a force on a foot: the beginnings of their names, which x, y and z follow."""

    force: str
    """Columns of the force [N]"""
    point: str
    """Columns of the point of application [m]"""
    torque: str
    """Columns of the free moment [N m]; empty: there are none"""

    @property
    def columns(self) -> str:
        """Text that names the columns."""
        return " ".join(f"{name}(x y z)" for name in self if name)


class GroundFile(NamedTuple):
    """Ground reactions over time, and which of them act on a foot."""

    data: Storage
    forces: tuple[FootForce, ...]
    notes: tuple[str, ...]
    """What was left out, as sentences"""


def data_file(ground: Path, folder: Path | None = None) -> Path:
    """Find the file with the numbers: `ground` itself, or the one that it names if it is an external loads file.

    That file lies beside it, or is named from `folder`, in which a tool of OpenSim runs with it.

    Raises:
        UsageError: the external loads file names no file, or one that is not there.
    """
    return named_data(ground, folder) if ground.suffix.lower() == XML else ground


def read_ground(ground: Path, data: Path, side: str) -> GroundFile:
    """Read the forces on the right or left foot; `data` is the file that `data_file` finds.

    Raises:
        UsageError: a file cannot be read, it is not clear which forces act on the foot, or a column is missing.
    """
    storage = read_storage(data)
    if ground.suffix.lower() == XML:
        forces, notes = by_loads(ground, side)
    else:
        forces, notes = [by_names(storage, side)], []
    for force in forces:
        missing = [name + axis for name in force if name for axis in "xyz" if name + axis not in storage.names]
        if missing:
            raise UsageError(f"{storage.path} has no column {', '.join(missing)}; it has {some(storage.names)}")
    return GroundFile(storage, tuple(forces), tuple(notes))


def by_loads(path: Path, side: str) -> tuple[list[FootForce], list[str]]:
    """Forces that an external loads file applies to bodies of a foot, and notes on forces on other bodies than feet.

    Raises:
        UsageError: there are no forces on the foot, or they are not expressed in ground.
    """
    forces: list[FootForce] = []
    bodies: list[str] = []
    elsewhere: list[str] = []
    for element in read_xml(path, "ExternalLoads").iter("ExternalForce"):
        body = text_in(element, "applied_to_body")
        bodies.append(body)
        if not applies(element) or not body:
            continue
        if is_foot(body, side):
            forces.append(foot_force(path, element))
        elif not any(is_foot(body, other) for other in SIDE_WORDS):
            elsewhere.append(body)
    if not forces:
        named = some(list(dict.fromkeys(filter(None, bodies))))
        raise UsageError(f"{path} applies no force to the {side} foot; its forces act on {named or 'nothing'}")
    return forces, [f"ground: what acts on {', '.join(elsewhere)} is left out"] * bool(elsewhere)


def foot_force(path: Path, element: ET.Element) -> FootForce:
    """Columns that an ExternalForce of an external loads file names.

    Raises:
        UsageError: it has no force or no point, or these are not expressed in ground.
    """
    where = f"{path}: the force {element.get('name', '')!r}"
    for tag in ("force_expressed_in_body", "point_expressed_in_body"):
        if text_in(element, tag) not in GROUND:
            raise UsageError(f"{where}: {tag} is {text_in(element, tag)}, and must be ground")
    force, point, torque = (text_in(element, f"{what}_identifier") for what in ("force", "point", "torque"))
    for name, value in (("force", force), ("point", point)):
        if value in NOTHING:
            raise UsageError(f"{where} has no {name}_identifier")
    return FootForce(force, point, "" if torque in NOTHING else torque)


def applies(element: ET.Element) -> bool:
    """Whether a force is enabled, by the properties of OpenSim 3 and 4."""
    return text_in(element, "isDisabled").lower() != "true" and text_in(element, "appliesForce").lower() != "false"


def is_foot(body: str, side: str) -> bool:
    """Whether a body belongs to the foot of a side, by its name."""
    return is_part(body, FOOT) and bool(words(body) & SIDE_WORDS[side])


def by_names(storage: Storage, side: str) -> FootForce:
    """Find the force whose columns name the foot, or have the names that OpenSim's examples have for it.

    Raises:
        UsageError: there is no such force, or more than one.
    """
    stems = [match["stem"] for match in map(FORCE.fullmatch, storage.names) if match]
    if not stems:
        raise UsageError(f"{storage.path} has no ground force, as ground_force_vx, but {some(storage.names)}")
    fitting = [stem for stem in stems if words(stem) & SIDE_WORDS[side]]
    if set(stems) == set(EXAMPLES):
        fitting = [stem for stem in stems if EXAMPLES[stem] == side]
    if len(fitting) != 1:
        raise UsageError(
            f"{storage.path}: which of {some([f'{stem}vx' for stem in stems])} is of the {side} foot? "
            "Give the external loads file (.xml) in its place"
        )
    stem = fitting[0]
    return FootForce(f"{stem}v", f"{stem}p", torque_of(storage.names, stem))


def torque_of(names: Sequence[str], stem: str) -> str:
    """Beginning of the names of a free moment's columns, from that of its force; empty if there are none."""
    for turn in TURNS:
        for prefix in (stem.replace("force", turn), stem.replace("force", turn) + "m"):
            if f"{prefix}y" in names:
                return prefix
    return ""


IN_THE_AIR = 10.0
"""Vertical force [N] below which a foot is in the air: plates are noisy, and have no centre of pressure then"""
STANDS = 100.0
"""Vertical force [N] that a walking foot reaches, and above which its centre of pressure must be near the ankle"""
NEAR = 0.30
"""Largest median distance [m] of ankle and centre of pressure in the ground plane: more than a foot's length ahead"""


def during(ground: GroundFile, stamps: Stamps) -> GroundFile:
    """Select the rows between the first and the last stamp [ns], with a neighbour at each end.

    Raises:
        UsageError: there are fewer than two.
    """
    data = ground.data
    first = max(int(np.searchsorted(data.stamps, stamps[0], "right")) - 1, 0)
    last = int(np.searchsorted(data.stamps, stamps[-1], "left")) + 1
    within = data._replace(stamps=data.stamps[first:last], values=data.values[first:last])
    if len(within.stamps) < 2:
        span = " to ".join(f"{stamp / NANOSECONDS:g}" for stamp in (stamps[0], stamps[-1]))
        raise UsageError(f"{data.path} spans {data.span()}, and the kinematics {span} s")
    return ground._replace(data=within)


def about_ankle(ground: GroundFile, ankle: Floats) -> GroundForces:
    """Sum the forces on a foot, with their torque about the ankle, at the rows of the file; 0 with the foot in the air.

    Args:
        ground: the file, in OpenSim's axes of the ground (x forward, y up, z to the right).
        ankle: [m] the ankle joint's centre in these axes, at the file's stamps; shape (n, 3).

    Raises:
        UsageError: a number is not finite, or this cannot be what acts on this foot.
    """
    force, torque = np.zeros_like(ankle), np.zeros_like(ankle)
    for each in ground.forces:
        one, about = wrench_of(ground.data, each, ankle)
        force, torque = force + one, torque + about
    return GroundForces(ground.data.stamps, force, torque)


def wrench_of(data: Storage, names: FootForce, ankle: Floats) -> tuple[Floats, Floats]:
    """Force [N] and torque [N m] about the ankle of one external force, shapes (n, 3).

    Raises:
        UsageError: a number that counts is not finite, or this cannot be what acts on this foot.
    """
    force = vector(data, names.force)
    stands = force[:, 1] >= IN_THE_AIR
    point, moment = (vector(data, name, stands) if name else np.zeros_like(force) for name in names[1:])
    arm = np.where(stands[:, None], point - ankle, 0.0)
    check_near(data, names, arm[force[:, 1] >= STANDS])
    kept = np.where(stands[:, None], force, 0.0)
    return kept, np.where(stands[:, None], np.cross(arm, kept) + moment, 0.0)


def vector(data: Storage, name: str, where: np.ndarray | None = None) -> Floats:
    """Vector in three columns, shape (n, 3), 0 where `where`, shape (n,), is false: a point may be NaN in the air.

    Raises:
        UsageError: a number that counts is not finite.
    """
    table = np.column_stack([data.values[:, data.names.index(name + axis)] for axis in "xyz"])
    if where is not None:
        table = np.where(where[:, None], table, 0.0)
    wrong = ~np.isfinite(table).all(axis=1)
    if wrong.any():
        time = data.stamps[int(np.argmax(wrong))] / NANOSECONDS
        raise UsageError(f"{data.path}: {name}(x y z) is not finite at {time:g} s, and the foot stands")
    return table


def check_upright(ground: GroundFile) -> None:
    """Check that each force acts upwards, and is as large as that on a walking foot.

    Raises:
        UsageError: one does not or is not, or a number is not finite.
    """
    for names in ground.forces:
        up = vector(ground.data, names.force)[:, 1]
        low, high = float(up.min()), float(up.max())
        if high >= max(STANDS, -low):
            continue
        raise UsageError(
            f"{ground.data.path}: {names.force}y goes from {low:.4g} to {high:.4g}; it must be in N, upwards, "
            "and what the ground does to the foot"
        )


def check_near(data: Storage, names: FootForce, arm: Floats) -> None:
    """Check that centres of pressure are near the foot; `arm` [m] is from the ankle to each, shape (n, 3).

    Raises:
        UsageError: they are not near it.
    """
    if not len(arm):
        return
    away = float(np.median(np.hypot(arm[:, 0], arm[:, 2])))
    if away > NEAR:
        raise UsageError(
            f"{data.path}: {names.point}(x y z) is {away:.2f} m away from the ankle while the foot stands, by the "
            "median: the other foot's, not in m, or in other axes than the model's?"
        )


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
        forces = GroundForces(*mirrored(Reactions(*forces)))
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
    if code := run_python(child.__name__, (child.PLACES, request.name, answer.name), work, log):
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
