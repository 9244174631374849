"""From a laboratory's own sensors to a gait bag (`knee-contact import-csv`), by a map of their columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, ValidationError, model_validator

from knee_contact_ros.lab import checks, gait_bag, tables
from knee_contact_ros.lab.gait_bag import Gait, Signal
from knee_contact_ros.lab.tables import DAY, Column, Header, Series, Table
from knee_contact_ros.parameters.files import first_error
from knee_contact_ros.parameters.schema import Section, one_of
from knee_contact_ros.streams.topics import NANOSECONDS
from knee_contact_ros.system.errors import UsageError, list_names, suggest
from knee_contact_ros.system.files import find_file, read_mapping
from knee_contact_ros.system.output_files import work_folder

BEYOND = NANOSECONDS
"""Time [ns] before and after the loads for which angles are kept: as long as `pairing.angle_delay` can be"""
GROUND = (
    "ground_force_x",
    "ground_force",
    "ground_force_z",
    "ground_torque_x",
    "ground_torque_y",
    "ground_torque_z",
)
"""Channels of the ground's wrench in the order of its components; an insole has only the second"""
ANGLES, TORQUES = ("angle", "hip", "ankle"), ("assistance", "", "ankle_assistance")
"""Channels of joint angles, and of actuator torques"""
IMPORTED = (*ANGLES, *filter(None, TORQUES), "load", "moment", *GROUND)


class Channel(Section):
    """A column, or a weighted sum of columns, of one file."""

    column: Column | None = Field(None, description="name, or place from 1")
    columns: dict[Column, float] | None = Field(
        None, min_length=1, description="names or places, with weights"
    )
    unit: str = Field(description="of the sum")
    scale: float = Field(1.0, description="which the sum is multiplied by, as a calibration says")
    offset: float = Field(
        0.0, description="in `unit`, added at the end, behind scale, sign and direction"
    )
    file: str = Field(
        "",
        description="pattern of the file's name, like *_motion.csv, if several have such columns",
    )

    @model_validator(mode="after")
    def _one_way(self) -> Channel:
        if (self.column is None) == (self.columns is None):
            raise ValueError("allowed: either column or columns")
        if self.scale == 0.0 or not any(self.weights.values()):
            raise ValueError("allowed: a scale and at least one weight that are not 0")
        return self

    @property
    def weights(self) -> dict[Column, float]:
        """Weights by the names or places of the columns."""
        return self.columns or ({} if self.column is None else {self.column: 1.0})

    @property
    def turned(self) -> float:
        """Factor, 1 or -1, that converts the quantity to our sign."""
        return (
            -1.0
            if getattr(self, "direction", "") == "tension"
            else float(getattr(self, "sign", 1.0))
        )


class SignedChannel(Channel):
    """Angle of a joint, torque of its actuator, or a component of the ground's wrench."""

    sign: Annotated[float, one_of(1.0, -1.0)] = Field(
        1.0, description="1 if it is positive as ours is, or -1"
    )


class AngleChannel(SignedChannel):
    """Flexion angle of the knee."""

    joint: str = Field(gait_bag.JOINT, min_length=1, description="name in joint_states")


class LoadChannel(Channel):
    """Axial load of the knee: the force that the femur exerts on the tibia, along the tibia."""

    direction: Annotated[str, one_of("compression", "tension")] = Field(
        "compression",
        description="what a positive sum is; tension: as force.y of OpenSim's reaction on the tibia",
    )


