"""From a laboratory's own sensors to a gait bag (`knee-contact import-csv`), by a map of their columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..joint_reaction.leg import GRAVITY
from ..model.types import Floats, Stamps
from ..streams.topics import NANOSECONDS, NET_LOAD
from ..system.errors import UsageError, list_names, suggest
from ..system.output_files import work_folder
from . import checks, gait_bag
from .c3d import c3d_mass
from .cells import DAY
from .events import with_events
from .gait_bag import ImportedGait, Signal
from .headers import Header, header_of
from .plates import Plates, ground_channels
from .sensor_map import (
    GROUND_CHANNELS,
    IMPORTED,
    JOINT_CHANNELS,
    AngleChannel,
    MapChannel,
    SensorMap,
    read_map,
)
from .tables import Table, TimeColumn, TimeSeries, is_time, read_columns
from .units import (
    ColumnName,
    Dimension,
    check_unit,
    unit_factor,
    unit_name,
)


def run_import_csv(
    files: Sequence[Path],
    maps: Sequence[Path],
    output: Path,
    overwrite: bool,
    anyway: bool,
    events: str,
) -> None:
    """Import files into the bag `output` by maps, later ones overriding earlier ones, and print a summary.

    For `events` see `with_events`.

    Raises:
        UsageError: a file, the map or the output cannot be used, or the values are impossible for a knee; without
            `anyway` also if they are unlikely. Nothing is written then.
    """
    sensors = read_map(maps)
    if not (sensors.load or sensors.ground_force or sensors.plates or sensors.net_force):
        raise UsageError(
            f"map {maps[-1]}: load: is missing, or ground_force:, plates: or net_force: for estimate-load; only align "
            "needs none"
        )
    gait_bag.check_bag_output(output, overwrite)
    sensors, about_mass, unlike = _with_weight(sensors, files)
    channels = read_channels(files, sensors, IMPORTED)
    channels = _with_thigh(channels)
    if sensors.plates:
        channels |= _of_plates(files, sensors.plates, sensors)
    checks.refuse(unlike, anyway)
    doubts = [*unlike, *_check_channels(channels, sensors, anyway)]
    gait = with_events(_gait_of(channels, sensors), events, anyway, files, sensors.time.offset)
    likely = checks.convention_doubts(gait, sensors.body_weight)
    checks.refuse(likely, anyway)
    notes = [*about_mass, *gait.notes]
    gait = gait._replace(notes=notes, doubts=[*doubts, *likely, *gait.doubts])
    used = {f"file {number}": path for number, path in enumerate(files, start=1)}
    record = {"map": sensors.model_dump_json(exclude_defaults=True)}
    with work_folder(output.parent) as work:
        gait_bag.store({output: gait}, "CSV", used, record, work)


def _with_weight(
    sensors: SensorMap, files: Sequence[Path]
) -> tuple[SensorMap, list[str], list[str]]:
    """Return the map with a C3D file's body weight, if it has none; also notes, and a doubt if they differ."""
    for path in files:
        mass = c3d_mass(path) if path.suffix.lower() == ".c3d" else None
        if mass is None:
            continue
        weight = mass * GRAVITY
        if sensors.body_weight is None:
            note = f"body weight {weight:.1f} N: {mass:.1f} kg of {path.name}"
            return sensors.model_copy(update={"body_weight": weight}), [note], []
        what = f"the ratio of its {mass:.1f} kg to the map's body_weight"
        ratio = weight / sensors.body_weight
        return sensors, [], checks.outside(path, what, ratio, "", (0.9, 1.1), "is it in N?")
    return sensors, [], []


