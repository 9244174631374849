"""C3D files of motion capture as tables: points, analog channels at the times of the points, units, and gait events."""

import os
import pickle
import re
from collections.abc import Iterable
from functools import lru_cache
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from ..model.types import Floats
from ..streams.gait_events import HEEL_STRIKE, TOE_OFF
from ..system.errors import UsageError, list_names
from ..system.files import open_regular, require
from ..system.processes import written_by
from . import c3d_file
from .headers import Header

_KINDS = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS")
"""Parameters of the group POINT that list what a program computed; each has its unit, such as ANGLE_UNITS"""

_EVENT = re.compile(
    r"(r(?:ight)?|l(?:eft)?)?(?:((?:foot|heel)strike|(?:foot|heel|initial)contact|hs|fs|ic)|((?:foot|toe)off|to|fo))"
)
"""Leg, heel strike and toe-off in a label, of which only the letters are left: Foot Strike, RHS, left toe-off"""

_MASSES = (15.0, 250.0)
"""Smallest and largest mass [kg] that is taken for a body's; programs write 0 or 1 where nobody gave one"""

LegEvent = tuple[float, str]
"""Time [s] and kind of a gait event"""


def c3d_header(path: Path) -> Header:
    """Read the points of a C3D file, as RKneeAngles.X, and its analog channels at the times of the points.

    Raises:
        UsageError: the file cannot be read, or has another number of names than of columns.
    """
    read = read_c3d(path)
    points = read["data"]["points"][:3]
    analogs = read["data"]["analogs"][0]
    timing = read["header"]["points"]
    rows = points.shape[2]
    point, analog = read["parameters"]["POINT"], read["parameters"]["ANALOG"]
    labels = point_names(path, read)
    channels = _names(path, analog, "analog channels", len(analogs))
    columns = [
        (timing["first_frame"] + np.arange(rows)) / timing["frame_rate"],
        *points.transpose(1, 0, 2).reshape(-1, rows),
        *at_frames(analogs, rows),
    ]
    stems = [label.rpartition(":")[2] for label in labels]
    names = [f"{stem}.{axis}" for stem in stems for axis in "XYZ"]
    units = ["", *(unit for each in _point_units(point, labels) for unit in 3 * [each])]
    units += texts(analog, "UNITS")
    return Header(
        path,
        ("time", *names, *channels),
        entries={"nrows": str(read["stated_frames"])},
        data=np.column_stack(columns),
        units=dict(enumerate(units)),
    )


def read_c3d(path: Path, *, plates: bool = False) -> Any:
    """Read a C3D file, with the force `plates` if they are wanted.

    Raises:
        UsageError: the file cannot be read, or has no points over time.
    """
    require("c3d", "ezc3d")
    try:
        with open_regular(path) as file:
            made = os.fstat(file.fileno())
        read = _content(path, plates, made.st_mtime_ns, made.st_size)
    except (OSError, ValueError) as error:
        said = str(error)
        if "bad_alloc" in said or "MemoryError" in said:
            said = "its sizes ask for more memory than its samples can take; is it damaged?"
        raise UsageError(f"cannot read {path}: {said}") from None
    if not read["data"]["points"].shape[2]:
        raise UsageError(f"{path} has no points over time")
    return read


@lru_cache(maxsize=1)  # an import wants the mass, then the tables
def _content(path: Path, plates: bool, *_made: int) -> Any:
    """Return what a C3D file held when it was `made`, read in a process of its own."""
    more = "plates" if plates else ""
    return pickle.loads(written_by(c3d_file.__name__, path, more, library="ezc3d"))  # noqa: S301  (our own)


def c3d_mass(path: Path) -> float | None:
    """Return the body mass [kg] that a C3D file states, as Vicon and C3D.org write it; None without a likely one."""
    parameters = read_c3d(path)["parameters"]
    for group, name in (("PROCESSING", "BODYMASS"), ("SUBJECT", "WEIGHT")):
        for known, parameter in parameters.get(group, {}).items():
            if known.upper() == name and len(mass := np.ravel(parameter["value"])):
                return float(mass[0]) if _MASSES[0] <= mass[0] <= _MASSES[1] else None
    return None


