"""Surface from a file, in m and in the axes of the femur or tibia frame."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.model.types import Floats
from knee_contact_ros.system.errors import UsageError

Integers = NDArray[np.int64]
UNITS = {"m": 1.0, "mm": 1e-3}
SMALLEST, LARGEST = 0.008, 0.7
"""Range of the longest edge of the box around a cartilage or bone of the knee [m], generously"""
LETTERS = "xyz"


class Axes(NamedTuple):
    """Axes of a file that point anterior, superior and lateral."""

    places: tuple[int, ...]
    """Index of the file's axis for each"""
    signs: tuple[float, ...]
    """Sign of the file's axis for each, 1 or -1"""

    def turned(self, points: Floats) -> Floats:
        """Points of the file, shape (n, 3), in the order anterior, superior, lateral."""
        return np.ascontiguousarray(points[:, self.places] * np.array(self.signs))


class Surface(NamedTuple):
    """Mesh, or a cloud of points if there are no triangles."""

    path: Path
    points: Floats
    """Points, shape (n, 3) [m]: x anterior, y superior, z lateral"""
    triangles: Integers
    """Indices in `points` of each triangle's corners, shape (m, 3); m = 0 for a cloud"""

    @property
    def lateral_range(self) -> str:
        """Text of the surface's extent along z [mm]."""
        low, high = 1e3 * self.points[:, 2].min(), 1e3 * self.points[:, 2].max()
        return f"z = {low:.1f} to {high:.1f} mm"


def parse_axes(text: str) -> Axes:
    """Parse the file's axes that point anterior, superior and lateral, as in `x,y,z` or `-y,z,x`.

    Raises:
        UsageError: these are not three different axes.
    """
    names = [name.strip().lower() for name in text.split(",")]
    letters = [name.lstrip("+-") for name in names]
    if sorted(letters) != list(LETTERS) or any(len(name) > 2 for name in names):
        raise UsageError(
            f"--axes {text}: it must name the file's axes that point anterior, superior and lateral, "
            "each of x, y and z once, as x,y,z or --axes=-y,z,x"
        )
    return Axes(
        tuple(LETTERS.index(letter) for letter in letters),
        tuple(-1.0 if name.startswith("-") else 1.0 for name in names),
    )


def placed(path: Path, points: Floats, triangles: Integers, unit: str, axes: Axes) -> Surface:
    """Make a surface from points and triangles in the unit and axes of a file.

    Raises:
        UsageError: a number is not finite, or the size is not that of a knee, as with a wrong unit.
    """
    if not np.isfinite(points).all():
        raise UsageError(f"{path} has a point that is not finite")
    largest = float(np.ptp(points, axis=0).max())
    size = largest * UNITS[unit]
    if not SMALLEST <= size <= LARGEST:
        wanted = f"cartilages and bones of a knee measure {SMALLEST:g} to {LARGEST:g} m"
        raise UsageError(f"{path} measures {size:.3g} m with --unit {unit}; {wanted}{likely(largest)}")
    return Surface(path, axes.turned(points * UNITS[unit]), triangles)


def likely(largest: float) -> str:
    """Hint at the unit that a file with a longest edge of so many units may be in; empty if there is none."""
    for name, factor in UNITS.items():
        if SMALLEST <= largest * factor <= LARGEST:
            return f": likely it is in {name}, --unit {name}"
    if largest <= 0.0 or not math.isfinite(largest):
        return ""
    for name, factor in {"cm": 1e-2, "µm": 1e-6, "km or was divided by 1000 twice": 1e3}.items():
        if SMALLEST <= largest * factor <= LARGEST:
            return f": likely it is in {name}; scale it to m or mm first"
    return ""
