"""Read a knee's angle and joint reaction from results of OpenSim; notes say what was converted.

Columns are found by OpenSim's names, which contain coordinate, joint, body and frame.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

import numpy as np

from knee_contact_ros.joint_reaction.leg import GRAVITY
from knee_contact_ros.lab import checks
from knee_contact_ros.lab.gait_bag import MIRROR, Signal
from knee_contact_ros.lab.opensim.run import read_xml
from knee_contact_ros.lab.tables import Table, read_storage
from knee_contact_ros.model.types import Floats, Stamps
from knee_contact_ros.system.errors import UsageError, list_names

RIGHT, LEFT = "right", "left"
SIDE_WORDS = {RIGHT: {"r", "right"}, LEFT: {"l", "left"}}
ANGLE_WORDS = {"angle", "flexion", "flex", "extension", "ext", "fe"}
"""Words allowed in the name of a knee's angle, besides `knee` and the side; others mean the patella or other axes"""
TIBIA, FEMUR = ("tibia", "shank"), ("femur", "femor", "thigh")
"""Beginnings of words in the names of bodies"""
PLATEAU, COMPARTMENTS = ("tibial", "tibiofemoral", "plat"), ("med", "lat")
"""Beginnings of words in names of joints or bodies: at the plateau, and at the medial and lateral compartment"""
REACTION = re.compile(r"(?P<joint>.+)_on_(?P<body>.+)_in_(?P<frame>.+)_(?:[fmp][xyz])")
MOCO = re.compile(r"(?P<path>.*?(?P<joint>[^/|]+)\|reaction_on_child)_[1-6]")
"""Columns that Moco writes for a reaction on a joint's child: torque and force in ground, at the joint"""
MOCO_PLACES = {"mx": 1, "my": 2, "mz": 3, "fx": 4, "fy": 5, "fz": 6}
GROUND = "ground"
AXES = ("fx", "fy", "fz", "mx", "my", "mz")
ALL = f"({' '.join(AXES)})"
POINT = ("px", "py", "pz")
HOW = "in the JointReaction set-up: apply_on_bodies child, express_in_frame child"
MAX_GAP = 0.1
"""Longest time between rows [s] that is interpolated, as `max_gap` of import-csv"""


class Settings(NamedTuple):
    """Settings of the import."""

    joint: str | None = None
    """Joint of the reactions; None: the one with knee and side in its name"""
    coordinate: str | None = None
    """Coordinate of the kinematics; None: the one with knee and side in its name"""
    angle_unit: str = "auto"
    """Unit of the angle: `deg`, `rad` or `auto`"""
    angle_sign: int | None = None
    """Sign that makes the angle positive in flexion, 1 or -1; None: found from the data"""
    start: float | None = None
    """First time [s]; None: the first that all files have"""
    end: float | None = None
    """Last time [s]; None: the last that all files have"""
    rate: float | None = None
    """Rate of interpolated samples [Hz]; None: every row keeps its stamp"""
    anyway: bool = False
    """Whether to import what is likely a mistake"""


class Reaction(NamedTuple):
    """Reaction of a joint in a file, in columns `<joint>_on_<body>_in_<frame>_fx` and so on."""

    joint: str
    body: str
    """Body on which it acts"""
    frame: str
    """Frame in which it is expressed"""
    moco: str = ""
    """Beginning of the names of its columns, if Moco wrote them"""

    def column(self, axis: str) -> str:
        """Name of a column."""
        if self.moco:
            return f"{self.moco}_{MOCO_PLACES.get(axis)}"
        return f"{self.joint}_on_{self.body}_in_{self.frame}_{axis}"

    @property
    def rank(self) -> int:
        """0: on a tibia, in its frame; 1: on a femur, in a tibia's; 2: in a femur's frame; 3: in another."""
        if is_part(self.body, TIBIA) and self.frame == self.body:
            return 0
        whole = "offset" not in self.frame
        if is_part(self.body, FEMUR) and is_part(self.frame, TIBIA) and whole:
            return 1
        return 2 if is_part(self.frame, FEMUR) and whole else 3