def _with_thigh(channels: dict[str, TimeSeries]) -> dict[str, TimeSeries]:
    """Take the pelvis' tilt off the hip's angle, which becomes that of the thigh to the vertical."""
    if "pelvis" not in channels:
        return channels
    channels = dict(channels)
    pelvis, hip = channels.pop("pelvis"), channels["hip"]
    tilt = _signal(pelvis).at(hip.stamps).values[:, 0]
    columns = f"{hip.columns} - {pelvis.columns}"
    notes = (*hip.notes, *pelvis.notes)
    thigh = hip._replace(columns=columns, values=hip.values - tilt, notes=notes)
    return {**channels, "hip": thigh}


def _of_plates(files: Sequence[Path], plates: Plates, sensors: SensorMap) -> dict[str, TimeSeries]:
    """Read the ground's wrench on the foot from the force plates of the one C3D file.

    Raises:
        UsageError: there is no such file, or more than one; see `ground_channels`.
    """
    named = [
        path
        for path in files
        if path.suffix.lower() == ".c3d" and fnmatchcase(path.name, plates.file or "*")
    ]
    if len(named) != 1:
        raise UsageError(
            f"map: plates: {len(named)} C3D files are given; say which with plates.file"
        )
    return ground_channels(named[0], plates, sensors.side, GROUND_CHANNELS, sensors.time.offset)


def _check_channels(
    channels: dict[str, TimeSeries], sensors: SensorMap, anyway: bool
) -> list[str]:
    """List what may be a mistake.

    Raises:
        UsageError: the values are impossible for a leg, or likely a mistake and `anyway` is not given.
    """
    load = channels.get("load")
    ground = channels.get("ground_force")
    weight = sensors.body_weight
    for name in JOINT_CHANNELS:
        if name in channels:
            checks.refuse(checks.impossible(channels[name], load))
    unit = sensors.load.unit if sensors.load else None
    doubts = list(dict.fromkeys(doubt for series in channels.values() for doubt in series.doubts))
    doubts += checks.gait_doubts(
        channels["angle"], load, unit, weight, sensors.max_gap, channels.get("moment")
    )
    for name, series in channels.items():
        if name in {"hip", "ankle"}:
            doubts += checks.joint_doubts(series)
        elif "assistance" in name:
            doubts += checks.torque_doubts(series)
    if ground:
        checks.check_upright(ground.values, ground.where)
        unit = sensors.ground_force.unit if sensors.ground_force else None
        doubts += checks.peak_doubts(ground, unit, weight, *checks.GROUND_PEAKS)
    if sensors.net_force:
        net = channels["net_force"], channels["net_moment"]
        doubts += checks.net_doubts(*net, sensors.net_force.unit, weight)
    checks.refuse(doubts, anyway)
    return doubts + (checks.unusual(load, weight) if load else [])


def read_channels(
    files: Sequence[Path], sensors: SensorMap, wanted: Sequence[str]
) -> dict[str, TimeSeries]:
    """Read the channels that are `wanted` and in the map; return them by name.

    Raises:
        UsageError: a unit is wrong, a file cannot be read, or a column is missing, in several files, or not numeric.
    """
    channels: dict[str, MapChannel] = {
        name: each for name in wanted if (each := getattr(sensors, name, None)) is not None
    }
    factors = {
        name: unit_factor(each.unit, _dimension(name), f"map: {name}", sensors.body_weight)
        for name, each in channels.items()
    }
    timings = {name: each.time or sensors.time for name, each in channels.items()}
    columns = [column for each in channels.values() for column in each.weights]
    columns += [column for timing in timings.values() for column in timing.places]
    headers = {path: header_of(path, columns, sensors.table) for path in files}
    homes = {name: _file_of(channel, name, headers) for name, channel in channels.items()}
    parts: dict[_Part, list[ColumnName]] = {}
    part_of = {}
    for name, path in homes.items():
        weights = channels[name].weights
        timing = _nearest_time(headers[path], timings[name], weights)
        part = _Part(
            path, timing.model_dump_json(exclude_unset=True), channels[name].time is not None
        )
        part_of[name] = part
        parts.setdefault(part, []).extend(weights)
    read = {
        part: read_columns(
            headers[part.path], list(dict.fromkeys(needed)), part.timing, sensors.table
        )
        for part, needed in parts.items()
    }
    # Frames of a channel with a time of its own count from their own first row.
    frames = [part for part in read if part.is_own and part.timing.rate]
    others = {part: table for part, table in read.items() if part not in frames}
    clocks = {table.day is None for table in others.values()}
    if len(clocks) > 1 or (
        len({part.path for part in others}) > 1 and not all(part.timing.places for part in others)
    ):
        raise UsageError(
            f"{' and '.join(part.path.name for part in others)} must have times of one clock, but only some count "
            "rows or frames, or give the time of day; give each channel its own time, or put all into one file"
        )
    shifted = _on_one_clock(others, round(sensors.time.offset * NANOSECONDS))
    for part in frames:
        offset = round(part.timing.offset * NANOSECONDS)
        shifted |= _on_one_clock({part: read[part]}, offset)
    leave_out = sensors.missing == "leave_out"
    return {
        name: _series(name, each, shifted[part_of[name]], factors[name], leave_out)
        for name, each in channels.items()
    }


