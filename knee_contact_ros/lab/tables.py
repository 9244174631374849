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
import re
from array import array
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
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
BODY_WEIGHT, PERCENT = "BW", "%BW"
"""Units of force that need the map's `body_weight`"""
NOT_A_NUMBER = re.compile(r"[-+]?(?:nan(?:\(\w*\))?|\d\.#\w+)", re.IGNORECASE)
"""How computers write NaN, and Windows also infinity: nan, -nan(ind), 1.#QNAN, -1.#IND, 1.#INF"""
GROUPED = re.compile(r"[-+]?[1-9]\d{0,2}(?:(?:\.\d{3})+(?:,\d*)?|(?:,\d{3})+(?:\.\d*)?)")
"""Numbers that may have thousands marks: 1.760 and 1,760 have, or have a decimal mark; 1.760,5 and 1,760.5 have"""
DECIMAL_COMMA = re.compile(r"[-+]?(?:0,\d+|\d+,(?:\d{1,2}|\d{4,}))")
"""Numbers whose comma is no thousands mark"""
BEGINS = re.compile(r"\s*[-+]?(?:\.?\d|nan\b|inf)", re.IGNORECASE)
"""Begin of a line of numbers"""
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
    """Cells of a storage file that are no numbers, and NaN in `values`, by stamp and column"""

    def columns(self, names: Sequence[str]) -> Floats:
        """Return columns by their names, shape (n, columns).

        Raises:
            UsageError: a column is not there or there twice.
        """
        return self.values[:, [_place(name, self.names, self.path) for name in names]]

    def column(self, name: str) -> Floats:
        """Return a column by its name, shape (n,).

        Raises:
            UsageError: the column is not there or there twice, or has a value that is not finite.
        """
        values = self.values[:, _place(name, self.names, self.path)]
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
    words: dict[tuple[int, int], str] = {}
    try:
        numbers = np.loadtxt(rows, ndmin=2, comments=None)
    except ValueError:
        numbers, words = _by_cells(path, names, rows)
    if numbers.shape[1] != len(names):
        raise UsageError(f"{path}: {len(names)} column names, but {numbers.shape[1]} columns")
    degrees = {"yes": True, "no": False}.get(header.get("indegrees", "").lower())
    table = _over_time(path, names[1:], numbers, degrees)
    stamps = {row: round(numbers[row, 0] * NANOSECONDS) for row, _ in words}
    return table._replace(words={(stamps[row], names[place]): cell for (row, place), cell in words.items()})


def _by_cells(path: Path, names: Sequence[str], rows: Sequence[str]) -> tuple[Floats, dict[tuple[int, int], str]]:
    """Read rows that hold more than numbers with points, cell by cell.

    Returns the numbers, NaN where a cell has none, shape (n, columns), and such cells by row and column. Commas are
    decimal ones if no cell has a point, and those of the times cannot be thousands marks.
    """
    cells = [row.split("\t") if row.count("\t") == len(names) - 1 else row.split() for row in rows]
    comma = "." not in "".join(rows) and any(DECIMAL_COMMA.fullmatch(row[0].strip()) for row in cells)
    numbers, words = np.empty((len(rows), len(names))), {}
    for row, texts in enumerate(cells):
        if len(texts) != len(names):
            raise UsageError(f"{path}: {len(names)} column names, but {len(texts)} columns in row {row + 1}")
        for place, text in enumerate(texts):
            try:
                numbers[row, place] = _number(text, "," if comma else ".", strict=True)
            except ValueError:
                if place == 0:
                    fault = f"{path}: time is {text.strip()[:40]!r} in row {row + 1}; numbers must have decimal points"
                    raise UsageError(fault) from None
                numbers[row, place], words[row, place] = math.nan, repr(text.strip()[:40])
    return numbers, words


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
    if len(names) == 1 and " " not in names[0] and "," in names[0]:
        names, rows = [name.strip() for name in names[0].split(",")], [row.replace(",", "\t") for row in rows]
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
    to_seconds = factor(time.unit, TIME, "time")
    if path.suffix.lower() in STORAGES:
        storage = read_storage(path)
        storage.columns(list(wanted))
        stamps = storage.stamps if to_seconds == 1.0 else np.rint(storage.stamps * to_seconds).astype(np.int64)
        return storage._replace(stamps=stamps + round(time.offset * NANOSECONDS))
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
    either = table_format.decimal == "auto" and header.delimiter != ","
    decimal = "." if table_format.decimal == "auto" else table_format.decimal
    stated = table_format.decimal != "auto"
    flat, marks = array("d"), Marks(places)
    width, first = len(header.names), table_format.first_line or header.line + 1
    with _opened(path) as file:
        for line, cells in _rows(file, path, header.delimiter):
            if line < first or not any(cells) or cells[0].startswith(COMMENT):
                continue
            if len(cells) < width or any(cells[width:]):
                raise UsageError(f"{path}: line {line} has {len(cells)} columns, and the names are {width}")
            for place in places:
                try:
                    flat.append(_number(cells[place], "" if either else decimal, strict=not stated))
                except ValueError:
                    fault = (
                        f"{path}: line {line}, column {header.names[place]}: {cells[place].strip()[:40]!r} is no number"
                    )
                    cause = _stated(cells[place], decimal) if stated else _cause(cells, place, line == first)
                    raise UsageError(fault + cause) from None
                if not stated:
                    marks.add(place, cells[place].strip(), line)
    if not stated:
        marks.check(path, header.names)
    return np.array(flat).reshape(-1, len(places))


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
                    "thousands mark; say which mark is the decimal one (table.decimal: '.' or ',')"
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


def _stated(cell: str, decimal: str) -> str:
    """Hint at a cell with the mark that is not the stated decimal mark."""
    other = "." if decimal == "," else ","
    return f"; table.decimal says {decimal!r}, and digits are not grouped by {other!r}" if other in cell else ""


def _cause(cells: Sequence[str], place: int, first: bool) -> str:
    """Hint at the cause of a cell that has no number; `first`: it is in the first row."""
    if first and not any(_is_number(cell) for cell in cells if cell.strip()):
        return "; where the rows begin later, say so (table.first_line)"
    if GROUPED.fullmatch(cells[place].strip()):
        return "; say which mark is the decimal one (table.decimal: '.' or ',')"
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
