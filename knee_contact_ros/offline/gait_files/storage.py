"""OpenSim's storage files (.sto, .mot): a header that ends with `endheader`, a line of column names, numbers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.messages.stamps import NANOSECONDS
from knee_contact_ros.system.errors import UsageError

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]

END = "endheader"
TIME = "time"
LAST_TIME = 2**31
"""First time [s] that a ROS stamp cannot hold"""
MOST_NAMES = 12
"""Largest number of column names in an error message"""


class Storage(NamedTuple):
    """Content of a storage file; of rows with one stamp, which OpenSim writes at the ends of steps, only the last."""

    path: Path
    names: tuple[str, ...]
    """Names of the columns, without time"""
    stamps: Stamps
    """[ns], growing; shape (n,)"""
    values: Floats
    """Shape (n, columns)"""
    degrees: bool | None
    """Value of `inDegrees` in the header; None: the header does not have it"""
    duplicates: int
    """Number of rows that were left out for a later one of the same stamp"""

    def column(self, name: str) -> Floats:
        """Return a column by its name, shape (n,).

        Raises:
            UsageError: the column has a value that is not finite.
        """
        values = self.values[:, self.names.index(name)]
        if not np.isfinite(values).all():
            row = int(np.argmin(np.isfinite(values)))
            time = self.stamps[row] / NANOSECONDS
            raise UsageError(f"{self.path}: column {name} is {values[row]} at {time:g} s; it must be finite")
        return values

    def span(self) -> str:
        """Return the first and the last time [s] as text."""
        return f"{self.stamps[0] / NANOSECONDS:g} to {self.stamps[-1] / NANOSECONDS:g} s"


def read_storage(path: Path) -> Storage:
    """Read a storage file.

    Raises:
        UsageError: the file cannot be read, is no storage file, or its times decrease.
    """
    header, names, rows = split(path, text_of(path))
    if header.get("datatype", "double").lower() != "double":
        raise UsageError(f"{path} holds {header['datatype']} (DataType in its header); only numbers can be read")
    table = numbers(path, names, rows)
    degrees = {"yes": True, "no": False}.get(header.get("indegrees", "").lower())
    return over_time(path, names[1:], table[:, 0], table[:, 1:], degrees)


def over_time(path: Path, names: Sequence[str], time: Floats, values: Floats, degrees: bool | None) -> Storage:
    """Make a `Storage` of columns `values`, shape (n, columns), at `time` [s], shape (n,).

    Raises:
        UsageError: a time is no number of seconds, or times decrease.
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
    """Return the content of a text file.

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
    first = next((number for number in range(end + 1, len(lines)) if is_number(lines[number].split()[0])), len(lines))
    names = lines[first - 1].split()
    if first > end + 1 and names[0].lower() != TIME:
        raise UsageError(f"{path}: its first column is {names[0]}, and must be {TIME}")
    entries = [line.split("=", 1) for line in lines[:end] if "=" in line]
    return {key.strip().lower(): value.strip() for key, value in entries}, names, lines[first:]


def is_number(text: str) -> bool:
    """Return whether a text is a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def repaired(text: str, path: Path) -> str:
    """Return a storage file's text with a single header that fits its table, as OpenSim itself reads it.

    Raises:
        UsageError: the text is no storage file.
    """
    header, names, rows = split(path, text)
    degrees = header.get("indegrees", "no")
    top = ["states", "version=1", f"nRows={len(rows)}", f"nColumns={len(names)}", f"inDegrees={degrees}", END]
    return "\n".join([*top, "\t".join(names), *rows]) + "\n"


def numbers(path: Path, names: list[str], rows: list[str]) -> Floats:
    """Return the numbers of a table, shape (rows, columns).

    Raises:
        UsageError: the table is empty, has more or fewer columns than names, or holds what is no number.
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
    """List names for an error message, `MOST_NAMES` at most."""
    more = len(names) - MOST_NAMES
    return ", ".join(names[:MOST_NAMES]) + (f" and {more} more" if more > 0 else "")
