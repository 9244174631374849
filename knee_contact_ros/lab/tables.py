"""Columns over time from files of numbers; `headers.header_of` finds their names, `read_columns` reads columns.

Text tables may have decimal points or commas, and times of day.
"""

from __future__ import annotations

import csv
import math
import re
from array import array
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from ..model.types import Floats, Stamps
from ..parameters.sections import Section
from ..streams.topics import NANOSECONDS
from ..system.errors import UsageError
from .cells import GROUPED, TIME_OF_DAY, Clock, is_number, parse_number
from .headers import (
    COMMENT,
    END_OF_HEADER,
    PARQUET_SUFFIXES,
    Header,
    TableFormat,
    each_line,
    storage_header,
    unreadable,
)
from .units import UNIT_FACTORS, ColumnName, check_unit, unit_factor, unit_name

_LAST_TIME = 2**31
"""First time [s] that a ROS stamp cannot hold"""
_FEW_CELLS = 3
"""Number of cells that show how a column writes its numbers. Tuned; see test_tables.py"""
_UNIT_IN_NAME = re.compile(r"(?:[\[(]([^\[(\])]+)[\])]|_([a-zµ°%]+))$", re.IGNORECASE)
"""A unit at the end of a name: Force [N], time_ms"""

_Mark = tuple[int, str, bool]
"""How a cell writes its number: index of its column, mark, and whether that may be a decimal or a thousands mark"""


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
    units: Mapping[ColumnName, str] = {}
    """What the file says of the units of columns"""
    notes: tuple[str, ...] = ()
    """How the file was read, as sentences"""
    doubts: tuple[str, ...] = ()
    """What is likely a damage of the file, as sentences"""

    def columns(self, names: Sequence[ColumnName]) -> Floats:
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
        finite = np.isfinite(values)
        if not finite.all():
            row = int(np.argmin(finite))
            fault = f"{self.path}: column {name} is {values[row]} at {self.time(row)} s"
            raise UsageError(
                f"{fault}; it must be a finite number: mend the row, or leave it out by --start and --end"
            )
        return values

    def needed(self, names: Sequence[str], start: float | None, end: float | None) -> Table:
        """Leave out rows before `start` or after `end` [s] that lack a number in one of the columns `names`."""
        first = -math.inf if start is None else start * NANOSECONDS
        last = math.inf if end is None else end * NANOSECONDS
        inside = (self.stamps >= first) & (self.stamps <= last)
        return self.rows(inside | np.isfinite(self.columns(names)).all(axis=1))

    def rows(self, kept: NDArray[np.bool_]) -> Table:
        """Select rows by booleans, shape (n,)."""
        return self._replace(stamps=self.stamps[kept], values=self.values[kept])

    def time(self, row: int) -> str:
        """Return the time [s] of a row as text."""
        return f"{self.stamps[row] / NANOSECONDS:.13g}"


class TimeSeries(NamedTuple):
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


class TimeColumn(Section):
    """Time of each row."""

    column: ColumnName = "time"
    """Numbers of `unit`, times of day, or with `rate` frames"""
    unit: str = "s"
    rate: float | None = Field(None, gt=0.0, le=1e6)
    """[Hz] of the frames in `column`, or without `column` of the rows"""
    offset: float = 0.0
    """[s] added, so that recordings with large times begin near 0"""

    @property
    def places(self) -> list[ColumnName]:
        """The column, if there is one."""
        return [] if self.rate and "column" not in self.model_fields_set else [self.column]


def read_columns(
    header: Header, wanted: Sequence[ColumnName], time: TimeColumn, table_format: TableFormat
) -> Table:
    """Read the columns `wanted` of a file over time; an empty cell is read as NaN.

    Raises:
        UsageError: a column is missing or there twice, a cell is not a number, or times stand still or decrease.
    """
    path = header.path
    # Storage and C3D files have times in seconds, whatever the map says.
    in_seconds = header.entries is not None or header.data is not None
    time_columns: list[ColumnName] = ["time"] if in_seconds else time.places
    names = [*time_columns, *wanted]
    places = [header.place(name) for name in names]
    numbers, below, day = read_numbers(header, places, table_format, len(time_columns))
    if not len(numbers):
        raise UsageError(f"{path} has no rows below its names (line {header.line})")
    units = {
        name: (below.get(place) or _unit_in_name(name))
        if isinstance(name, str)
        else ("" if header.data is not None else below.get(place, ""))
        for name, place in zip(names, places, strict=True)
    }
    times = numbers[:, 0] if time_columns else np.arange(float(len(numbers)))
    notes: tuple[str, ...] = ()
    if day is None and not in_seconds:
        if time.rate:
            if fractions := times[times % 1.0 != 0.0].tolist():
                raise UsageError(
                    f"{path}: column {time.column} has {fractions[0]:g}, and with time.rate it must count frames"
                )
            times = times * (1.0 / time.rate)
            day = ""
        else:
            times = times * unit_factor(time.unit, "time", "time")
            stated = units[time.column]
            notes = check_unit(path, time.column, stated, time.unit, "time.unit")
    column = time_columns[0] if time_columns else time.column
    values = numbers[:, len(time_columns) :]
    # Of several clocks in one file the slower ones leave cells empty.
    filled = np.isfinite(times) | np.isfinite(values).any(axis=1)
    times, values = times[filled], values[filled]
    table = _over_time(header, [str(name) for name in wanted], column, times + time.offset, values)
    # OpenSim writes a row twice here and there; more than a tenth of them is another column.
    if table.duplicates > 0.1 * len(numbers):
        raise UsageError(
            f"{path}: in {table.duplicates} of {len(numbers)} rows column {column} has the value of the next row; "
            f"is it the time, in {time.unit}, with enough digits?"
        )
    return table._replace(day=day, units=units, notes=table.notes + notes)


