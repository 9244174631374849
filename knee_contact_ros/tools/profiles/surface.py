"""A surface as it came from a file, in m and in the axes of the femur or tibia frame."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from knee_contact_ros.core.arrays import Floats, Integers
from knee_contact_ros.system.errors import UsageError

UNITS = {"m": 1.0, "mm": 1e-3}
SMALLEST, LARGEST = 0.008, 0.7
"""Longest edge [m] of the box around a piece of cartilage or a bone of the knee, generously"""
LETTERS = "xyz"


class Axes(NamedTuple):
    """Which axis of a file points anterior, superior and lateral."""

    places: tuple[int, ...]
    signs: tuple[float, ...]

    def turned(self, points: Floats) -> Floats:
        """Points of shape (n, 3) in the order anterior, superior, lateral."""
        return np.ascontiguousarray(points[:, self.places] * np.array(self.signs))


class Surface(NamedTuple):
    """A mesh, or a cloud of points if it has no triangles."""

    path: Path
    points: Floats
    """Shape (n, 3) [m]: x anterior, y superior, z lateral"""
    triangles: Integers
    """Shape (m, 3): places in `points`; m = 0 for a cloud"""

    @property
    def lateral_range(self) -> str:
        """From where to where it reaches along z, in mm."""
        low, high = 1e3 * self.points[:, 2].min(), 1e3 * self.points[:, 2].max()
        return f"z = {low:.1f} to {high:.1f} mm"


def parse_axes(text: str) -> Axes:
    """The file's axes that point anterior, superior and lateral, as in `x,y,z` or `-y,z,x`.

    Raises:
        UsageError: not three different axes.
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
    """A surface in m and in our axes.

    Raises:
        UsageError: a number is not finite, or it is no knee's size: then the unit is wrong.
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
    """What the unit of a file with such a longest edge may be."""
    for name, factor in UNITS.items():
        if SMALLEST <= largest * factor <= LARGEST:
            return f": likely it is in {name}, --unit {name}"
    if largest <= 0.0 or not math.isfinite(largest):
        return ""
    for name, factor in {"cm": 1e-2, "µm": 1e-6, "km or was divided by 1000 twice": 1e3}.items():
        if SMALLEST <= largest * factor <= LARGEST:
            return f": likely it is in {name}; scale it to m or mm first"
    return ""
