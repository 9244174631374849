"""From a laboratory's own sensors to a gait bag (`knee-contact import-csv`), by a map of their columns."""

from __future__ import annotations

import difflib
import json
from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError, model_validator

from knee_contact_ros.lab import checks, gait_bag, tables
from knee_contact_ros.lab.gait_bag import Gait, Signal
from knee_contact_ros.lab.tables import Series, Table
from knee_contact_ros.parameters.files import first_error
from knee_contact_ros.parameters.schema import Section, one_of
from knee_contact_ros.streams.topics import NANOSECONDS
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.files import read_mapping
from knee_contact_ros.system.output_files import replace, work_folder
from knee_contact_ros.system.terminal import say, warn

Bools = NDArray[np.bool_]
KINDS = {"angle": tables.ANGLE, "reference": tables.ANGLE, "load": tables.FORCE, "moment": tables.MOMENT}
BEYOND = NANOSECONDS
"""Time [ns] before and behind the loads within which angles are kept: as far as `pairing.angle_delay` reaches"""


class Channel(Section):
    """Column, or weighted sum of columns of a single file."""

    column: str | None = Field(None, min_length=1)
    columns: dict[str, float] | None = Field(None, min_length=1, description="names with weights")
    unit: str = Field(description="of the sum")
    scale: float = Field(1.0, description="which the sum is multiplied by, as a calibration says")
    offset: float = Field(0.0, description="in `unit`, added at the end, behind scale, sign and direction")
    file: str = Field("", description="pattern of the file's name, as *_motion.csv, if several have such columns")

    @model_validator(mode="after")
    def _one_way(self) -> Channel:
        if (self.column is None) == (self.columns is None):
            raise ValueError("allowed: either column or columns")
        if self.scale == 0.0 or not any(self.weights.values()):
            raise ValueError("allowed: a scale, and weights of which one at least, other than 0")
        return self

    @property
    def weights(self) -> dict[str, float]:
        """Weights by the names of the columns."""
        return self.columns if self.columns is not None else {str(self.column): 1.0}

    @property
    def turned(self) -> float:
        """Sign that makes the quantity positive as ours is, 1 or -1."""
        return 1.0


class AngleChannel(Channel):
    """Flexion angle of the knee."""

    sign: Annotated[float, one_of(1.0, -1.0)] = Field(1.0, description="1 if it grows in flexion, or -1")
    joint: str = Field("knee", min_length=1, description="name in joint_states")

    @property
    def turned(self) -> float:
        """Sign that makes flexion positive, 1 or -1."""
        return self.sign


class LoadChannel(Channel):
    """Axial load of the knee: the force that the femur exerts on the tibia, along the tibia."""

    direction: Annotated[str, one_of("compression", "tension")] = Field(
        "compression", description="what a positive sum is; tension: as force.y of OpenSim's reaction on the tibia"
    )

    @property
    def turned(self) -> float:
        """Sign that makes compression positive, 1 or -1."""
        return -1.0 if self.direction == "tension" else 1.0


class SensorMap(Section):
    """Content of a map."""

    table: tables.TableFormat = tables.TableFormat()
    time: tables.TimeColumn = tables.TimeColumn()
    angle: AngleChannel
    reference: AngleChannel | None = Field(None, description="the angle that align holds `angle` against")
    load: LoadChannel | None = None
    moment: Channel | None = Field(
        None, description="frontal moment about the middle of the plateau; > 0 loads the lateral compartment more"
    )
    side: Annotated[str, one_of("right", "left")] = "right"
    body_weight: float | None = Field(None, gt=0.0, le=1e5, description="[N]")
    rate: float = Field(0.0, ge=0.0, le=1e4, description="[Hz] both are interpolated at; 0: every row keeps its stamp")
    max_gap: float = Field(0.1, gt=0.0, le=3600.0, description="[s] between rows, beyond which nothing is interpolated")
    missing: Annotated[str, one_of("refuse", "leave_out")] = Field(
        "refuse", description="what to do with a row that has no number (empty, NaN) where one is needed"
    )