def is_time(name: str) -> bool:
    """Return whether a column's name says that it has times: X[s], Time, time_ms."""
    unit = unit_name(_unit_in_name(name).lstrip("_"))
    return "time" in name.lower() or unit in UNIT_FACTORS["time"]


def _unit_in_name(name: str) -> str:
    """Return the unit at the end of a column's name, with `_` before one that may be another word."""
    match = _UNIT_IN_NAME.search(name)
    return (match[1] or f"_{match[2]}").strip() if match else ""


def read_storage(path: Path) -> Table:
    """Read all columns of a storage file; a cell that is not a number is NaN.

    Raises:
        UsageError: the file cannot be read, is no storage file, or its times decrease.
    """
    header = storage_header(path)
    numbers, _, _ = read_numbers(header, range(len(header.names)), TableFormat(), strict=False)
    return _over_time(header, header.names[1:], "time", numbers[:, 0], numbers[:, 1:])


def repaired(path: Path) -> str:
    """Return a storage file's text with a single header that fits its table, as OpenSim itself reads it.

    Raises:
        UsageError: the file cannot be read, or is no storage file.
    """
    header = storage_header(path)
    below = islice(each_line(header.text), header.line, None)
    rows = [line.rstrip("\n") for line in below if line.strip()]
    lines = [
        "states",
        "version=1",
        f"nRows={len(rows)}",
        f"nColumns={len(header.names)}",
        f"inDegrees={'yes' if header.degrees else 'no'}",
        END_OF_HEADER,
        "\t".join(header.names),
        *rows,
    ]
    return "\n".join(lines) + "\n"


