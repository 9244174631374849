"""Simulated sensors of a leg: hip and ankle angles from OpenSim's kinematics, and ground reactions about the ankle.

OpenSim's external loads say which columns of ground reactions act on a foot; otherwise their names do.
"""

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

import numpy as np

from ...model.types import Floats, Stamps
from ...streams.topics import NANOSECONDS
from ...system.errors import UsageError, list_names
from ...system.files import require
from .. import checks
from ..gait_bag import Signal
from ..tables import Table, read_storage
from . import child
from .results import (
    LEFT,
    RIGHT,
    SIDE_WORDS,
    TIBIA_WORDS,
    JointReaction,
    TibiaPose,
    coordinate_of,
    is_part,
    words,
)
from .run import failure_in, run_python
from .setups import UNSET, XML, read_xml, text_in

_GROUND_NAMES = {"ground", "/ground", *UNSET}
"""Names of the ground frame, which is the default"""
_FOOT_WORDS = ("foot", "calc", "talus", "toe", "heel", "mtp", "midfoot", "forefoot", "hindfoot")
"""Beginnings of words in the names of a foot's bodies"""
_FIRST_COLUMN = re.compile(r"(.*force.*_)vx", re.IGNORECASE)
"""Name of a force's first column, like `ground_force_vx`, `1_ground_force_vx`, `ground_force_r_vx`"""
_EXAMPLE_SIDES = {"ground_force_": RIGHT, "1_ground_force_": LEFT}
"""Side of each force plate in OpenSim's own examples, which do not name the foot"""


class FootForce(NamedTuple):
    """Columns of a force on a foot: their names without the final x, y or z."""

    force: str
    """Columns of the force [N]"""
    point: str
    """Columns of the point of application [m]"""
    torque: str
    """Columns of the free moment [N m]; empty if there are none"""


class GroundFile(NamedTuple):
    """Ground reactions over time, and which of them act on a foot."""

    data: Table
    forces: tuple[FootForce, ...]
    notes: tuple[str, ...]
    """What was left out, as sentences"""

    @property
    def columns(self) -> str:
        """Text that names the columns."""
        return ", ".join(
            " ".join(f"{name}(x y z)" for name in force if name) for force in self.forces
        )


class Frames(NamedTuple):
    """Places of k frames in the ground frame, at n rows of the kinematics."""

    names: tuple[str, ...]
    rotations: Floats
    """Shape (n, k, 3, 3); columns are the frame's axes"""
    origins: Floats
    """[m], shape (n, k, 3)"""
    unknown: tuple[str, ...]
    """Coordinates that move the first two frames relative to each other, but are not in the kinematics"""


def read_ground(ground: Path, data: Path, side: str) -> GroundFile:
    """Read the forces on the right or left foot; `data` is the file that `data_file` finds.

    External loads name the body of a force; force and point are required, and must be expressed in ground. As in
    OpenSim, an identifier may be the beginning of three column names.

    Raises:
        UsageError: a file cannot be read, it is not clear which forces act on the foot, or a column is missing.
    """
    table = read_storage(data)
    if ground.suffix.lower() != XML:
        return GroundFile(table, (_complete(_by_names(table, side), table),), ())
    forces = []
    bodies = []
    notes = []
    for element in read_xml(ground, "ExternalLoads").iter("ExternalForce"):
        body = text_in(element, "applied_to_body")
        bodies.append(body)
        disabled = text_in(element, "isDisabled").lower() == "true"
        if disabled or text_in(element, "appliesForce").lower() == "false" or not body:
            continue
        if _is_foot(body, side):
            where = f"{ground}: the force {element.get('name', '')!r}"
            forces.append(_foot_force(element, table, where))
        elif not any(_is_foot(body, other) for other in SIDE_WORDS):
            notes.append(f"ground: what acts on {body} is left out")
    if not forces:
        named = list_names(list(dict.fromkeys(filter(None, bodies))))
        raise UsageError(
            f"{ground} applies no force to the {side} foot; its forces act on {named or 'nothing'}"
        )
    return GroundFile(table, tuple(forces), tuple(dict.fromkeys(notes)))