def import_csv(files: Sequence[Path], map_file: Path, output: Path, *, overwrite: bool, anyway: bool) -> None:
    """Import files by a map into the bag `output`, and print a summary.

    Raises:
        UsageError: a file, the map or the output cannot be used, or the values are not those of a knee: with `anyway`
            only if that is impossible, and not just unlikely. Nothing is then written.
    """
    sensors = read_map(map_file)
    if sensors.load is None:
        raise UsageError(f"map {map_file}: load: is missing; only align needs none")
    gait_bag.check_output(output, overwrite)
    channels = read_channels(files, sensors, ("angle", "load", "moment"))
    angle, load = channels["angle"], channels["load"]
    if fault := checks.impossible(angle, load):
        raise UsageError(fault)
    doubtful = checks.doubts(angle, load, sensors.load.unit, sensors.body_weight, sensors.max_gap)
    if doubtful and not anyway:
        raise UsageError(f"{doubtful[0]} (--anyway imports it as it is)")
    gait = gait_of(channels, sensors)
    used = {f"file {number}": path for number, path in enumerate(files, start=1)}
    origin = gait_bag.origin_of("CSV", sensors.side, used)
    origin |= {f"columns of {name}": columns for name, columns in gait.columns.items()}
    origin |= {"map": json.dumps(sensors.model_dump(exclude_defaults=True)), "conversions": "\n".join(gait.notes)}
    origin |= {"body_weight": f"{sensors.body_weight:.7g} N"} if sensors.body_weight else {}
    origin |= ({"doubts": "\n".join(doubtful)} if doubtful else {}) | gait_bag.QUANTITIES
    with work_folder(output.parent) as work:
        gait_bag.write_bag(gait, work / output.name, origin)
        replace(work / output.name, output)
    show(channels, gait, sensors, output)
    warn([*doubtful, *checks.unusual(load, sensors.body_weight)])


def read_map(path: Path) -> SensorMap:
    """Read a map from a YAML file.

    Raises:
        UsageError: the file cannot be read, or has a name or value that is not allowed.
    """
    content = dict(read_mapping(path, "map", "names to values"))
    try:
        return SensorMap.model_validate(content)
    except ValidationError as error:
        raise UsageError(f"map {path}: {first_error(error)}{_meant(error)}") from None


def _meant(error: ValidationError) -> str:
    """Hint at the name that is close to an unknown one, or all the names; empty for other errors."""
    first = error.errors()[0]
    if first["type"] != "extra_forbidden":
        return ""
    model: Any = SensorMap
    for part in first["loc"][:-1]:
        field = model.model_fields[part]
        kinds = getattr(field.annotation, "__args__", (field.annotation,))
        model = next(kind for kind in kinds if isinstance(kind, type) and issubclass(kind, Section))
    near = difflib.get_close_matches(str(first["loc"][-1]), model.model_fields, n=1, cutoff=0.5)
    return f"; did you mean {near[0]}?" if near else f"; known are {', '.join(model.model_fields)}"


def read_channels(files: Sequence[Path], sensors: SensorMap, wanted: Sequence[str]) -> dict[str, Series]:
    """Read those of the channels `wanted` that the map has; return them by name.

    Raises:
        UsageError: a unit is wrong, a file cannot be read, or a column is missing, in several files, or not a number.
    """
    channels: dict[str, Channel] = {name: each for name in wanted if (each := getattr(sensors, name)) is not None}
    factors, names = {}, {}
    for name, each in channels.items():
        factors[name] = tables.factor(each.unit, KINDS[name], f"map: {name}", sensors.body_weight)
    for path in files:
        names[path] = tables.names_in(path, sensors.table)
    homes = {name: _home(channel, name, names) for name, channel in channels.items()}
    read: dict[Path, Table] = {}
    for path in dict.fromkeys(homes.values()):
        needed = [column for name, home in homes.items() if home == path for column in channels[name].weights]
        read[path] = tables.read_columns(path, list(dict.fromkeys(needed)), sensors.time, sensors.table)
    leave_out = sensors.missing == "leave_out"
    return {name: _series(name, each, read[homes[name]], factors[name], leave_out) for name, each in channels.items()}


def _home(channel: Channel, name: str, names: dict[Path, tuple[str, ...]]) -> Path:
    """Find the only file that has a channel's columns; `names` are the columns of each file."""
    candidates = [path for path in names if fnmatchcase(path.name, channel.file or "*")]
    if not candidates:
        given = ", ".join(path.name for path in names)
        raise UsageError(f"map: {name}.file: no file is named as {channel.file}; given are {given}")
    homes = [path for path in candidates if set(channel.weights) <= set(names[path])]
    if len(homes) == 1:
        return homes[0]
    if homes:
        both = " and ".join(path.name for path in homes)
        raise UsageError(f"map: {name}: {both} both have {', '.join(channel.weights)}; say which with {name}.file")
    best = max(candidates, key=lambda path: len(set(channel.weights) & set(names[path])))
    missing = next(column for column in channel.weights if column not in names[best])
    everywhere = list(dict.fromkeys(column for path in candidates for column in names[path]))
    fault = f"none of {', '.join(path.name for path in candidates)} has a column"
    if len(candidates) == 1 or missing in everywhere:
        fault = f"{best} has no column"
    raise UsageError(f"{fault} {missing} (map: {name}); {tables.meant(missing, everywhere)}")


