"""Read a knee's gait from results of OpenSim, kinematics and joint reactions; notes say what was converted."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from knee_contact_ros.joint_reaction.leg import GRAVITY
from knee_contact_ros.offline.gait_files import knee_gait
from knee_contact_ros.offline.gait_files.knee_gait import Angles, Reactions
from knee_contact_ros.offline.gait_files.leg_gait import Leg, leg_at
from knee_contact_ros.offline.gait_files.storage import Floats, Stamps, Storage, read_storage
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.tools.opensim.angle import AUTO, DEGREES, sign_of, unit_of
from knee_contact_ros.tools.opensim.columns import (
    AXES,
    LEFT,
    POINT,
    Reaction,
    angle_column,
    coordinate_of,
    find_reaction,
    speed_column,
)
from knee_contact_ros.tools.opensim.external_loads import data_file, read_ground
from knee_contact_ros.tools.opensim.leg import LegGait, leg_joints, read_leg
from knee_contact_ros.tools.opensim.model_file import read_model

SMALLEST_FORCE, LARGEST_FORCE = 20.0, 1e6
"""Range of the peak of an axial force [N], outside of which the force is not in N"""
MOVES = 0.1
"""RMS of the rate [rad/s] below which a given rate cannot be checked"""
FITS = (0.5, 2.0)
"""Range of the slope of given over derived rate; outside, the given one has another unit or is another joint's"""
SPLIT = (AXES[:3], AXES[3:])
"""Axes of the force, and of the torque"""


@dataclass(frozen=True)
class Files:
    """Files to read."""

    kinematics: Path
    reactions: Path
    speeds: Path | None = None
    model: Path | None = None
    ground: Path | None = None
    """External loads file, or ground reactions with names that tell the foot; None: no leg's sensors are simulated"""
    ground_data: Path | None = None
    """File with the numbers of `ground`"""


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


class KneeGait(NamedTuple):
    """Gait of a knee, with its origin."""

    side: str
    angles: Angles
    reactions: Reactions
    columns: dict[str, str]
    """Names of the columns, by quantity"""
    notes: tuple[str, ...]
    """What was converted or left out, as sentences"""
    body_weight: float | None
    """Weight of the model [N]; None: no model is given"""
    leg: Leg | None = None
    """Measurements of the leg's simulated sensors; None: no ground reactions are given"""


def read_knee(side: str, files: Files, settings: Settings, work: Path | None = None) -> KneeGait:
    """Read a knee's gait, and with ground reactions that of its leg, for which OpenSim runs in the folder `work`.

    Raises:
        UsageError: a file cannot be used, a column is missing, or unit, sign or frame are wrong or not clear.
    """
    for name in ("start", "end", "rate"):
        value = getattr(settings, name)
        if value is not None and not math.isfinite(value):
            raise UsageError(f"--{name} {value}: it must be a finite number")
    kinematics, reactions = read_storage(files.kinematics), read_storage(files.reactions)
    column = angle_column(kinematics, side, settings.coordinate)
    facts = read_model(files.model, coordinate_of(column)) if files.model else None
    angles, angle_notes = read_angles(kinematics, column, files.speeds, settings, facts.bounds if facts else None)
    chosen = find_reaction(reactions, side, settings.joint)
    wrenches, wrench_notes = read_wrenches(reactions, chosen, side)
    leg = read_sensors(kinematics, column, side, files, settings, work) if files.ground else None
    ground_stamps = leg.leg.ground.stamps if leg else None
    window = knee_gait.common_window(angles, wrenches, settings.start, settings.end, ground_stamps)
    rows = len(wrenches.stamps)
    if settings.rate:
        angles, wrenches = knee_gait.resample(angles, wrenches, window, settings.rate)
        window_notes = [f"{'all' if leg else 'both'} interpolated linearly at {settings.rate:g} Hz"]
    else:
        angles, wrenches = knee_gait.cut(angles, wrenches, window)
        outside = rows - len(wrenches.stamps)
        left_out = f"{outside} reactions left out: no angle at their time, or outside --start and --end"
        window_notes = [left_out] if outside > 0 else []
    columns = {"angle": column, "reaction": chosen.prefix + f"({' '.join(AXES)})"}
    columns |= {"ground force": leg.columns} if leg else {}
    return KneeGait(
        side,
        knee_gait.with_rate(angles),
        wrenches,
        columns,
        (*angle_notes, *wrench_notes, *(leg.notes if leg else ()), *window_notes),
        facts.mass * GRAVITY if facts else None,
        leg_within(leg.leg, angles.stamps, window, settings) if leg else None,
    )


def read_sensors(
    kinematics: Storage, column: str, side: str, files: Files, settings: Settings, work: Path | None
) -> LegGait:
    """Simulate the leg's sensors; `column` is that of the knee's angle in the kinematics.

    Raises:
        UsageError: OpenSim is not installed or fails, or a file cannot be used or does not fit the others.
    """
    assert files.ground is not None  # noqa: S101  (the caller has looked)
    if files.model is None:
        raise UsageError("--ground needs --model M.osim, which tells where the ankle is")
    if work is None:
        raise UsageError("ground reactions need a folder to work in")
    ground = read_ground(files.ground, files.ground_data or data_file(files.ground), side)
    joints = leg_joints(files.model, side, coordinate_of(column))
    degrees = unit_of(kinematics, column, settings.angle_unit) == DEGREES
    return read_leg(ground, kinematics, degrees, files.model, joints, work)


def leg_within(leg: Leg, stamps: Stamps, window: tuple[int, int], settings: Settings) -> Leg:
    """Interpolate a leg at the stamps of the knee's angles, shape (n,); without a rate, ground forces keep theirs."""
    own = leg.ground.stamps
    return leg_at(leg, stamps, stamps if settings.rate else own[(own >= window[0]) & (own <= window[1])])


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
    derived = knee_gait.with_rate(angles).rate
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
        wrenches = knee_gait.mirrored(wrenches)
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
