"""Find the columns of a knee by OpenSim's names, which tell coordinate, joint, body and frame."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import NamedTuple

from knee_contact_ros.offline.gait_files.storage import Storage, some
from knee_contact_ros.system.errors import UsageError

RIGHT, LEFT = "right", "left"
SIDE_WORDS = {RIGHT: {"r", "right"}, LEFT: {"l", "left"}}
ANGLE_WORDS = {"angle", "flexion", "flex", "extension", "ext", "fe"}
"""Words allowed in the name of a knee's angle beside `knee` and the side; others are of the patella or other axes"""
TIBIA, FEMUR = ("tibia", "shank"), ("femur", "femor", "thigh")
"""Beginnings of words in the names of bodies"""
REACTION = re.compile(r"(?P<joint>.+)_on_(?P<body>.+)_in_(?P<frame>.+)_(?P<axis>[fmp][xyz])")
AXES = ("fx", "fy", "fz", "mx", "my", "mz")
POINT = ("px", "py", "pz")
HOW = "in the JointReaction set-up: apply_on_bodies child, express_in_frame child"


class Reaction(NamedTuple):
    """Reaction of a joint in a file, with columns `<joint>_on_<body>_in_<frame>_fx` and so on."""

    joint: str
    body: str
    """Body on which it acts"""
    frame: str
    """Frame in which it is expressed"""

    @property
    def prefix(self) -> str:
        """Beginning of the names of its columns."""
        return f"{self.joint}_on_{self.body}_in_{self.frame}_"

    @property
    def on_tibia(self) -> bool:
        """Whether it acts on a tibia and is expressed in its frame."""
        return is_part(self.body, TIBIA) and self.frame == self.body

    @property
    def on_femur(self) -> bool:
        """Whether it acts on a femur and is expressed in a tibia's frame."""
        return is_part(self.body, FEMUR) and is_part(self.frame, TIBIA) and "offset" not in self.frame


def angle_column(storage: Storage, side: str, coordinate: str | None) -> str:
    """Find the column with the knee's angle; `coordinate` is its name or that of its coordinate, None if not known.

    Raises:
        UsageError: there is no such column, or more than one.
    """
    by_coordinate = {found: name for name in storage.names if (found := coordinate_of(name)) is not None}
    if coordinate is not None:
        if coordinate in storage.names:
            return coordinate
        if coordinate in by_coordinate:
            return by_coordinate[coordinate]
        raise UsageError(f"{storage.path} has no column {coordinate} (--coordinate); it has {some(storage.names)}")
    fitting = [name for name in by_coordinate if is_knee_angle(name, side)]
    if len(fitting) != 1:
        having = (
            f"has {', '.join(fitting)}" if fitting else f"has no angle of the {side} knee, but {some(storage.names)}"
        )
        raise UsageError(f"{storage.path} {having}; choose one with --coordinate NAME")
    return by_coordinate[fitting[0]]


def speed_column(names: Iterable[str], angle: str) -> str | None:
    """Find the column with the rate of an angle's column, in a file of states or of speeds; None: there is none."""
    wanted = angle.removesuffix("/value") + "/speed" if "/" in angle else angle
    coordinate = coordinate_of(angle)
    return next((name for name in names if name in {wanted, coordinate} or name.endswith(f"/{coordinate}/speed")), None)


def coordinate_of(name: str) -> str | None:
    """Coordinate whose value a column has, also with a name `/jointset/JOINT/COORDINATE/value`; None: it has none."""
    parts = name.strip("/").split("/")
    if len(parts) == 1:
        return name
    return parts[-2] if parts[-1] == "value" else None


def is_knee_angle(name: str, side: str) -> bool:
    """Whether a coordinate is the flexion angle of the knee of a side, by its name."""
    parts = words(name)
    return "knee" in parts and bool(parts & SIDE_WORDS[side]) and not parts - {"knee"} - ANGLE_WORDS - SIDE_WORDS[side]


def find_reaction(storage: Storage, side: str, joint: str | None) -> Reaction:
    """Find the knee's reaction on the tibia in the tibia's frame, or else one from which it can be computed.

    Raises:
        UsageError: there is no such joint or more than one, or its reaction is on another body or in another frame.
    """
    there = reactions(storage)
    if not there:
        raise UsageError(
            f"{storage.path} has no reaction <joint>_on_<body>_in_<frame>_fx ..., but {some(storage.names)}"
        )
    joints = list(dict.fromkeys(reaction.joint for reaction in there))
    if joint is not None and joint not in joints:
        raise UsageError(f"{storage.path} has no joint {joint} (--joint); it has {some(joints)}")
    knees = [joint] if joint else [name for name in joints if "knee" in words(name) and words(name) & SIDE_WORDS[side]]
    if len(knees) != 1:
        having = f"{len(knees)} joints of the {side} knee" if knees else f"no joint of the {side} knee"
        raise UsageError(f"{storage.path} has {having} among {some(joints)}; choose one with --joint NAME")
    ours = [reaction for reaction in there if reaction.joint == knees[0]]
    for reaction in (*(r for r in ours if r.on_tibia), *(r for r in ours if r.on_femur)):
        missing = [reaction.prefix + axis for axis in AXES if reaction.prefix + axis not in storage.names]
        if missing:
            raise UsageError(f"{storage.path} has no column {', '.join(missing)}")
        return reaction
    raise UsageError(f"{storage.path}: {refusal(ours[0])}; {HOW}")


def refusal(reaction: Reaction) -> str:
    """Say why a reaction cannot be used."""
    if not is_part(reaction.body, (*TIBIA, *FEMUR)):
        return f"{reaction.joint} acts on {reaction.body}, and must on the tibia"
    return f"{reaction.joint} on {reaction.body} is expressed in {reaction.frame}, and must be in the tibia's frame"


def reactions(storage: Storage) -> list[Reaction]:
    """List the reactions that a file has."""
    matches = [REACTION.fullmatch(name) for name in storage.names]
    return list(dict.fromkeys(Reaction(m["joint"], m["body"], m["frame"]) for m in matches if m))


def is_part(name: str, beginnings: tuple[str, ...]) -> bool:
    """Whether a body's name has a word with one of these beginnings."""
    return any(word.startswith(beginnings) for word in words(name))


def words(name: str) -> set[str]:
    """Words of a name, in lower case."""
    return set(re.findall("[a-z]+", name.lower()))