class SensorMap(Section):
    """Content of a map."""

    table: tables.TableFormat = tables.TableFormat()
    time: tables.TimeColumn = tables.TimeColumn()
    angle: AngleChannel = Field(description="knee, positive in flexion")
    hip: SignedChannel | None = Field(
        None, description="thigh to the vertical, positive with the knee ahead"
    )
    ankle: SignedChannel | None = Field(
        None, description="positive in dorsiflexion, 0 at a right angle"
    )
    assistance: SignedChannel | None = Field(
        None, description="torque of an actuator at the knee, in its angle's sense"
    )
    ankle_assistance: SignedChannel | None = Field(
        None, description="torque at the ankle, in its angle's sense"
    )
    reference: AngleChannel | None = Field(
        None, description="the angle that align compares `angle` with"
    )
    load: LoadChannel | None = None
    moment: Channel | None = Field(
        None,
        description="frontal moment about the middle of the plateau; > 0 loads the lateral compartment more",
    )
    ground_force: SignedChannel | None = Field(
        None, description="vertical force of the ground on the foot, upwards"
    )
    ground_force_x: SignedChannel | None = Field(None, description="forwards")
    ground_force_z: SignedChannel | None = Field(None, description="to the right")
    ground_torque_x: SignedChannel | None = Field(
        None, description="about the ankle's centre, forwards"
    )
    ground_torque_y: SignedChannel | None = Field(
        None, description="about the ankle's centre, upwards"
    )
    ground_torque_z: SignedChannel | None = Field(
        None, description="about the ankle's centre, to the right"
    )
    side: Annotated[str, one_of("right", "left")] = "right"
    body_weight: float | None = Field(None, gt=0.0, le=1e5, description="[N]")
    rate: float = Field(
        0.0, ge=0.0, le=1e4, description="[Hz] of interpolation; 0: every row keeps its stamp"
    )
    max_gap: float = Field(
        0.1,
        gt=0.0,
        le=3600.0,
        description="[s] between rows, beyond which nothing is interpolated",
    )
    missing: Annotated[str, one_of("refuse", "leave_out")] = Field(
        "refuse",
        description="what to do with a row that has no number (empty, NaN) where one is needed",
    )

    @model_validator(mode="after")
    def _complete(self) -> SensorMap:
        parts = {
            "ankle_assistance": "ankle",
            "moment": "load",
            **dict.fromkeys(GROUND, "ground_force"),
        }
        for name, whole in parts.items():
            if getattr(self, name) is not None and getattr(self, whole) is None:
                raise ValueError(f"{name} needs {whole}")
        return self


def import_csv(
    files: Sequence[Path], maps: Sequence[Path], output: Path, overwrite: bool, anyway: bool
) -> None:
    """Import files into the bag `output` by maps, later ones overriding earlier ones, and print a summary.

    Raises:
        UsageError: a file, the map or the output cannot be used, or the values are impossible for a knee; without
            `anyway` also if they are unlikely. Nothing is written then.
    """
    sensors = read_map(maps)
    if not (sensors.load or sensors.ground_force):
        raise UsageError(
            f"map {maps[-1]}: load: is missing, or ground_force: for estimate-load; only align needs none"
        )
    gait_bag.check_output(output, overwrite)
    channels = read_channels(files, sensors, IMPORTED)
    doubts = check(channels, sensors, anyway)
    gait = gait_of(channels, sensors)._replace(doubts=doubts)
    used = {f"file {number}": path for number, path in enumerate(files, start=1)}
    with work_folder(output.parent) as work:
        gait_bag.store(
            {output: gait},
            "CSV",
            used,
            {"map": sensors.model_dump_json(exclude_defaults=True)},
            work,
        )


def check(channels: dict[str, Series], sensors: SensorMap, anyway: bool) -> list[str]:
    """List what may be a mistake.

    Raises:
        UsageError: the values are impossible for a leg, or likely a mistake and `anyway` is not given.
    """
    load, ground, weight = channels.get("load"), channels.get("ground_force"), sensors.body_weight
    for name in ANGLES:
        if name in channels:
            checks.refuse(checks.impossible(channels[name], load))
    unit = sensors.load.unit if sensors.load else None
    doubts = list(dict.fromkeys(doubt for series in channels.values() for doubt in series.doubts))
    doubts += checks.doubts(
        channels["angle"], load, unit, weight, sensors.max_gap, channels.get("moment")
    )
    for name in (*ANGLES[1:], *TORQUES):
        if name in channels:
            doubts += checks.joint_doubts(channels[name], is_torque=name in TORQUES)
    if ground and sensors.ground_force:
        checks.check_upright(ground.values, ground.where)
        doubts += checks.peak_doubts(ground, sensors.ground_force.unit, weight, *checks.OF_GROUND)
    checks.refuse(doubts, anyway)
    return doubts + (checks.unusual(load, weight) if load else [])


def read_map(paths: Sequence[Path]) -> SensorMap:
    """Read a map from YAML files, later ones overriding earlier ones; shipped maps may be given by their short names.

    Raises:
        UsageError: a file cannot be read, or has a name or value that is not allowed.
    """
    content: dict[str, Any] = {}
    for path in paths:
        shipped = find_file(f"maps/{path}.yaml")
        own = read_mapping(
            shipped if not path.exists() and shipped.exists() else path, "map", "names to values"
        )
        for name, value in own.items():
            before = content.get(name)
            merged = isinstance(before, Mapping) and isinstance(value, Mapping)
            content[name] = {**before, **value} if merged else value  # type: ignore[dict-item]
    try:
        return SensorMap.model_validate(content)
    except ValidationError as error:
        raise UsageError(f"map {paths[-1]}: {first_error(error)}{_meant(error)}") from None