def _foot_force(element: ET.Element, table: Table, where: str) -> FootForce:
    """Read a force of external loads; `where` names it in messages."""
    for tag in ("force_expressed_in_body", "point_expressed_in_body"):
        if text_in(element, tag) not in _GROUND_NAMES:
            raise UsageError(f"{where}: {tag} is {text_in(element, tag)}, but must be ground")
    stems = (_stem(text_in(element, f"{name}_identifier"), table) for name in FootForce._fields)
    force = FootForce(*stems)
    if not force.force or not force.point:
        raise UsageError(f"{where} has no {'point' if force.force else 'force'}_identifier")
    return _complete(force, table)


def _complete(force: FootForce, table: Table) -> FootForce:
    """Return a force of which all columns are there."""
    columns = [stem + axis for stem in force if stem for axis in "xyz"]
    if missing := [name for name in columns if name not in table.names]:
        raise UsageError(
            f"{table.path} has no column {', '.join(missing)}; it has {list_names(table.names)}"
        )
    return force


def _stem(identifier: str, table: Table) -> str:
    """Return the names of three columns without x, y, z; a clear shorter identifier suffices; empty: none."""
    if identifier in UNSET:
        return ""
    fitting = [name for name in table.names if name.startswith(identifier)]
    stem = fitting[0][:-1] if fitting else identifier
    return stem if fitting == [f"{stem}{axis}" for axis in "xyz"] else identifier


def _is_foot(body: str, side: str) -> bool:
    """Return whether a body belongs to the foot of a side, by its name."""
    return is_part(body, _FOOT_WORDS) and bool(words(body) & SIDE_WORDS[side])


def _by_names(table: Table, side: str) -> FootForce:
    """Find the only force whose columns name the foot, or are named as in OpenSim's examples."""
    stems = [match[1] for match in map(_FIRST_COLUMN.fullmatch, table.names) if match]
    if not stems:
        raise UsageError(
            f"{table.path} has no ground force, as ground_force_vx, but {list_names(table.names)}"
        )
    fitting = [stem for stem in stems if words(stem) & SIDE_WORDS[side]]
    if set(stems) == set(_EXAMPLE_SIDES):
        fitting = [stem for stem in stems if _EXAMPLE_SIDES[stem] == side]
    if len(fitting) != 1:
        raise UsageError(
            f"{table.path}: which of {list_names([f'{stem}vx' for stem in stems])} is of the {side} foot? "
            "Give the external loads file (.xml) in its place"
        )
    stem = fitting[0]
    torques = [
        stem.replace("force", kind) + end for kind in ("torque", "moment") for end in ("", "m")
    ]
    torque = next((name for name in torques if f"{name}y" in table.names), "")
    return FootForce(f"{stem}v", f"{stem}p", torque)


def during(ground: GroundFile, stamps: Stamps) -> GroundFile:
    """Check that all forces act upwards, and select the rows between the first and the last stamp [ns].

    Raises:
        UsageError: a force acts downwards, a number is not finite, or there are fewer than two rows.
    """
    data = ground.data
    for names in ground.forces:
        checks.check_upright(_vector(data, names.force)[:, 1], f"{data.path}: {names.force}y")
    within = Signal(data.stamps, data.values).around((int(stamps[0]), int(stamps[-1])))
    if len(within.stamps) < 2:
        spans = [
            " to ".join(f"{each[row] / NANOSECONDS:.13g}" for row in (0, -1))
            for each in (data.stamps, stamps)
        ]
        raise UsageError(f"{data.path} spans {spans[0]} s, and the kinematics {spans[1]} s")
    return ground._replace(data=data._replace(stamps=within.stamps, values=within.values))