class Pose(NamedTuple):
    """Pose of the tibia in the frame of a reaction, at its n rows."""

    rotation: Floats
    """Rotates vectors from that frame to the tibia's, shape (n, 3, 3)"""
    origin: Floats
    """Origin of the tibia's frame in that frame [m], shape (n, 3)"""
    point: Floats | None = None
    """Point in that frame where the reaction acts [m], shape (n, 3), if the file does not give it"""


def read_model(path: Path, coordinate: str | None) -> tuple[float, tuple[float, float] | None]:
    """Read the weight [N] of a model (.osim, of any version), and the range [rad] of a coordinate, None without one.

    Raises:
        UsageError: the file is not a model, has no such coordinate, or a number in it is none.
    """

    def numbers(element: ET.Element, tag: str) -> list[float]:
        text = element.findtext(tag, "")
        try:
            return [float(number) for number in text.split()]
        except ValueError:
            name = f"{tag} of {element.tag} {element.get('name')}"
            raise UsageError(
                f"{path} (--model): {name} is {text!r}, and must be numbers such as 9.3"
            ) from None

    root = read_xml(path, "Model")
    found = next((c for c in root.iter("Coordinate") if c.get("name") == coordinate), None)
    if found is None:
        raise UsageError(
            f"{path} (--model) has no coordinate {coordinate}; is it the model of these results?"
        )
    mass = sum(number for body in root.iter("Body") for number in numbers(body, "mass"))
    if not 0.0 < mass < math.inf:
        raise UsageError(
            f"{path} (--model): mass of all Body elements is {mass:g} kg; it must be finite and > 0"
        )
    ends = numbers(found, "range")
    return mass * GRAVITY, (ends[0], ends[1]) if len(ends) == 2 else None


def angle_column(table: Table, side: str, coordinate: str | None) -> str:
    """Find the column with the knee's angle; `coordinate` is the name of it or its coordinate, None if unknown.

    Raises:
        UsageError: there is no such column, or more than one.
    """
    names = list(dict.fromkeys(table.names))  # one that is there twice is refused when it is read
    if coordinate is not None:
        fitting = (
            [coordinate]
            if coordinate in names
            else [name for name in names if coordinate_of(name) == coordinate]
        )
        if not fitting:
            raise UsageError(
                f"{table.path} has no column {coordinate} (--coordinate); it has {list_names(names)}"
            )
    else:
        fitting = [name for name in names if is_knee_angle(coordinate_of(name) or "", side)]
    if len(fitting) != 1:
        found = ", ".join(fitting) or f"no angle of the {side} knee, but {list_names(names)}"
        raise UsageError(f"{table.path} has {found}; choose one with --coordinate NAME")
    return fitting[0]


def is_knee_angle(name: str, side: str) -> bool:
    """Whether a coordinate is the flexion angle of the knee of a side, by its name."""
    return is_knee(name, side) and not words(name) - {"knee"} - ANGLE_WORDS - SIDE_WORDS[side]


def is_knee(name: str, side: str) -> bool:
    """Whether a name has the words `knee` and a side."""
    return "knee" in words(name) and bool(words(name) & SIDE_WORDS[side])


def speed_column(names: Iterable[str], angle: str) -> str | None:
    """Find the column with the rate of an angle's column, in a file of states or speeds; None if there is none."""
    wanted = angle.removesuffix("/value") + "/speed" if "/" in angle else angle
    coordinate = coordinate_of(angle)
    return next(
        (
            name
            for name in names
            if name in {wanted, coordinate} or name.endswith(f"/{coordinate}/speed")
        ),
        None,
    )


def coordinate_of(name: str) -> str | None:
    """Coordinate of a column, whose name may also be `/jointset/JOINT/COORDINATE/value`; None if it has none."""
    parts = name.strip("/").split("/")
    if len(parts) == 1:
        return name
    return parts[-2] if parts[-1] == "value" else None


