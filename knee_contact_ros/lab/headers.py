"""Names of columns in files of numbers: OpenSim's storage files (.sto, .mot), text tables, Parquet and C3D files.

A storage file has a header that ends with `endheader`, a line of column names, and numbers. Text tables may separate
columns by commas, semicolons, tabs or spaces, and have more lines above and below the names.
"""

import codecs
import csv
import io
import re
from collections.abc import Collection, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Annotated, NamedTuple

from pydantic import Field

from ..model.types import Floats
from ..parameters.sections import Section, one_of
from ..system.errors import UsageError, list_names, suggest
from ..system.files import open_regular, require
from .cells import is_number
from .units import ColumnName

PARQUET_SUFFIXES = {".parquet", ".pq"}
_WRITE = "pandas.DataFrame({'time': ..., 'knee': ...}).to_csv('trial.csv', index=False)"
_CONVERSIONS = {
    **dict.fromkeys(
        (".xlsx", ".xls", ".ods"), "pandas.read_excel(FILE).to_csv('trial.csv', index=False)"
    ),
    ".mat": f"content = scipy.io.loadmat(FILE); {_WRITE}",
    ".npz": f"content = numpy.load(FILE); {_WRITE}",
    ".npy": f"content = numpy.load(FILE); {_WRITE}",
    ".json": f"content = json.load(open(FILE)); {_WRITE}",
    **dict.fromkeys((".h5", ".hdf5"), f"content = h5py.File(FILE); {_WRITE}"),
    ".b3d": f"content = nimblephysics.biomechanics.SubjectOnDisk(FILE); {_WRITE}",
    ".mvnx": f"content = xml.etree.ElementTree.parse(FILE) (jointAngle of each frame); {_WRITE}",
}
"""Lines of Python that make a table of other files, by their suffixes"""
_LARGEST_TEXT = 2**28
"""Largest size of a table as text [B]: an hour at 1 kHz of 8 columns"""
END_OF_HEADER = "endheader"
"""Last line of a storage file's header"""
COMMENT = "#"
"""Beginning of a comment in a text table"""
_DECIMAL_COMMA = re.compile(r"\s*[-+]?(?:0,\d+|\d+,(?:\d{1,2}|\d{4,}))(?![^\s;])")
"""Beginning of a row whose time has a decimal comma"""


class TableFormat(Section):
    """Format of the files, where it cannot be recognised."""

    header_line: int | None = Field(None, ge=1)
    """Line with the names; default: the one with most of the names that the map has"""
    first_line: int | None = Field(None, ge=2)
    """Line of the first row; default: the first with a number"""
    delimiter: str | None = Field(None, min_length=1, max_length=1)
    """Default: as the names are divided"""
    decimal: Annotated[str, one_of("auto", ".", ",")] = "auto"
    """Auto: a comma where columns are not divided by commas"""
    encoding: str = "auto"
    """As Python names it; auto: UTF-8, UTF-16 by its mark, or Windows-1252"""
    rows: dict[str, str | int | float] = Field({})
    """Take only rows with these values in these columns"""


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
    """Entries above `endheader` in a storage file, by names in lower case; of a C3D file the number of rows"""
    decimal: str = ""
    """Decimal mark of a storage file"""
    data: Floats | None = None
    """Numbers of a C3D file, shape (n, columns)"""
    units: Mapping[int, str] = {}
    """What a C3D file says of the units of columns, by their indices"""
    notes: tuple[str, ...] = ()
    """How the file was read, as sentences"""

    @property
    def degrees(self) -> bool | None:
        """Value of `inDegrees` in a storage file's header; None: there is none."""
        return {"yes": True, "no": False}.get((self.entries or {}).get("indegrees", "").lower())

    def places(self, name: ColumnName) -> list[int]:
        """Return the indices of columns with a place (from 1) or a name: `X`, or `KneeAngles.X` with the line above."""
        if isinstance(name, int):
            return [name - 1] if 1 <= name <= len(self.names) else []
        found = [place for place, each in enumerate(self.names) if each == name]
        return found or [
            place for place in range(len(self.names)) if name in self._full_names(place)
        ]

    def _full_names(self, place: int) -> list[str]:
        """Return the names of a column with those above it, also without the part before their colon."""
        above = [line[place] for line in self.above if line[place]]
        names = dict.fromkeys(each for name in above for each in (name, name.rpartition(":")[2]))
        return [f"{name}.{self.names[place]}" for name in names]

    def place(self, name: ColumnName) -> int:
        """Return the index of a column.

        Raises:
            UsageError: the column is missing or there twice.
        """
        found = self.places(name)
        if len(found) > 1:
            full = [self._full_names(place)[:1] for place in found]
            cure = "their names must differ"
            if all(full):
                cure = f"say which: {', '.join(each[0] for each in full)}"
            raise UsageError(f"{self.path} has {len(found)} columns {name}; {cure}")
        if not found:
            hint = suggest(str(name), self.names, f"it has {list_names(self.names)}")
            raise UsageError(f"{self.path} has no column {name}; {hint}")
        return found[0]


