"""Tables of measurements: inputs over time, and the depth, force, gap or height to which parameters are fitted."""

from __future__ import annotations

import difflib
import hashlib
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.regular_file import read_regular

Floats = NDArray[np.float64]
LARGEST_FILE = 2**28
"""Largest size [B] of a file"""
TIME, ANGLE, LOAD, AXIAL_LOAD, HEIGHT = "time", "flexion_angle", "load", "axial_load", "femoral_height"
ANSWERS = {"penetration_depth": "m", "contact_force": "N", "gap": "m", HEIGHT: "m"}
"""Columns to which the model is fitted, with their units; the height only where it is not prescribed"""
COLUMNS = (TIME, ANGLE, LOAD, AXIAL_LOAD, *ANSWERS)
COMMENT = "#"


class Measured(NamedTuple):
    """Inputs and measured answers of a trial of n samples."""

    source: str
    """Name of the file or table, for messages"""
    digest: str
    """SHA-256 of the file; empty for a table in memory"""
    time: Floats
    """Time [s], shape (n,), increasing"""
    angle: Floats
    """Flexion angle [rad], shape (n,)"""
    load: Floats
    """Compressive load of the compartment, or the axial one, [N], shape (n,)"""
    axial: bool
    """Whether the load is the axial joint reaction, of which the compartment bears `load.share`"""
    height: Floats | None
    """Prescribed femoral height [m], shape (n,); None with drive force"""
    answers: dict[str, Floats]
    """Measured columns by name, see `ANSWERS`, shape (n,) each; not a number where nothing was measured"""

    @property
    def number(self) -> int:
        """Number of measured values."""
        return sum(int(np.isfinite(column).sum()) for column in self.answers.values())

    def load_of(self, share: float) -> Floats:
        """Give the load of the compartment [N], which bears a `share` of an axial load."""
        return share * self.load if self.axial else self.load


def read_measured(path: Path, drive: str) -> Measured:
    """Read a trial from a CSV file: names in the first line, an empty cell (or nan) where nothing was measured.

    Lines that begin with `#` are ignored. Columns are `time` [s], `flexion_angle` [rad], `load` or `axial_load` [N]
    or, with drive displacement, `femoral_height` [m]; and one or more of `ANSWERS`.

    Raises:
        UsageError: the file cannot be read or is no such table, or values make no sense.
    """
    try:
        content = read_regular(path, LARGEST_FILE)
        text = content.decode("utf-8-sig")
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise UsageError(f"cannot read {path}: it is not a text file in UTF-8") from None
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith(COMMENT)]
    names = [name.strip() for name in lines[0].split(",")] if lines else []
    doubled = [name for place, name in enumerate(names) if name in names[:place]]
    if doubled:
        raise UsageError(f"{path}: column {doubled[0] or repr('')} is there twice")
    _check_names(names, str(path))
    rows = np.array([_row(line, len(names), number, path) for number, line in enumerate(lines[1:], start=1)])
    columns = {name: rows[:, place] if len(rows) else rows for place, name in enumerate(names)}
    return measured_from(columns, drive, str(path))._replace(digest=hashlib.sha256(content).hexdigest())


def measured_from(table: Mapping[str, ArrayLike] | Any, drive: str, source: str = "table") -> Measured:
    """Make a trial from columns by name: a mapping of arrays of shape (n,), or a data frame; see `read_measured`.

    Args:
        table: The columns.
        drive: The parameter `drive`: force or displacement.
        source: Name of the table, for messages.

    Raises:
        UsageError: columns are missing, or values make no sense.
    """
    columns = {str(name): _column(table, name, source) for name in table}
    _check_names(columns, source)
    prescribed = drive == "displacement"
    loads = [name for name in (LOAD, AXIAL_LOAD) if name in columns]
    if len(loads) == 2:
        raise UsageError(f"{source}: columns load and axial_load are both there; give the one that was measured")
    needed = [TIME, ANGLE, *([HEIGHT] if prescribed else [] if loads else [LOAD])]
    for name in needed:
        if name not in columns:
            present = ", ".join(columns) or "none"
            raise UsageError(f"{source}: it has no column {name}, which drive {drive} needs; it has {present}")
    answers = {name: columns[name] for name in ANSWERS if name in columns and name not in needed}
    if not answers:
        known = ", ".join(name for name in ANSWERS if name not in needed)
        raise UsageError(f"{source}: nothing is measured in it; one or more of the columns {known} are needed")
    if len({len(column) for column in columns.values()}) > 1 or not len(columns[TIME]):
        raise UsageError(f"{source}: its columns must be equally long, with one sample or more")
    for name in {*needed, *loads}:
        _check_finite(columns[name], name, source, all_of_them=True)
    for name, column in answers.items():
        _check_finite(column, name, source, all_of_them=False)
    time = columns[TIME]
    if not (np.diff(np.rint(time * 1e9)) > 0.0).all():
        row = int(np.argmin(np.diff(np.rint(time * 1e9)) > 0.0)) + 2
        raise UsageError(f"{source}: column {TIME} must increase, by a nanosecond or more; row {row} does not")
    load = columns[loads[0]] if loads else np.zeros(len(time))
    height = columns[HEIGHT] if prescribed else None
    return Measured(source, "", time, columns[ANGLE], load, loads == [AXIAL_LOAD], height, answers)


def _column(table: Any, name: str, source: str) -> Floats:
    """Copy a column as numbers."""
    try:
        column = np.array(table[name], dtype=np.float64)
    except (TypeError, ValueError):
        raise UsageError(f"{source}: column {name} must hold numbers") from None
    if column.ndim != 1:
        raise UsageError(f"{source}: column {name} has shape {column.shape}; allowed is (n,)")
    return column


def _row(line: str, columns: int, number: int, path: Path) -> list[float]:
    """Read the numbers of a line; an empty cell is not a number."""
    try:
        cells = [float(cell) if cell.strip() else math.nan for cell in line.split(",")]
    except ValueError:
        cells = []
    if len(cells) != columns:
        raise UsageError(f"{path}: row {number} does not hold {columns} numbers or empty cells: {line[:60]}")
    return cells


def _check_names(names: Iterable[str], source: str) -> None:
    for name in names:
        if name not in COLUMNS:
            near = difflib.get_close_matches(name, COLUMNS, n=1, cutoff=0.6)
            hint = f"did you mean {near[0]}?" if near else f"allowed are {', '.join(COLUMNS)}"
            raise UsageError(f"{source}: column {name or repr(name)} is not known; {hint}")


def _check_finite(column: Floats, name: str, source: str, *, all_of_them: bool) -> None:
    """Refuse an input that is missing or infinite anywhere, and an answer that is infinite or missing everywhere."""
    wrong = ~np.isfinite(column) if all_of_them else np.isinf(column)
    if wrong.any():
        what = "an input must be known at every sample" if all_of_them else "allowed are numbers and empty cells"
        raise UsageError(f"{source}: column {name} is {column[wrong][0]:g} in row {int(wrong.argmax()) + 1}; {what}")
    if np.isnan(column).all():
        raise UsageError(f"{source}: column {name} is empty; leave it out, or give what was measured")
