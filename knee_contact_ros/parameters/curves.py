"""Files that parameters name: CSV files of surfaces, of the translation and of shares."""

from collections.abc import Mapping

import numpy as np

from ..joint_reaction.compartments import ShareTable
from ..model.knee import LARGEST_ANGLE
from ..model.types import Floats
from ..system.errors import UsageError
from ..system.files import find_file, read_regular
from .schema import (
    LATERAL_PREFIX,
    Parameters,
    has_two_compartments,
    lateral_knee,
)

MAX_CURVE_SIZE = 2**20
"""Largest size of a file that a parameter names [B], and of its text [characters]"""
MAX_CURVE_POINTS = 2000
"""Largest number of rows of such a file; the curves of this package have 120.

With 2000 points, those of a condyle are 0.05 mm apart. The memory for building a profile grows with the square of their
number; here it is 0.8 GB.
"""
SHARE_FILE = "load.share_file"
"""Parameter that names the file with a table of shares"""
SHARE_COLUMNS = ("flexion_angle", "axial_load", "medial_share")
"""Columns of that file, in rad, body weights and 1"""


def curve_files(parameters: Parameters) -> dict[str, str]:
    """Names of the files that a computation with these parameters needs, by the parameter that names them."""
    knees = {"": parameters}
    if has_two_compartments(parameters):
        knees[LATERAL_PREFIX] = lateral_knee(parameters)
    names = {}
    for before, knee in knees.items():
        for bone, surface in (("femur", knee.femur), ("tibia", knee.tibia)):
            if surface.geometry == "profile":
                names[f"{before}{bone}.profile"] = surface.profile
    if parameters.translation.mechanism == "table":
        names["translation.table"] = parameters.translation.table
    if parameters.load.rule == "measured_share":
        names[SHARE_FILE] = parameters.load.share_file
    return names


def curve_texts(parameters: Parameters, known: Mapping[str, str]) -> dict[str, str]:
    """Contents of the files that parameters name, by parameter; those in `known` are not read.

    Raises:
        UsageError: a file cannot be read.
    """
    return {
        by: known[by] if by in known else read_curve(by, name)
        for by, name in curve_files(parameters).items()
    }


def lateral_texts(texts: Mapping[str, str]) -> dict[str, str]:
    """Contents of the lateral compartment's files, under the names of the medial one's parameters.

    `texts` has the contents of the files of both compartments by parameter.
    """
    own = {
        name.removeprefix(LATERAL_PREFIX): text
        for name, text in texts.items()
        if name.startswith(LATERAL_PREFIX)
    }
    shared = {name: text for name, text in texts.items() if name.startswith("translation.")}
    return shared | own


def read_curve(by: str, name: str) -> str:
    """Read the text of the file `name` that a parameter names.

    Raises:
        UsageError: it cannot be read.
    """
    path = find_file(name)
    try:
        # Spreadsheets put a byte-order mark before the first letter.
        return read_regular(path, MAX_CURVE_SIZE).decode("utf-8-sig")
    except OSError as error:
        raise UsageError(f"parameter {by}: cannot read {path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise UsageError(
            f"parameter {by}: cannot read {path}: it is not a text file in UTF-8"
        ) from None


def curve_points(by: str, name: str, text: str) -> tuple[Floats, Floats]:
    """Read the two columns of a curve, each of shape (n,), from the text of the file that a parameter names.

    Those of `translation.table` are flexion_angle [rad], x [m]; those of a profile x, y [m].

    Raises:
        UsageError: the text has not two columns of numbers, too many points, or other units.
    """
    is_table = by == "translation.table"
    points = _columns(by, name, text, ("flexion_angle", "x") if is_table else ("x", "y"))
    if not is_table and np.abs(points).max(initial=0.0) > 1.0:
        raise UsageError(
            f"parameter {by}: {name} reaches {np.abs(points).max():g}; x and y must be in m"
        )
    return points[:, 0], points[:, 1]


def read_share_table(name: str, text: str) -> ShareTable:
    """Read the table from the text of the file that `load.share_file` names.

    Comments begin with #; then come rows of flexion angle [rad], axial load [BW] and medial share [1], every angle with
    every load once, with one line of column names or none.

    Raises:
        UsageError: the text has anything else, or a value that is impossible for a knee; see `ShareTable.of`.
    """
    try:
        return ShareTable.of(_columns(SHARE_FILE, name, text, SHARE_COLUMNS))
    except ValueError as error:
        raise UsageError(f"parameter {SHARE_FILE}: {name} {error}") from None


def _columns(by: str, name: str, text: str, columns: tuple[str, ...]) -> Floats:
    """Read the numbers in the text of a CSV file that a parameter names, shape (n, number of columns).

    Comments begin with #; the first line may have the names of the columns. Further columns are ignored.
    """
    if len(text) > MAX_CURVE_SIZE:
        raise UsageError(
            f"parameter {by}: {name} has {len(text)} characters; at most {MAX_CURVE_SIZE} are allowed"
        )
    lines = [line for line in map(str.strip, text.splitlines()) if line and line[0] != "#"]
    rows = [line.split(",")[: len(columns)] for line in lines]
    if rows and tuple(map(str.strip, rows[0])) == columns:
        del rows[0]
    if len(rows) > MAX_CURVE_POINTS:
        raise UsageError(
            f"parameter {by}: {name} has {len(rows)} points; at most {MAX_CURVE_POINTS} are allowed"
        )
    try:
        numbers = np.array(rows, dtype=float).reshape(len(rows), len(columns))
        if not np.isfinite(numbers).all() or (by == SHARE_FILE and not rows):
            raise ValueError("not finite, or no table")
    except ValueError:
        count = {2: "two", 3: "three"}[len(columns)]
        words = f"must hold {count} columns {', '.join(columns)} of numbers"
        raise UsageError(f"parameter {by}: {name} {words}") from None
    angle = np.abs(numbers[:, 0]).max(initial=0.0) if columns[0] == "flexion_angle" else 0.0
    if angle > LARGEST_ANGLE:
        raise UsageError(
            f"parameter {by}: {name} reaches {angle:g} rad; flexion angles must be in rad, not deg"
        )
    return numbers