def header_of(path: Path, wanted: Collection[ColumnName], table_format: TableFormat) -> Header:
    """Find the names of the columns of a file, time included; `wanted` are the ones to look for.

    Raises:
        UsageError: the file cannot be read, or has no names.
    """
    suffix = path.suffix.lower()
    if suffix in {".sto", ".mot"}:
        return storage_header(path, quaternions=True)
    if suffix == ".c3d":
        from .c3d import c3d_header

        return c3d_header(path)
    if suffix in PARQUET_SUFFIXES:
        return _parquet_header(path)
    if suffix in _CONVERSIONS:
        raise UsageError(
            f"{path} is no table that is read here; make it one, as in Python: {_CONVERSIONS[suffix]}"
        )
    return _text_header(path, wanted, table_format)


def unreadable(path: Path, error: Exception) -> UsageError:
    """Return the error for a file that a library cannot read."""
    return UsageError(f"cannot read {path}: {' '.join(str(error).split())[:200]}")


def _parquet_header(path: Path) -> Header:
    require("tables", "pandas", "pyarrow")
    import pyarrow as pa
    from pyarrow.parquet import read_schema

    try:
        return Header(path, tuple(read_schema(path).names))
    except (OSError, pa.ArrowException) as error:
        raise unreadable(path, error) from None


def storage_header(path: Path, *, quaternions: bool = False) -> Header:
    """Read the names and the header of a storage file; if allowed, `quaternions` of OpenSense become four columns each.

    OpenSim 4.6 writes an empty header and parts of a second one in `*_states.sto`, so the names are the line right
    above the numbers. Tabs or commas may separate columns; with tabs, names may contain blanks.

    Raises:
        UsageError: the file cannot be read, or is no storage file.
    """
    text, _ = _read_text(path)
    lines = [line.strip() for line in each_line(text)]
    end = next((n for n, line in enumerate(lines) if line.lower() == END_OF_HEADER), None)
    if end is None:
        raise UsageError(
            f"{path} is not an OpenSim storage file (.sto, .mot): it has no line {END_OF_HEADER}"
        )
    pairs = (line.partition("=") for line in lines[:end])
    entries = {key.strip().lower(): value.strip() for key, _, value in pairs}
    kind = entries.get("datatype", "double").lower()
    if kind == "quaternion" and quaternions:
        return _of_quaternions(path, lines, end, entries)
    if kind != "double":
        hint = "angle.orientations of import-csv reads them" if kind == "quaternion" else ""
        hint = hint or "only numbers can be read"
        raise UsageError(f"{path} holds {entries['datatype']} (DataType in its header); {hint}")
    below = [n for n in range(end + 1, len(lines)) if lines[n]]
    first_cells = (re.split(r"[\s,;]+", lines[n])[0] for n in below)
    first = next((n for n, cell in enumerate(first_cells) if is_number(cell)), 0)
    if not first:
        raise UsageError(f"{path} has no rows below its names")
    place = below[first - 1]
    rows = [lines[n] for n in below[first:]]
    delimiter = _delimiter_of(lines[place], "\t;,")
    names = _cells(lines[place], delimiter)
    if names[0].lower() != "time":
        raise UsageError(f"{path}: its first column is {names[0]}, and must be time")
    comma = not any("." in row for row in rows) and any(map(_DECIMAL_COMMA.match, rows))
    return Header(
        path,
        tuple(names),
        place + 1,
        delimiter,
        text,
        entries=entries,
        decimal="," if comma else ".",
    )


def _of_quaternions(path: Path, lines: list[str], end: int, entries: Mapping[str, str]) -> Header:
    """Read a storage file with a quaternion w,x,y,z in each cell; `imu` becomes `imu.w` and so on."""
    line = next((n for n in range(end + 1, len(lines)) if lines[n]), end)
    time, *sensors = lines[line].split()
    names = (time, *(f"{sensor}.{part}" for sensor in sensors for part in "wxyz"))
    text = "\n".join(each.replace(",", "\t") for each in lines)
    return Header(path, names, line + 1, "\t", text, entries=entries, decimal=".")


