"""Text files of numbers, as programs and loggers write them: the columns that are wanted, over time.

Commas, semicolons, tabs or spaces between columns; decimal points or commas; a byte order mark; lines before the names.
Read row by row: a file may be larger than memory as long as the columns wanted are not.
"""

from __future__ import annotations

import csv
import difflib
import io
from array import array
from collections.abc import Callable, Collection, Iterator, Sequence
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
LOOKED_AT = 200
"""Lines among which a header is looked for"""
LONGEST_LINE = 2**20
MOST_STANDING = 0.1
"""Part of the rows that may have the time of the next one"""
MARKS = {b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}


class Header(NamedTuple):
    """Names of a text file's columns, and how it is written."""

    names: tuple[str, ...]
    line: int
    """That they stand in, from 1 on"""
    delimiter: str
    """A space stands for any blanks"""


def names_in(path: Path, how: TableFormat) -> tuple[str, ...]:
    """The columns of a file, time among them.

    Raises:
        UsageError: it cannot be read, or has no names.
    """
    return ("time", *read_storage(path).names) if path.suffix.lower() in STORAGES else header_of(path, how).names


def read_columns(path: Path, wanted: Collection[str], time: TimeColumn, how: TableFormat) -> Storage:
    """Columns of a file over time [s]; a cell that is empty or NaN is not a number.

    Raises:
        UsageError: the file cannot be read, a column is not there or there twice, a cell is no number, or time stands
            still or goes back.
    """
    if path.suffix.lower() in STORAGES:
        return _moved(read_storage(path), time.offset)
    to_seconds = factor(time.unit, TIME, "time")
    header = header_of(path, how)
    places = [place_of(name, header.names, path) for name in (time.column, *wanted)]
    table = _numbers(path, header, places, how)
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


def header_of(path: Path, how: TableFormat) -> Header:
    """The names of a text file's columns.

    Raises:
        UsageError: it cannot be read, is empty, or has numbers where names should be.
    """
    with _opened(path) as file:
        for number, line in enumerate(_lines(file, path), start=1):
            wanted = number == how.header_line if how.header_line else bool(line.strip()) and line[0] != COMMENT
            if wanted:
                break
        else:
            asked = f" has no line {how.header_line} (table.header_line)" if how.header_line else " is empty"
            raise UsageError(f"{path}{asked}")
    delimiter = how.delimiter or next((mark for mark in ";\t," if mark in line), " ")
    names = tuple(name.strip() for name in _cells(line, delimiter))
    if all(_is_number(name) for name in names if name):
        raise UsageError(
            f"{path}: line {number} has numbers, and must have the columns' names; put a line with them on top, or say "
            "where they are (table.header_line)"
        )
    return Header(names, number, delimiter)


def place_of(name: str, names: Sequence[str], path: Path) -> int:
    """Where a column is.

    Raises:
        UsageError: it is not there, or there twice.
    """
    found = [place for place, other in enumerate(names) if other == name]
    if len(found) == 1:
        return found[0]
    if found:
        raise UsageError(f"{path} has {len(found)} columns {name}; their names must differ")
    raise UsageError(f"{path} has no column {name}; {meant(name, names)}")


def meant(name: str, names: Sequence[str]) -> str:
    """The column that a name may be meant for, or which there are."""
    lower = {other.lower(): other for other in names if other}
    near = difflib.get_close_matches(name.lower(), lower, n=1, cutoff=0.6)
    return f"did you mean {lower[near[0]]}?" if near else f"it has {some([other for other in names if other])}"


def _numbers(path: Path, header: Header, places: Sequence[int], how: TableFormat) -> Floats:
    """The columns at some places, shape (rows, places)."""
    number = _number_reader(header, how)
    flat = array("d")
    width, first = len(header.names), how.first_line or header.line + 1
    with _opened(path) as file:
        for line, cells in _rows(file, path, header.delimiter):
            if line < first or not any(cells) or cells[0].startswith(COMMENT):
                continue
            if len(cells) < width or any(cells[width:]):
                raise UsageError(f"{path}: line {line} has {len(cells)} columns, and the names are {width}")
            for place in places:
                try:
                    flat.append(number(cells[place]))
                except ValueError:
                    raise UsageError(_no_number(path, line, header, place, cells, first)) from None
    return np.frombuffer(flat, dtype=np.float64).reshape(-1, len(places)) if flat else np.empty((0, len(places)))


def _number_reader(header: Header, how: TableFormat) -> Callable[[str], float]:
    """What makes a number of a cell; an empty one is not a number, as is NaN."""
    comma = how.decimal == "," or (how.decimal == "auto" and header.delimiter != ",")

    def number(cell: str) -> float:
        if "_" in cell:  # which Python takes
            raise ValueError
        text = cell.strip()
        if comma and "," in text and "." not in text:
            text = text.replace(",", ".", 1)
        return float(text) if text else float("nan")

    return number


def _no_number(path: Path, line: int, header: Header, place: int, cells: Sequence[str], first: int) -> str:
    """What is wrong with a cell, and what may be meant."""
    told = f"{path}: line {line}, column {header.names[place]}: {cells[place].strip()[:40]!r} is no number"
    if line == first and not any(_is_number(cell) for cell in cells if cell.strip()):
        return f"{told}; where the rows begin later, say so (table.first_line)"
    if "," in cells[place]:
        return f"{told}; for decimal commas say table.decimal: ','"
    return told


def _moved(storage: Storage, offset: float) -> Storage:
    return storage._replace(stamps=storage.stamps + round(offset * 1e9))


def _opened(path: Path) -> io.TextIOWrapper:
    """A text file, in UTF-8 (what is not is replaced: units have many letters) or with the mark of UTF-16."""
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
    """Lines, whatever ends them."""
    while line := file.readline(LONGEST_LINE):
        if len(line) == LONGEST_LINE:
            raise UsageError(f"{path}: a line has more than {LONGEST_LINE} characters; it is no table")
        yield line.rstrip("\r\n")


def _rows(file: io.TextIOWrapper, path: Path, delimiter: str) -> Iterator[tuple[int, list[str]]]:
    """Cells of each line, with its number."""
    if delimiter == " ":
        yield from ((number, line.split()) for number, line in enumerate(_lines(file, path), start=1))
        return
    lines = csv.reader(_lines(file, path), delimiter=delimiter)
    try:
        for cells in lines:
            yield lines.line_num, cells
    except csv.Error as error:
        raise UsageError(f"{path}: line {lines.line_num} cannot be read: {error}") from None


def _cells(line: str, delimiter: str) -> list[str]:
    return line.split() if delimiter == " " else next(csv.reader([line], delimiter=delimiter), [])


def _is_number(text: str) -> bool:
    try:
        float(text.replace(",", ".", 1))
    except ValueError:
        return False
    return True
