"""Where femur and tibia overlap: the region between the two outlines, as upright lines."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
LINES = 24
"""Lines across an overlap"""
SAMPLES = 33
"""Places at which the outlines are compared first"""
MARGIN = 1.8
"""How much wider than the overlap of a circle and a plane the place looked at is"""


class Overlaps(NamedTuple):
    """The overlap in each of `n` pictures as `LINES` upright lines, side by side."""

    x: Floats
    """[m] shape (n, LINES)"""
    lower: Floats
    """[m] on the femur, likewise"""
    upper: Floats
    """[m] on the tibia, likewise; not above `lower` where there is no overlap"""
    spacing: Floats
    """[m] from line to line, shape (n,)"""


def overlaps(femur: Floats, tibia: Floats, middle: Floats, depth: Floats, radius: float) -> Overlaps:
    """Find the overlap in `n` pictures, at least one.

    Args:
        femur: outline of the femur in every picture, shape (n, m, 2) [m], tibia frame.
        tibia: outline of the tibia, shape (k, 2) [m], x ascending.
        middle: x of the contact point [m], shape (n,).
        depth: penetration depth [m], shape (n,).
        radius: roughly that of the femur [m].
    """
    half = MARGIN * np.sqrt(2.0 * radius * np.maximum(depth, 0.0))
    x = middle[:, None] + half[:, None] * np.linspace(-1.0, 1.0, SAMPLES)
    upper = np.interp(x, tibia[:, 0], tibia[:, 1], left=-np.inf, right=-np.inf)
    inside = upper > lowest_at(femur, x)
    rows = np.arange(len(x))
    first = np.maximum(inside.argmax(axis=1) - 1, 0)
    last = np.minimum(SAMPLES - inside[:, ::-1].argmax(axis=1), SAMPLES - 1)
    begin, end = x[rows, first], np.where(inside.any(axis=1), x[rows, last], x[rows, first])
    spacing = (end - begin) / LINES
    x = begin[:, None] + spacing[:, None] * (np.arange(LINES) + 0.5)
    upper = np.interp(x, tibia[:, 0], tibia[:, 1], left=-np.inf, right=-np.inf)
    return Overlaps(x, lowest_at(femur, x), upper, spacing)


def lowest_at(outlines: Floats, x: Floats) -> Floats:
    """Lowest y [m] of outlines, shape (n, m, 2) [m], at `x`, shape (n, s) [m]; infinite beside them."""
    lowest = np.full(x.shape, np.inf)
    begin, end = outlines[:, :-1], outlines[:, 1:]
    left, right = np.minimum(begin[..., 0], end[..., 0]), np.maximum(begin[..., 0], end[..., 0])
    below = (begin[..., 1] < outlines[..., 1].mean(axis=1)[:, None]).any(axis=0)
    near = below & (left.min(axis=0) <= x.max()) & (right.max(axis=0) >= x.min())
    for segment in np.flatnonzero(near).tolist():
        (x0, y0), (x1, y1) = begin[:, segment, :, None].swapaxes(0, 1), end[:, segment, :, None].swapaxes(0, 1)
        width = x1 - x0
        part = (x - x0) / np.where(width == 0.0, 1.0, width)
        on_it = (part >= 0.0) & (part <= 1.0) & (width != 0.0)
        lowest = np.where(on_it, np.minimum(lowest, y0 + part * (y1 - y0)), lowest)
    return lowest
