"""Read a knee's angle and joint reaction from results of OpenSim; notes say what was converted.

Columns are found by OpenSim's names, which contain coordinate, joint, body and frame.
"""

import math
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

import numpy as np

from ...joint_reaction.leg import GRAVITY
from ...model.types import Floats, Stamps
from ...system.errors import UsageError, list_names
from .. import checks
from ..gait_bag import MIRROR, Signal
from ..tables import Table, read_storage
from .setups import read_xml

RIGHT = "right"
LEFT = "left"
SIDE_WORDS = {RIGHT: {"r", "right"}, LEFT: {"l", "left"}}
"""Words that name a side"""
TIBIA_WORDS = ("tibia", "shank")
"""Beginnings of words in the names of a tibia"""
FEMUR_WORDS = ("femur", "femor", "thigh")
"""Beginnings of words in the names of a femur"""
_ANGLE_WORDS = {"angle", "flexion", "flex", "extension", "ext", "fe"}
"""Words allowed in the name of a knee's angle, besides `knee` and the side; others mean the patella or other axes"""
_PLATEAU_WORDS = ("tibial", "tibiofemoral", "plat")
"""Beginnings of words in names of joints or bodies at the plateau"""
_COMPARTMENT_WORDS = ("med", "lat")
"""Beginnings of words in names of joints or bodies at the medial and at the lateral compartment"""
_REACTION = re.compile(r"(?P<joint>.+)_on_(?P<body>.+)_in_(?P<frame>.+)_(?:[fmp][xyz])")
"""Column of JointReaction"""
_MOCO_REACTION = re.compile(r"(?P<path>.*?(?P<joint>[^/|]+)\|reaction_on_child)_[1-6]")
"""Columns that Moco writes for a reaction on a joint's child: torque and force in ground, at the joint"""
_MOCO_PLACES = {"mx": 1, "my": 2, "mz": 3, "fx": 4, "fy": 5, "fz": 6}
_GROUND_FRAME = "ground"
AXES = ("fx", "fy", "fz", "mx", "my", "mz")
_POINT = ("px", "py", "pz")
_RUN_AGAIN = "in the JointReaction set-up: apply_on_bodies child, express_in_frame child"
MAX_GAP = 0.1
"""Longest time between rows [s] that is interpolated, as `max_gap` of import-csv"""


class ImportSettings(NamedTuple):
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
    body_weight: float | None = None
    """Body weight [N]; None: that of the model, if there is one"""
    net: bool = False
    """Whether the reactions are without muscle forces, for the load node"""


class JointReaction(NamedTuple):
    """Reaction of a joint in a file, in columns `<joint>_on_<body>_in_<frame>_fx` and so on."""

    joint: str
    body: str
    """Body on which it acts"""
    frame: str
    """Frame in which it is expressed"""
    moco: str = ""
    """Beginning of the names of its columns, if Moco wrote them"""

    def column(self, axis: str) -> str:
        """Return the name of a column."""
        if self.moco:
            return f"{self.moco}_{_MOCO_PLACES.get(axis)}"
        return f"{self.joint}_on_{self.body}_in_{self.frame}_{axis}"

    @property
    def is_on_bone(self) -> bool:
        """Whether it acts on a tibia or a femur."""
        return is_part(self.body, (*TIBIA_WORDS, *FEMUR_WORDS))

    @property
    def rank(self) -> int:
        """0: on a tibia, in its frame; 1: on a femur, in a tibia's; 2: in a femur's frame; 3: in another."""
        if is_part(self.body, TIBIA_WORDS) and self.frame == self.body:
            return 0
        if "offset" in self.frame:
            return 3
        if is_part(self.body, FEMUR_WORDS) and is_part(self.frame, TIBIA_WORDS):
            return 1
        return 2 if is_part(self.frame, FEMUR_WORDS) else 3


class TibiaPose(NamedTuple):
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
    root = read_xml(path, "Model")
    found = next((c for c in root.iter("Coordinate") if c.get("name") == coordinate), None)
    if found is None:
        raise UsageError(
            f"{path} (--model) has no coordinate {coordinate}; is it the model of these results?"
        )
    mass = sum(number for body in root.iter("Body") for number in _numbers(path, body, "mass"))
    if not 0.0 < mass < math.inf:
        raise UsageError(
            f"{path} (--model): mass of all Body elements is {mass:g} kg; it must be finite and > 0"
        )
    ends = _numbers(path, found, "range")
    return mass * GRAVITY, (ends[0], ends[1]) if len(ends) == 2 else None


