"""Force plates of a C3D file: the force of the ground on one foot, about its ankle.

`ezc3d` computes force, centre of pressure and free moment of each plate. A contact belongs to the foot whose markers
are nearest to its centre of pressure. A foot that stands beside the plates has an
unknown force; one that moves, or is about to land by the file's events, has none.
"""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from ..model.types import Floats
from ..parameters.sections import Section, one_of
from ..streams.gait_events import HEEL_STRIKE
from ..streams.topics import NANOSECONDS
from ..system.errors import UsageError, list_names
from .c3d import at_frames, c3d_events, first_text, point_names, read_c3d
from .tables import TimeSeries
from .units import Dimension, unit_factor

_LOADED = 20.0
"""Vertical force [N] above which something stands on a plate"""
_OFFSET, _OFTEN = 60.0, 0.1
"""Largest force [N] of an unloaded plate whose amplifier has an offset, and smallest part of the time it is unloaded"""
_SURE = 50.0
"""Vertical force [N] above which its centre of pressure is known"""
_NEAR = 0.2
"""Largest median distance [m] of the centre of pressure of a foot to the line through its markers"""
_STANDS = 0.5
"""Speed [m/s] below which the slowest marker of a foot that stands is"""
_LANDING = 0.15
"""Time [s] before a heel strike of the file in which the foot is in the air, though its slowest marker may stand"""
_WALKS = 0.5
"""Way [m] of an ankle from which it tells the direction of walking"""
_ANKLES = (("AJC",), ("TIO",), ("ANK", "ANKin"), ("ANK", "MED"), ("ANK", "MMA"), ("ANK",))
"""Names of markers at the ankle behind the letter of the leg: its centre, or those whose mean is nearest to it"""
_AXES = {f"{sign}{axis}": number for sign in "+-" for number, axis in enumerate("XYZ")}


class Plates(Section):
    """Foot on the force plates of a C3D file."""

    ankle: list[str] = Field([])
    """Markers whose mean is its centre; default: RTIO, RANK and such"""
    heel: str = ""
    """Marker; default: RHEE, or LHEE"""
    toe: str = ""
    """Marker; default: RTOE, or LTOE"""
    numbers: list[int] = Field([])
    """Of the plates that only this foot touches; default: found by its markers"""
    forward: Annotated[str, one_of("", *_AXES)] = ""
    """Direction of walking, as +X; default: the way of the ankle, or of the foot"""
    file: str = ""
    """Pattern of the file's name, if several are C3D files"""


class _Foot(NamedTuple):
    ankle: Floats
    """Centre [m], shape (n, 3)"""
    line: tuple[Floats, Floats]
    """Ends of the foot, each as `ankle`"""
    stands: NDArray[np.bool_]
    markers: list[str]


class _Plate(NamedTuple):
    centre: Floats
    """[m], shape (3,)"""
    force: Floats
    """Of the ground on the foot [N], shape (n, 3)"""
    moment: Floats
    """About the centre [N m], shape (n, 3)"""
    corners: Floats
    """[m], shape (4, 3)"""