def _text_header(path: Path, wanted: Collection[ColumnName], table_format: TableFormat) -> Header:
    """Find the names of a text file's columns: the line that has most of those `wanted`, or else the first line.

    The line may begin with `#`.

    Raises:
        UsageError: the file cannot be read, is empty, or has numbers instead of names.
    """
    text, notes = _read_text(path, table_format.encoding)
    given = table_format.header_line
    # The names are among the first 300 lines.
    searched = islice(each_line(text), max(300, given or 0))
    lines = [line.rstrip("\n") for line in searched]
    filled = {number: line for number, line in enumerate(lines, start=1) if line.strip()}
    content = [number for number, line in filled.items() if not line.startswith(COMMENT)]
    if not content:
        raise UsageError(f"{path} is empty")
    if given and given not in filled:
        raise UsageError(f"{path} has no names in line {given} (table.header_line)")
    marks = {n: table_format.delimiter or _delimiter_of(s, ";\t,|") for n, s in filled.items()}
    cells = {n: _cells(line.lstrip(COMMENT), marks[n]) for n, line in filled.items()}
    names = [name for name in wanted if isinstance(name, str)]
    asked = {*names, *(name.rpartition(".")[2] for name in names)}
    found = {n: len(asked.intersection(row)) for n, row in cells.items()}
    line = given or max(filled, key=lambda n: (found[n], n in content))
    if not given and not found[line]:
        line = content[0]
        least = max([1, *(place for place in wanted if isinstance(place, int))])
        row = next((n for n in content if len(cells[n]) >= least and _are_numbers(cells[n])), 0)
        if row and not asked:  # columns by their places need no names
            places = tuple(str(place) for place in range(1, len(cells[row]) + 1))
            above = _lines_above(lines[: row - 1], marks[row], len(places))
            return Header(path, places, row - 1, marks[row], text, above, notes=notes)
    if _are_numbers(cells[line]):
        raise UsageError(
            f"{path}: line {line} has numbers, and must have the columns' names; put a line with them on top, say "
            "where they are (table.header_line), or name columns by their place (column: 2)"
        )
    above = _lines_above(lines[: line - 1], marks[line], len(cells[line]))
    return Header(path, tuple(cells[line]), line, marks[line], text, above, notes=notes)


def _lines_above(lines: Sequence[str], delimiter: str, width: int) -> tuple[tuple[str, ...], ...]:
    """Return the cells of the lines right above the names, from below; an empty cell has the text to its left."""
    above = []
    for line in reversed(lines):
        cells = _cells(line.lstrip(COMMENT), delimiter)
        if len(cells) < 2:
            break
        filled = [""]
        for cell in (cells + [""] * width)[:width]:
            filled.append(cell or filled[-1])
        above.append(tuple(filled[1:]))
    return tuple(above)


def _are_numbers(cells: Sequence[str]) -> bool:
    return all(is_number(cell) for cell in cells if cell)


def _read_text(path: Path, encoding: str = "auto") -> tuple[str, tuple[str, ...]]:
    """Read a text, and note its encoding: UTF-16 if it has the mark, else UTF-8 if valid, else Windows-1252."""
    try:
        with open_regular(path) as file:
            data = file.read(_LARGEST_TEXT + 1)
        if len(data) > _LARGEST_TEXT:
            raise UsageError(
                f"{path} has more than {_LARGEST_TEXT / 1e6:.0f} MB, which is read at most: cut it, or save it as "
                "Parquet"
            )
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


def each_line(text: str) -> io.TextIOWrapper:
    """Iterate over the lines of a text, with the line ends of any system replaced by newlines.

    `io.StringIO` would take four bytes for each character.
    """
    data = io.BytesIO(text.encode("utf-8", "surrogatepass"))
    return io.TextIOWrapper(data, "utf-8", "surrogatepass", newline=None)


def _delimiter_of(line: str, marks: str) -> str:
    """Return the first of the marks that a line has, else a space."""
    return next((mark for mark in marks if mark in line), " ")


def _cells(line: str, delimiter: str) -> list[str]:
    cells = line.split() if delimiter == " " else next(csv.reader([line], delimiter=delimiter), [])
    return [cell.strip() for cell in cells]