def _series(name: str, channel: Channel, table: Table, to_si: float, leave_out: bool) -> Series:
    """Sum the columns of a channel, in SI units and in our sign; `leave_out` rows without a number."""
    if isinstance(channel, AngleChannel) and table.degrees is not None:
        says, header = ("deg", "yes") if table.degrees else ("rad", "no")
        if channel.unit in {"deg", "rad"} - {says}:
            raise UsageError(f"{table.path} says inDegrees={header}, and map: {name}.unit {channel.unit}")
    places = [table.names.index(column) for column in channel.weights]
    numbers = np.isfinite(table.values[:, places])
    there: Bools = np.asarray(numbers.all(axis=1))
    rows, lost = len(there), np.count_nonzero(~there)
    if lost and not leave_out:
        row = int(np.argmin(there))
        column = table.names[places[int(np.argmin(numbers[row]))]]
        raise UsageError(
            f"{table.path}: column {column} has no number at {table.stamps[row] / NANOSECONDS:.7g} s, and in {lost} of "
            f"{rows} rows something is missing; map: missing: leave_out leaves such rows out"
        )
    if rows - lost < 2:
        raise UsageError(f"{table.path} has {rows - lost} row with numbers for {name}; a signal over time needs two")
    notes = [f"{name}: {lost} of {rows} rows left out, as a number is missing"] * bool(lost)
    notes += [f"{name}: {table.duplicates} rows gave way to the next of the same time"] * bool(table.duplicates)
    weights = np.array(list(channel.weights.values()))
    values = (table.values[there][:, places] @ weights) * (to_si * channel.scale * channel.turned)
    words = " + ".join(column if w == 1.0 else f"{w:g} {column}" for column, w in channel.weights.items())
    if channel.offset:
        values += to_si * channel.offset
        notes.append(f"{name}: {channel.offset:g} {channel.unit} added (offset)")
    return Series(name, table.path, words, table.stamps[there], values, tuple(notes))


def gait_of(channels: dict[str, Series], sensors: SensorMap) -> Gait:
    """Make angles and reactions over the time that angle and load have in common.

    Raises:
        UsageError: there is no such time, or fewer than two samples are left.
    """
    angle, load, moment = channels["angle"], channels["load"], channels.get("moment")
    notes = [note for series in channels.values() for note in series.notes]
    wrench = np.zeros((len(load.values), 6))
    wrench[:, 1] = 0.0 - load.values  # no minus zero
    if moment:
        if moment.stamps[0] > load.stamps[0] or moment.stamps[-1] < load.stamps[-1]:
            raise UsageError(f"{moment.where} spans less than the load")
        wrench[:, 3] = np.interp(load.stamps, moment.stamps, moment.values)
    flexion, reaction = Signal(angle.stamps, angle.values[:, None]), Signal(load.stamps, wrench)
    early = int(np.count_nonzero(load.stamps < 0))
    notes += [f"{early} rows of the load lie before time 0, which no stamp does, and are left out"] * (early > 0)
    window = gait_bag.common_window(flexion, reaction)
    notes += gait_bag.gaps("angle", angle.stamps, sensors.max_gap) + gait_bag.gaps("load", load.stamps, sensors.max_gap)
    if sensors.rate:
        stamps = gait_bag.grid(window, sensors.rate)
        stamps = stamps[
            np.all([gait_bag.bridged(stamps, each.stamps, sensors.max_gap) for each in (angle, load)], axis=0)
        ]
        if len(stamps) < 2:
            raise UsageError(f"map: rate {sensors.rate:g}: fewer than two samples lie outside gaps (max_gap)")
        flexion, reaction = flexion.at(stamps), reaction.at(stamps)
        notes.append(f"both interpolated linearly at {sensors.rate:g} Hz, and nothing where a gap is")
    else:
        reaction = gait_bag.within(reaction, window)
        flexion = flexion.inside((max(0, window[0] - BEYOND), window[1] + BEYOND))
        outside = len(load.stamps) - early - len(reaction.stamps)
        notes += [f"{outside} rows of the load left out: no angle at their time"] * (outside > 0)
    columns = {name: series.columns for name, series in channels.items()}
    return Gait(sensors.side, {sensors.angle.joint: flexion.with_rate()}, reaction, columns, notes)


def show(channels: dict[str, Series], gait: Gait, sensors: SensorMap, bag: Path) -> None:
    """Print the columns, the ranges of their values, what was left out, and where the bag is."""
    angle, load = np.degrees(gait.angle.values[:, 0]), -gait.reaction.values[:, 1]
    weight = f" ({load.max() / sensors.body_weight:.2f} BW)" if sensors.body_weight else ""
    at = gait.reaction.stamps[int(load.argmax())] / NANOSECONDS
    ranges = {
        "angle": f"{gait.angle.span}, {angle.min():.1f} to {angle.max():.1f} deg",
        "load": f"{gait.reaction.span}, largest {load.max():.1f} N{weight} at {at:.3f} s",
    }
    rows = []
    for name, series in channels.items():
        rows.append((name, f"{series.columns} of {series.path.name}"))
        if name in ranges:
            rows.append(("", ranges[name]))
    gait_bag.show(rows)
    for line in ("", *(f"- {note}" for note in gait.notes), *[""][: len(gait.notes)], f"Bag: {bag}"):
        say(line, hang=2)