def _over_time(
    header: Header, names: Sequence[str], column: ColumnName, seconds: Floats, values: Floats
) -> Table:
    """Make a table from times [s], read from `column`, and columns `names`, shape (n, columns).

    Raises:
        UsageError: a time is not a number, or cannot be a stamp, or times decrease.
    """
    path = header.path
    wrong = ~(np.abs(seconds) < _LAST_TIME)
    if wrong.any():
        row = int(np.argmax(wrong))
        fault = f"{path}: column {column} is {seconds[row]:g} s in row {row + 1}"
        raise UsageError(f"{fault}; it must be a time below {_LAST_TIME} s")
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
    duplicates = int(np.count_nonzero(~last))
    notes = header.notes
    if duplicates:
        notes += (
            f"{path.name}: {duplicates} row{'s' * (duplicates > 1)} dropped: the next has the same time",
        )
    doubts: tuple[str, ...] = ()
    stated = (header.entries or {}).get("nrows", "")
    if stated.isdecimal() and float(stated) > len(seconds):
        doubts = (
            f"{path} has {len(seconds)} rows, and its header says nRows={stated}: is it cut off?",
        )
    return Table(
        path,
        tuple(names),
        stamps[last],
        values[last],
        header.degrees,
        duplicates,
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

    The first `times` places, 0 or 1, may have times of day, which become seconds. Also returns what the file
    says of units by column, as in a row right below the names, and the day of the first time of day, as in `Table`.

    Raises:
        UsageError: a cell is not a number and reading is `strict`, or a line has another number of columns
            than there are names.
    """
    if header.data is not None:
        return header.data[:, places], dict(header.units), None
    if header.path.suffix.lower() in PARQUET_SUFFIXES:
        return _read_parquet(header, places, table_format), {}, None
    stated = header.decimal or ("" if table_format.decimal == "auto" else table_format.decimal)
    by_commas = header.delimiter == ","
    decimal = stated or ("." if by_commas else "")
    thousands = not decimal or (bool(stated) and not header.decimal)
    flat = array("d")
    units: dict[int, str] = {}
    clock = Clock()
    marks = Counter[_Mark]()
    examples: dict[_Mark, tuple[int, str]] = {}
    for line, cells in _rows(header, table_format, units):
        for number, place in enumerate(places):
            cell = cells[place].strip()
            try:
                if number < times and ":" in cell:
                    value = clock.seconds(cell)
                else:
                    value = parse_number(cell, decimal, thousands)
            except ValueError:
                if strict:
                    raise UsageError(
                        f"{header.path}: line {line}, column {header.names[place]}: {cell[:40]!r} is not a number; "
                        "table.decimal ('.' or ',') says which mark is the decimal one, table.rows which rows count"
                    ) from None
                value = math.nan
            flat.append(value)
            if not stated and not by_commas:
                mark = (place, *_mark_in(cell))
                marks[mark] += 1
                examples.setdefault(mark, (line, cell))
    _check_marks(header, marks, examples)
    return np.array(flat).reshape(-1, len(places)), units, clock.day


def _mark_in(cell: str) -> tuple[str, bool]:
    """Return the mark in a number's text, empty without one, and whether it may be a decimal or a thousands mark."""
    if "." not in cell and "," not in cell:
        return "", False
    mark = "." if "." in cell else ","
    both = "." in cell and "," in cell
    return mark, not both and GROUPED.fullmatch(cell) is not None


def _check_marks(
    header: Header, marks: Counter[_Mark], examples: Mapping[_Mark, tuple[int, str]]
) -> None:
    """Refuse a cell like 1.760 if other cells have a decimal comma, or no cell below 1000 has a mark.

    `marks` counts the cells of each kind, `examples` has the line and the text of the first one.
    """
    certain = {mark for _, mark, is_ambiguous in marks if not is_ambiguous}
    for (place, mark, is_ambiguous), count in marks.items():
        if not is_ambiguous:
            continue
        is_always_ambiguous = (place, mark, False) not in marks
        both_kinds = min(count, marks[place, "", False]) >= _FEW_CELLS
        other = "," if mark == "." else "."
        if other in certain or (is_always_ambiguous and both_kinds):
            line, cell = examples[place, mark, True]
            name = "point" if mark == "." else "comma"
            raise UsageError(
                f"{header.path}: line {line}, column {header.names[place]}: the {name} of {cell!r} may be a decimal or "
                "a thousands mark; say which mark is the decimal one (table.decimal: '.' or ',' in a map)"
            )


def _read_parquet(header: Header, places: Sequence[int], table_format: TableFormat) -> Floats:
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
        # The metadata of pandas would make the time an index.
        frame = table.to_pandas(ignore_metadata=True)
        return np.column_stack([frame[name].to_numpy(np.float64) for name in names])
    except (OSError, pa.ArrowException) as error:
        raise unreadable(header.path, error) from None
    except (ValueError, TypeError) as error:
        fault = " ".join(str(error).split())[:200]
        raise UsageError(f"{header.path}: {', '.join(names)} must be numbers: {fault}") from None


def _rows(
    header: Header, table_format: TableFormat, units: dict[int, str]
) -> Iterator[tuple[int, list[str]]]:
    """Yield number and cells of each row below the names; `units` gets the cells of a row of texts above the numbers.

    A blank line ends a table if one of another width follows.
    """
    width = len(header.names)
    first = table_format.first_line
    has_begun = first is not None or header.entries is not None
    after_blank = False
    chosen = {header.place(name): str(value) for name, value in table_format.rows.items()}
    for line, cells in _lines(header):
        if line < (first or header.line + 1) or not any(cells) or cells[0].startswith(COMMENT):
            after_blank = not any(cells)
            continue
        has_begun = has_begun or any(is_number(c) or TIME_OF_DAY.fullmatch(c) for c in cells)
        if not has_begun:
            for place, cell in enumerate(cells):
                units[place] = units.get(place) or cell.strip(" []()")
            continue
        if after_blank and len(cells) == 1 < width:
            return
        if len(cells) < width or any(cells[width:]):
            raise UsageError(
                f"{header.path}: line {line} has {len(cells)} columns, and the names are {width}"
            )
        after_blank = False
        if all(cells[place].strip() == value for place, value in chosen.items()):
            yield line, cells


def _lines(header: Header) -> Iterator[tuple[int, list[str]]]:
    """Yield number and cells of each line of a text file."""
    file = each_line(header.text)
    mark = header.delimiter
    if mark == " " or header.entries is not None:
        between = len(header.names) - 1
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
