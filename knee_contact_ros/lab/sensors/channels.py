"""The map of `import-csv` and `align` (what the columns of a laboratory's files are), and its channels in SI units."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError, model_validator

from knee_contact_ros.lab.tables import (
    ANGLE,
    FORCE,
    MOMENT,
    Floats,
    Stamps,
    Storage,
    TableFormat,
    TimeColumn,
    factor,
    meant,
    names_in,
    read_columns,
)
from knee_contact_ros.parameters.files import first_error
from knee_contact_ros.parameters.schema import Section, one_of
from knee_contact_ros.streams.topics import NANOSECONDS
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.files import read_mapping

REFUSE, LEAVE_OUT = "refuse", "leave_out"
COMPRESSION, TENSION = "compression", "tension"


class Channel(Section):
    """Column, or weighted sum of columns of a single file."""

    column: str | None = Field(None, min_length=1)
    columns: dict[str, float] | None = Field(None, min_length=1, description="names with weights")
    unit: str = Field(description="of the sum")
    scale: float = Field(1.0, description="which the sum is multiplied by, as a calibration says")
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


class AngleChannel(Channel):
    """Flexion angle of the knee."""

    sign: Annotated[float, one_of(1.0, -1.0)] = Field(1.0, description="1 if it grows in flexion, or -1")
    joint: str = Field("knee", min_length=1, description="name in joint_states")


class LoadChannel(Channel):
    """Axial load of the knee: the force that the femur exerts on the tibia, along the tibia."""

    direction: Annotated[str, one_of(COMPRESSION, TENSION)] = Field(
        COMPRESSION, description="what a positive sum is; tension: as force.y of OpenSim's reaction on the tibia"
    )


class SensorMap(Section):
    """Content of a map."""

    table: TableFormat = TableFormat()
    time: TimeColumn = TimeColumn()
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
    missing: Annotated[str, one_of(REFUSE, LEAVE_OUT)] = Field(
        REFUSE, description="what to do with a row that has no number (empty, NaN) where one is needed"
    )


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


Bools = NDArray[np.bool_]
KINDS = {"angle": ANGLE, "reference": ANGLE, "load": FORCE, "moment": MOMENT}


class Series(NamedTuple):
    """Channel over time."""

    name: str
    """Name of the channel in the map"""
    path: Path
    """File from which it was read"""
    stamps: Stamps
    """Stamps [ns], increasing, shape (n,)"""
    values: Floats
    """Flexion angle [rad], compression [N] or moment [N m], shape (n,)"""
    columns: str
    """Text that names the columns and their weights"""
    notes: tuple[str, ...]
    """What was left out, as sentences"""

    @property
    def seconds(self) -> Floats:
        """Times since the first stamp [s], shape (n,)."""
        seconds: Floats = (self.stamps - self.stamps[0]) / NANOSECONDS
        return seconds

    @property
    def where(self) -> str:
        """Text with file and columns, for messages."""
        return f"{self.path}: {self.columns}"


def read_channels(files: Sequence[Path], sensors: SensorMap, wanted: Sequence[str]) -> dict[str, Series]:
    """Read those of the channels `wanted` that the map has; return them by name.

    Raises:
        UsageError: a unit is wrong, a file cannot be read, or a column is missing, in several files, or not a number.
    """
    channels = {name: channel for name in wanted if (channel := getattr(sensors, name)) is not None}
    factors = {
        name: factor(channel.unit, KINDS[name], f"map: {name}", sensors.body_weight)
        for name, channel in channels.items()
    }
    names = {path: names_in(path, sensors.table) for path in files}
    homes = {name: _home(channel, name, names) for name, channel in channels.items()}
    tables: dict[Path, Storage] = {}
    for path in dict.fromkeys(homes.values()):
        needed = [column for name, home in homes.items() if home == path for column in channels[name].weights]
        tables[path] = read_columns(path, list(dict.fromkeys(needed)), sensors.time, sensors.table)
    return {
        name: _series(name, channels[name], tables[homes[name]], factors[name], sensors.missing == LEAVE_OUT)
        for name in channels
    }


def _home(channel: Channel, name: str, names: dict[Path, tuple[str, ...]]) -> Path:
    """Find the only file that has a channel's columns; `names` are the columns of each file."""
    pattern = channel.file or "*"
    candidates = [path for path in names if fnmatchcase(path.name, pattern)]
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
    raise UsageError(f"{fault} {missing} (map: {name}); {meant(missing, everywhere)}")


def _series(name: str, channel: Channel, table: Storage, to_si: float, leave_out: bool) -> Series:
    """Sum the columns of a channel, in SI units and in our sign; `leave_out` rows without a number."""
    if isinstance(channel, AngleChannel) and table.degrees is not None and (channel.unit in ("deg", "rad")):
        says = "deg" if table.degrees else "rad"
        if says != channel.unit:
            raise UsageError(
                f"{table.path} says inDegrees={'yes' if table.degrees else 'no'}, and map: {name}.unit {channel.unit}"
            )
    columns = [table.names.index(column) for column in channel.weights]
    there: Bools = np.asarray(np.isfinite(table.values[:, columns]).all(axis=1))
    notes = []
    if not there.all():
        row = int(np.argmin(there))
        if not leave_out:
            column = next(n for n in channel.weights if not np.isfinite(table.values[row, table.names.index(n)]))
            raise UsageError(
                f"{table.path}: column {column} has no number at {table.stamps[row] / NANOSECONDS:.7g} s, and in "
                f"{np.count_nonzero(~there)} of {len(there)} rows something is missing; map: missing: leave_out leaves "
                "such rows out"
            )
        notes.append(f"{name}: {np.count_nonzero(~there)} of {len(there)} rows left out, as a number is missing")
    if np.count_nonzero(there) < 2:
        raise UsageError(
            f"{table.path} has {np.count_nonzero(there)} row with numbers for {name}; a signal over time needs two"
        )
    if table.duplicates:
        notes.append(f"{name}: {table.duplicates} rows gave way to the next of the same time")
    weights = np.array(list(channel.weights.values()))
    values = (table.values[there][:, columns] @ weights) * (to_si * channel.scale * _sign(channel))
    words = " + ".join(column if w == 1.0 else f"{w:g} {column}" for column, w in channel.weights.items())
    return Series(name, table.path, table.stamps[there], values, words, tuple(notes))


def _sign(channel: Channel) -> float:
    """Sign that makes flexion or compression positive, 1 or -1."""
    if isinstance(channel, AngleChannel):
        return channel.sign
    return -1.0 if isinstance(channel, LoadChannel) and channel.direction == TENSION else 1.0