def about_ankle(ground: GroundFile, ankle: Floats) -> Signal:
    """Sum the forces on a foot, and their torque about the ankle, at the file's rows; 0 with the foot in the air.

    Args:
        ground: The file, in OpenSim's ground axes (x forward, y up, z to the right).
        ankle: Centre of the ankle joint [m] in these axes at the file's stamps, shape (n, 3).

    Raises:
        UsageError: a number that counts is not finite, or the forces cannot be those on this foot.
    """
    data = ground.data
    wrench = np.zeros((len(ankle), 6))
    for names in ground.forces:
        force = _vector(data, names.force)
        # Below 10 N a foot counts as in the air: plates are noisy, and the centre of pressure is undefined.
        stands = force[:, 1:2] >= 10.0
        # In the air, a point may be NaN.
        standing = data._replace(values=np.where(stands, data.values, 0.0))
        arm = _vector(standing, names.point) - ankle
        checks.check_near(arm, force[:, 1], f"{data.path}: {names.point}(x y z)")
        torque = np.cross(arm, force)
        if names.torque:
            torque += _vector(standing, names.torque)
        wrench += np.where(stands, np.hstack([force, torque]), 0.0)
    return Signal(data.stamps, wrench)


def _vector(data: Table, name: str) -> Floats:
    """Return the vector in three columns, shape (n, 3); a number that is not finite is refused."""
    return np.column_stack([data.column(name + axis) for axis in "xyz"])


def read_leg(
    ground: GroundFile,
    kinematics: Table,
    degrees: bool,
    model: Path,
    joints: Sequence[str],
    work: Path,
) -> tuple[dict[str, Signal], Signal, list[str]]:
    """Simulate the sensors of a leg: angles of hip and ankle, the ground's wrench about the ankle, and notes.

    The hip angle is between thigh and vertical in the sagittal plane, positive with the knee ahead of the hip. The
    ankle angle is positive in dorsiflexion, 0 at a right angle.

    Args:
        ground: Ground reactions on the foot.
        kinematics: Coordinates of the model over time.
        degrees: Whether angles in the kinematics are in degrees.
        model: File of the model.
        joints: Names of hip, knee and ankle in the model.
        work: Folder for OpenSim's process and its log.

    Raises:
        UsageError: OpenSim is not installed or fails, or a file cannot be used or does not fit the others.
    """
    ground = during(ground, kinematics.stamps)
    kinds = ("child", "child", "child", "parent_base", "child_base", "child_base")
    frames = list(zip(kinds, (*joints, *joints), strict=True))
    found = frames_of(kinematics, degrees, model, frames, work)
    hip, knee, ankle = (found.origins[:, place] for place in range(3))
    pelvis, shank, foot = (found.rotations[:, place] for place in (3, 4, 5))
    checks.check_heading(pelvis[:, :, 0], kinematics.path)
    thigh = knee - hip
    toes = np.einsum("nji,nj->ni", shank, foot[:, :, 0])
    angles = {
        "hip": np.arctan2(thigh[:, 0], -thigh[:, 1]),
        "ankle": np.arctan2(toes[:, 1], toes[:, 0]),
    }
    wrench = about_ankle(ground, Signal(kinematics.stamps, ankle).at(ground.data.stamps).values)
    notes = [
        f"hip and ankle: by OpenSim, of {', '.join(joints)} of {model.name}",
        "ground: moved from the centre of pressure to the ankle",
        *ground.notes,
    ]
    if not all(force.torque for force in ground.forces):
        notes.append("ground: no free moment in the file")
    signals = {name: Signal(kinematics.stamps, each[:, None]) for name, each in angles.items()}
    return signals, wrench, notes


def leg_joints(model: Path, side: str, coordinate: str | None) -> list[str]:
    """Find the names of hip, knee and ankle of a leg in a model's file; the knee is the joint with the coordinate.

    Raises:
        UsageError: the file is not a model, or a joint is missing or not unique.
    """
    elements = read_xml(model, "Model").iter()
    joints = [each for each in elements if each.tag.endswith("Joint") and each.get("name")]
    names = [each.get("name", "") for each in joints]
    of_side = [name for name in names if words(name) & SIDE_WORDS[side]]
    with_coordinate = [
        name
        for name, joint in zip(names, joints, strict=True)
        if any(each.get("name") == coordinate for each in joint.iter("Coordinate"))
    ]
    found = []
    for what, fitting in (
        (f"{side} hip", [name for name in of_side if "hip" in words(name)]),
        (f"coordinate {coordinate}", with_coordinate),
        (f"{side} ankle", [name for name in of_side if "ankle" in words(name)]),
    ):
        if len(set(fitting)) != 1:
            having = f"the joints {', '.join(dict.fromkeys(fitting))}" if fitting else "no joint"
            raise UsageError(f"{model} has {having} of the {what}; exactly one is needed")
        found.append(fitting[0])
    return found


