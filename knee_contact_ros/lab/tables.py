"""Columns over time from files of numbers: OpenSim's storage files (.sto, .mot), text tables, Parquet and C3D files.

A storage file has a header that ends with `endheader`, a line of column names, and numbers. In text tables columns may
be separated by commas, semicolons, tabs or spaces, numbers have decimal points or commas, and lines before and behind
the names may be there. They are read row by row, so that only the selected columns must fit in memory.
"""

from __future__ import annotations

import codecs
import csv
import difflib
import io
import math
import re
from array import array
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from datetime import date
from itertools import islice
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from knee_contact_ros.parameters.schema import Section, one_of
from knee_contact_ros.streams.topics import NANOSECONDS
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.files import open_regular, require

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]
Column = str | int
"""Name of a column, or its place from 1"""

STORAGES, PARQUETS, C3D = {".sto", ".mot"}, {".parquet", ".pq"}, ".c3d"
END = "endheader"
LAST_TIME = 2**31
"""First time [s] that a ROS stamp cannot hold"""
MOST_NAMES = 12
"""Largest number of column names in an error message"""
MOST_STANDING = 0.1
"""Largest share of the rows of a text table that may have the time of the next row"""
LONGEST_LINE = 2**20
"""Largest number of characters in a line of a text table"""
COMMENT = "#"
SEARCHED = 300
"""Number of lines at the beginning of a text table among which its names are looked for"""
HALF_DAY, DAY = 43_200.0, 86_400.0
"""[s]"""
WINDOWS = "cp1252"
POUND_FORCE, KILOPOND, INCH = 4.4482216152605, 9.80665, 0.0254
TIME, ANGLE, FORCE, MOMENT = "time", "angle", "force", "moment"
BODY_WEIGHT, PERCENT = "BW", "%BW"
"""Units of force that need the map's `body_weight`"""
NOT_A_NUMBER = re.compile(r"[-+]?(?:nan(?:\(\w*\))?|\d\.#\w+)|n/?a|#n/?a|#div/0!|null|none|-+", re.IGNORECASE)
"""How programs write what is missing, and Windows also infinity: nan, -nan(ind), 1.#QNAN, -1.#IND, NA, #N/A, null, -"""
GROUPED = re.compile(r"[-+]?[1-9]\d{0,2}(?:(?:\.\d{3})+(?:,\d*)?|(?:,\d{3})+(?:\.\d*)?)")
"""Numbers that may have thousands marks: 1.760 and 1,760 have, or have a decimal mark; 1.760,5 and 1,760.5 have"""
DECIMAL_COMMA = re.compile(r"[-+]?(?:0,\d+|\d+,(?:\d{1,2}|\d{4,}))")
"""Numbers whose comma is no thousands mark"""
BEGINS = re.compile(r"\s*[-+]?(?:\.?\d|nan\b|inf)", re.IGNORECASE)
"""Begin of a line of numbers"""
CLOCK = re.compile(
    r"(?:(\d{4})[-/](\d\d?)[-/](\d\d?)[ T]+|([^:]*?)[ ,]+)?(?:(\d+):)?([0-5]?\d):([0-5]?\d(?:[.,]\d+|:\d{3})?)"
    r"(?: *([ap])\.?m\.?)?(?: *(Z|UTC|GMT|[-+]\d\d(?::?\d\d)?))?",
    re.IGNORECASE,
)
"""A time of day: an ISO date or another one, hours, minutes, seconds, am or pm, zone; only minutes and seconds must be
there"""
BRACKETED = re.compile(r"(?:[\[(]([^\[(\])]+)[\])]|_([a-zµ°%]+))$", re.IGNORECASE)
"""A unit at the end of a name: Force [N], time_ms"""
SOME = 3
"""Number of cells from which a column's way to write numbers is told"""
UNITS = {
    TIME: {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    ANGLE: {"rad": 1.0, "deg": math.radians(1.0), "mrad": 1e-3, "rev": 2.0 * math.pi},
    FORCE: {"N": 1.0, "kN": 1e3, "mN": 1e-3, "lbf": POUND_FORCE, "kgf": KILOPOND, BODY_WEIGHT: 1.0, PERCENT: 0.01},
    MOMENT: {"N*m": 1.0, "N*mm": 1e-3, "kN*m": 1e3, "lbf*in": POUND_FORCE * INCH, "lbf*ft": 12.0 * POUND_FORCE * INCH},
}
"""Factors of units to s, rad, N (or body weights) and N m, by quantity"""
ALIASES = {
    "sec": "s", "second": "s", "seconds": "s", "µs": "us", "μs": "us",
    "degree": "deg", "degrees": "deg", "°": "deg", "radian": "rad", "radians": "rad",
    "newton": "N", "newtons": "N", "lb": "lbf", "kp": "kgf", "Nm": "N*m", "Nmm": "N*mm", "N m": "N*m", "N mm": "N*mm",
    "xBW": BODY_WEIGHT, "bw": BODY_WEIGHT, "% BW": PERCENT, "%bw": PERCENT, "% bw": PERCENT, "percent BW": PERCENT,
}  # fmt: skip


class Table(NamedTuple):
    """Columns over time; of rows with one stamp, which OpenSim writes at the ends of steps, only the last."""

    path: Path
    names: tuple[str, ...]
    """Names of the columns, without time"""
    stamps: Stamps
    """[ns], growing; shape (n,)"""
    values: Floats
    """Shape (n, columns)"""
    degrees: bool | None
    """Value of `inDegrees` in a storage file's header; None: there is none"""
    duplicates: int
    """Number of rows that were left out for a later one of the same stamp"""
    words: Mapping[tuple[int, str], str] = {}
    """Cells of a storage file that are not numbers, and NaN in `values`, by stamp and column"""
    day: int | str | None = None
    """Day of the first row, if times are frames or times of day, which begin anywhere: the number of an ISO date, the
    text of another one, empty without one; None: they are not"""
    units: Mapping[Column, str] = {}
    """What the file says of the units of columns"""
    notes: tuple[str, ...] = ()
    """How the file was read, as sentences"""

    def columns(self, names: Sequence[Column]) -> Floats:
        """Return columns by their names, shape (n, columns).

        Raises:
            UsageError: a column is not there or there twice.
        """
        return self.values[:, [self.header.place(name) for name in names]]

    @property
    def header(self) -> Header:
        """Names of the columns."""
        return Header(self.path, self.names)

    def column(self, name: str) -> Floats:
        """Return a column by its name, shape (n,).

        Raises:
            UsageError: the column is not there or there twice, or has a value that is not finite.
        """
        values = self.values[:, self.header.place(name)]
        if not np.isfinite(values).all():
            row = int(np.argmin(np.isfinite(values)))
            cell = self.words.get((int(self.stamps[row]), name), values[row])
            raise UsageError(f"{self.path}: column {name} is {cell} at {self.time(row)} s; it must be a finite number")
        return values

    def needed(self, names: Sequence[str], start: float | None, end: float | None) -> Table:
        """Leave out rows before `start` and after `end` [s] that have no number in one of the columns `names`."""
        first, last = (edge if s is None else s * NANOSECONDS for s, edge in ((start, -math.inf), (end, math.inf)))
        kept = (self.stamps >= first) & (self.stamps <= last) | np.isfinite(self.columns(names)).all(axis=1)
        return self._replace(stamps=self.stamps[kept], values=self.values[kept])

    def at(self, stamps: Stamps) -> Table:
        """Select the rows at some of the stamps [ns]."""
        rows = np.isin(self.stamps, stamps)
        return self._replace(stamps=self.stamps[rows], values=self.values[rows])

    def time(self, row: int) -> str:
        """Return the time [s] of a row as text."""
        return f"{self.stamps[row] / NANOSECONDS:g}"

    @property
    def span(self) -> str:
        """First and last time [s] as text."""
        return f"{self.time(0)} to {self.time(-1)} s"


class Series(NamedTuple):
    """Quantity over time, in SI units and the package's signs."""

    name: str
    """Name of the quantity"""
    path: Path
    """File from which it was read"""
    columns: str
    """Text that names the columns and their weights"""
    stamps: Stamps
    """[ns], growing; shape (n,)"""
    values: Floats
    """Shape (n,)"""
    notes: tuple[str, ...] = ()
    """What was left out, as sentences"""

    @property
    def where(self) -> str:
        """Text with file and columns, for messages."""
        return f"{self.path}: {self.columns}"


class TableFormat(Section):
    """Format of the files, where it cannot be recognised."""

    header_line: int | None = Field(
        None, ge=1, description="line with the names; default: the one with most of the names that the map has"
    )
    first_line: int | None = Field(None, ge=2, description="line of the first row; default: the first with a number")
    delimiter: str | None = Field(None, min_length=1, max_length=1, description="default: as the names are divided")
    decimal: Annotated[str, one_of("auto", ".", ",")] = Field(
        "auto", description="auto: a comma where columns are not divided by commas"
    )
    encoding: str = Field("auto", description="as Python names it; auto: UTF-8, UTF-16 by its mark, or Windows-1252")
    rows: dict[str, str | int | float] = Field({}, description="take only rows with these values in these columns")


class TimeColumn(Section):
    """Time of each row."""

    column: Column = Field("time", description="numbers of `unit`, times of day, or with `rate` frames")
    unit: str = "s"
    rate: float | None = Field(
        None, gt=0.0, le=1e6, description="[Hz] of the frames in `column`, or without `column` of the rows"
    )
    offset: float = Field(0.0, description="[s] added, so that recordings with large times begin near 0")

    @property
    def places(self) -> list[Column]:
        """The column, if there is one."""
        return [] if self.rate and "column" not in self.model_fields_set else [self.column]


class Header(NamedTuple):
    """Names of a file's columns, and how its lines are divided."""

    path: Path
    names: tuple[str, ...]
    line: int = 0
    """Number of the line that has the names, counted from 1; 0: there is none"""
    delimiter: str = ""
    """Character between columns; a space stands for any number of blanks"""
    encoding: str = ""
    above: tuple[tuple[str, ...], ...] = ()
    """Lines right above the names that are divided as they are, such as of sensors that have columns X, Y, Z each"""

    def places(self, name: Column) -> list[int]:
        """Indices of the columns that a place from 1 or a name means: `X`, or `KneeAngles.X` with the one above it."""
        if isinstance(name, int):
            return [name - 1] if 1 <= name <= len(self.names) else []
        found = [place for place, each in enumerate(self.names) if each == name]
        return found or [place for place in range(len(self.names)) if name in self.qualified(place)]

    def qualified(self, place: int) -> list[str]:
        """Names of a column with those above it, also without what is before their colon."""
        above = [line[place] for line in self.above if line[place]]
        names = dict.fromkeys(each for name in above for each in (name, name.rpartition(":")[2]))
        return [f"{name}.{self.names[place]}" for name in names]

    def place(self, name: Column) -> int:
        """Index of a column; refuse one that is not there, or there twice."""
        found = self.places(name)
        if len(found) > 1:
            full = [self.qualified(place)[:1] for place in found]
            cure = f"say which: {', '.join(each[0] for each in full)}" if all(full) else "their names must differ"
            raise UsageError(f"{self.path} has {len(found)} columns {name}; {cure}")
        if not found:
            raise UsageError(f"{self.path} has no column {name}; {meant(str(name), self.names)}")
        return found[0]


def factor(unit: str, kind: str, what: str, body_weight: float | None = None) -> float:
    """Factor of a unit to SI; `kind` is the quantity that it must be of, `what` names the value in messages.

    Raises:
        UsageError: the unit is not known or is of another quantity, or in body weights without `body_weight` [N].
    """
    name = ALIASES.get(unit, unit)
    if name in {BODY_WEIGHT, PERCENT} and kind == FORCE:
        if body_weight is None:
            raise UsageError(f"{what}: unit {name} needs body_weight [N] in the map")
        return UNITS[FORCE][name] * body_weight
    if name in UNITS[kind]:
        return UNITS[kind][name]
    known = ", ".join(UNITS[kind])
    other = next((quantity for quantity, units in UNITS.items() if name in units), None)
    if other is not None:
        raise UsageError(f"{what}: unit {unit} cannot be: it is a unit of {other}, and {kind} is wanted: {known}")
    near = difflib.get_close_matches(unit, UNITS[kind], n=1, cutoff=0.5)
    hint = f"did you mean {near[0]}? " if near else ""
    raise UsageError(f"{what}: unit {unit!r} is not known; {hint}allowed: {known}")


def read_storage(path: Path) -> Table:
    """Read a storage file.

    Raises:
        UsageError: the file cannot be read, is no storage file, or its times decrease.
    """
    header, names, rows = split(path, text_of(path))
    if header.get("datatype", "double").lower() != "double":
        raise UsageError(f"{path} holds {header['datatype']} (DataType in its header); only numbers can be read")
    if not rows:
        raise UsageError(f"{path} has no rows")
    numbers, words = _by_cells(path, names, rows)
    degrees = {"yes": True, "no": False}.get(header.get("indegrees", "").lower())
    table = _over_time(path, names[1:], _stamps(path, numbers[:, 0]), numbers[:, 1:])._replace(degrees=degrees)
    stamps = {row: round(numbers[row, 0] * NANOSECONDS) for row, _ in words}
    return table._replace(words={(stamps[row], names[place]): cell for (row, place), cell in words.items()})


def read_c3d(path: Path) -> Table:
    """Read the points of a C3D file, as RKneeAngles.X, and its analog channels at the times of the points.

    Raises:
        UsageError: ezc3d is not installed, the file cannot be read, or has no points.
    """
    require("c3d", "ezc3d")
    import ezc3d

    try:
        read: Any = ezc3d.c3d(str(path))
    except (OSError, ValueError, RuntimeError) as error:
        raise UsageError(f"cannot read {path}: {error}") from None
    points, analogs, header = read["data"]["points"][:3], read["data"]["analogs"][0], read["header"]["points"]
    labels, channels = (read["parameters"][kind]["LABELS"]["value"] for kind in ("POINT", "ANALOG"))
    rows = points.shape[2]
    if not rows:
        raise UsageError(f"{path} has no points over time")
    columns = [*points.transpose(1, 0, 2).reshape(-1, rows), *analogs[:, :: max(1, analogs.shape[1] // rows)]]
    names = [f"{label.rpartition(':')[2]}.{axis}" for label in labels[: points.shape[1]] for axis in "XYZ"]
    times = (header["first_frame"] + np.arange(rows)) / header["frame_rate"]
    return _over_time(path, [*names, *channels[: len(analogs)]], _stamps(path, times), np.column_stack(columns))


def _by_cells(path: Path, names: Sequence[str], rows: Sequence[str]) -> tuple[Floats, dict[tuple[int, int], str]]:
    """Read rows of numbers; commas are decimal marks if no cell has a point, and those of the times show it.

    Returns the numbers, NaN where a cell has none, shape (n, columns), and such cells by row and column.
    """
    cells = [row.split("\t") if row.count("\t") == len(names) - 1 else row.split() for row in rows]
    comma = "." not in "".join(rows) and any(DECIMAL_COMMA.fullmatch(row[0].strip()) for row in cells)
    numbers, words = np.empty((len(rows), len(names))), {}
    for row, texts in enumerate(cells):
        if len(texts) != len(names):
            raise UsageError(f"{path}: {len(names)} column names, but {len(texts)} columns in row {row + 1}")
        for place, text in enumerate(texts):
            try:
                numbers[row, place] = float(text)
            except ValueError:
                try:
                    numbers[row, place] = _number(text, "," if comma else ".", strict=True)
                except ValueError:
                    numbers[row, place], words[row, place] = math.nan, repr(text.strip()[:40])
        if (row, 0) in words:
            fault = f"{path}: time is {words[row, 0]} in row {row + 1}; numbers must have decimal points"
            raise UsageError(fault)
    return numbers, words


def _stamps(path: Path, time: Floats, factor: float = 1.0, offset: float = 0.0) -> Stamps:
    """Convert times to stamps [ns]; refuse one that is not a number, or that a stamp cannot hold."""
    seconds = time * factor + offset
    if not np.isfinite(seconds).all() or np.abs(seconds).max() >= LAST_TIME:
        raise UsageError(f"{path}: a time is not a number of seconds below {LAST_TIME}")
    return np.rint(seconds * NANOSECONDS).astype(np.int64)


def _over_time(path: Path, names: Sequence[str], stamps: Stamps, values: Floats) -> Table:
    """Make a table of stamps [ns] and columns `names`, shape (n, columns).

    Raises:
        UsageError: times decrease.
    """
    steps = np.diff(stamps)
    if (steps < 0).any():
        row = int(np.argmax(steps < 0))
        before, after = stamps[row : row + 2] / NANOSECONDS
        cure = "; of several recordings choose one (table.rows in the map)" if path.suffix.lower() in PARQUETS else ""
        raise UsageError(f"{path}: time goes back from {before:.7g} to {after:.7g} s (rows {row + 1}, {row + 2}){cure}")
    last = np.append(steps > 0, True)
    return Table(path, tuple(names), stamps[last], values[last], None, int(np.count_nonzero(~last)))


def text_of(path: Path) -> str:
    """Return the content of a storage file.

    Raises:
        UsageError: the file cannot be read, or is not text.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror}") from None
    if b"\0" in data[:4096]:
        raise UsageError(f"{path} is not an OpenSim storage file (.sto, .mot): it is not text")
    return data.decode("utf-8-sig", errors="replace")  # headers hold file names of all kinds of computers


def split(path: Path, text: str) -> tuple[dict[str, str], list[str], list[str]]:
    """Split a storage file's text into header entries (by names in lower case), column names and lines of the table.

    OpenSim 4.6 writes an empty header, and parts of a second one, before the names in `*_states.sto`: the names are
    the line right before the numbers. Where tabs divide them they may hold blanks; commas may divide columns too.

    Raises:
        UsageError: the text is no storage file.
    """
    lines = [line for line in text.splitlines() if line.strip()]
    end = next((number for number, line in enumerate(lines) if line.strip().lower() == END), None)
    if end is None:
        raise UsageError(f"{path} is not an OpenSim storage file (.sto, .mot): it has no line {END}")
    first = next((n for n in range(end + 1, len(lines)) if BEGINS.match(lines[n])), len(lines))
    names, rows = [name.strip() for name in lines[first - 1].strip().split("\t")], lines[first:]
    mark = next((mark for mark in ";," if mark in names[0]), "")
    if len(names) == 1 and mark:
        names, rows = [name.strip() for name in names[0].split(mark)], [row.replace(mark, "\t") for row in rows]
    elif len(names) == 1:
        names = names[0].split()
    if first > end + 1 and names[0].lower() != TIME:
        raise UsageError(f"{path}: its first column is {names[0]}, and must be {TIME}")
    entries = [line.split("=", 1) for line in lines[:end] if "=" in line]
    return {key.strip().lower(): value.strip() for key, value in entries}, names, rows


def repaired(text: str, path: Path) -> str:
    """Return a storage file's text with a single header that fits its table, as OpenSim itself reads it.

    Raises:
        UsageError: the text is no storage file.
    """
    header, names, rows = split(path, text)
    top = ["states", "version=1", f"nRows={len(rows)}", f"nColumns={len(names)}"]
    return "\n".join([*top, f"inDegrees={header.get('indegrees', 'no')}", END, "\t".join(names), *rows]) + "\n"


def header_of(path: Path, wanted: Collection[Column], table_format: TableFormat) -> Header:
    """Names of the columns of a file, with that of the time; `wanted` are those that are looked for.

    Raises:
        UsageError: the file cannot be read, or has no names.
    """
    if path.suffix.lower() in {*STORAGES, C3D}:
        return Header(path, (TIME, *_whole(path).names))
    if path.suffix.lower() not in PARQUETS:
        return _text_header(path, wanted, table_format)
    require("tables", "pandas", "pyarrow")
    import pyarrow as pa
    from pyarrow.parquet import read_schema

    try:
        return Header(path, tuple(read_schema(path).names))
    except (OSError, pa.ArrowException) as error:
        raise UsageError(f"cannot read {path}: {' '.join(str(error).split())[:200]}") from None


def _whole(path: Path) -> Table:
    return read_c3d(path) if path.suffix.lower() == C3D else read_storage(path)


def read_columns(path: Path, wanted: Sequence[Column], time: TimeColumn, table_format: TableFormat) -> Table:
    """Read the columns `wanted` of a file over time; an empty cell is read as NaN.

    Raises:
        UsageError: the file cannot be read, a column is not there or there twice, a cell is not a number, or time
            stands still or goes back.
    """
    to_seconds = factor(time.unit, TIME, "time")
    if path.suffix.lower() in {*STORAGES, C3D}:
        storage = _whole(path)
        stamps = storage.stamps if to_seconds == 1.0 else np.rint(storage.stamps * to_seconds).astype(np.int64)
        header = Header(path, (TIME, *storage.names))
        values = np.column_stack([storage.stamps / NANOSECONDS, storage.values])[:, [header.place(c) for c in wanted]]
        names = tuple(str(name) for name in wanted)
        return storage._replace(names=names, values=values, stamps=stamps + round(time.offset * NANOSECONDS))
    header = header_of(path, [*time.places, *wanted], table_format)
    places = [header.place(name) for name in (*time.places, *wanted)]
    numbers, units, day = read_numbers(header, places, table_format, len(time.places))
    if not len(numbers):
        raise UsageError(f"{path} has no rows below its names (line {header.line})")
    said = {name: units.get(place, "") or _bracketed(header.names[place] if isinstance(name, str) else "")
            for name, place in zip((*time.places, *wanted), places, strict=True)}  # fmt: skip
    stamps, day = _times(path, time, numbers, day, said)
    table = _over_time(path, [str(name) for name in wanted], stamps, numbers[:, len(time.places) :])
    if table.duplicates > MOST_STANDING * len(numbers):
        raise UsageError(
            f"{path}: in {table.duplicates} of {len(numbers)} rows column {time.column} has the value of the next row; "
            f"is it the time, in {time.unit}, with enough digits?"
        )
    odd = header.encoding == WINDOWS and table_format.encoding == "auto"
    notes = (f"{path.name} is not in UTF-8, and was read as Windows-1252 (table.encoding)",) * odd
    return table._replace(day=day, units=said, notes=notes)


def check_unit(path: Path, column: Column, said: str, unit: str, kind: str, what: str) -> None:
    """Refuse a unit of `kind` that is not the one which the file says of a column; `what` names the given one."""
    theirs = ALIASES.get(said, said)
    if theirs in UNITS[kind] and theirs != ALIASES.get(unit, unit):
        raise UsageError(
            f"{path} says {said} of column {column}, and {what} {unit}; where the file is wrong, name the column "
            "by its place (column: 2), and the first row below the units (table.first_line)"
        )


def _times(
    path: Path, time: TimeColumn, numbers: Floats, day: int | str | None, said: Mapping[Column, str]
) -> tuple[Stamps, int | str | None]:
    """Stamps [ns] of rows, and the day on which they begin, as for `Table`; `said` are units in the file."""
    if not time.places:
        numbers = np.arange(len(numbers), dtype=np.float64)[:, None]
    first = numbers[:, 0]
    if not np.isfinite(first).all():
        row = int(np.argmin(np.isfinite(first)))
        raise UsageError(f"{path}: column {time.column} is {first[row]} in row {row + 1}; a time must be there")
    if day is not None:
        return _stamps(path, first, 1.0, time.offset), day
    if time.rate is None:
        check_unit(path, time.column, said.get(time.column, ""), time.unit, TIME, "time.unit")
        return _stamps(path, first, factor(time.unit, TIME, "time"), time.offset), None
    if (first % 1.0).any():
        odd = first[first % 1.0 > 0.0][0]
        raise UsageError(f"{path}: column {time.column} has {odd:g}, and with time.rate it must count frames")
    return _stamps(path, first, 1.0 / time.rate, time.offset), ""


def read_numbers(
    header: Header, places: Sequence[int], table_format: TableFormat, times: int = 0
) -> tuple[Floats, dict[int, str], int | str | None]:
    """Read the columns of a Parquet file or text at some places, shape (rows, places), NaN where there is none.

    The first `times` places, 0 or 1, may hold times of day, which become seconds. The other answers are what a row
    right below the names says in each column, and the day of the first time of day, as for `Table`.

    Raises:
        UsageError: a cell is not a number, or a line has not as many columns as there are names.
    """
    if header.path.suffix.lower() in PARQUETS:
        return _parquet(header, places, table_format), {}, None
    either = table_format.decimal == "auto" and header.delimiter != ","
    decimal = "." if table_format.decimal == "auto" else table_format.decimal
    stated = table_format.decimal != "auto"
    flat, marks, units, clock = array("d"), Marks(places), dict[int, str](), Clock()
    for line, cells in _records(header, table_format, units):
        for number, place in enumerate(places):
            cell = cells[place].strip()
            try:
                if number < times and ":" in cell:
                    flat.append(clock.seconds(cell))
                    continue
                flat.append(_number(cell, "" if either else decimal, strict=not stated))
            except ValueError:
                fault = f"{header.path}: line {line}, column {header.names[place]}: {cell[:40]!r} is not a number"
                raise UsageError(fault + _cause(cell, decimal if stated else "")) from None
            if not stated:
                marks.add(place, cell, line)
    if not stated:
        marks.check(header.path, header.names)
    return np.array(flat).reshape(-1, len(places)), units, clock.day


def _parquet(header: Header, places: Sequence[int], table_format: TableFormat) -> Floats:
    """Read the columns at some places of a Parquet file, shape (rows, places)."""
    import pandas as pd

    filters = [(name, "==", value) for name, value in table_format.rows.items()]
    for name in table_format.rows:
        header.place(name)
    names = [header.names[place] for place in places]
    try:
        frame = pd.read_parquet(header.path, columns=list(dict.fromkeys(names)), filters=filters or None)
        return np.column_stack([frame[name].to_numpy(np.float64) for name in names])
    except (ValueError, TypeError) as error:
        fault = " ".join(str(error).split())[:200]
        raise UsageError(f"{header.path}: {', '.join(names)} must be numbers: {fault}") from None


def _text_header(path: Path, wanted: Collection[Column], table_format: TableFormat) -> Header:
    """Find the names of a text file's columns: the line that has most of those `wanted`, or else the first line.

    They may stand behind a `#`. Raises a `UsageError` for a file that is empty, or has numbers where names should be.
    """
    encoding, given = _encoding(path, table_format), table_format.header_line
    with _opened(path, encoding) as file:
        lines = list(islice(_lines(file, path), max(SEARCHED, given or 0)))
    if given and given > len(lines):
        raise UsageError(f"{path} has no line {given} (table.header_line)")
    there = [number for number, line in enumerate(lines, start=1) if line.strip()]
    content = [number for number in there if not lines[number - 1].startswith(COMMENT)]
    if not content:
        raise UsageError(f"{path} is empty")
    delimiters = {n: table_format.delimiter or next((m for m in ";\t,|" if m in lines[n - 1]), " ") for n in there}
    names = {number: _cells(lines[number - 1].lstrip(COMMENT), delimiters[number]) for number in there}
    asked = {name for name in wanted if isinstance(name, str)}
    asked |= {name.rpartition(".")[2] for name in asked}

    def fits(number: int) -> tuple[int, bool]:
        return len(asked.intersection(names[number])), number in content

    number = given or max([content[0], *there], key=fits)
    if not given and not fits(number)[0]:
        alike = [line for line in there if line < content[0] and len(names[line]) == len(names[content[0]])]
        number = alike[-1] if alike else content[0]
        least = max([1, *(name for name in wanted if isinstance(name, int))])
        full = [line for line in content if len(names[line]) >= least]
        rows = [line for line in full if all(map(_is_number, filter(None, names[line])))]
        if not asked and rows:  # columns by their places need no names
            width = len(names[rows[0]])
            return Header(path, tuple(map(str, range(1, width + 1))), rows[0] - 1, delimiters[rows[0]], encoding)
    if all(_is_number(name) for name in names[number] if name):
        raise UsageError(
            f"{path}: line {number} has numbers, and must have the columns' names; put a line with them on top, say "
            "where they are (table.header_line), or name columns by their place (column: 2)"
        )
    above = []
    for line in range(number - 1, 0, -1):
        cells = _cells(lines[line - 1].lstrip(COMMENT), delimiters[number])
        if len(cells) < 2:
            break
        filled, last = [], ""
        for cell in (cells + [""] * len(names[number]))[: len(names[number])]:
            last = cell or last
            filled.append(last)
        above.append(tuple(filled))
    return Header(path, tuple(names[number]), number, delimiters[number], encoding, tuple(above))


def _cells(line: str, delimiter: str) -> list[str]:
    cells = line.split() if delimiter == " " else next(csv.reader([line], delimiter=delimiter), [])
    return [cell.strip() for cell in cells]


def _bracketed(name: str) -> str:
    """Unit at the end of a name."""
    match = BRACKETED.search(name)
    return (match[1] or match[2]).strip() if match else ""


def _records(header: Header, table_format: TableFormat, units: dict[int, str]) -> Iterator[tuple[int, list[str]]]:
    """Yield number and cells of each row below the names; `units` gets what a row without a number says before them.

    A blank line ends a table if another one follows, of another width.
    """
    width, first, begun, blank = len(header.names), table_format.first_line, False, False
    chosen = {header.place(name): str(value) for name, value in table_format.rows.items()}
    with _opened(header.path, header.encoding) as file:
        for line, cells in _rows(file, header.path, header.delimiter):
            if line < (first or header.line + 1) or not any(cells) or cells[0].startswith(COMMENT):
                blank = not any(cells)
                continue
            begun = begun or first is not None or any(_is_number(cell) or CLOCK.fullmatch(cell) for cell in cells)
            if not begun:
                units |= {place: cell.strip(" []()") for place, cell in enumerate(cells) if not units.get(place)}
                continue
            if begun and blank and len(cells) == 1 < width:
                return
            if len(cells) < width or any(cells[width:]):
                raise UsageError(f"{header.path}: line {line} has {len(cells)} columns, and the names are {width}")
            blank = False
            if all(cells[place].strip() == value for place, value in chosen.items()):
                yield line, cells


class Clock:
    """Reads times of day, also over midnight; those with a zone become UTC."""

    def __init__(self) -> None:
        """Begin before the first one."""
        self.day: int | str | None = None
        """Day of the first row, as for `Table`"""
        self._last, self._nights = 0.0, 0

    def seconds(self, cell: str) -> float:
        """Time [s] from the midnight before the first row; a ValueError if a cell has none."""
        match = CLOCK.fullmatch(cell)
        if match is None:
            raise ValueError
        year, month, day, other, hours, minutes, seconds, half, zone = match.groups()
        hour = int(hours or 0)
        if half:
            if not (hours and 1 <= hour <= 12):
                raise ValueError
            hour = hour % 12 + 12 * (half in "pP")
        at = 3600.0 * hour + 60.0 * int(minutes) + float(re.sub("[,:]", ".", seconds))
        if zone and zone[0] in "+-":
            at -= float(f"{zone[0]}1") * (3600.0 * int(zone[1:3]) + 60.0 * int(zone[3:].strip(":") or 0))
        today = date(int(year), int(month), int(day)).toordinal() if year else 0
        if self.day is None:
            self.day = today or other or ""
        if not year or not isinstance(self.day, int):
            self._nights += self._last - at > HALF_DAY
            self._last = at
            return DAY * self._nights + at
        return DAY * (today - self.day) + at


class Marks:
    """Decimal and thousands marks in columns, where the table's format does not say which is which."""

    def __init__(self, places: Sequence[int]) -> None:
        """Begin for the columns at some places."""
        self._kinds = {place: Counter[str]() for place in places}
        self._first: dict[tuple[int, str], tuple[int, str]] = {}

    def add(self, place: int, cell: str, line: int) -> None:
        """Count a cell by its mark: none, one that is a decimal mark, or one that may be a thousands mark (`?`)."""
        mark = "." if "." in cell else "," if "," in cell else ""
        if mark and GROUPED.fullmatch(cell) and not (mark == "." and "," in cell):
            mark += "?"
            self._first.setdefault((place, mark), (line, cell))
        self._kinds[place][mark] += 1

    def check(self, path: Path, names: Sequence[str]) -> None:
        """Refuse a cell as 1.760 if another cell's comma is the decimal mark, or no cell below 1000 has a mark."""
        sure = {mark for kinds in self._kinds.values() for mark in kinds}
        for (place, mark), (line, cell) in self._first.items():
            kinds, other = self._kinds[place], "," if mark == ".?" else "."
            whole = mark[0] not in kinds and min(kinds[""], kinds[mark]) >= SOME
            if other in sure or whole:
                sign = "point" if mark == ".?" else "comma"
                raise UsageError(
                    f"{path}: line {line}, column {names[place]}: the {sign} of {cell!r} may be a decimal or a "
                    "thousands mark; say which mark is the decimal one (table.decimal: '.' or ',' in a map)"
                )


def _number(cell: str, decimal: str, *, strict: bool = False) -> float:
    """Number in a cell, NaN if it is empty or not a number; a ValueError if it is something else.

    Args:
        cell: text of the cell.
        decimal: decimal mark; the other mark then is a thousands mark, if the digits are so grouped. Empty: both are
            decimal marks, and in a cell with both the last one.
        strict: refuse thousands marks too, if `decimal` is not empty.
    """
    text = cell.strip()
    if not text or NOT_A_NUMBER.fullmatch(text):
        return math.nan
    if "_" in text:  # which Python takes
        raise ValueError
    mark = decimal or ("," if text.rfind(",") > text.rfind(".") else ".")
    other = "." if mark == "," else ","
    if other in text:
        if (strict and decimal) or not GROUPED.fullmatch(text) or (mark in text and text.find(mark) < text.find(other)):
            raise ValueError
        text = text.replace(other, "")
    return float(text.replace(mark, ".", 1))


def _cause(cell: str, decimal: str) -> str:
    """Hint at the cause of a cell that has no number; `decimal` is the mark that is stated, if one is."""
    if decimal:
        other = "." if decimal == "," else ","
        said = f"; table.decimal says {decimal!r}, and digits are not grouped by {other!r}"
        return said if other in cell else ""
    if GROUPED.fullmatch(cell):
        return "; say which mark is the decimal one (table.decimal: '.' or ',' in a map)"
    return "; for decimal commas say table.decimal: ','" if "," in cell else ""


def _encoding(path: Path, table_format: TableFormat) -> str:
    """Encoding of a text file: the given one; UTF-16 if it has the mark; UTF-8 if it is valid, or else Windows-1252."""
    given = table_format.encoding
    try:
        if given != "auto":
            return codecs.lookup(given).name
        decoder = codecs.getincrementaldecoder("utf-8-sig")()
        with open_regular(path) as file:
            begin = file.peek(4096)[:4096]
            if begin[:2] in {b"\xff\xfe", b"\xfe\xff"}:
                return "utf-16"
            if b"\0" in begin:
                raise UsageError(f"{path} is not a text file")
            while block := file.read(2**20):
                decoder.decode(block)
            decoder.decode(b"", final=True)
    except LookupError:
        raise UsageError(f"table.encoding {given!r} is not known; as utf-8, cp1252, cp1251, mac-roman") from None
    except UnicodeDecodeError:
        return WINDOWS
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror}") from None
    return "utf-8-sig"


def _opened(path: Path, encoding: str) -> io.TextIOWrapper:
    return io.TextIOWrapper(open_regular(path), encoding=encoding, errors="replace", newline="")


def _lines(file: io.TextIOWrapper, path: Path) -> Iterator[str]:
    """Yield the lines of a file, whatever ends them."""
    while line := file.readline(LONGEST_LINE):
        if len(line) == LONGEST_LINE:
            raise UsageError(f"{path}: a line has more than {LONGEST_LINE} characters; it is no table")
        yield line.rstrip("\r\n")


def _rows(file: io.TextIOWrapper, path: Path, delimiter: str) -> Iterator[tuple[int, list[str]]]:
    """Yield the number and the cells of each row."""
    if delimiter == " ":
        yield from ((number, line.split()) for number, line in enumerate(_lines(file, path), start=1))
        return
    lines = csv.reader(_lines(file, path), delimiter=delimiter)
    try:
        for cells in lines:
            yield lines.line_num, cells
    except csv.Error as error:
        raise UsageError(f"{path}: line {lines.line_num} cannot be read: {error}") from None


def _is_number(text: str) -> bool:
    try:
        float(text.replace(",", ".", 1))
    except ValueError:
        return False
    return True


def some(names: Sequence[str]) -> str:
    """List names for an error message, `MOST_NAMES` at most."""
    more = len(names) - MOST_NAMES
    return ", ".join(names[:MOST_NAMES]) + (f" and {more} more" if more > 0 else "")


def meant(name: str, names: Sequence[str]) -> str:
    """Hint for a message: the column whose name is close to an unknown one, or all the names."""
    lower = {other.lower(): other for other in names if other}
    near = difflib.get_close_matches(name.lower(), lower, n=1, cutoff=0.6)
    return f"did you mean {lower[near[0]]}?" if near else f"it has {some([other for other in names if other])}"
