"""Columns over time from files of numbers: OpenSim's storage files (.sto, .mot) and text tables.

A storage file has a header that ends with `endheader`, a line of column names, and numbers. In text tables columns may
be separated by commas, semicolons, tabs or spaces, numbers have decimal points or commas, and a byte order mark or
lines before the names may be there. They are read row by row, so that only the selected columns must fit in memory.
"""

from __future__ import annotations

import csv
import difflib
import io
import math
from array import array
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from knee_contact_ros.parameters.schema import Section, one_of
from knee_contact_ros.streams.topics import NANOSECONDS
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.files import open_regular

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]

STORAGES = {".sto", ".mot"}
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
POUND_FORCE, KILOPOND, INCH = 4.4482216152605, 9.80665, 0.0254
TIME, ANGLE, FORCE, MOMENT = "time", "angle", "force", "moment"
BODY_WEIGHT = "BW"
"""Unit of force that needs the map's `body_weight`"""
UNITS = {
    TIME: {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    ANGLE: {"rad": 1.0, "deg": math.radians(1.0), "mrad": 1e-3, "rev": 2.0 * math.pi},
    FORCE: {"N": 1.0, "kN": 1e3, "mN": 1e-3, "lbf": POUND_FORCE, "kgf": KILOPOND, BODY_WEIGHT: math.nan},
    MOMENT: {"N*m": 1.0, "N*mm": 1e-3, "kN*m": 1e3, "lbf*in": POUND_FORCE * INCH, "lbf*ft": 12.0 * POUND_FORCE * INCH},
}
"""Factors of units to s, rad, N and N m, by quantity"""
ALIASES = {
    "sec": "s", "second": "s", "seconds": "s", "µs": "us", "μs": "us",
    "degree": "deg", "degrees": "deg", "°": "deg", "radian": "rad", "radians": "rad",
    "newton": "N", "newtons": "N", "lb": "lbf", "kp": "kgf", "Nm": "N*m", "Nmm": "N*mm", "N m": "N*m", "N mm": "N*mm",
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

    def columns(self, names: Sequence[str]) -> Floats:
        """Return columns by their names, shape (n, columns)."""
        return self.values[:, [self.names.index(name) for name in names]]

    def column(self, name: str) -> Floats:
        """Return a column by its name, shape (n,).

        Raises:
            UsageError: the column has a value that is not finite.
        """
        values = self.values[:, self.names.index(name)]
        if not np.isfinite(values).all():
            row = int(np.argmin(np.isfinite(values)))
            raise UsageError(f"{self.path}: column {name} is {values[row]} at {self.time(row)} s; it must be finite")
        return values

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
    """Format of the text files, where it cannot be recognised."""

    header_line: int | None = Field(None, ge=1, description="line with the names; default: the first with content")
    first_line: int | None = Field(None, ge=2, description="line of the first row; default: the one after the names")
    delimiter: str | None = Field(None, min_length=1, max_length=1, description="default: as the names are divided")
    decimal: Annotated[str, one_of("auto", ".", ",")] = Field(
        "auto", description="auto: a comma where columns are not divided by commas"
    )


class TimeColumn(Section):
    """Column with the time of each row."""

    column: str = Field("time", min_length=1)
    unit: str = "s"
    offset: float = Field(0.0, description="[s] added, so that recordings with large times begin near 0")


class Header(NamedTuple):
    """Names of a text file's columns, and its delimiter."""

    names: tuple[str, ...]
    line: int
    """Number of the line that has the names, counted from 1"""
    delimiter: str
    """Character between columns; a space stands for any number of blanks"""


def factor(unit: str, kind: str, what: str, body_weight: float | None = None) -> float:
    """Factor of a unit to SI; `kind` is the quantity that it must be of, `what` names the value in messages.

    Raises:
        UsageError: the unit is not known or is of another quantity, or it is BW and there is no `body_weight` [N].
    """
    name = ALIASES.get(unit, unit)
    if name == BODY_WEIGHT and kind == FORCE:
        if body_weight is None:
            raise UsageError(f"{what}: unit BW needs body_weight [N] in the map")
        return body_weight
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
    try:
        numbers = np.loadtxt(rows, ndmin=2, comments=None)
    except ValueError as error:
        raise UsageError(f"{path}: its table cannot be read: {str(error).split(';')[0]}") from None
    if numbers.shape[1] != len(names):
        raise UsageError(f"{path}: {len(names)} column names, but {numbers.shape[1]} columns")
    degrees = {"yes": True, "no": False}.get(header.get("indegrees", "").lower())
    return _over_time(path, names[1:], numbers, degrees)


def _over_time(path: Path, names: Sequence[str], numbers: Floats, degrees: bool | None = None) -> Table:
    """Make a table of time [s] and columns `names`, shape (n, 1 + columns).

    Raises:
        UsageError: a time is no number of seconds, or times decrease.
    """
    time = numbers[:, 0]
    if not np.isfinite(time).all() or np.abs(time).max() >= LAST_TIME:
        raise UsageError(f"{path}: a time is not a number of seconds below {LAST_TIME}")
    stamps = np.rint(time * NANOSECONDS).astype(np.int64)
    steps = np.diff(stamps)
    if (steps < 0).any():
        row = int(np.argmax(steps < 0))
        rows = f"(rows {row + 1}, {row + 2})"
        raise UsageError(f"{path}: time goes back from {time[row]:.7g} to {time[row + 1]:.7g} s {rows}")
    last = np.append(steps > 0, True)
    return Table(path, tuple(names), stamps[last], numbers[last, 1:], degrees, int(np.count_nonzero(~last)))


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
    the line right before the numbers.

    Raises:
        UsageError: the text is no storage file.
    """
    lines = [line for line in text.splitlines() if line.strip()]
    end = next((number for number, line in enumerate(lines) if line.strip().lower() == END), None)
    if end is None:
        raise UsageError(f"{path} is not an OpenSim storage file (.sto, .mot): it has no line {END}")
    first = next((n for n in range(end + 1, len(lines)) if _is_number(lines[n].split()[0])), len(lines))
    names = lines[first - 1].split()
    if first > end + 1 and names[0].lower() != TIME:
        raise UsageError(f"{path}: its first column is {names[0]}, and must be {TIME}")
    entries = [line.split("=", 1) for line in lines[:end] if "=" in line]
    return {key.strip().lower(): value.strip() for key, value in entries}, names, lines[first:]


def repaired(text: str, path: Path) -> str:
    """Return a storage file's text with a single header that fits its table, as OpenSim itself reads it.

    Raises:
        UsageError: the text is no storage file.
    """
    header, names, rows = split(path, text)
    top = ["states", "version=1", f"nRows={len(rows)}", f"nColumns={len(names)}"]
    return "\n".join([*top, f"inDegrees={header.get('indegrees', 'no')}", END, "\t".join(names), *rows]) + "\n"


def names_in(path: Path, table_format: TableFormat) -> tuple[str, ...]:
    """Names of the columns of a text file or OpenSim storage file, with that of the time.

    Raises:
        UsageError: the file cannot be read, or has no names.
    """
    if path.suffix.lower() in STORAGES:
        return (TIME, *read_storage(path).names)
    return _header(path, table_format).names


def read_columns(path: Path, wanted: Collection[str], time: TimeColumn, table_format: TableFormat) -> Table:
    """Read the columns `wanted` of a file over time; an empty cell is read as NaN.

    Raises:
        UsageError: the file cannot be read, a column is not there or there twice, a cell is no number, or time stands
            still or goes back.
    """
    if path.suffix.lower() in STORAGES:
        storage = read_storage(path)
        return storage._replace(stamps=storage.stamps + round(time.offset * 1e9))
    to_seconds = factor(time.unit, TIME, "time")
    header = _header(path, table_format)
    numbers = _numbers(
        path, header, [_place(name, header.names, path) for name in (time.column, *wanted)], table_format
    )
    if not len(numbers):
        raise UsageError(f"{path} has no rows below its names (line {header.line})")
    if not np.isfinite(numbers[:, 0]).all():
        row = int(np.argmin(np.isfinite(numbers[:, 0])))
        raise UsageError(f"{path}: column {time.column} is {numbers[row, 0]} in row {row + 1}; a time must be there")
    numbers[:, 0] = numbers[:, 0] * to_seconds + time.offset
    table = _over_time(path, list(wanted), numbers)
    if table.duplicates > MOST_STANDING * len(numbers):
        raise UsageError(
            f"{path}: in {table.duplicates} of {len(numbers)} rows column {time.column} has the value of the next row; "
            f"is it the time, in {time.unit}, with enough digits?"
        )
    return table


def _header(path: Path, table_format: TableFormat) -> Header:
    """Read the names of a text file's columns; refuse a file that is empty, or has numbers where names should be."""
    wanted = table_format.header_line
    with _opened(path) as file:
        for number, line in enumerate(_lines(file, path), start=1):
            if (number == wanted) if wanted else (line.strip() and line[0] != COMMENT):
                break
        else:
            raise UsageError(f"{path} has no line {wanted} (table.header_line)" if wanted else f"{path} is empty")
    delimiter = table_format.delimiter or next((mark for mark in ";\t," if mark in line), " ")
    cells = line.split() if delimiter == " " else next(csv.reader([line], delimiter=delimiter), [])
    names = tuple(name.strip() for name in cells)
    if all(_is_number(name) for name in names if name):
        raise UsageError(
            f"{path}: line {number} has numbers, and must have the columns' names; put a line with them on top, or say "
            "where they are (table.header_line)"
        )
    return Header(names, number, delimiter)


def _place(name: str, names: Sequence[str], path: Path) -> int:
    """Index of a column by its name; refuse one that is not there, or there twice."""
    count = list(names).count(name)
    if count == 0:
        raise UsageError(f"{path} has no column {name}; {meant(name, names)}")
    if count > 1:
        raise UsageError(f"{path} has {count} columns {name}; their names must differ")
    return names.index(name)


def _numbers(path: Path, header: Header, places: Sequence[int], table_format: TableFormat) -> Floats:
    """Read the numbers of the columns at some places, shape (rows, places)."""
    decimal_comma = table_format.decimal == "," or (table_format.decimal == "auto" and header.delimiter != ",")
    flat = array("d")
    width, first = len(header.names), table_format.first_line or header.line + 1
    with _opened(path) as file:
        for line, cells in _rows(file, path, header.delimiter):
            if line < first or not any(cells) or cells[0].startswith(COMMENT):
                continue
            if len(cells) < width or any(cells[width:]):
                raise UsageError(f"{path}: line {line} has {len(cells)} columns, and the names are {width}")
            for place in places:
                try:
                    flat.append(_number(cells[place], decimal_comma))
                except ValueError:
                    fault = (
                        f"{path}: line {line}, column {header.names[place]}: {cells[place].strip()[:40]!r} is no number"
                    )
                    raise UsageError(fault + _cause(cells, place, line == first)) from None
    return np.array(flat).reshape(-1, len(places))


def _number(cell: str, decimal_comma: bool) -> float:
    """Number in a cell, NaN if it is empty; a ValueError if it has no number."""
    if "_" in cell:  # which Python takes
        raise ValueError
    text = cell.strip()
    if decimal_comma and "," in text and "." not in text:
        text = text.replace(",", ".", 1)
    return float(text) if text else math.nan


def _cause(cells: Sequence[str], place: int, first: bool) -> str:
    """Hint at the cause of a cell that has no number; `first`: it is in the first row."""
    if first and not any(_is_number(cell) for cell in cells if cell.strip()):
        return "; where the rows begin later, say so (table.first_line)"
    return "; for decimal commas say table.decimal: ','" if "," in cells[place] else ""


def _opened(path: Path) -> io.TextIOWrapper:
    """Open a text file in UTF-8, or in UTF-16 if it has the mark; bytes that are neither are replaced."""
    try:
        file = open_regular(path)
        begin = file.peek(4096)[:4096]
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror}") from None
    encoding = "utf-16" if begin[:2] in {b"\xff\xfe", b"\xfe\xff"} else "utf-8-sig"
    if b"\0" in begin and encoding != "utf-16":
        file.close()
        raise UsageError(f"{path} is not a text file")
    return io.TextIOWrapper(file, encoding=encoding, errors="replace", newline="")


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
