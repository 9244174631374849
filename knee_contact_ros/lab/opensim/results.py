"""Read a knee's gait from results of OpenSim, kinematics and joint reactions; notes say what was converted."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from knee_contact_ros.lab.gait_bag import (
    Angles,
    Reactions,
    mirrored,
    with_rate,
)
from knee_contact_ros.lab.opensim.pipeline import read_xml
from knee_contact_ros.lab.tables import Floats, Storage, read_storage, some
from knee_contact_ros.system.errors import UsageError


class ModelFacts(NamedTuple):
    """Mass and range of a coordinate of a model."""

    mass: float
    """Mass of all bodies [kg]"""
    bounds: tuple[float, float] | None
    """Range of the coordinate [rad]; None: it has none"""


def read_model(path: Path, coordinate: str | None) -> ModelFacts:
    """Read the mass of a model, and the range of a coordinate.

    Raises:
        UsageError: the file is no model, or has no such coordinate.
    """
    root = read_xml(path, "Model")
    mass = sum(float(body.findtext("mass", "0")) for body in root.iter("Body"))
    found = next((c for c in root.iter("Coordinate") if c.get("name") == coordinate), None)
    if found is None:
        raise UsageError(f"{path} (--model) has no coordinate {coordinate}; is it the model of these results?")
    numbers = [float(number) for number in found.findtext("range", "").split()]
    return ModelFacts(mass, (numbers[0], numbers[1]) if len(numbers) == 2 else None)


DEGREES, RADIANS, AUTO = "deg", "rad", "auto"
LARGEST_RADIANS = 3.5
"""Angle [rad] that no knee reaches: larger numbers are in degrees"""
SMALLEST_DEGREES = 3.5
"""Angle [deg] below which numbers may also be in radians"""
FLEXES = math.radians(20.0)
"""Angle [rad] that a knee reaches in flexion in every step, and never in extension"""
TIMES_MORE = 2.0
"""Least ratio of the angles to both sides for which the sign is clear"""
EXTENDS = math.radians(30.0)
"""Hyperextension [rad] beyond which a sign or unit is wrong"""
LARGEST_FLEXION = math.radians(170.0)
"""Flexion angle [rad] beyond which a sign or unit is wrong"""


def unit_of(storage: Storage, column: str, requested: str) -> str:
    """Unit of a column, `deg` or `rad`: the requested one, or with `auto` that of the header, checked by the values.

    Raises:
        UsageError: header and values contradict each other, or the unit is not clear.
    """
    if requested != AUTO:
        return requested
    values = storage.column(column)
    reach, span = float(np.abs(values).max()), f"{column} goes from {values.min():.3g} to {values.max():.3g}"
    if storage.degrees is None:
        if reach > LARGEST_RADIANS:
            return DEGREES
        raise UsageError(f"{storage.path} does not say inDegrees, and {span}; give --angle-unit deg or rad")
    if storage.degrees and reach < SMALLEST_DEGREES:
        raise UsageError(f"{storage.path} says inDegrees=yes, but {span}, like rad; give --angle-unit deg or rad")
    if not storage.degrees and reach > LARGEST_RADIANS:
        raise UsageError(f"{storage.path} says inDegrees=no, but {span}, like degrees; give --angle-unit deg or rad")
    return DEGREES if storage.degrees else RADIANS


def sign_of(angle: Floats, where: str, requested: int | None, bounds: tuple[float, float] | None) -> int:
    """Sign that makes an angle [rad] positive in flexion, 1 or -1.

    It is the requested one, or else follows from the data, as a walking knee flexes far more than it extends, or else
    from `bounds`, the coordinate's range [rad] in the model. `where` names file and column in messages.

    Raises:
        UsageError: the sign is impossible for a knee, or is not clear.
    """
    low, high = float(angle.min()), float(angle.max())
    span = f"{where} goes from {math.degrees(low):.1f} to {math.degrees(high):.1f} deg"
    sign = requested or clear_sign(low, high) or (clear_sign(*bounds) if bounds else None)
    if sign is None:
        raise UsageError(f"{span}: which sign is flexion? Give --angle-sign 1 or -1, or --model")
    lowest, highest = (low, high) if sign > 0 else (-high, -low)
    if lowest < -EXTENDS or highest > LARGEST_FLEXION:
        raise UsageError(
            f"{span}; with sign {sign:+d} that is {math.degrees(lowest):.1f} to {math.degrees(highest):.1f} deg of "
            f"flexion, and a knee has {-math.degrees(EXTENDS):.0f} to {math.degrees(LARGEST_FLEXION):.0f}: "
            "see --angle-sign and --angle-unit"
        )
    return sign


def clear_sign(low: float, high: float) -> int | None:
    """Sign of flexion if a range of angles [rad] reaches clearly further to one side; None if it does not."""
    if high >= FLEXES and high >= -TIMES_MORE * low:
        return 1
    if -low >= FLEXES and -low >= TIMES_MORE * high:
        return -1
    return None


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


@dataclass(frozen=True)
class Settings:
    """Settings of the import."""

    joint: str | None = None
    """Joint of the reactions; None: the one whose name says knee and side"""
    coordinate: str | None = None
    """Coordinate of the kinematics; None: the one whose name says knee and side"""
    angle_unit: str = AUTO
    """Unit of the angle: `deg`, `rad` or `auto`"""
    angle_sign: int | None = None
    """Sign that makes the angle positive in flexion, 1 or -1; None: it is found from the data"""
    start: float | None = None
    """First time [s]; None: the first that all files have"""
    end: float | None = None
    """Last time [s]; None: the last that all files have"""
    rate: float | None = None
    """Rate of interpolated samples [Hz]; None: every row keeps its stamp"""


SMALLEST_FORCE, LARGEST_FORCE = 20.0, 1e6
"""Range of the peak of an axial force [N], outside of which the force is not in N"""
MOVES = 0.1
"""RMS of the rate [rad/s] below which a given rate cannot be checked"""
FITS = (0.5, 2.0)
"""Range of the slope of given over derived rate; outside, the given one has another unit or is another joint's"""
SPLIT = (AXES[:3], AXES[3:])
"""Axes of the force, and of the torque"""


