"""Columns of numbers in the text of a CSV file that a parameter names.

Comments begin with #; the first line may have the names of the columns.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.system.errors import UsageError

LARGEST = 2**20
"""Largest size of a file [B], and of its text [characters]"""
MOST_POINTS = 2000
"""Largest number of rows of a file; the curves of this package have 120.

With 2000 points, those of a condyle are 0.05 mm apart. The memory to build a profile grows with the square of their
number: it is 0.8 GB here.
"""


def read_columns(
    parameter: str, name: str, text: str, columns: tuple[str, ...], *, further_columns: bool
) -> NDArray[np.float64]:
    """Read the numbers in the text of the file `name`, shape (n, number of columns).

    Args:
        parameter: Parameter that names the file, for errors.
        name: Name of the file, for errors.
        text: Content of the file.
        columns: Names of the columns.
        further_columns: Whether columns behind these are ignored; if not, they are refused.

    Raises:
        UsageError: the text is too long, has too many rows, or holds anything else.
    """
    count = len(columns)
    if len(text) > LARGEST:
        raise UsageError(f"parameter {parameter}: {name} has {len(text)} characters; at most {LARGEST} are allowed")
    lines = [line.strip() for line in text.splitlines() if line.strip() and not line.strip().startswith("#")]
    rows = [line.split(",")[: count if further_columns else None] for line in lines]
    if rows and tuple(entry.strip() for entry in rows[0]) == columns:
        del rows[0]
    if len(rows) > MOST_POINTS:
        raise UsageError(f"parameter {parameter}: {name} has {len(rows)} points; at most {MOST_POINTS} are allowed")
    try:
        return np.array([[float(value) for value in row] for row in rows]).reshape(len(rows), count)
    except ValueError:
        raise not_columns(parameter, name, columns) from None


def not_columns(parameter: str, name: str, columns: tuple[str, ...]) -> UsageError:
    """Error for a file that does not hold these columns of numbers."""
    number = {2: "two", 3: "three"}[len(columns)]
    return UsageError(f"parameter {parameter}: {name} must hold {number} columns {', '.join(columns)} of numbers")