def _meant(error: ValidationError) -> str:
    """Suggest the name that is closest to an unknown one; empty for other errors."""
    first, sections = (
        error.errors()[0],
        (SensorMap, tables.TableFormat, tables.TimeColumn, AngleChannel, LoadChannel),
    )
    if first["type"] != "extra_forbidden":
        return ""
    return f"; {suggest(str(first['loc'][-1]), [name for section in sections for name in section.model_fields])}"


def read_channels(
    files: Sequence[Path], sensors: SensorMap, wanted: Sequence[str]
) -> dict[str, Series]:
    """Read the channels that are `wanted` and in the map; return them by name.

    Raises:
        UsageError: a unit is wrong, a file cannot be read, or a column is missing, in several files, or not numeric.
    """
    channels: dict[str, Channel] = {
        name: each for name in wanted if (each := getattr(sensors, name, None)) is not None
    }
    factors = {
        name: tables.factor(each.unit, _kind(name), f"map: {name}", sensors.body_weight)
        for name, each in channels.items()
    }
    columns = [
        *sensors.time.places,
        *(column for each in channels.values() for column in each.weights),
    ]
    headers = {path: tables.header_of(path, columns, sensors.table) for path in files}
    homes = {name: _home(channel, name, headers) for name, channel in channels.items()}
    read: dict[Path, Table] = {}
    for path in dict.fromkeys(homes.values()):
        needed = [
            column
            for name, home in homes.items()
            if home == path
            for column in channels[name].weights
        ]
        read[path] = tables.read_columns(
            headers[path], list(dict.fromkeys(needed)), sensors.time, sensors.table
        )
    if len({table.day is None for table in read.values()}) > 1 or (
        len(read) > 1 and not sensors.time.places
    ):
        raise UsageError(
            f"{' and '.join(path.name for path in read)} must have times of one clock, but only some count rows or "
            "frames, or give the time of day; put all channels into one file"
        )
    read = _on_one_clock(read, round(sensors.time.offset * NANOSECONDS))
    leave_out = sensors.missing == "leave_out"
    return {
        name: _series(name, each, read[homes[name]], factors[name], leave_out)
        for name, each in channels.items()
    }


def _on_one_clock(read: dict[Path, Table], offset: int) -> dict[Path, Table]:
    """Shift frames and times of day so that the first is at `offset` [ns]; undated files must begin within a day."""
    first = next(iter(read.values()))
    if first.day is None:
        return read
    stamps = {}
    for path, table in read.items():
        if isinstance(table.day, int) and isinstance(first.day, int):
            days = table.day - first.day
        else:
            days = round(int(first.stamps[0] - table.stamps[0]) / (DAY * NANOSECONDS))
            if not days and table.day and first.day and table.day != first.day:
                raise UsageError(
                    f"{first.path.name} begins on {first.day}, and {path.name} on {table.day}: are they of one trial? "
                    "Dates are compared where all are written as 2026-11-27"
                )
        stamps[path] = table.stamps + round(days * DAY) * NANOSECONDS
    begin = min(int(each[0]) for each in stamps.values())
    return {
        path: table._replace(stamps=stamps[path] - begin + offset) for path, table in read.items()
    }


def _kind(name: str) -> str:
    """Quantity of a channel."""
    if name in (*ANGLES, "reference"):
        return tables.ANGLE
    return (
        tables.MOMENT
        if name == "moment" or "torque" in name or "assistance" in name
        else tables.FORCE
    )


def _home(channel: Channel, name: str, headers: dict[Path, Header]) -> Path:
    """Find the one file that has a channel's columns, by their names."""
    named = {
        path: header
        for path, header in headers.items()
        if fnmatchcase(path.name, channel.file or "*")
    }
    lacking = {
        path: [each for each in channel.weights if not header.places(each)]
        for path, header in named.items()
    }
    homes = [path for path, missing in lacking.items() if not missing]
    if len(homes) == 1:
        return homes[0]
    if homes:
        both, columns = (
            " and ".join(path.name for path in homes),
            ", ".join(map(str, channel.weights)),
        )
        raise UsageError(f"map: {name}: {both} both have {columns}; say which with {name}.file")
    if not named:
        given = ", ".join(path.name for path in headers)
        raise UsageError(
            f"map: {name}.file: no file is named as {channel.file}; given are {given}"
        )
    missing, where = min(lacking.values(), key=len)[0], " and ".join(map(str, named))
    names = [each for header in named.values() for each in header.names]
    hint = suggest(str(missing), names, f"it has {list_names(names)}")
    raise UsageError(f"{where} has no column {missing} (map: {name}); {hint}")