def read_angles(
    storage: Storage, column: str, speeds: Path | None, settings: Settings, bounds: tuple[float, float] | None
) -> tuple[Angles, list[str]]:
    """Read the flexion angle, its rate if a file has it, and notes; `bounds` [rad] is its range in the model.

    Raises:
        UsageError: unit, sign or rate are wrong or not clear, or there are fewer than two rows.
    """
    if len(storage.stamps) < 2:
        raise UsageError(f"{storage.path} has {len(storage.stamps)} row, and an angle over time needs two")
    unit = unit_of(storage, column, settings.angle_unit)
    factor = math.radians(1.0) if unit == DEGREES else 1.0
    angle = storage.column(column) * factor
    sign = sign_of(angle, f"{storage.path}: {column}", settings.angle_sign, bounds)
    notes = [f"angle: {'degrees to rad' if unit == DEGREES else 'rad'}"]
    notes[0] += ", sign turned (flexion was negative)" if sign < 0 else ", flexion positive as it was"
    angles = Angles(storage.stamps, sign * angle, None)
    source = read_storage(speeds) if speeds else storage
    name = speed_column(source.names, column) if speeds or column.endswith("/value") else None
    if name is not None:
        rate = sign * source.column(name) * (math.radians(1.0) if source.degrees else 1.0)
        angles = angles._replace(rate=checked_rate(angles, source, name, rate))
        notes.append(f"rate: {name} of {source.path.name}")
    elif speeds:
        raise UsageError(f"{speeds} has no rate of {column}")
    else:
        notes.append("rate: derived from the angle")
    return angles, [*notes, *duplicate_notes(storage)]


def checked_rate(angles: Angles, source: Storage, name: str, rate: Floats) -> Floats:
    """Interpolate a rate [rad/s] at the stamps of the angles, and check it.

    Raises:
        UsageError: the rate does not span the angles, or is not that of these angles.
    """
    if source.stamps[0] > angles.stamps[0] or source.stamps[-1] < angles.stamps[-1]:
        raise UsageError(f"{source.path} spans {source.span()}, less than the angles")
    first = angles.stamps[0]
    given: Floats = np.interp(angles.stamps - first, source.stamps - first, rate)
    derived = with_rate(angles).rate
    assert derived is not None  # noqa: S101  (with_rate gives one)
    power = float(derived @ derived)
    slope = float(given @ derived) / power if power > MOVES**2 * len(derived) else 1.0
    if not FITS[0] <= slope <= FITS[1]:
        raise UsageError(
            f"{source.path}: {name} is {slope:.3g} times the rate of the angle; another unit than its "
            "inDegrees says, or another coordinate's?"
        )
    return given


def read_wrenches(storage: Storage, reaction: Reaction, side: str) -> tuple[Reactions, list[str]]:
    """Read force and torque on the tibia at its frame's origin, mirrored for a left knee, and notes.

    Raises:
        UsageError: the force pulls the joint apart, or is not in N.
    """
    force, torque = (np.column_stack([storage.column(reaction.prefix + axis) for axis in part]) for part in SPLIT)
    notes = []
    if reaction.on_femur:
        force, torque = -force, -torque
        notes.append(f"reaction: on {reaction.body} turned into that on the tibia (Newton's third law)")
    points = [reaction.prefix + axis for axis in POINT]
    if set(points) <= set(storage.names):
        point = np.column_stack([storage.column(name) for name in points])
        if point.any():
            torque = torque + np.cross(point, force)
            notes.append("torque: moved to the tibia frame's origin")
    check_axial(storage, reaction, -force[:, 1])
    wrenches = Reactions(storage.stamps, force, torque)
    if side == LEFT:
        wrenches = mirrored(wrenches)
        notes.append("reaction: left knee mirrored to a right one (force z, torque x and y turned)")
    return wrenches, [*notes, *duplicate_notes(storage)]


def check_axial(storage: Storage, reaction: Reaction, load: Floats) -> None:
    """Check the axial load [N], > 0 in compression, shape (n,).

    Raises:
        UsageError: it is mostly tension, or not in N.
    """
    name = f"{storage.path}: {reaction.prefix}fy"
    if load.max() < -load.min():
        raise UsageError(
            f"{name} pulls the knee apart, by up to {-load.min():.0f} N, and presses with {load.max():.0f} N at most: "
            "it is not what acts on the tibia, or its y does not point up"
        )
    if not SMALLEST_FORCE <= load.max() <= LARGEST_FORCE:
        raise UsageError(f"{name} presses with {load.max():.3g} at most; it must be in N")


def duplicate_notes(storage: Storage) -> list[str]:
    """Note on rows that were left out as the next row has the same stamp, if there are any."""
    if not storage.duplicates:
        return []
    rows = "row gave" if storage.duplicates == 1 else "rows gave"
    return [f"{storage.path.name}: {storage.duplicates} {rows} way to the next of the same time"]
