"""The region in which the outlines of femur and tibia overlap."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
POINTS = 13
"""Number of points along an overlap"""
SAMPLES = 33
"""Number of places at which the outlines are compared to find the ends of the overlap"""
MARGIN = 2.0
"""Width of the range that is searched first, in widths of the overlap of a circle and a plane"""
WIDENINGS = 4
"""Most doublings of that range: surfaces that are nearly congruent overlap over a greater length"""


class Overlaps(NamedTuple):
    """Overlaps in `n` pictures, from posterior to anterior."""

    x: Floats
    """x [m], shape (n, POINTS)"""
    lower: Floats
    """y [m] on the femur, shape (n, POINTS); not above `upper`"""
    upper: Floats
    """y [m] on the tibia, shape (n, POINTS)"""


def overlaps(femur: Floats, tibia: Floats, middle: Floats, depth: Floats, radius: float) -> Overlaps:
    """Find the overlap in `n` pictures, at least one; it has no width where the surfaces are apart.

    Args:
        femur: outline of the femur in every picture, shape (n, m, 2) [m], tibia frame.
        tibia: outline of the tibia, shape (k, 2) [m], x ascending.
        middle: x of the contact point [m], shape (n,).
        depth: penetration depth [m], shape (n,).
        radius: approximate radius of the femur [m].
    """
    half = MARGIN * np.sqrt(2.0 * radius * np.maximum(depth, 0.0))
    for _ in range(1 + WIDENINGS):
        x = middle[:, None] + half[:, None] * np.linspace(-1.0, 1.0, SAMPLES)
        deep = _above(tibia, x) - lowest_at(femur, x)
        cut = (deep[:, [0, -1]] > 0.0).any(axis=1)
        if not cut.any():
            break
        half = np.where(cut, 2.0 * half, half)
    begin, end = _crossing(x, deep), _crossing(x[:, ::-1], deep[:, ::-1])
    x = begin[:, None] + (end - begin)[:, None] * np.linspace(0.0, 1.0, POINTS)
    upper = _above(tibia, x)
    return Overlaps(x, np.minimum(lowest_at(femur, x), upper), upper)


def _above(tibia: Floats, x: Floats) -> Floats:
    """Return the height [m] of the tibia at `x` [m]; beyond its outline the height of its ends."""
    return np.interp(x, tibia[:, 0], tibia[:, 1])


def _crossing(x: Floats, deep: Floats) -> Floats:
    """Return where the outlines first cross along `x` [m], shape (n,); the middle of `x` where they do not overlap."""
    rows, inside = np.arange(len(x)), deep > 0.0
    after = inside.argmax(axis=1)
    before = np.maximum(after - 1, 0)
    over, under = np.maximum(-deep[rows, before], 0.0), np.maximum(deep[rows, after], 0.0)
    part = np.where(np.isfinite(over) & (under > 0.0), under / np.where(under > 0.0, over + under, 1.0), 0.0)
    place = x[rows, after] + part * (x[rows, before] - x[rows, after])
    return np.asarray(np.where(inside.any(axis=1), place, x.mean(axis=1)))


def lowest_at(outlines: Floats, x: Floats) -> Floats:
    """Return the lowest y [m] of outlines, shape (n, m, 2) [m], at `x`, shape (n, s) [m]; infinite beyond them."""
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
