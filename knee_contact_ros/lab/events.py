"""Gait events that a laboratory has: of the group EVENT of a C3D file, of a table, or given as times."""

import csv
from collections.abc import Iterable, Sequence
from itertools import cycle, islice, pairwise
from pathlib import Path

import numpy as np

from ..streams.gait_events import HEEL_STRIKE, NEARBY, TOE_OFF, GaitEvent, GaitEvents
from ..streams.topics import NANOSECONDS, NET_LOAD
from ..system.errors import UsageError, list_names
from ..system.files import is_file
from . import checks
from .c3d import LegEvent, c3d_events, events_of_leg, read_c3d
from .cells import parse_number
from .gait_bag import ImportedGait
from .headers import TableFormat, each_line, header_of
from .units import TYPICAL_BODY_WEIGHT

_LEFT_OUT = 900_000_000
"""Distance [ns] from which an event is one that nobody marked, a stride away; the other leg's is half a stride away"""
_COLUMNS = (("time",), ("name", "event", "label", "kind"), ("context", "side", "leg"))
"""Beginnings of the names of a table's columns: time [s], event, leg"""
_NEAR = 150_000_000
"""Largest time [ns] between an event and the one that angle and load show; in seven laboratories' files it is 61 ms"""


def with_events(
    gait: ImportedGait, given: str, anyway: bool, files: Sequence[Path] = (), offset: float = 0.0
) -> ImportedGait:
    """Return a gait with the events of its leg: the `given` ones, or those of the C3D files among `files`.

    `given` names a table or a C3D file, or is times [s] of heel strike, toe-off, heel strike and so on. `offset` [s] is
    added to all times.

    Raises:
        UsageError: the given events cannot be read, or none is within the data; or the load contradicts the events and
            `anyway` is not given.
    """
    if given:
        path = Path(given)
        found, notes = _of_file(path, gait.side) if is_file(path) else (_of_times(given), [])
    else:
        found, notes = [], []
        for path in files:
            if path.suffix.lower() == ".c3d":
                more, about = _of_file(path, gait.side)
                found, notes = found + more, notes + about
    events = sorted(
        GaitEvent(round((time + offset) * NANOSECONDS), kind, kind) for time, kind in found
    )
    name = next(name for name in ("load", "ground_force", NET_LOAD) if name in gait.wrenches)
    stamps = gait.wrenches[name].stamps
    first, last = int(stamps[0]) - NEARBY, int(stamps[-1]) + NEARBY
    inside = [event for event in events if first <= event.stamp <= last]
    if given and not inside:
        begin, end = stamps[[0, -1]] / NANOSECONDS
        raise UsageError(f"--events {given}: none is within the data, {begin:g} to {end:g} s")
    if events:
        counts = [sum(event.kind == kind for event in inside) for kind in (HEEL_STRIKE, TOE_OFF)]
        outside = len(events) - len(inside)
        notes.append(
            f"gait events: heel strikes {counts[0]}, toe-offs {counts[1]}"
            + f" ({outside} more outside the data)" * bool(outside)
        )
    doubts = _contradictions(inside, _shown(gait, name)) if inside else []
    checks.refuse(doubts, anyway)
    return gait._replace(
        events=inside, notes=[*gait.notes, *notes], doubts=[*gait.doubts, *doubts]
    )


def _shown(gait: ImportedGait, name: str) -> list[GaitEvent]:
    """Return the events that the angle and a wrench of a gait show."""
    stamps, wrench = gait.wrenches[name]
    angles = next(iter(gait.joints.values())).at(stamps).values[:, 0]
    upwards = 1.0 if name == "ground_force" else -1.0
    finder = GaitEvents(gait.weight or TYPICAL_BODY_WEIGHT)
    return finder.add_samples(stamps, angles, upwards * wrench[:, 1]) + finder.finish_events()


def _contradictions(events: Sequence[GaitEvent], shown: Iterable[GaitEvent]) -> list[str]:
    """Doubt about events if angle and load have one of their kinds in between that is not among them."""
    for each in shown:
        away = min((abs(e.stamp - each.stamp) for e in events if e.kind == each.kind), default=0)
        covered = events[0].stamp - _NEAR <= each.stamp <= events[-1].stamp + _NEAR
        if covered and _NEAR < away < _LEFT_OUT:
            return [
                f"angle and load show a {each.kind} at {each.stamp / NANOSECONDS:.3f} s, but the nearest of the gait "
                f"events is {away / NANOSECONDS:.2f} s away: are they of this leg, and of this clock (--events)?"
            ]
    return []


def _of_times(given: str) -> list[LegEvent]:
    """Return events from times [s], which begin with a heel strike.

    Raises:
        UsageError: these are not increasing times.
    """
    try:
        times = [float(text) for text in given.split(",")]
    except ValueError:
        times = []
    if not times or not np.isfinite(times).all() or any(b <= a for a, b in pairwise(times)):
        raise UsageError(
            f"--events {given}: no such file, and no increasing times [s] of heel strike, toe-off, heel strike, as "
            "0.12,0.78,1.24"
        )
    return list(zip(times, cycle([HEEL_STRIKE, TOE_OFF]), strict=False))


def _of_file(path: Path, side: str) -> tuple[list[LegEvent], list[str]]:
    """Return the events of a leg in a C3D file or a table, and notes."""
    if path.suffix.lower() == ".c3d":
        return c3d_events(path, read_c3d(path), side)
    return events_of_leg(_of_table(path, side), side), []


def _of_table(path: Path, side: str) -> list[tuple[float, str, str]]:
    """Return time [s], label and leg of events in a text table; without a column of the leg all are of `side`.

    Raises:
        UsageError: it cannot be read, or has no columns of times and events.
    """
    header = header_of(path, ("time", "Time", "Time (s)", "Name"), TableFormat())
    places = [
        next((n for n, name in enumerate(header.names) if name.lower().startswith(words)), None)
        for words in _COLUMNS
    ]
    if None in places[:2]:
        raise UsageError(
            f"{path}: gait events need the columns time [s] and event, and side if both legs are in it; it has "
            f"{list_names(header.names)}"
        )
    found = []
    lines = islice(each_line(header.text), header.line, None)
    for cells in csv.reader(lines, delimiter=header.delimiter):
        if len(cells) < len(header.names):
            break  # another table follows
        time, label, leg = (side if place is None else cells[place].strip() for place in places)
        try:
            found.append((parse_number(time, "", thousands=False), label, leg))
        except ValueError:
            raise UsageError(f"{path}: {time} is no time [s] of an event") from None
    return found