def _series(name: str, channel: Channel, table: Table, to_si: float, leave_out: bool) -> Series:
    """Sum the columns of a channel, in SI units and our sign; `leave_out` drops rows without a number."""
    if _kind(name) == tables.ANGLE and table.degrees is not None:
        says, header = ("deg", "yes") if table.degrees else ("rad", "no")
        if tables.spelt(channel.unit) in {"deg", "rad"} - {says}:
            raise UsageError(
                f"{table.path} says inDegrees={header}, and map: {name}.unit {channel.unit}"
            )
    notes = [*table.notes, *["times count from the first row"] * (table.day is not None)]
    times = max(map(abs, channel.weights.values())) * channel.scale
    for column in channel.weights:
        said, what = table.units.get(column, ""), f"map: {name}.unit"
        notes += tables.check_unit(table.path, column, said, channel.unit, what, times=times)
    places = [table.names.index(str(column)) for column in channel.weights]
    numbers = np.isfinite(table.values[:, places])
    there = np.asarray(numbers.all(axis=1))
    rows, lost = len(there), np.count_nonzero(~there)
    if lost and not leave_out:
        row = int(np.argmin(there))
        column = table.names[places[int(np.argmin(numbers[row]))]]
        raise UsageError(
            f"{table.path}: column {column} has no number at {table.stamps[row] / NANOSECONDS:.7g} s, and in {lost} of "
            f"{rows} rows something is missing; map: missing: leave_out leaves such rows out"
        )
    if rows - lost < 2:
        raise UsageError(
            f"{table.path} has {rows - lost} row with numbers for {name}; a signal over time needs two"
        )
    notes += [f"{name}: {lost} of {rows} rows left out, as a number is missing"] * bool(lost)
    weights = np.array(list(channel.weights.values()))
    values = (table.values[there][:, places] @ weights) * (to_si * channel.scale * channel.turned)
    words = " + ".join(
        str(column) if w == 1.0 else f"{w:g} {column}" for column, w in channel.weights.items()
    )
    if channel.offset:
        values += to_si * channel.offset
        notes.append(f"{name}: {channel.offset:g} {channel.unit} added (offset)")
    return Series(name, table.path, words, table.stamps[there], values, tuple(notes), table.doubts)


def gait_of(channels: dict[str, Series], sensors: SensorMap) -> Gait:
    """Combine angles, reactions and ground forces over the time that all channels cover.

    Raises:
        UsageError: there is no such time, or fewer than two samples are left.
    """
    joints = {
        sensors.angle.joint if name == "angle" else name: [
            _signal(channels[each]) for each in pair if each in channels
        ]
        for name, pair in zip(ANGLES, zip(ANGLES, TORQUES, strict=True), strict=True)
        if name in channels
    }
    wrenches = {}
    if "load" in channels:
        wrench = _wrench(
            channels, ("", "load", "", "moment", "", ""), "load", 0.0, sensors.max_gap
        )
        wrenches["load"] = wrench._replace(
            values=wrench.values * [1.0, -1.0, 1.0, 1.0, 1.0, 1.0] + 0.0
        )  # no minus 0
    if "ground_force" in channels:
        wrenches["ground_force"] = _wrench(
            channels, GROUND, "ground_force", np.nan, sensors.max_gap
        )
    every = {name: _signal(series) for name, series in channels.items()}
    rate, gap = sensors.rate, sensors.max_gap
    gait = gait_bag.sampled(
        sensors.side, joints, wrenches, every, rate=rate, max_gap=gap, beyond=BEYOND
    )
    notes = dict.fromkeys(note for series in channels.values() for note in series.notes)
    columns = {
        name: f"{series.columns} of {series.path.name}" for name, series in channels.items()
    }
    return gait._replace(notes=[*notes, *gait.notes], columns=columns, weight=sensors.body_weight)


def _wrench(
    channels: dict[str, Series], parts: Sequence[str], main: str, unknown: float, max_gap: float
) -> Signal:
    """Make a wrench from the channels `parts` at the stamps of channel `main`; missing channels become `unknown`.

    Stamps in gaps of a part longer than `max_gap` [s] are left out.
    """
    known, stamps = (
        [channels[name].stamps for name in parts if name in channels],
        channels[main].stamps,
    )
    stamps = stamps[np.all([gait_bag.bridged(stamps, each, max_gap) for each in known], axis=0)]
    if len(stamps) < 2:
        raise UsageError(
            f"{channels[main].where}: all but {len(stamps)} rows lie in gaps of another channel of this "
            f"wrench that are longer than {max_gap:g} s (map: max_gap)"
        )
    columns = [
        _signal(channels[name]).at(stamps).values
        if name in channels
        else np.full((len(stamps), 1), unknown)
        for name in parts
    ]
    return Signal(stamps, np.hstack(columns))


def _signal(series: Series) -> Signal:
    return Signal(series.stamps, series.values[:, None])
