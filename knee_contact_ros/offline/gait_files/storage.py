"""OpenSim's storage files (.sto, .mot): a header that ends with `endheader`, a line of column names, numbers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.messages.ros_types import NANOSECONDS
from knee_contact_ros.system.errors import UsageError

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]

END = "endheader"
TIME = "time"
LAST_TIME = 2**31
"""[s] beyond what a ROS stamp holds"""
SHOWN = 12
"""Column names in an error message"""


class Storage(NamedTuple):
    """A storage file; of rows with one stamp, as OpenSim writes them at the ends of steps, the last one."""

    path: Path
    names: tuple[str, ...]
    """Of the columns, without time"""
    stamps: Stamps
    """[ns], growing; shape (n,)"""
    values: Floats
    """Shape (n, columns)"""
    degrees: bool | None
    """What `inDegrees` in the header says; None: nothing"""
    duplicates: int
    """Rows that gave way to a later one of the same stamp"""

    def column(self, name: str) -> Floats:
        """A column by its name, all of it finite.

        Raises:
            UsageError: it has a value that is not.
        """
        values = self.values[:, self.names.index(name)]
        if not np.isfinite(values).all():
            row = int(np.argmin(np.isfinite(values)))
            time = self.stamps[row] / NANOSECONDS
            raise UsageError(f"{self.path}: column {name} is {values[row]} at {time:g} s; it must be finite")
        return values

    def span(self) -> str:
        """From when to when, for a message."""
        return f"{self.stamps[0] / NANOSECONDS:g} to {self.stamps[-1] / NANOSECONDS:g} s"


def read_storage(path: Path) -> Storage:
    """Read a storage file.

    Raises:
        UsageError: it cannot be read, is no storage file, or its times go back.
    """
    header, names, rows = split(path, text_of(path))
    if header.get("datatype", "double").lower() != "double":
        raise UsageError(f"{path} holds {header['datatype']} (DataType in its header); only numbers can be read")
    table = numbers(path, names, rows)
    degrees = {"yes": True, "no": False}.get(header.get("indegrees", "").lower())
    return over_time(path, names[1:], table[:, 0], table[:, 1:], degrees)


def over_time(path: Path, names: Sequence[str], time: Floats, values: Floats, degrees: bool | None) -> Storage:
    """Columns `values`, shape (n, columns), at `time` [s], shape (n,); of rows with one stamp the last one.

    Raises:
        UsageError: a time is no number of seconds, or goes back.
    """
    if not np.isfinite(time).all() or np.abs(time).max() >= LAST_TIME:
        raise UsageError(f"{path}: a time is not a number of seconds below {LAST_TIME}")
    stamps = np.rint(time * NANOSECONDS).astype(np.int64)
    back = np.flatnonzero(np.diff(stamps) < 0)
    if back.size:
        row = int(back[0])
        raise UsageError(
            f"{path}: time goes back from {time[row]:.7g} to {time[row + 1]:.7g} s (rows {row + 1}, {row + 2})"
        )
    last = np.append(np.diff(stamps) > 0, True)
    return Storage(path, tuple(names), stamps[last], values[last], degrees, int(np.count_nonzero(~last)))


def text_of(path: Path) -> str:
    """A text file's content.

    Raises:
        UsageError: it cannot be read, or is no text.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror}") from None
    if b"\0" in data[:4096]:
        raise UsageError(f"{path} is not an OpenSim storage file (.sto, .mot): it is not text")
    return data.decode("utf-8-sig", errors="replace")  # headers hold file names of all kinds of computers


def split(path: Path, text: str) -> tuple[dict[str, str], list[str], list[str]]:
    """Header entries by their names in lower case, column names, and the lines of the table.

    OpenSim 4.6 leaves an empty header, and more or less of a second one, in front of the names in `*_states.sto`: the
    names are what is right before the numbers.

    Raises:
        UsageError: it is no storage file.
    """
    lines = [line for line in text.splitlines() if line.strip()]
    end = next((number for number, line in enumerate(lines) if line.strip().lower() == END), None)
    if end is None:
        raise UsageError(f"{path} is not an OpenSim storage file (.sto, .mot): it has no line {END}")
    first = next((number for number in range(end + 1, len(lines)) if is_number(lines[number].split()[0])), len(lines))
    names = lines[first - 1].split()
    if first > end + 1 and names[0].lower() != TIME:
        raise UsageError(f"{path}: its first column is {names[0]}, and must be {TIME}")
    entries = [line.split("=", 1) for line in lines[:end] if "=" in line]
    return {key.strip().lower(): value.strip() for key, value in entries}, names, lines[first:]


def is_number(text: str) -> bool:
    """Whether a text is a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def repaired(text: str, path: Path) -> str:
    """A storage file's text with one header that fits its table, for OpenSim itself.

    Raises:
        UsageError: it is no storage file.
    """
    header, names, rows = split(path, text)
    degrees = header.get("indegrees", "no")
    top = ["states", "version=1", f"nRows={len(rows)}", f"nColumns={len(names)}", f"inDegrees={degrees}", END]
    return "\n".join([*top, "\t".join(names), *rows]) + "\n"


def numbers(path: Path, names: list[str], rows: list[str]) -> Floats:
    """The table, shape (rows, columns).

    Raises:
        UsageError: there is none, a line has more or fewer columns than names, or something is no number.
    """
    if not rows:
        raise UsageError(f"{path} has no rows")
    try:
        table = np.loadtxt(rows, ndmin=2, comments=None)
    except ValueError as error:
        raise UsageError(f"{path}: its table cannot be read: {str(error).split(';')[0]}") from None
    if table.shape[1] != len(names):
        raise UsageError(f"{path}: {len(names)} column names, but {table.shape[1]} columns")
    return table


def some(names: tuple[str, ...] | list[str]) -> str:
    """Names for an error message, not too many."""
    more = len(names) - SHOWN
    return ", ".join(names[:SHOWN]) + (f" and {more} more" if more > 0 else "")
