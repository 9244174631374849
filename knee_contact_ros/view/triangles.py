"""Polygons and bands as triangles: Rerun fills nothing else."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Triangles = NDArray[np.uint32]
"""Triangles as indices of their corners, shape (m, 3)"""
Corners = tuple[int, int, int]
"""Indices of three neighbours"""


def triangles_of(polygon: Floats) -> Triangles:
    """Triangulate a simple polygon, shape (n, 2), of either orientation, by cutting off ears: n - 2 triangles."""
    left = list(range(len(polygon)))
    if _turn(polygon, np.roll(polygon, -1, axis=0), np.zeros(2)).sum() < 0.0:
        left.reverse()
    triangles, in_the_way = [], dict[Corners, int]()
    there = np.ones(len(polygon), dtype=bool)
    while len(left) > 3:
        corners = [(left[i - 1], left[i], left[(i + 1) % len(left)]) for i in range(len(left))]
        ears = (i for i, one in enumerate(corners) if _is_ear(polygon, one, there, in_the_way))
        ear = next(ears, 0)  # none is left by rounding alone
        triangles.append(corners[ear])
        there[left.pop(ear)] = False
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


def _is_ear(polygon: Floats, corners: Corners, there: NDArray[np.bool_], in_the_way: dict[Corners, int]) -> bool:
    """Return whether the middle one of three neighbours of a counterclockwise polygon can be cut off.

    `there` tells which corners are left of the polygon. `in_the_way` keeps, by neighbours, a corner that forbids it as
    long as it is there.
    """
    if (found := in_the_way.get(corners)) is not None and there[found]:
        return False
    a, b, c = polygon[list(corners)]
    if _turn(a, b, c) <= 0.0:
        in_the_way[corners] = corners[1]
        return False
    inside = (_turn(a, b, polygon) >= 0.0) & (_turn(b, c, polygon) >= 0.0) & (_turn(c, a, polygon) >= 0.0) & there
    inside[list(corners)] = False
    if inside.any():
        in_the_way[corners] = int(inside.argmax())
        return False
    return True
