"""Polygons and bands as triangles, which is what Rerun fills."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Triangles = NDArray[np.uint32]
"""Shape (m, 3), indices of corners"""


def triangles_of(polygon: Floats) -> Triangles:
    """A simple polygon, shape (n, 2), either way around, in n - 2 triangles: ears are cut off until none is left."""
    left = list(range(len(polygon)))
    if _turn(polygon, np.roll(polygon, -1, axis=0), np.zeros(2)).sum() < 0.0:
        left.reverse()
    found = []
    while len(left) > 3:
        ear = next((i for i in range(len(left)) if _is_ear(polygon[left], i)), 0)  # none is left by rounding alone
        found.append((left[ear - 1], left[ear], left[(ear + 1) % len(left)]))
        del left[ear]
    return np.array([*found, left], dtype=np.uint32)


def band(columns: int, first: int = 0) -> Triangles:
    """The band between two rows of `columns` points each, one behind the other, from the point `first` on."""
    near = first + np.arange(columns - 1)
    far = near + columns
    halves = [np.stack([near, near + 1, far], axis=1), np.stack([far, near + 1, far + 1], axis=1)]
    return np.concatenate(halves).astype(np.uint32)


def _turn(a: Floats, b: Floats, c: Floats) -> Floats:
    """Twice the area of triangles, > 0 against the clock."""
    return np.asarray(
        (b[..., 0] - a[..., 0]) * (c[..., 1] - a[..., 1]) - (b[..., 1] - a[..., 1]) * (c[..., 0] - a[..., 0])
    )


def _is_ear(polygon: Floats, i: int) -> bool:
    """Whether a corner of a polygon that goes against the clock can be cut off."""
    a, b, c = polygon[i - 1], polygon[i], polygon[(i + 1) % len(polygon)]
    if _turn(a, b, c) <= 0.0:
        return False
    others = np.delete(polygon, [i - 1, i, (i + 1) % len(polygon)], axis=0)
    inside = (_turn(a, b, others) >= 0.0) & (_turn(b, c, others) >= 0.0) & (_turn(c, a, others) >= 0.0)
    return not inside.any()
