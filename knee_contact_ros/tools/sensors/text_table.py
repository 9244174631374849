"""Read selected columns over time from text files of numbers, as programs and loggers write them.

Columns may be separated by commas, semicolons, tabs or spaces, numbers have decimal points or commas, and a byte order
mark or lines before the names may be there. Files are read row by row, so that only the selected columns must fit in
memory.
"""

from __future__ import annotations

import csv
import difflib
import io
from array import array
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from knee_contact_ros.offline.gait_files.storage import Floats, Storage, over_time, read_storage, some
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.regular_file import open_regular
from knee_contact_ros.tools.sensors.sensor_map import TableFormat, TimeColumn
from knee_contact_ros.tools.sensors.units import TIME, factor

STORAGES = {".sto", ".mot"}
COMMENT = "#"
LONGEST_LINE = 2**20
MOST_STANDING = 0.1
"""Largest share of the rows that may have the time of the next row"""
MARKS = {b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}


class Header(NamedTuple):
    """Names of a text file's columns, and its delimiter."""

    names: tuple[str, ...]
    line: int
    """Number of the line that has the names, counted from 1"""
    delimiter: str
    """Character between columns; a space stands for any number of blanks"""


def names_in(path: Path, table_format: TableFormat) -> tuple[str, ...]:
    """Names of the columns of a text file or OpenSim storage file, with that of the time.

    Raises:
        UsageError: the file cannot be read, or has no names.
    """
    if path.suffix.lower() in STORAGES:
        return ("time", *read_storage(path).names)
    return header_of(path, table_format).names


def read_columns(path: Path, wanted: Collection[str], time: TimeColumn, table_format: TableFormat) -> Storage:
    """Read the columns `wanted` of a file over time; an empty cell is read as NaN.

    Raises:
        UsageError: the file cannot be read, a column is not there or there twice, a cell is no number, or time stands
            still or goes back.
    """
    if path.suffix.lower() in STORAGES:
        storage = read_storage(path)
        return storage._replace(stamps=storage.stamps + round(time.offset * 1e9))
    to_seconds = factor(time.unit, TIME, "time")
    header = header_of(path, table_format)
    places = [place_of(name, header.names, path) for name in (time.column, *wanted)]
    table = _numbers(path, header, places, table_format)
    if not len(table):
        raise UsageError(f"{path} has no rows below its names (line {header.line})")
    if not np.isfinite(table[:, 0]).all():
        row = int(np.argmin(np.isfinite(table[:, 0])))
        raise UsageError(f"{path}: column {time.column} is {table[row, 0]} in row {row + 1}; a time must be there")
    storage = over_time(path, list(wanted), table[:, 0] * to_seconds + time.offset, table[:, 1:], None)
    if storage.duplicates > MOST_STANDING * len(table):
        raise UsageError(
            f"{path}: in {storage.duplicates} of {len(table)} rows column {time.column} has the value of the next row; "
            f"is it the time, in {time.unit}, with enough digits?"
        )
    return storage


def header_of(path: Path, table_format: TableFormat) -> Header:
    """Read the names of a text file's columns.

    Raises:
        UsageError: the file cannot be read, is empty, or has numbers where names should be.
    """
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


def place_of(name: str, names: Sequence[str], path: Path) -> int:
    """Index of a column by its name; `path` is for messages.

    Raises:
        UsageError: there is no such column, or more than one.
    """
    count = list(names).count(name)
    if count == 0:
        raise UsageError(f"{path} has no column {name}; {meant(name, names)}")
    if count > 1:
        raise UsageError(f"{path} has {count} columns {name}; their names must differ")
    return names.index(name)


def meant(name: str, names: Sequence[str]) -> str:
    """Hint for a message: the column whose name is close to an unknown one, or all the names."""
    lower = {other.lower(): other for other in names if other}
    near = difflib.get_close_matches(name.lower(), lower, n=1, cutoff=0.6)
    return f"did you mean {lower[near[0]]}?" if near else f"it has {some([other for other in names if other])}"


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
                    raise UsageError(_no_number(path, line, header, place, cells, first)) from None
    return np.frombuffer(flat, dtype=np.float64).reshape(-1, len(places)) if flat else np.empty((0, len(places)))


def _number(cell: str, decimal_comma: bool) -> float:
    """Number in a cell, NaN if it is empty; a ValueError if it has no number."""
    if "_" in cell:  # which Python takes
        raise ValueError
    text = cell.strip()
    if decimal_comma and "," in text and "." not in text:
        text = text.replace(",", ".", 1)
    return float(text) if text else float("nan")


def _no_number(path: Path, line: int, header: Header, place: int, cells: Sequence[str], first: int) -> str:
    """Message on a cell that has no number, with a hint at the cause."""
    fault = f"{path}: line {line}, column {header.names[place]}: {cells[place].strip()[:40]!r} is no number"
    if line == first and not any(_is_number(cell) for cell in cells if cell.strip()):
        return f"{fault}; where the rows begin later, say so (table.first_line)"
    if "," in cells[place]:
        return f"{fault}; for decimal commas say table.decimal: ','"
    return fault


def _opened(path: Path) -> io.TextIOWrapper:
    """Open a text file in UTF-8, or in UTF-16 if it has the mark; bytes that are neither are replaced."""
    try:
        file = open_regular(path)
        begin = file.peek(4096)[:4096]
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror}") from None
    encoding = MARKS.get(begin[:2], "utf-8-sig")
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
