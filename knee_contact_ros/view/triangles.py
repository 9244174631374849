"""Polygons and bands as triangles: Rerun fills nothing else."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Triangles = NDArray[np.uint32]
"""Triangles as indices of their corners, shape (m, 3)"""


def triangles_of(polygon: Floats) -> Triangles:
    """Triangulate a simple polygon, shape (n, 2), of either orientation, by cutting off ears: n - 2 triangles."""
    left = list(range(len(polygon)))
    if _turn(polygon, np.roll(polygon, -1, axis=0), np.zeros(2)).sum() < 0.0:
        left.reverse()
    triangles = []
    while len(left) > 3:
        ear = next((i for i in range(len(left)) if _is_ear(polygon[left], i)), 0)  # none is left by rounding alone
        triangles.append((left[ear - 1], left[ear], left[(ear + 1) % len(left)]))
        del left[ear]
    return np.array([*triangles, left], dtype=np.uint32)


def band(columns: int, first: int = 0) -> Triangles:
    """Triangulate the band between two rows of `columns` points; the rows follow each other from point `first` on."""
    near = first + np.arange(columns - 1)
    far = near + columns
    halves = [np.stack([near, near + 1, far], axis=1), np.stack([far, near + 1, far + 1], axis=1)]
    return np.concatenate(halves).astype(np.uint32)


def _turn(a: Floats, b: Floats, c: Floats) -> Floats:
    """Return twice the area of triangles, positive if their corners go counterclockwise."""
    return np.asarray(
        (b[..., 0] - a[..., 0]) * (c[..., 1] - a[..., 1]) - (b[..., 1] - a[..., 1]) * (c[..., 0] - a[..., 0])
    )


def _is_ear(polygon: Floats, i: int) -> bool:
    """Return whether corner `i` of a counterclockwise polygon can be cut off."""
    a, b, c = polygon[i - 1], polygon[i], polygon[(i + 1) % len(polygon)]
    if _turn(a, b, c) <= 0.0:
        return False
    others = np.delete(polygon, [i - 1, i, (i + 1) % len(polygon)], axis=0)
    inside = (_turn(a, b, others) >= 0.0) & (_turn(b, c, others) >= 0.0) & (_turn(c, a, others) >= 0.0)
    return not inside.any()