def ground_channels(
    path: Path, plates: Plates, side: str, names: tuple[str, ...], offset: float
) -> dict[str, TimeSeries]:
    """Return force (x, y, z) and torque on the foot of a side as channels of these names.

    `offset` [s] is added to the times.

    Raises:
        UsageError: the file has no plates, the foot or its direction is not found, or it touches no plate.
    """
    read = read_c3d(path, plates=True)
    timing = read["header"]["points"]
    points = read["data"]["points"][:3]
    count = points.shape[2]
    unit = first_text(read["parameters"]["POINT"], "UNITS") or "mm"
    scale = unit_factor(unit, "length", f"{path}: POINT:UNITS")
    labels = [name.rpartition(":")[2] for name in point_names(path, read)]
    places = {name: place for place, name in reversed([*enumerate(labels)])}
    found = np.where((points == 0.0).all(axis=0), np.nan, points) * scale
    rate = float(timing["frame_rate"])
    foot = _foot(path, plates, places, found, rate, side[0].upper())
    at = (timing["first_frame"] + np.arange(count)) / rate
    foot.stands[_lands(path, read, side, at)] = False
    other = None
    if not plates.numbers:
        letter = "L" if side == "right" else "R"
        other = _foot(path, Plates(), places, found, rate, letter, needed=False)
    kinds = np.ravel(read["parameters"]["FORCE_PLATFORM"]["TYPE"]["value"])
    platforms = zip(read["data"]["platform"], kinds.tolist(), strict=False)
    known = [_plate(path, each, kind, count) for each, kind in platforms]
    if not known:
        raise UsageError(f"{path} has no force plates (FORCE_PLATFORM:USED is 0)")
    up = _up(known[0], foot)
    known = [_upright(plate, up) for plate in known]
    total, torque, carried = np.zeros((count, 3)), np.zeros((count, 3)), np.zeros(count, bool)
    unknown, used = np.isnan(foot.ankle).any(axis=1), dict[int, None]()
    for number, plate in enumerate(known, start=1):
        if plates.numbers and number not in plates.numbers:
            continue
        for begin, end in _contacts(plate.force @ up > _LOADED):
            if not plates.numbers and not _is_of(plate, slice(begin, end), foot, other, up):
                continue
            used[number] = None
            rows = slice(begin, end)
            total[rows] += plate.force[rows]
            torque[rows] += plate.moment[rows]
            torque[rows] += np.cross(plate.centre - foot.ankle[rows], plate.force[rows])
            carried[rows] = True
            if other:
                unknown[rows] |= other.stands[rows] & _over(plate, other, up)[rows]
    unknown |= ~carried & (foot.stands | (len(foot.markers) < 2))
    if not used or unknown.all():
        raise UsageError(
            f"{path}: no plate is touched by the {side} foot ({list_names(foot.markers)}); give ankle, heel and toe of "
            "other markers, or the numbers of its plates (map: plates)"
        )
    forward = _forward(path, plates.forward, foot, up, carried)
    axes = np.array([forward, up, np.cross(forward, up)])
    columns = np.hstack([total @ axes.T, torque @ axes.T])[~unknown]
    stamps = np.rint((at[~unknown] + offset) * NANOSECONDS).astype(np.int64)
    text = f"plates {', '.join(map(str, used))} under {', '.join(foot.markers)}"
    left_out = (
        f"{path.name}: {int(unknown.sum())} of {count} frames left out: the foot is elsewhere"
    )
    return {
        name: TimeSeries(name, path, text, stamps, column, (left_out,) * bool(unknown.any()))
        for name, column in zip(names, columns.T, strict=True)
    }


def _lands(path: Path, read: Any, side: str, at: Floats) -> NDArray[np.bool_]:
    """Return at which times [s], shape (n,), the foot is about to land by the file's events."""
    strikes = [time for time, kind in c3d_events(path, read, side)[0] if kind == HEEL_STRIKE]
    before = np.subtract.outer(strikes, at)
    return np.asarray(((before > 0.0) & (before <= _LANDING)).any(axis=0))


def _plate(path: Path, platform: Any, kind: int, count: int) -> _Plate:
    """Return a plate of a type in SI units at the times of the frames; unloaded it tells 0.

    Raises:
        UsageError: it has no data, or an unknown unit.
    """
    factors = {}
    quantities: tuple[tuple[str, Dimension], ...] = (
        ("force", "force"),
        ("moment", "moment"),
        ("position", "length"),
    )
    for name, quantity in quantities:
        factors[name] = unit_factor(platform[f"unit_{name}"], quantity, f"{path}: FORCE_PLATFORM")
    corners = platform["corners"].T * factors["position"]
    middle = corners.mean(axis=0)
    force, moment, free, centre = (
        np.nan_to_num(platform[name].T * factors[unit])
        for name, unit in (
            ("force", "force"),
            ("moment", "moment"),
            ("Tz", "moment"),
            ("center_of_pressure", "position"),
        )
    )
    if not len(force):
        raise UsageError(f"{path}: its force plates have no data")
    most = int(np.linalg.norm(force, axis=1).argmax())
    if kind == 3:
        # ezc3d 1.7 turns a sensor's height that is positive, and with it the distances of the four sensors.
        wide, _, height = np.ravel(platform["origin"]) * factors["position"]
        down = np.cross(corners[0] - corners[1], corners[0] - corners[3])
        lever = down / np.linalg.norm(down) * height
        moment = moment if wide > 0.0 else 2.0 * np.cross(force, lever) - moment
    elif moment[most] @ (np.cross(centre[most] - middle, force[most]) + free[most]) < 0.0:
        moment = -moment  # ezc3d 1.7 has another sign for plates of type 1
    force, moment = at_frames(force.T, count).T, at_frames(moment.T, count).T
    idle = np.linalg.norm(force, axis=1) < _OFFSET
    if idle.mean() > _OFTEN:
        force = force - np.median(force[idle], axis=0)
        moment = moment - np.median(moment[idle], axis=0)
    return _Plate(middle, force, moment, corners)


def _up(plate: _Plate, foot: _Foot) -> Floats:
    """Return the axis of the laboratory that points up: the plate's normal, on the side of the ankle."""
    edges = plate.corners[1] - plate.corners[0], plate.corners[2] - plate.corners[1]
    normal = np.cross(*edges)
    axis = np.zeros(3)
    place = int(np.abs(normal).argmax())
    above = np.nanmedian(foot.ankle[:, place]) - plate.centre[place]
    axis[place] = np.copysign(1.0, above)
    return axis