def _numbers(path: Path, element: ET.Element, tag: str) -> list[float]:
    """Read the numbers in a property of an element of a model."""
    text = element.findtext(tag, "")
    try:
        return [float(number) for number in text.split()]
    except ValueError:
        name = f"{tag} of {element.tag} {element.get('name')}"
        raise UsageError(
            f"{path} (--model): {name} is {text!r}, and must be numbers such as 9.3"
        ) from None


def angle_column(table: Table, side: str, coordinate: str | None) -> str:
    """Find the column with the knee's angle; `coordinate` is the name of it or its coordinate, None if unknown.

    Raises:
        UsageError: there is no such column, or more than one.
    """
    names = list(dict.fromkeys(table.names))  # one that is there twice is refused when it is read
    if coordinate in names:
        return coordinate
    if coordinate is not None:
        fitting = [name for name in names if coordinate_of(name) == coordinate]
        if not fitting:
            raise UsageError(
                f"{table.path} has no column {coordinate} (--coordinate); it has {list_names(names)}"
            )
    else:
        fitting = [name for name in names if _is_knee_angle(coordinate_of(name) or "", side)]
    if len(fitting) != 1:
        found = ", ".join(fitting) or f"no angle of the {side} knee, but {list_names(names)}"
        if any(name.endswith("_fy") for name in names) and not fitting:
            raise UsageError(
                f"{table.path} has forces and no angle of the {side} knee: are --kinematics and --reactions exchanged?"
            )
        raise UsageError(f"{table.path} has {found}; choose one with --coordinate NAME")
    return fitting[0]


def _is_knee_angle(name: str, side: str) -> bool:
    """Return whether a coordinate is the flexion angle of the knee of a side, by its name."""
    others = words(name) - {"knee"} - _ANGLE_WORDS - SIDE_WORDS[side]
    return _is_knee(name, side) and not others


def _is_knee(name: str, side: str) -> bool:
    """Return whether a name has the words `knee` and a side."""
    return "knee" in words(name) and bool(words(name) & SIDE_WORDS[side])


def _speed_column(names: Iterable[str], angle: str) -> str | None:
    """Find the column with the rate of an angle's column, in a file of states or speeds; None if there is none."""
    coordinate = coordinate_of(angle)
    wanted = {coordinate, angle.removesuffix("/value") + "/speed" if "/" in angle else angle}
    suffix = f"/{coordinate}/speed"
    return next((name for name in names if name in wanted or name.endswith(suffix)), None)


def coordinate_of(name: str) -> str | None:
    """Return the coordinate of a column, also of one named `/jointset/JOINT/COORDINATE/value`; None if it has none."""
    parts = name.strip("/").split("/")
    if len(parts) == 1:
        return name
    return parts[-2] if parts[-1] == "value" else None