class _Part(NamedTuple):
    """Columns of a file that have one time."""

    path: Path
    time: str
    """`TimeColumn` as JSON"""
    is_own: bool
    """Whether it is a channel's own time"""

    @property
    def timing(self) -> TimeColumn:
        """Where the time is."""
        return TimeColumn.model_validate_json(self.time)


def _nearest_time(
    header: Header, timing: TimeColumn, columns: Mapping[ColumnName, float]
) -> TimeColumn:
    """Return the time of columns: of several time columns with one name, the next one to their left is theirs."""
    if header.entries is not None or header.data is not None or not timing.places:
        return timing
    places = header.places(timing.column)
    for names in (header.names, *header.above):
        same = [
            place for place in range(len(names)) if places and names[place] == names[places[0]]
        ]
        first = min((place for each in columns for place in header.places(each)), default=0)
        left = [place for place in same if place < first]
        if left and same[1:] and is_time(names[left[0]]):
            return timing.model_copy(update={"column": left[-1] + 1})
    return timing


def _on_one_clock(read: dict[_Part, Table], offset: int) -> dict[_Part, Table]:
    """Shift frames and times of day so that the first is at `offset` [ns]; undated files must begin within a day."""
    first = next(iter(read.values()), None)
    if first is None or first.day is None:
        return read
    stamps = {}
    for part, table in read.items():
        if isinstance(table.day, int) and isinstance(first.day, int):
            days = table.day - first.day
        else:
            days = round(int(first.stamps[0] - table.stamps[0]) / (DAY * NANOSECONDS))
            if not days and table.day and first.day and table.day != first.day:
                raise UsageError(
                    f"{first.path.name} begins on {first.day}, and {table.path.name} on {table.day}: "
                    "are they of one trial? Dates are compared where all are written as 2026-11-27"
                )
        stamps[part] = table.stamps + round(days * DAY) * NANOSECONDS
    shift = offset - min(int(each[0]) for each in stamps.values())
    return {part: table._replace(stamps=stamps[part] + shift) for part, table in read.items()}


def _dimension(name: str) -> Dimension:
    """Return the dimension of a channel."""
    if name in {*JOINT_CHANNELS, "pelvis", "reference"}:
        return "angle"
    return (
        "moment" if any(part in name for part in ("moment", "torque", "assistance")) else "force"
    )