def find_reactions(table: Table, side: str, joint: str | None) -> list[Reaction]:
    """Find the knee's reaction on the tibia in the tibia's frame, or one from which it can be computed.

    If the knee's joint does not act on the tibia, this is the reaction of the joint at the plateau, or those of the
    medial and the lateral compartment, to be added up.

    Raises:
        UsageError: there is no such joint or more than one, or the reaction acts on another body.
    """
    matches = [REACTION.fullmatch(name) for name in table.names]
    there = list(dict.fromkeys(Reaction(*match.groups()) for match in matches if match))
    there += dict.fromkeys(
        Reaction(match["joint"], TIBIA[0], GROUND, match["path"])
        for match in map(MOCO.fullmatch, table.names)
        if match
    )
    if not there:
        raise UsageError(
            f"{table.path} has no reaction <joint>_on_<body>_in_<frame>_fx ...; it has {list_names(table.names)}"
        )
    joints = list(dict.fromkeys(reaction.joint for reaction in there))
    if joint is not None and joint not in joints:
        raise UsageError(
            f"{table.path} has no joint {joint} (--joint); it has {list_names(joints)}"
        )
    usable: dict[str, Reaction] = {}
    for each in sorted(there, key=lambda each: each.rank):
        if is_part(each.body, (*TIBIA, *FEMUR)) or (
            is_part(each.joint, COMPARTMENTS) and each.frame != GROUND
        ):
            usable.setdefault(each.joint, each)
    ours = [name for name in usable if words(name) & SIDE_WORDS[side]]
    halves = [[name for name in ours if is_part(name, (half,))] for half in COMPARTMENTS]
    ways = (
        [
            name
            for name in ours
            if is_knee(name, side) and is_part(usable[name].body, (*TIBIA, *FEMUR))
        ],
        [name for name in ours if is_part(f"{name} {usable[name].body}", PLATEAU)],
    )
    pair = (
        [name for names in halves for name in names]
        if all(len(names) == 1 for names in halves)
        else []
    )
    found = [joint] if joint in usable else next((each for each in ways if len(each) == 1), pair)
    if not found or joint not in {None, *found}:
        raise UsageError(
            f"{table.path}: of {joint or list_names(joints)} none acts on the tibia of the {side} knee, or several do; "
            f"name one that does with --joint NAME, or run JointReaction again, {HOW}"
        )
    if missing := [
        name
        for each in found
        for name in map(usable[each].column, AXES)
        if name not in table.names
    ]:
        raise UsageError(f"{table.path} has no column {', '.join(missing)}")
    return [usable[name] for name in found]


def is_part(name: str, beginnings: tuple[str, ...]) -> bool:
    """Whether a body's name has a word with one of these beginnings."""
    return any(word.startswith(beginnings) for word in words(name))


def words(name: str) -> set[str]:
    """Words of a name, in lower case."""
    return set(re.findall("[a-z]+", name.lower()))