def find_reactions(table: Table, side: str, joint: str | None) -> list[JointReaction]:
    """Find the knee's reaction on the tibia in the tibia's frame, or one from which it can be computed.

    If the knee's joint does not act on the tibia, this is the reaction of the joint at the plateau, or those of the
    medial and the lateral compartment, to be added up.

    Raises:
        UsageError: there is no such joint or more than one, or the reaction acts on another body.
    """
    matches = [_REACTION.fullmatch(name) for name in table.names]
    there = list(dict.fromkeys(JointReaction(*match.groups()) for match in matches if match))
    of_moco = [_MOCO_REACTION.fullmatch(name) for name in table.names]
    there += dict.fromkeys(
        JointReaction(match["joint"], TIBIA_WORDS[0], _GROUND_FRAME, match["path"])
        for match in of_moco
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
    usable: dict[str, JointReaction] = {}
    for each in sorted(there, key=lambda each: each.rank):
        of_compartment = is_part(each.joint, _COMPARTMENT_WORDS) and each.frame != _GROUND_FRAME
        if each.is_on_bone or of_compartment:
            usable.setdefault(each.joint, each)
    found = [joint] if joint in usable else _knee_joints(usable, side)
    if not found or joint not in {None, *found}:
        raise UsageError(
            f"{table.path}: of {joint or list_names(joints)} none acts on the tibia of the {side} knee, or several do; "
            f"name one that does with --joint NAME, or run JointReaction again, {_RUN_AGAIN}"
        )
    needed = [usable[name].column(axis) for name in found for axis in AXES]
    if missing := [name for name in needed if name not in table.names]:
        raise UsageError(f"{table.path} has no column {', '.join(missing)}")
    return [usable[name] for name in found]


def _knee_joints(usable: dict[str, JointReaction], side: str) -> list[str]:
    """Find the joint of a side's knee or plateau, or those of both compartments; empty if it is not clear."""
    ours = [name for name in usable if words(name) & SIDE_WORDS[side]]
    of_knee = [name for name in ours if _is_knee(name, side) and usable[name].is_on_bone]
    of_plateau = [name for name in ours if is_part(f"{name} {usable[name].body}", _PLATEAU_WORDS)]
    for found in (of_knee, of_plateau):
        if len(found) == 1:
            return found
    halves = [[name for name in ours if is_part(name, (half,))] for half in _COMPARTMENT_WORDS]
    if any(len(names) != 1 for names in halves):
        return []
    return [names[0] for names in halves]


def is_part(name: str, beginnings: tuple[str, ...]) -> bool:
    """Return whether a body's name has a word with one of these beginnings."""
    return any(word.startswith(beginnings) for word in words(name))


def words(name: str) -> set[str]:
    """Return the words of a name, in lower case."""
    return set(re.findall("[a-z]+", name.lower()))


def read_angles(
    table: Table,
    column: str,
    speeds: Path | None,
    settings: ImportSettings,
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
    degrees = checks.angle_unit_of(table, column, settings.angle_unit) == "deg"
    angle = table.column(column) * (math.radians(1.0) if degrees else 1.0)
    sign = checks.flexion_sign_of(angle, f"{table.path}: {column}", settings.angle_sign, bounds)
    signal = Signal(table.stamps, sign * angle[:, None])
    turned = "sign turned (flexion was negative)" if sign < 0 else "flexion positive as it was"
    notes = [f"angle: {'degrees to rad' if degrees else 'rad'}, {turned}"]
    source = read_storage(speeds) if speeds else table
    name = _speed_column(source.names, column) if speeds or column.endswith("/value") else None
    if name is None:
        if speeds:
            raise UsageError(f"{speeds} has no rate of {column}")
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


def needs_model(table: Table, reaction: JointReaction) -> UsageError:
    """Return the error for a reaction that is expressed in another frame, which only a model can locate."""
    origin = "Moco's reaction, torque before force, " if reaction.moco else ""
    return UsageError(
        f"{table.path}: {reaction.column('fx')} is {origin}in {reaction.frame}, and must be in the tibia's frame: give "
        f"--model M.osim (needs the extra opensim, and all coordinates in --kinematics); or run JointReaction, "
        f"{_RUN_AGAIN}"
    )


def tibia_on_hinge(angle: Signal, stamps: Stamps) -> TibiaPose:
    """Return the pose of a tibia in a femur's frame with the same origin, rotated about z by the flexion angle only."""
    flexion = np.interp(stamps, angle.stamps, angle.values[:, 0])
    cosine, sine, zero = np.cos(flexion), np.sin(flexion), np.zeros(len(stamps))
    rotation = np.array([[cosine, -sine, zero], [sine, cosine, zero], [zero, zero, zero + 1.0]])
    return TibiaPose(np.moveaxis(rotation, 2, 0), np.zeros((len(stamps), 3)))


def read_reaction(
    table: Table, parts: Sequence[tuple[JointReaction, TibiaPose | None]], side: str
) -> tuple[Signal, list[str]]:
    """Read force and torque on the tibia at its frame's origin, mirrored for a left knee, and notes.

    The `parts` are added up. One in another frame has the pose of the tibia in that frame at the table's rows.
    """
    total = np.zeros((len(table.stamps), 6))
    notes = []
    for reaction, pose in parts:
        wrench = np.column_stack([table.column(reaction.column(axis)) for axis in AXES])
        if is_part(reaction.body, FEMUR_WORDS):
            wrench = -wrench
            notes.append(
                f"reaction: on {reaction.body} turned into that on the tibia (Newton's third law)"
            )
        arm = np.zeros((len(wrench), 3))
        names = [reaction.column(axis) for axis in _POINT]
        if set(names) <= set(table.names):
            arm = np.column_stack([table.column(name) for name in names])
        elif pose and pose.point is not None:
            arm = pose.point
        if pose:
            arm = arm - pose.origin
        if arm.any():
            wrench[:, 3:] += np.cross(arm, wrench[:, :3])
            notes.append("torque: moved to the tibia frame's origin")
        if pose:
            halves = (wrench[:, :3], wrench[:, 3:])
            wrench = np.hstack([np.einsum("nij,nj->ni", pose.rotation, half) for half in halves])
            notes.append(f"reaction: turned from {reaction.frame} into the tibia's frame")
        total += wrench
    if len(parts) > 1:
        notes.append(
            "reaction: sum of the compartments, its torque about the tibia frame's origin"
        )
    if side == LEFT:
        total *= MIRROR
        notes.append(
            "reaction: left knee mirrored to a right one (force z, torque x and y turned)"
        )
    return Signal(table.stamps, total), [*dict.fromkeys(notes), *table.notes]