def c3d_events(path: Path, read: Any, side: str) -> tuple[list[LegEvent], list[str]]:
    """Return the gait events of a leg in the group EVENT of a C3D file, and why events are not used, if any are not."""
    group = read["parameters"].get("EVENT", {})
    labels, legs, people = (texts(group, name) for name in ("LABELS", "CONTEXTS", "SUBJECTS"))
    # Minutes and seconds of each event.
    times = np.ravel(group["TIMES"]["value"] if "TIMES" in group else [], order="F")
    at = times[: len(times) // 2 * 2].reshape(-1, 2) @ [60.0, 1.0]
    if len({*people} - {""}) > 1:
        return [], [f"{path.name}: events of {list_names([*people])} are not used; see --events"]
    if len(labels) != len(at):
        return [], [f"{path.name}: {len(labels)} events with {len(at)} times are not used"]
    legs += [""] * (len(labels) - len(legs))
    return events_of_leg(zip(at.tolist(), labels, legs, strict=False), side), []


def events_of_leg(rows: Iterable[tuple[float, str, str]], side: str) -> list[LegEvent]:
    """Return the heel strikes and toe-offs of a leg among events: time [s], label, and leg if the label names none."""
    found = []
    for time, label, leg in rows:
        match = _EVENT.fullmatch(re.sub(r"[^a-z]", "", label.lower()))
        if match and (match[1] or leg.lower())[:1] == side[0]:
            found.append((time, HEEL_STRIKE if match[2] else TOE_OFF))
    return found


def point_names(path: Path, read: Any) -> list[str]:
    """Return the names of the points of a C3D file.

    Raises:
        UsageError: it has another number of names.
    """
    return _names(path, read["parameters"]["POINT"], "points", read["data"]["points"].shape[1])


def first_text(group: Any, name: str) -> str:
    """Return the first text of a parameter; empty without one."""
    return "".join(texts(group, name)[:1])


def texts(group: Any, name: str) -> list[str]:
    """Return the texts of a parameter and of its continuations: LABELS, LABELS2 and so on hold 255 each."""
    found: list[str] = []
    for number in count(1):
        parameter = group.get(name if number == 1 else f"{name}{number}")
        if parameter is None:
            return [text.strip() for text in found]
        found += parameter["value"]
    raise AssertionError


def _names(path: Path, group: Any, what: str, number: int) -> list[str]:
    """Return the names of a number of columns; empty ones at the end may be missing or too many."""
    labels = texts(group, "LABELS")
    while len(labels) > number and not labels[-1]:
        labels.pop()
    if len(labels) != number:
        raise UsageError(
            f"{path} has {number} {what}, and names {len(labels)} (LABELS): which column has which name is not known"
        )
    return labels


def _point_units(point: Any, labels: list[str]) -> list[str]:
    """Return the unit that the file states of each point; empty if it does not tell markers and results apart."""
    kinds = {kind: texts(point, kind) for kind in _KINDS}
    of_results = {
        label: first_text(point, f"{kind[:-1]}_UNITS")
        for kind, listed in kinds.items()
        for label in listed
    }
    of_markers = first_text(point, "UNITS") if of_results else ""
    return [of_results.get(label, of_markers) for label in labels]


def at_frames(analogs: Floats, rows: int) -> Floats:
    """Return analog channels, shape (channels, samples), at the times of `rows` frames, averaged over two frames each.

    So hum and what else is faster than frames can show does not become an offset. A mean over a frame before and one
    after has no hum of the frames' rate, of half of it, or of multiples; it is not late.
    """
    each = analogs.shape[1] // rows
    if each < 2:
        return analogs[:, :rows]
    weights = np.ones(2 * each + 1)
    weights[[0, -1]] = 0.5
    weights /= weights.sum()
    wide = np.pad(analogs, ((0, 0), (each, each)), mode="edge")
    return np.array([np.convolve(channel, weights, "valid")[::each][:rows] for channel in wide])
