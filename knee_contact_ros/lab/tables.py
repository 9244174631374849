"""Columns over time from files of numbers: OpenSim's storage files (.sto, .mot), text tables, Parquet and C3D files.

A storage file has a header that ends with `endheader`, a line of column names, and numbers. Text tables may separate
columns by commas, semicolons, tabs or spaces, use decimal points or commas, and have more lines above and below the
names. `header_of` finds the names, `read_columns` reads columns.
"""

from __future__ import annotations

import codecs
import csv
import io
import math
import re
from array import array
from collections.abc import Collection, Iterator, Mapping, Sequence
from datetime import date
from itertools import islice
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy import constants

from knee_contact_ros.model.types import Floats, Stamps
from knee_contact_ros.parameters.schema import Section, one_of
from knee_contact_ros.streams.topics import NANOSECONDS
from knee_contact_ros.system.errors import UsageError, list_names, suggest
from knee_contact_ros.system.files import open_regular, require

Column = str | int
"""Name of a column, or its place from 1"""

STORAGES, PARQUETS, C3D = {".sto", ".mot"}, {".parquet", ".pq"}, ".c3d"
END = "endheader"
LAST_TIME = 2**31
"""First time [s] that a ROS stamp cannot hold"""
MOST_STANDING = 0.1
"""Largest fraction of rows that may have the same time as the next row"""
COMMENT = "#"
SEARCHED = 300
"""Number of lines at the beginning of a text table that are searched for its column names"""
HALF_DAY, DAY = 43_200.0, 86_400.0
"""[s]"""
TIME, ANGLE, FORCE, MOMENT, LENGTH = "time", "angle", "force", "moment", "length"
BODY_WEIGHT, PERCENT = "BW", "%BW"
"""Units of force that need the map's `body_weight`"""
NOT_A_NUMBER = re.compile(
    r"[-+]?(?:nan(?:\(\w*\))?|\d\.#\w+)|n/?a|#n/?a|#div/0!|null|none|-+", re.IGNORECASE
)
"""Texts for a missing number, or on Windows infinity: nan, -nan(ind), 1.#QNAN, -1.#IND, NA, #N/A, null, -"""
GROUPED = re.compile(r"[-+]?[1-9]\d{0,2}(?:(?:\.\d{3})+(?:,\d*)?|(?:,\d{3})+(?:\.\d*)?)")
"""Numbers that may have a thousands mark: in 1.760 and 1,760 it may also be a decimal mark; 1.760,5 has one"""
DECIMAL_COMMA = re.compile(r"\s*[-+]?(?:0,\d+|\d+,(?:\d{1,2}|\d{4,}))(?![^\s;])")
"""Beginning of a row whose time has a decimal comma"""
CLOCK = re.compile(
    r"(?:(\d{4})[-/](\d\d?)[-/](\d\d?)[ T]+|([^:]*?)[ ,]+)?(?:(\d+):)?([0-5]?\d):([0-5]?\d(?:[.,]\d+|:\d{3})?)"
    r"(?: *([ap])\.?m\.?)?(?: *(Z|UTC|GMT|[-+]\d\d(?::?\d\d)?))?",
    re.IGNORECASE,
)
"""A time of day: an ISO date or another one, hours, minutes, seconds, am or pm, zone; only minutes and seconds are
required"""
BRACKETED = re.compile(r"(?:[\[(]([^\[(\])]+)[\])]|_([a-zµ°%]+))$", re.IGNORECASE)
"""A unit at the end of a name: Force [N], time_ms"""
SOME = 3
"""Number of cells that show how a column writes its numbers"""
UNITS: dict[str, dict[str, float]] = {
    TIME: {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    ANGLE: {"rad": 1.0, "deg": constants.degree, "mrad": 1e-3, "rev": 2.0 * math.pi},
    FORCE: {
        "N": 1.0,
        "kN": 1e3,
        "mN": 1e-3,
        "lbf": constants.lbf,
        "kgf": constants.kgf,
        BODY_WEIGHT: 1.0,
        PERCENT: 0.01,
    },
    MOMENT: {
        "N*m": 1.0,
        "N*mm": 1e-3,
        "kN*m": 1e3,
        "lbf*in": constants.lbf * constants.inch,
        "lbf*ft": constants.lbf * constants.foot,
    },
    LENGTH: {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6},
}
"""Factors of units to s, rad, N (or body weights), N m and m, by quantity"""
ALIASES = {
    "sec": "s",
    "second": "s",
    "seconds": "s",
    "µs": "us",
    "μs": "us",
    "degree": "deg",
    "degrees": "deg",
    "°": "deg",
    "radian": "rad",
    "radians": "rad",
    "newton": "N",
    "newtons": "N",
    "lb": "lbf",
    "lbs": "lbf",
    "kp": "kgf",
    "kg": "kgf",
    "µm": "um",
    "μm": "um",
    "xbw": BODY_WEIGHT,
    "percentbw": PERCENT,
}
SPELT = {
    unit.replace("*", "").lower(): unit
    for units in UNITS.values()
    for unit in units
    if unit != "mN"
} | ALIASES
"""Units by what `spelt` leaves of them; MN is not mN"""
OTHER_UNITS = {"g", "V", "mV", "W", "Hz"}
"""Units of other quantities, which only a factor can turn into one of ours"""
PLACED = (
    "; where the file is wrong, name the column by its place (column: 2), and the first row below the units "
    "(table.first_line)"
)
"""What helps against a wrong unit in a file"""
MIDDLE_WEIGHT = 700.0
"""Weight of a body [N] where none is given and only its order counts"""
CALIBRATES = math.log(2.0)
"""Logarithm of a factor that may still be a sensor's calibration; larger ones convert a unit"""


class Table(NamedTuple):
    """Columns over time. OpenSim may write several rows with one stamp; only the last of them is kept."""

    path: Path
    names: tuple[str, ...]
    """Names of the columns, without time"""
    stamps: Stamps
    """[ns], increasing; shape (n,)"""
    values: Floats
    """Shape (n, columns)"""
    degrees: bool | None
    """Value of `inDegrees` in a storage file's header; None: there is none"""
    duplicates: int
    """Number of rows left out because a later one has the same stamp"""
    day: int | str | None = None
    """Day of the first row where times are frames or times of day: the day number of an ISO date, the text of another
    date, empty without a date; None: times are seconds of one clock"""
    units: Mapping[Column, str] = {}
    """What the file says of the units of columns"""
    notes: tuple[str, ...] = ()
    """How the file was read, as sentences"""
    doubts: tuple[str, ...] = ()
    """What is likely a damage of the file, as sentences"""

    def columns(self, names: Sequence[Column]) -> Floats:
        """Return columns by their names, shape (n, columns).

        Raises:
            UsageError: a column is missing or there twice.
        """
        header = Header(self.path, self.names)
        return self.values[:, [header.place(name) for name in names]]

    def column(self, name: str) -> Floats:
        """Return a column by its name, shape (n,).

        Raises:
            UsageError: the column is missing or there twice, or has a value that is not finite.
        """
        values = self.columns([name])[:, 0]
        if not np.isfinite(values).all():
            row = int(np.argmin(np.isfinite(values)))
            fault = f"{self.path}: column {name} is {values[row]} at {self.time(row)} s"
            raise UsageError(f"{fault}; it must be a finite number")
        return values

    def needed(self, names: Sequence[str], start: float | None, end: float | None) -> Table:
        """Leave out rows before `start` or after `end` [s] that lack a number in one of the columns `names`."""
        first, last = (
            edge if s is None else s * NANOSECONDS
            for s, edge in ((start, -math.inf), (end, math.inf))
        )
        return self.rows(
            (self.stamps >= first) & (self.stamps <= last)
            | np.isfinite(self.columns(names)).all(axis=1)
        )

    def rows(self, kept: NDArray[np.bool_]) -> Table:
        """Select rows by booleans, shape (n,)."""
        return self._replace(stamps=self.stamps[kept], values=self.values[kept])

    def time(self, row: int) -> str:
        """Return the time [s] of a row as text."""
        return f"{self.stamps[row] / NANOSECONDS:g}"


class Series(NamedTuple):
    """Quantity over time, in SI units and the package's signs."""

    name: str
    """Name of the quantity"""
    path: Path
    """File from which it was read"""
    columns: str
    """Text that names the columns and their weights"""
    stamps: Stamps
    """[ns], increasing; shape (n,)"""
    values: Floats
    """Shape (n,)"""
    notes: tuple[str, ...] = ()
    """What was left out, as sentences"""
    doubts: tuple[str, ...] = ()
    """What is likely a damage of the file, as sentences"""

    @property
    def where(self) -> str:
        """Text with file and columns, for messages."""
        return f"{self.path}: {self.columns}"


class TableFormat(Section):
    """Format of the files, where it cannot be recognised."""

    header_line: int | None = Field(
        None,
        ge=1,
        description="line with the names; default: the one with most of the names that the map has",
    )
    first_line: int | None = Field(
        None, ge=2, description="line of the first row; default: the first with a number"
    )
    delimiter: str | None = Field(
        None, min_length=1, max_length=1, description="default: as the names are divided"
    )
    decimal: Annotated[str, one_of("auto", ".", ",")] = Field(
        "auto", description="auto: a comma where columns are not divided by commas"
    )
    encoding: str = Field(
        "auto", description="as Python names it; auto: UTF-8, UTF-16 by its mark, or Windows-1252"
    )
    rows: dict[str, str | int | float] = Field(
        {}, description="take only rows with these values in these columns"
    )


class TimeColumn(Section):
    """Time of each row."""

    column: Column = Field(
        "time", description="numbers of `unit`, times of day, or with `rate` frames"
    )
    unit: str = "s"
    rate: float | None = Field(
        None,
        gt=0.0,
        le=1e6,
        description="[Hz] of the frames in `column`, or without `column` of the rows",
    )
    offset: float = Field(
        0.0, description="[s] added, so that recordings with large times begin near 0"
    )

    @property
    def places(self) -> list[Column]:
        """The column, if there is one."""
        return [] if self.rate and "column" not in self.model_fields_set else [self.column]


class Header(NamedTuple):
    """Names of a file's columns, and what is needed to read them."""

    path: Path
    names: tuple[str, ...]
    line: int = 0
    """Number of the line that has the names, counted from 1; 0: there is none"""
    delimiter: str = ""
    """Character between columns; a space stands for any number of blanks"""
    text: str = ""
    """The whole of a text file"""
    above: tuple[tuple[str, ...], ...] = ()
    """Lines right above the names with the same columns, such as names of sensors over their columns X, Y, Z"""
    entries: Mapping[str, str] | None = None
    """Entries above `endheader` in a storage file, by names in lower case"""
    decimal: str = ""
    """Decimal mark of a storage file"""
    data: Floats | None = None
    """Numbers of a C3D file, shape (n, columns)"""
    notes: tuple[str, ...] = ()
    """How the file was read, as sentences"""

    @property
    def degrees(self) -> bool | None:
        """Value of `inDegrees` in a storage file's header; None: there is none."""
        return {"yes": True, "no": False}.get((self.entries or {}).get("indegrees", "").lower())

    def places(self, name: Column) -> list[int]:
        """Indices of the columns with a place (from 1) or a name: `X`, or `KneeAngles.X` with the name above it."""
        if isinstance(name, int):
            return [name - 1] if 1 <= name <= len(self.names) else []
        found = [place for place, each in enumerate(self.names) if each == name]
        return found or [
            place for place in range(len(self.names)) if name in self.qualified(place)
        ]

    def qualified(self, place: int) -> list[str]:
        """Names of a column with those above it, also without the part before their colon."""
        above = [line[place] for line in self.above if line[place]]
        names = dict.fromkeys(each for name in above for each in (name, name.rpartition(":")[2]))
        return [f"{name}.{self.names[place]}" for name in names]

    def place(self, name: Column) -> int:
        """Index of a column; refuse one that is missing or there twice."""
        found = self.places(name)
        if len(found) > 1:
            full = [self.qualified(place)[:1] for place in found]
            cure = (
                f"say which: {', '.join(each[0] for each in full)}"
                if all(full)
                else "their names must differ"
            )
            raise UsageError(f"{self.path} has {len(found)} columns {name}; {cure}")
        if not found:
            hint = suggest(str(name), self.names, f"it has {list_names(self.names)}")
            raise UsageError(f"{self.path} has no column {name}; {hint}")
        return found[0]


def spelt(unit: str) -> str:
    """Unit as `UNITS` has it, however it is written: KN, N.m, Degrees; a text that is no such unit stays as it is."""
    return SPELT.get(re.sub(r"[\s.*·⋅-]", "", unit).lower(), unit)


def factor(unit: str, kind: str, what: str, body_weight: float | None = None) -> float:
    """Factor of a unit to SI; `kind` is the quantity it must measure, `what` names the value in messages.

    Raises:
        UsageError: the unit is not one of this quantity, or needs the missing `body_weight` [N].
    """
    name, factors = spelt(unit), UNITS[kind]
    if name not in factors:
        raise UsageError(
            f"{what}: unit {unit!r} is not one of a {kind}; allowed: {', '.join(factors)}"
        )
    if name not in {BODY_WEIGHT, PERCENT}:
        return factors[name]
    if body_weight is None:
        raise UsageError(f"{what}: unit {name} needs body_weight [N] in the map")
    return factors[name] * body_weight


def header_of(path: Path, wanted: Collection[Column], table_format: TableFormat) -> Header:
    """Names of the columns of a file, time included; `wanted` are the ones to look for.

    Raises:
        UsageError: the file cannot be read, or has no names.
    """
    suffix = path.suffix.lower()
    if suffix in STORAGES:
        return storage_header(path)
    if suffix == C3D:
        return _c3d_header(path)
    if suffix not in PARQUETS:
        return _text_header(path, wanted, table_format)
    require("tables", "pandas", "pyarrow")
    import pyarrow as pa
    from pyarrow.parquet import read_schema

    try:
        return Header(path, tuple(read_schema(path).names))
    except (OSError, pa.ArrowException) as error:
        raise _unreadable(path, error) from None


def _unreadable(path: Path, error: Exception) -> UsageError:
    return UsageError(f"cannot read {path}: {' '.join(str(error).split())[:200]}")


def storage_header(path: Path) -> Header:
    """Names and header of a storage file.

    OpenSim 4.6 writes an empty header and parts of a second one in `*_states.sto`, so the names are the line right
    above the numbers. Tabs or commas may separate columns; with tabs, names may contain blanks.

    Raises:
        UsageError: the file cannot be read, or is no storage file.
    """
    text, _ = _text_of(path)
    lines = [line.strip() for line in _each_line(text)]
    end = next((number for number, line in enumerate(lines) if line.lower() == END), None)
    if end is None:
        raise UsageError(
            f"{path} is not an OpenSim storage file (.sto, .mot): it has no line {END}"
        )
    entries = {
        key.strip().lower(): value.strip()
        for key, _, value in (line.partition("=") for line in lines[:end])
    }
    if entries.get("datatype", "double").lower() != "double":
        raise UsageError(
            f"{path} holds {entries['datatype']} (DataType in its header); only numbers can be read"
        )
    below = [number for number in range(end + 1, len(lines)) if lines[number]]
    first = next(
        (n for n, line in enumerate(below) if _is_number(re.split(r"[\s,;]+", lines[line])[0])), 0
    )
    if not first:
        raise UsageError(f"{path} has no rows below its names")
    place, rows = below[first - 1], [lines[number] for number in below[first:]]
    delimiter = next((mark for mark in "\t;," if mark in lines[place]), " ")
    names = _cells(lines[place], delimiter)
    if names[0].lower() != TIME:
        raise UsageError(f"{path}: its first column is {names[0]}, and must be {TIME}")
    comma = not any("." in row for row in rows) and any(map(DECIMAL_COMMA.match, rows))
    return Header(
        path, tuple(names), place + 1, delimiter, text, (), entries, "," if comma else "."
    )


def read_storage(path: Path) -> Table:
    """Read all columns of a storage file; a cell that is not a number is NaN.

    Raises:
        UsageError: the file cannot be read, is no storage file, or its times decrease.
    """
    header = storage_header(path)
    numbers, _, _ = read_numbers(header, range(len(header.names)), TableFormat(), strict=False)
    return _over_time(header, header.names[1:], TIME, numbers[:, 0], numbers[:, 1:])


def repaired(path: Path) -> str:
    """Return a storage file's text with a single header that fits its table, as OpenSim itself reads it.

    Raises:
        UsageError: the file cannot be read, or is no storage file.
    """
    header = storage_header(path)
    rows = [
        line.rstrip("\n")
        for line in islice(_each_line(header.text), header.line, None)
        if line.strip()
    ]
    top = ["states", "version=1", f"nRows={len(rows)}", f"nColumns={len(header.names)}"]
    return (
        "\n".join(
            [
                *top,
                f"inDegrees={'yes' if header.degrees else 'no'}",
                END,
                "\t".join(header.names),
                *rows,
            ]
        )
        + "\n"
    )


def _c3d_header(path: Path) -> Header:
    """Read the points of a C3D file, as RKneeAngles.X, and its analog channels at the times of the points."""
    require("c3d", "ezc3d")
    import ezc3d

    try:
        read: Any = ezc3d.c3d(str(path))
    except (OSError, ValueError, RuntimeError) as error:
        raise UsageError(f"cannot read {path}: {error}") from None
    points, analogs, header = (
        read["data"]["points"][:3],
        read["data"]["analogs"][0],
        read["header"]["points"],
    )
    labels, channels = (
        read["parameters"][kind]["LABELS"]["value"] for kind in ("POINT", "ANALOG")
    )
    rows = points.shape[2]
    if not rows:
        raise UsageError(f"{path} has no points over time")
    times = (header["first_frame"] + np.arange(rows)) / header["frame_rate"]
    columns = [
        times,
        *points.transpose(1, 0, 2).reshape(-1, rows),
        *analogs[:, :: max(1, analogs.shape[1] // rows)],
    ]
    names = [
        f"{label.rpartition(':')[2]}.{axis}"
        for label in labels[: points.shape[1]]
        for axis in "XYZ"
    ]
    return Header(path, (TIME, *names, *channels[: len(analogs)]), data=np.column_stack(columns))


def _text_header(path: Path, wanted: Collection[Column], table_format: TableFormat) -> Header:
    """Find the names of a text file's columns: the line that has most of those `wanted`, or else the first line.

    The line may begin with `#`. Raises a `UsageError` for a file that is empty, or has numbers instead of names.
    """
    (text, notes), given = _text_of(path, table_format.encoding), table_format.header_line
    lines = [line.rstrip("\n") for line in islice(_each_line(text), max(SEARCHED, given or 0))]
    there = {number: line for number, line in enumerate(lines, start=1) if line.strip()}
    content = [number for number, line in there.items() if not line.startswith(COMMENT)]
    if not content:
        raise UsageError(f"{path} is empty")
    if given and given not in there:
        raise UsageError(f"{path} has no names in line {given} (table.header_line)")
    marks = {
        n: table_format.delimiter or next((m for m in ";\t,|" if m in line), " ")
        for n, line in there.items()
    }
    cells = {number: _cells(line.lstrip(COMMENT), marks[number]) for number, line in there.items()}
    asked = {
        part
        for name in wanted
        if isinstance(name, str)
        for part in (name, name.rpartition(".")[2])
    }
    line = given or max(
        there, key=lambda number: (len(asked.intersection(cells[number])), number in content)
    )
    if not given and not asked.intersection(cells[line]):
        line, least = content[0], max([1, *(name for name in wanted if isinstance(name, int))])
        rows = [
            n
            for n in content
            if len(cells[n]) >= least and all(map(_is_number, filter(None, cells[n])))
        ]
        if not asked and rows:  # columns by their places need no names
            names = tuple(str(place) for place in range(1, len(cells[rows[0]]) + 1))
            return Header(path, names, rows[0] - 1, marks[rows[0]], text, notes=notes)
    if all(_is_number(name) for name in cells[line] if name):
        raise UsageError(
            f"{path}: line {line} has numbers, and must have the columns' names; put a line with them on top, say "
            "where they are (table.header_line), or name columns by their place (column: 2)"
        )
    above, width = [], len(cells[line])
    for number in range(line - 1, 0, -1):
        over = _cells(lines[number - 1].lstrip(COMMENT), marks[line])
        if len(over) < 2:
            break
        filled = [""]
        for cell in (over + [""] * width)[:width]:
            filled.append(cell or filled[-1])
        above.append(tuple(filled[1:]))
    return Header(path, tuple(cells[line]), line, marks[line], text, tuple(above), notes=notes)


def _text_of(path: Path, encoding: str = "auto") -> tuple[str, tuple[str, ...]]:
    """Text of a file, and a note on its encoding: UTF-16 if it has the mark, else UTF-8 if valid, else Windows-1252."""
    try:
        with open_regular(path) as file:
            data = file.read()
        if encoding != "auto":
            return data.decode(codecs.lookup(encoding).name, errors="replace"), ()
        if data[:2] in {b"\xff\xfe", b"\xfe\xff"}:
            return data.decode("utf-16", errors="replace"), ()
        if b"\0" in data[:4096]:
            raise UsageError(f"{path} is not a text file")
        return data.decode("utf-8-sig"), ()
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror}") from None
    except (LookupError, ValueError):
        if encoding != "auto":
            what = f"table.encoding {encoding!r} is not known, or not of {path.name}"
            raise UsageError(f"{what}; as utf-8, cp1252, cp1251, mac-roman") from None
        note = f"{path.name} is not in UTF-8, and was read as Windows-1252 (table.encoding)"
        return data.decode("cp1252", errors="replace"), (note,)


def read_columns(
    header: Header, wanted: Sequence[Column], time: TimeColumn, table_format: TableFormat
) -> Table:
    """Read the columns `wanted` of a file over time; an empty cell is read as NaN.

    Raises:
        UsageError: a column is missing or there twice, a cell is not a number, or times stand still or decrease.
    """
    path, own = header.path, header.entries is not None or header.data is not None
    timed: list[Column] = [TIME] if own else time.places
    places, rate = [header.place(name) for name in (*timed, *wanted)], None if own else time.rate
    numbers, below, day = read_numbers(header, places, table_format, len(timed))
    if not len(numbers):
        raise UsageError(f"{path} has no rows below its names (line {header.line})")
    units = {
        name: below.get(place, "")
        or _bracketed(header.names[place] if isinstance(name, str) else "")
        for name, place in zip((*timed, *wanted), places, strict=True)
    }
    first = numbers[:, 0] if timed else np.arange(len(numbers), dtype=np.float64)
    notes: tuple[str, ...] = ()
    seconds = (
        1.0 if own or day is not None else 1.0 / rate if rate else factor(time.unit, TIME, "time")
    )
    if rate and day is None:
        if odd := [each for each in first if each % 1.0]:
            raise UsageError(
                f"{path}: column {time.column} has {odd[0]:g}, and with time.rate it must count frames"
            )
        day = ""
    elif day is None:
        notes = check_unit(path, timed[0], units[timed[0]], time.unit, "time.unit")
    column = timed[0] if timed else time.column
    values = numbers[:, len(timed) :]
    table = _over_time(
        header, [str(name) for name in wanted], column, first * seconds + time.offset, values
    )
    if table.duplicates > MOST_STANDING * len(numbers):
        raise UsageError(
            f"{path}: in {table.duplicates} of {len(numbers)} rows column {time.column} has the value of the next row; "
            f"is it the time, in {time.unit}, with enough digits?"
        )
    return table._replace(day=day, units=units, notes=table.notes + notes)


def check_unit(
    path: Path,
    column: Column,
    said: str,
    unit: str,
    what: str,
    *,
    times: float = 1.0,
    cure: str = PLACED,
) -> tuple[str, ...]:
    """Refuse a unit that contradicts what the file says of a column; return a note if that is not known.

    `what` names the given unit. The column is multiplied by `times`, which may convert it from one unit to the other.
    """
    theirs, note = (
        spelt(said.lstrip("_")),
        f"{path.name}: {said!r} is not a known unit ({what} {unit})",
    )
    kind = next(kind for kind, units in UNITS.items() if spelt(unit) in units)
    known, ratio = theirs in UNITS[kind], 1.0
    if not said or NOT_A_NUMBER.fullmatch(said) or theirs == spelt(unit):
        return ()
    if said == "_n" or (
        said[0] == "_" and not known
    ):  # the normal load, and load_m the medial one
        return ()
    if known:
        ratio = factor(theirs, kind, what, MIDDLE_WEIGHT) / factor(unit, kind, what, MIDDLE_WEIGHT)
    own, off = (abs(math.log(abs(times) / each)) for each in (1.0, ratio))
    other = theirs in {*SPELT.values(), *OTHER_UNITS} or "/" in theirs
    if off >= min(own, CALIBRATES) if known else own < CALIBRATES and other:
        raise UsageError(
            f"{path} says {said.lstrip('_')} of column {column}, and {what} {unit}{cure}"
        )
    return (note,) if own < CALIBRATES and not known else ()


def _over_time(
    header: Header, names: Sequence[str], column: Column, seconds: Floats, values: Floats
) -> Table:
    """Make a table from times [s], read from `column`, and columns `names`, shape (n, columns).

    Raises:
        UsageError: a time is not a number, or cannot be a stamp, or times decrease.
    """
    path = header.path
    wrong = ~(np.abs(seconds) < LAST_TIME)
    if wrong.any():
        row = int(np.argmax(wrong))
        fault = f"{path}: column {column} is {seconds[row]:g} s in row {row + 1}"
        raise UsageError(f"{fault}; it must be a time below {LAST_TIME} s")
    stamps = np.rint(seconds * NANOSECONDS).astype(np.int64)
    steps = np.diff(stamps)
    if (steps < 0).any():
        row = int(np.argmax(steps < 0))
        before, after = stamps[row : row + 2] / NANOSECONDS
        raise UsageError(
            f"{path}: time goes back from {before:.7g} to {after:.7g} s (rows {row + 1}, {row + 2}); of several "
            "recordings choose one (table.rows in the map)"
        )
    last = np.append(steps > 0, True)
    twice = int(np.count_nonzero(~last))
    notes = (
        *header.notes,
        *(f"{path.name}: {twice} rows gave way to the next with the same time",) * bool(twice),
    )
    said, cut = (
        (header.entries or {}).get("nrows", ""),
        f"{path} has {len(seconds)} rows, and its header says nRows=",
    )
    doubts = (f"{cut}{said}: is it cut off?",) * (said.isdecimal() and float(said) > len(seconds))
    return Table(
        path,
        tuple(names),
        stamps[last],
        values[last],
        header.degrees,
        twice,
        notes=notes,
        doubts=doubts,
    )


def read_numbers(
    header: Header,
    places: Sequence[int],
    table_format: TableFormat,
    times: int = 0,
    *,
    strict: bool = True,
) -> tuple[Floats, dict[int, str], int | str | None]:
    """Read the columns at some places of a file, shape (rows, places), NaN where a number is missing.

    The first `times` places, 0 or 1, may have times of day, which become seconds. Also returns the texts of a row right
    below the names by column, and the day of the first time of day, as in `Table`.

    Raises:
        UsageError: a cell is not a number and reading is `strict`, or a line has another number of columns
            than there are names.
    """
    if header.data is not None:
        return header.data[:, places], {}, None
    if header.path.suffix.lower() in PARQUETS:
        return _parquet(header, places, table_format), {}, None
    stated = header.decimal or (table_format.decimal if table_format.decimal != "auto" else "")
    decimal, thousands = (
        stated or "." * (header.delimiter == ","),
        not header.decimal and bool(stated),
    )
    flat, units, clock = array("d"), dict[int, str](), Clock()
    marks: dict[tuple[int, str], list[Any]] = {}
    for line, cells in _records(header, table_format, units):
        for number, place in enumerate(places):
            cell = cells[place].strip()
            try:
                is_clock = number < times and ":" in cell
                value = (
                    clock.seconds(cell)
                    if is_clock
                    else _number(cell, decimal, thousands or not decimal)
                )
            except ValueError:
                if strict:
                    cure = "table.decimal ('.' or ',') says which mark is the decimal one, table.rows which rows count"
                    fault = f"{header.path}: line {line}, column {header.names[place]}: {cell[:40]!r} is not a number"
                    raise UsageError(f"{fault}; {cure}") from None
                value = math.nan
            flat.append(value)
            if not stated:
                mark = "." if "." in cell else "," * ("," in cell)
                unsure = (
                    bool(mark) and GROUPED.fullmatch(cell) and not (mark == "." and "," in cell)
                )
                marks.setdefault((place, mark + "?" * bool(unsure)), [0, line, cell])[0] += 1
    _check_marks(header, marks)
    return np.array(flat).reshape(-1, len(places)), units, clock.day


def _check_marks(header: Header, marks: Mapping[tuple[int, str], list[Any]]) -> None:
    """Refuse a cell like 1.760 if other cells have a decimal comma, or no cell below 1000 has a mark.

    `marks` counts cells by column and mark: none, a decimal one, or one that may be a thousands mark (`.?`); with the
    line and text of the first.
    """
    for (place, mark), (count, line, cell) in marks.items():
        other = "," if mark == ".?" else "."
        whole = (place, mark[:1]) not in marks and min(
            count, marks.get((place, ""), [0])[0]
        ) >= SOME
        if mark[1:] and (whole or any(each == other for _, each in marks)):
            raise UsageError(
                f"{header.path}: line {line}, column {header.names[place]}: the {'comma' if other == '.' else 'point'} "
                f"of {cell!r} may be a decimal or a thousands mark; say which mark is the decimal one (table.decimal: "
                "'.' or ',' in a map)"
            )


def _parquet(header: Header, places: Sequence[int], table_format: TableFormat) -> Floats:
    """Read the columns at some places of a Parquet file, shape (rows, places)."""
    import pyarrow as pa
    from pyarrow import compute as pc
    from pyarrow.parquet import read_table

    kept = pc.scalar(True)
    for name, value in table_format.rows.items():
        texts = pa.array([str(value), str(value).removesuffix(".0")])  # Arrow writes 1.0 as 1
        kept &= pc.field(header.names[header.place(name)]).cast(pa.string()).isin(texts)
    names = [header.names[place] for place in places]
    try:
        table = read_table(header.path, columns=list(dict.fromkeys(names)), filters=kept)
        frame = table.to_pandas(ignore_metadata=True)  # which may make the time an index
        return np.column_stack([frame[name].to_numpy(np.float64) for name in names])
    except (OSError, pa.ArrowException) as error:
        raise _unreadable(header.path, error) from None
    except (ValueError, TypeError) as error:
        fault = " ".join(str(error).split())[:200]
        raise UsageError(f"{header.path}: {', '.join(names)} must be numbers: {fault}") from None


def _records(
    header: Header, table_format: TableFormat, units: dict[int, str]
) -> Iterator[tuple[int, list[str]]]:
    """Yield number and cells of each row below the names; `units` gets the cells of a row of texts above the numbers.

    A blank line ends a table if one of another width follows.
    """
    width, first, blank = len(header.names), table_format.first_line, False
    begun = first is not None or header.entries is not None
    chosen = {header.place(name): str(value) for name, value in table_format.rows.items()}
    for line, cells in _lines(header):
        if line < (first or header.line + 1) or not any(cells) or cells[0].startswith(COMMENT):
            blank = not any(cells)
            continue
        begun = begun or any(_is_number(cell) or CLOCK.fullmatch(cell) for cell in cells)
        if not begun:
            units |= {
                place: cell.strip(" []()")
                for place, cell in enumerate(cells)
                if not units.get(place)
            }
            continue
        if blank and len(cells) == 1 < width:
            return
        if len(cells) < width or any(cells[width:]):
            raise UsageError(
                f"{header.path}: line {line} has {len(cells)} columns, and the names are {width}"
            )
        blank = False
        if all(cells[place].strip() == value for place, value in chosen.items()):
            yield line, cells


def _each_line(text: str) -> io.StringIO:
    """Iterate over the lines of a text, with the line ends of any system replaced by newlines."""
    return io.StringIO(text, newline=None)


def _lines(header: Header) -> Iterator[tuple[int, list[str]]]:
    """Yield number and cells of each line of a text file."""
    file, mark, between = _each_line(header.text), header.delimiter, len(header.names) - 1
    if mark == " " or header.entries is not None:
        for number, text in enumerate(file, start=1):
            divided = mark != " " and text.count(mark) == between
            yield number, text.rstrip("\n").split(mark) if divided else text.split()
        return
    lines = csv.reader(file, delimiter=mark)
    try:
        for cells in lines:
            yield lines.line_num, cells
    except csv.Error as error:
        raise UsageError(f"{header.path}: line {lines.line_num} cannot be read: {error}") from None


class Clock:
    """Reads times of day, also across midnight; times with a zone become UTC."""

    def __init__(self) -> None:
        """Begin before the first time."""
        self.day: int | str | None = None
        """Day of the first row, as for `Table`"""
        self._last, self._nights = 0.0, 0

    def seconds(self, cell: str) -> float:
        """Time [s] since the midnight before the first row; a ValueError if a cell has no time."""
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
            at -= float(f"{zone[0]}1") * (
                3600.0 * int(zone[1:3]) + 60.0 * int(zone[3:].strip(":") or 0)
            )
        today = date(int(year), int(month), int(day)).toordinal() if year else 0
        if self.day is None:
            self.day = today or other or ""
        if not year or not isinstance(self.day, int):
            self._nights += self._last - at > HALF_DAY
            self._last = at
            return DAY * self._nights + at
        return DAY * (today - self.day) + at


def _number(cell: str, decimal: str, thousands: bool) -> float:
    """Number in a cell, NaN if it is empty or says that it is missing; a ValueError for any other text.

    Args:
        cell: text of the cell.
        decimal: decimal mark; empty: either, and in a cell with both the last one.
        thousands: whether the other mark may be a thousands mark, where the digits are grouped like that.
    """
    if not cell or NOT_A_NUMBER.fullmatch(cell):
        return math.nan
    if "_" in cell:  # which Python takes
        raise ValueError
    mark = decimal or ("," if cell.rfind(",") > cell.rfind(".") else ".")
    other = "." if mark == "," else ","
    if other in cell:
        if (
            not thousands
            or not GROUPED.fullmatch(cell)
            or (mark in cell and cell.find(mark) < cell.find(other))
        ):
            raise ValueError
        cell = cell.replace(other, "")
    return float(cell.replace(mark, ".", 1))


def _cells(line: str, delimiter: str) -> list[str]:
    cells = line.split() if delimiter == " " else next(csv.reader([line], delimiter=delimiter), [])
    return [cell.strip() for cell in cells]


def _bracketed(name: str) -> str:
    """Unit at the end of a name, with `_` before one that may be another word."""
    match = BRACKETED.search(name)
    return (match[1] or f"_{match[2]}").strip() if match else ""


def _is_number(text: str) -> bool:
    try:
        float(text.replace(",", ".", 1))
    except ValueError:
        return False
    return True