def read_angles(
    table: Table,
    column: str,
    speeds: Path | None,
    settings: Settings,
    bounds: tuple[float, float] | None,
) -> tuple[Signal, list[str]]:
    """Read the flexion angle, its rate if a file has it, and notes; `bounds` [rad] is its range in the model.

    Raises:
        UsageError: the unit, sign or rate is wrong or unclear, or there are fewer than two rows.
    """
    if len(table.stamps) < 2:
        raise UsageError(
            f"{table.path} has {len(table.stamps)} row, but an angle over time needs two"
        )
    unit = checks.unit_of(table, column, settings.angle_unit)
    angle = table.column(column) * (math.radians(1.0) if unit == "deg" else 1.0)
    sign = checks.sign_of(angle, f"{table.path}: {column}", settings.angle_sign, bounds)
    turned = "sign turned (flexion was negative)" if sign < 0 else "flexion positive as it was"
    notes = [f"angle: {'degrees to rad' if unit == 'deg' else 'rad'}, {turned}"]
    signal = Signal(table.stamps, sign * angle[:, None])
    source = read_storage(speeds) if speeds else table
    name = speed_column(source.names, column) if speeds or column.endswith("/value") else None
    if speeds and name is None:
        raise UsageError(f"{speeds} has no rate of {column}")
    if name is None:
        return signal, [*notes, "rate: derived from the angle", *table.notes]
    if source.stamps[0] > table.stamps[0] or source.stamps[-1] < table.stamps[-1]:
        raise UsageError(
            f"{source.path} spans {source.time(0)} to {source.time(-1)} s, less than the angles"
        )
    rate = sign * source.column(name) * (math.radians(1.0) if source.degrees else 1.0)
    given = Signal(source.stamps, rate[:, None]).at(table.stamps).values
    checks.check_rate(given[:, 0], signal.with_rate().values[:, 1], f"{source.path}: {name}")
    notes += [f"rate: {name} of {source.path.name}", *table.notes]
    return Signal(table.stamps, np.hstack([signal.values, given])), notes


def needs_model(table: Table, reaction: Reaction) -> UsageError:
    """Error for a reaction that is expressed in another frame, which only a model can locate."""
    said = "Moco's reaction, torque before force, " if reaction.moco else ""
    return UsageError(
        f"{table.path}: {reaction.column('fx')} is {said}in {reaction.frame}, and must be in the tibia's frame: give "
        f"--model M.osim (needs the extra opensim, and all coordinates in --kinematics); or run JointReaction, {HOW}"
    )


def hinge(angle: Signal, stamps: Stamps) -> Pose:
    """Pose of a tibia in a femur's frame with the same origin, rotated about z by the flexion angle only."""
    flexion = np.interp(stamps, angle.stamps, angle.values[:, 0])
    cosine, sine, zero = np.cos(flexion), np.sin(flexion), np.zeros(len(stamps))
    rotation = np.array([[cosine, -sine, zero], [sine, cosine, zero], [zero, zero, zero + 1.0]])
    return Pose(np.moveaxis(rotation, 2, 0), np.zeros((len(stamps), 3)))


def read_reaction(
    table: Table, parts: Sequence[tuple[Reaction, Pose | None]], side: str
) -> tuple[Signal, list[str]]:
    """Read force and torque on the tibia at its frame's origin, mirrored for a left knee, and notes.

    The `parts` are added up. One in another frame has the pose of the tibia in that frame at the table's rows.
    """
    total, notes = np.zeros((len(table.stamps), 6)), []
    for reaction, pose in parts:
        wrench = np.column_stack([table.column(reaction.column(axis)) for axis in AXES])
        if is_part(reaction.body, FEMUR):
            wrench = -wrench
            notes.append(
                f"reaction: on {reaction.body} turned into that on the tibia (Newton's third law)"
            )
        points = [reaction.column(axis) for axis in POINT]
        point = np.zeros((len(wrench), 3)) if pose is None or pose.point is None else pose.point
        if set(points) <= set(table.names):
            point = np.column_stack([table.column(name) for name in points])
        arm = point if pose is None else point - pose.origin
        if arm.any():
            wrench[:, 3:] += np.cross(arm, wrench[:, :3])
            notes.append("torque: moved to the tibia frame's origin")
        if pose:
            turned = [
                np.einsum("nij,nj->ni", pose.rotation, part)
                for part in (wrench[:, :3], wrench[:, 3:])
            ]
            wrench = np.hstack(turned)
            notes.append(f"reaction: turned from {reaction.frame} into the tibia's frame")
        total += wrench
    if len(parts) > 1:
        notes.append(
            "reaction: sum of the compartments, its torque about the tibia frame's origin"
        )
    if side == LEFT:
        total = total * MIRROR
        notes.append(
            "reaction: left knee mirrored to a right one (force z, torque x and y turned)"
        )
    return Signal(table.stamps, total), [*dict.fromkeys(notes), *table.notes]