def _file_of(channel: MapChannel, name: str, headers: dict[Path, Header]) -> Path:
    """Find the one file that has a channel's columns, by their names."""
    named = {
        path: header
        for path, header in headers.items()
        if fnmatchcase(path.name, channel.file or "*")
    }
    if not named:
        given = ", ".join(path.name for path in headers)
        raise UsageError(
            f"map: {name}.file: no file is named as {channel.file}; given are {given}"
        )
    missing = {
        path: [each for each in channel.weights if not header.places(each)]
        for path, header in named.items()
    }
    homes = [path for path, lacking in missing.items() if not lacking]
    if len(homes) > 1:
        both = " and ".join(path.name for path in homes)
        columns = ", ".join(map(str, channel.weights))
        raise UsageError(f"map: {name}: {both} both have {columns}; say which with {name}.file")
    if not homes:
        column = min(missing.values(), key=len)[0]
        names = [each for header in named.values() for each in header.names]
        hint = suggest(str(column), names, f"it has {list_names(names)}")
        where = " and ".join(map(str, named))
        raise UsageError(f"{where} has no column {column} (map: {name}); {hint}")
    return homes[0]


def _series(
    name: str, channel: MapChannel, table: Table, to_si: float, leave_out: bool
) -> TimeSeries:
    """Sum the columns of a channel, in SI units and our sign; `leave_out` drops rows without a number."""
    if _dimension(name) == "angle" and table.degrees is not None:
        stated, entry = ("deg", "yes") if table.degrees else ("rad", "no")
        if unit_name(channel.unit) in {"deg", "rad"} - {stated}:
            raise UsageError(
                f"{table.path} says inDegrees={entry}, and map: {name}.unit {channel.unit}"
            )
    notes = [*table.notes]
    if table.day is not None:
        notes.append("times count from the first row")
    multiplier = max(map(abs, channel.weights.values())) * channel.scale
    what = f"map: {name}.unit"
    for column in channel.weights:
        notes += check_unit(
            table.path,
            column,
            table.units.get(column, ""),
            channel.unit,
            what,
            multiplier=multiplier,
        )
    places = [table.names.index(str(column)) for column in channel.weights]
    finite = np.isfinite(table.values[:, places])
    complete = np.asarray(finite.all(axis=1))
    rows = len(complete)
    lost = np.count_nonzero(~complete)
    if lost and not leave_out:
        row = int(np.argmin(complete))
        lacking = table.names[places[int(np.argmin(finite[row]))]]
        raise UsageError(
            f"{table.path}: column {lacking} has no number at {table.stamps[row] / NANOSECONDS:.13g} s, and in {lost} "
            f"of {rows} rows something is missing; map: missing: leave_out leaves such rows out"
        )
    if rows - lost < 2:
        raise UsageError(
            f"{table.path} has {rows - lost} row with numbers for {name}; a signal over time needs two"
        )
    if lost:
        notes.append(f"{name}: {lost} of {rows} rows left out, as a number is missing")
    factor = to_si * channel.scale * channel.orientation
    stamps = table.stamps[complete]
    columns = table.values[complete][:, places]
    doubts = table.doubts
    if isinstance(channel, AngleChannel) and channel.orientations:
        values, doubts = _flexion(table, stamps, columns, channel.orientations.standing)
        values *= factor
    else:
        values = (columns @ [*channel.weights.values()]) * factor
    terms = (
        str(column) if weight == 1.0 else f"{weight:g} {column}"
        for column, weight in channel.weights.items()
    )
    if channel.offset:
        values += to_si * channel.offset
        notes.append(f"{name}: {channel.offset:g} {channel.unit} added (offset)")
    return TimeSeries(name, table.path, " + ".join(terms), stamps, values, tuple(notes), doubts)