def frames_of(
    kinematics: Table, degrees: bool, model: Path, frames: Sequence[tuple[str, str]], work: Path
) -> Frames:
    """Compute where frames are at the rows of the kinematics, by OpenSim in its own process; see `child`.

    Raises:
        UsageError: a number is not finite, or OpenSim fails.
    """
    require("opensim", "opensim")
    known = {e.get("name") for e in read_xml(model, "Model").iter("Coordinate")}
    columns = {coordinate_of(name): name for name in kinematics.names}
    content = {
        "model": str(model.absolute()),
        "frames": frames,
        "degrees": degrees,
        "coordinates": {
            name: kinematics.column(column).tolist()
            for name, column in columns.items()
            if name in known
        },
    }
    request = work / "leg_request.json"
    answer = work / "leg_answer.json"
    log = work / "leg.log"
    request.write_text(json.dumps(content), encoding="utf-8")
    if code := run_python(child.__name__, (child.PLACES, request.name, answer.name), work, log):
        raise UsageError(f"OpenSim failed with {model}, code {code}: {failure_in(log)}")
    found = json.loads(answer.read_text(encoding="utf-8"))
    numbers = np.array(found["places"]).reshape(len(kinematics.stamps), len(frames), 12)
    rotations = numbers[:, :, :9].reshape(*numbers.shape[:2], 3, 3)
    return Frames(tuple(found["names"]), rotations, numbers[:, :, 9:], tuple(found["unknown"]))


def tibia_in(
    reaction: JointReaction,
    kinematics: Table,
    degrees: bool,
    model: Path,
    stamps: Stamps,
    work: Path,
) -> tuple[TibiaPose, Stamps]:
    """Return the pose of the tibia in a reaction's frame, at those of its stamps that have kinematics.

    Raises:
        UsageError: OpenSim is not installed or fails, the model has no such joint or frame, or the kinematics lack a
            coordinate between both frames.
    """
    root = read_xml(model, "Model")
    if reaction.joint not in [e.get("name") for e in root.iter() if e.tag.endswith("Joint")]:
        raise UsageError(
            f"{model} (--model) has no joint {reaction.joint}; is it the model of these results?"
        )
    stamps = stamps[(stamps >= kinematics.stamps[0]) & (stamps <= kinematics.stamps[-1])]
    values = Signal(kinematics.stamps, kinematics.values).at(stamps).values
    table = kinematics._replace(stamps=stamps, values=values)
    tibia = ("child_base", reaction.joint)
    if not reaction.is_on_bone:  # of a compartment: the tibia of its side
        sides = [each for each in SIDE_WORDS.values() if words(reaction.joint) & each]
        names = [e.get("name", "") for e in root.iter("Body")]
        tibias = [
            name
            for name in names
            if is_part(name, TIBIA_WORDS) and any(words(name) & each for each in sides)
        ]
        tibia = ("frame", min(tibias, key=len, default="tibia"))
    frames = [tibia, ("frame", reaction.frame), ("child", reaction.joint)]
    found = frames_of(table, degrees, model, frames, work)
    if not is_part(found.names[0], TIBIA_WORDS):
        raise UsageError(
            f"{model}: {reaction.joint} joins {found.names[0]} to its parent, but must join the tibia to it"
        )
    if found.unknown:
        raise UsageError(
            f"{kinematics.path} has no coordinate {list_names(found.unknown)} of {model.name}, by which "
            f"{found.names[0]} moves in {found.names[1]}, in which the reaction is expressed"
        )
    of_tibia, of_reaction = found.rotations[:, 0], found.rotations[:, 1]
    to_tibia = np.einsum("nji,njk->nik", of_tibia, of_reaction)
    origin, point = (
        np.einsum("nji,nj->ni", of_reaction, found.origins[:, place] - found.origins[:, 1])
        for place in (0, 2)
    )
    return TibiaPose(to_tibia, origin, point if reaction.moco else None), stamps