def _upright(plate: _Plate, up: Floats) -> _Plate:
    """Return a plate that tells the force on the foot, and not the one on the plate."""
    vertical = plate.force @ up
    if vertical.max() >= -vertical.min():
        return plate
    return plate._replace(force=-plate.force, moment=-plate.moment)


def _foot(
    path: Path,
    given: Plates,
    places: dict[str, int],
    points: Floats,
    rate: float,
    letter: str,
    *,
    needed: bool = True,
) -> Any:
    """Return the foot of a leg by its markers; None if it has none and is not `needed`."""
    ways = (
        [tuple(given.ankle)]
        if given.ankle
        else [tuple(letter + one for one in way) for way in _ANKLES]
    )
    places = {name: at for name, at in places.items() if np.isfinite(points[:, at]).any()}
    ankle = next((way for way in ways if all(name in places for name in way)), ())
    ends = [given.heel or f"{letter}HEE", given.toe or f"{letter}TOE"]
    lacking = [name for name in (given.heel, given.toe) if name and name not in places]
    if not ankle or lacking:
        if not needed:
            return None
        raise UsageError(
            f"{path} has no markers {', '.join(lacking or ways[-1])}; name them (map: plates.ankle, heel, toe); it has "
            f"{list_names([*places])}"
        )
    ends = [name for name in ends if name in places]
    centre = np.mean([points[:, places[name]].T for name in ankle], axis=0)
    line = [points[:, places[name]].T for name in ends] or [centre]
    moving = [np.linalg.norm(np.gradient(each, axis=0), axis=1) * rate for each in (centre, *line)]
    stands = np.nanmin(np.nan_to_num(moving, nan=np.inf), axis=0) < _STANDS
    return _Foot(centre, (line[0], line[-1]), stands, list(dict.fromkeys([*ankle, *ends])))


def _contacts(loaded: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return the first row of each run of a loaded plate, and the one behind its last."""
    edges = np.flatnonzero(np.diff(loaded, prepend=False, append=False))
    return [(int(a), int(b)) for a, b in pairwise(edges.tolist())][::2]


def _is_of(plate: _Plate, rows: slice, foot: _Foot, other: _Foot | None, up: Floats) -> bool:
    """Return whether a contact is that of a foot, and not of the other one."""
    vertical = plate.force[rows] @ up
    sure = vertical > _SURE
    if not sure.any():
        return False
    moment = np.cross(up, plate.moment[rows][sure]) / vertical[sure, None]
    centres = plate.centre + moment
    near = []
    for each in filter(None, (foot, other)):
        away = _distances(centres, [end[rows][sure] for end in each.line], up)
        seen = away[np.isfinite(away)]
        near.append(float(np.median(seen)) if len(seen) else math.inf)
    return near[0] < _NEAR and near[0] == min(near)


def _distances(centres: Floats, line: list[Floats], up: Floats) -> Floats:
    """Return the horizontal distances of points to lines between two points, shape (n,)."""
    flat = np.eye(3) - np.outer(up, up)
    start, along = line[0] @ flat, (line[1] - line[0]) @ flat
    length = (along * along).sum(axis=1)
    part = ((centres @ flat - start) * along).sum(axis=1) / np.where(length > 0.0, length, 1.0)
    nearest = start + np.clip(part, 0.0, 1.0)[:, None] * along
    return np.asarray(np.linalg.norm(centres @ flat - nearest, axis=1))


def _over(plate: _Plate, foot: _Foot, up: Floats) -> NDArray[np.bool_]:
    """Return when a foot's end is above a plate, shape (n,)."""
    inside = np.zeros(len(foot.ankle), bool)
    level = [place for place in range(3) if not up[place]]
    low, high = plate.corners[:, level].min(axis=0), plate.corners[:, level].max(axis=0)
    for end in foot.line:
        inside |= ((end[:, level] > low) & (end[:, level] < high)).all(axis=1)
    return inside


def _forward(
    path: Path, given: str, foot: _Foot, up: Floats, carried: NDArray[np.bool_]
) -> Floats:
    """Return the horizontal direction of walking, shape (3,)."""
    if given:
        axis = np.zeros(3)
        axis[_AXES[given]] = 1.0 if given[0] == "+" else -1.0
        return axis
    flat = np.eye(3) - np.outer(up, up)
    seen = foot.ankle[np.isfinite(foot.ankle).all(axis=1)]
    way = (seen[-1] - seen[0]) @ flat
    if np.linalg.norm(way) < _WALKS:  # on a treadmill
        way = np.nanmean((foot.line[1] - foot.line[0])[carried], axis=0) @ flat
    if not np.linalg.norm(way) > 0.05:
        raise UsageError(
            f"{path}: the direction of walking is not clear; give it (map: plates.forward)"
        )
    return np.asarray(way / np.linalg.norm(way))