def _flexion(
    table: Table, stamps: Stamps, columns: Floats, standing: float
) -> tuple[Floats, tuple[str, ...]]:
    """Return the flexion [rad] of quaternions of thigh and shank, w, x, y, z each, and doubts about it.

    `standing` is the time [s] of standing at the beginning.

    Raises:
        UsageError: a row is no quaternion, or the person does not stand still.
    """
    from ..streams.orientations import KneeRotation, rotations, standing_pose

    try:
        thigh, shank = (rotations(columns[:, first + np.array([1, 2, 3, 0])]) for first in (0, 4))
    except ValueError as error:
        raise UsageError(f"{table.path}: {error}, w last (map: angle.orientations)") from None
    turned = thigh.inv() * shank
    first = stamps <= stamps[0] + standing * NANOSECONDS
    zero, fault = standing_pose(turned[first]) if standing else (turned[:1] * turned[:1].inv(), "")
    if fault:
        raise UsageError(
            f"{table.path}: in the first {standing:g} s {fault} (map: angle.orientations.standing)"
        )
    knee = KneeRotation()
    angles = knee.flexion(turned, zero)
    return angles, (
        *table.doubts,
        *filter(None, [f"{table.path}: {knee.doubt}" * bool(knee.doubt)]),
    )


def _gait_of(channels: dict[str, TimeSeries], sensors: SensorMap) -> ImportedGait:
    """Combine angles, reactions and ground forces over the time that all channels cover.

    Raises:
        UsageError: there is no such time, or fewer than two samples are left.
    """
    signals = {name: _signal(series) for name, series in channels.items()}
    of_plates = GROUND_CHANNELS if sensors.plates else ()
    gap = sensors.max_gap
    joints = {
        sensors.angle.joint if angle == "angle" else angle: [
            signals[name] for name in (angle, torque) if name in signals
        ]
        for angle, torque in JOINT_CHANNELS.items()
        if angle in signals
    }
    wrenches = {}
    for name, force, parts, unknown in (
        ("load", "load", ("", "load", "", "moment", "", ""), 0.0),
        (NET_LOAD, "net_force", ("", "net_force", "", "", "", "net_moment"), np.nan),
    ):
        if force in channels:
            wrench = _wrench(channels, parts, force, unknown, gap)
            upwards = np.array([1.0, -1.0, 1.0, 1.0, 1.0, 1.0])
            # Adding 0 makes minus 0 a 0.
            wrenches[name] = wrench._replace(values=wrench.values * upwards + 0.0)
    if "ground_force" in channels:
        wrenches["ground_force"] = _wrench(channels, GROUND_CHANNELS, "ground_force", np.nan, gap)
    # Angles are kept for a second before and after the loads, as long as `pairing.angle_delay` can be.
    gait = gait_bag.sampled(
        sensors.side,
        joints,
        wrenches,
        {name: each for name, each in signals.items() if name not in of_plates},
        rate=sensors.rate,
        max_gap=gap,
        beyond=NANOSECONDS,
    )
    notes = dict.fromkeys(note for series in channels.values() for note in series.notes)
    columns = {
        name: f"{series.columns} of {series.path.name}" for name, series in channels.items()
    }
    return gait._replace(notes=[*notes, *gait.notes], columns=columns, weight=sensors.body_weight)


def _wrench(
    channels: dict[str, TimeSeries],
    parts: Sequence[str],
    main: str,
    unknown: float,
    max_gap: float,
) -> Signal:
    """Make a wrench from the channels `parts` at the stamps of channel `main`; missing channels become `unknown`.

    Stamps in gaps of a part longer than `max_gap` [s] are left out.
    """
    stamps = channels[main].stamps
    known = [channels[name].stamps for name in parts if name in channels]
    stamps = stamps[np.all([gait_bag.bridged(stamps, each, max_gap) for each in known], axis=0)]
    if len(stamps) < 2:
        raise UsageError(
            f"{channels[main].where}: all but {len(stamps)} rows lie in gaps of another channel of this "
            f"wrench that are longer than {max_gap:g} s (map: max_gap)"
        )
    missing = np.full((len(stamps), 1), unknown)
    columns = [
        _signal(channels[name]).at(stamps).values if name in channels else missing
        for name in parts
    ]
    return Signal(stamps, np.hstack(columns))


def _signal(series: TimeSeries) -> Signal:
    return Signal(series.stamps, series.values[:, None])
