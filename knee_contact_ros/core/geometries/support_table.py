"""Support function of a profile as polynomials of the angle, where the lowest point glides along convex segments.

In a cell of angles whose candidates lie side by side and bend to the same side, the lowest point is the only place
where the tangent is parallel to the plane. So its segment changes where the tangent in a point of the spline is
parallel to the plane, and on each segment h' = -x is smooth. It is interpolated at Chebyshev's points, and h is its
integral. Where any of this does not hold, as over a dent, there is no polynomial.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.core.arrays import Floats, Integers
from knee_contact_ros.core.kernel_source import in_kernel

CELLS = 2048
"""Number of cells of the full turn"""
PER_RADIAN = CELLS / math.tau
"""Cells per radian"""
FARTHEST = 1e6
"""Angle [rad] beyond which rounding leaves its place in a turn too inexact for a polynomial"""
DEGREE = 6
"""Degree of the polynomials of h"""
CLOSE = 1e-16
"""Largest error of h' [m] of a polynomial; that of h is smaller by the width of a cell"""


@in_kernel
def tabulated(table: Floats, angle: float) -> tuple[float, float]:
    """Return support h [m] and dh/dangle [m/rad] at an angle [rad]; h is NaN where there is no polynomial."""
    if not abs(angle) < FARTHEST:
        return math.nan, math.nan
    part = angle * PER_RADIAN
    part -= CELLS * math.floor(part * (1.0 / CELLS))
    cell = min(int(part), CELLS - 1)
    t = part - cell - 0.5
    i = cell
    while t > table[i, 0]:
        i = int(table[i, 1])
    c0, c1, c2, c3 = float(table[i, 2]), float(table[i, 3]), float(table[i, 4]), float(table[i, 5])
    c4, c5, c6 = float(table[i, 6]), float(table[i, 7]), float(table[i, 8])
    h = c0 + t * (c1 + t * (c2 + t * (c3 + t * (c4 + t * (c5 + t * c6)))))
    slope = c1 + t * (2.0 * c2 + t * (3.0 * c3 + t * (4.0 * c4 + t * (5.0 * c5 + t * (6.0 * c6)))))
    return h, slope * PER_RADIAN


def support_table(cubics: Floats, begins: Integers, candidates: Integers) -> Floats:
    """Return the table of a curve; see `Curve` for the arguments, of which `begins` is `first`.

    Its shape is (n, DEGREE + 3). A row has a polynomial of t, which goes from -1/2 to 1/2 through a cell of angles: the
    largest t that it is valid for, the row to use beyond that, and the coefficients c0 to c6 of h [m]; c0 is NaN where
    there is no polynomial. The first `CELLS` rows are the first ones of the cells.
    """
    turned, glides = _glides(cubics, begins, candidates)
    cells, segments = np.repeat(np.arange(CELLS), np.diff(begins)), candidates
    cells, segments = cells[glides[cells]], segments[glides[cells]]
    cells, segments, start, end = _stretches(turned, len(cubics), cells, segments)
    coefficients, close = _polynomials(cubics, cells, segments, np.maximum(start, -0.5), np.minimum(end, 0.5))
    return _gathered(cells, start, end, np.where(close[:, None], coefficients, math.nan))


def _glides(cubics: Floats, begins: Integers, candidates: Integers) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the angles at which the curve's points are lowest, and which cells' candidates form one convex arc.

    The angles are in cells. Shapes (segments + 1,) and (CELLS,).
    """
    length, (x1, x2, x3), (y1, y2, y3) = cubics[:, 0], cubics[:, 3:6].T, cubics[:, 7:].T
    hull = [
        np.stack([c1, c1 + length * c2, c1 + length * (2.0 * c2 + 3.0 * length * c3)])
        for c1, c2, c3 in ((x1, x2, x3), (y1, y2, y3))
    ]  # of p', by its Bezier points
    chord = [hull_x.sum(axis=0) for hull_x in hull]
    forwards = (hull[0] * chord[0] + hull[1] * chord[1] > 0.0).all(axis=0)  # a segment turns by less than half a turn
    constant, linear, square = 2.0 * (x1 * y2 - y1 * x2), 6.0 * (x1 * y3 - y1 * x3), 6.0 * (x2 * y3 - y2 * x3)
    with np.errstate(divide="ignore", invalid="ignore"):
        vertex = np.clip(np.nan_to_num(-0.5 * linear / square), 0.0, length)
    bends = np.stack([constant + u * (linear + u * square) for u in (np.zeros_like(length), vertex, length)])
    left, right = forwards & (bends >= 0.0).all(axis=0), forwards & (bends <= 0.0).all(axis=0)
    sense = 1.0 if np.count_nonzero(left) >= np.count_nonzero(right) else -1.0
    convex = left if sense > 0.0 else right
    along = [np.append(first, last[-1]) for first, last in ((part[0], part[2]) for part in hull)]
    turned = -np.arctan2(sense * along[1], sense * along[0])
    counts = np.diff(begins)
    side_by_side = candidates[begins[1:] - 1] - candidates[begins[:-1]] == counts - 1
    return turned * PER_RADIAN, side_by_side & np.logical_and.reduceat(convex[candidates], begins[:-1])


def _stretches(
    turned: Floats, count: int, cells: Integers, segments: Integers
) -> tuple[Integers, Integers, Floats, Floats]:
    """Return the parts of cells in which one candidate is the lowest: cell, segment, first and last t, in their order.

    Segment -1 is the first point of the curve, and `count` its last point.
    """
    one, other = ((turned[segments + k] - (cells + 0.5) + 0.5 * CELLS) % CELLS - 0.5 * CELLS for k in (0, 1))
    parts = [(cells, segments, np.minimum(one, other), np.maximum(one, other))]
    for point, edge, place, is_first in (
        (-1, segments == 0, one, one < other), (count, segments == count - 1, other, other < one),
    ):  # fmt: skip
        start, end = np.where(is_first, -0.25 * CELLS, place)[edge], np.where(is_first, place, 0.25 * CELLS)[edge]
        parts.append((cells[edge], np.full(len(start), point), start, end))
    cells, segments, start, end = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    # Angles are known but for whole turns: what is far away is none of these.
    kept = (start < 0.5) & (end > -0.5) & (start < end) & (end - start <= 0.5 * CELLS)
    cells, segments, start, end = cells[kept], segments[kept], start[kept], end[kept]
    order = np.lexsort((start, cells))
    return cells[order], segments[order], start[order], end[order]


def _polynomials(
    cubics: Floats, cells: Integers, segments: Integers, start: Floats, end: Floats
) -> tuple[Floats, NDArray[np.bool_]]:
    """The coefficients of h for parts of cells, shape (n, DEGREE + 1), and whether they are exact enough there."""
    nodes = 0.5 * np.cos((np.arange(DEGREE) + 0.5) * math.pi / DEGREE)
    inverse = np.linalg.inv(np.vander(nodes, increasing=True))
    slopes = _support_of(cubics, cells, segments, nodes + np.zeros((len(cells), 1)))[1] @ inverse.T
    middle, _ = _support_of(cubics, cells, segments, np.zeros((len(cells), 1)))
    tried = start[:, None] + (end - start)[:, None] * np.linspace(0.0, 1.0, 2 * DEGREE + 1)
    _, tried_slopes = _support_of(cubics, cells, segments, tried)
    powers = tried[:, :, None] ** np.arange(DEGREE)
    close = np.abs((powers * slopes[:, None, :]).sum(axis=2) - tried_slopes).max(axis=1) <= CLOSE
    return np.column_stack([middle, slopes / (PER_RADIAN * np.arange(1, DEGREE + 1))]), close


def _support_of(cubics: Floats, cells: Integers, segments: Integers, t: Floats) -> tuple[Floats, Floats]:
    """Return support h [m] and dh/dangle [m/rad] of segments, continued beyond their ends; shapes (n, k) as of `t`."""
    inner = np.clip(segments, 0, len(cubics) - 1)
    length, _, x0, x1, x2, x3, y0, y1, y2, y3 = cubics[inner].T[:, :, None]
    angle = (cells[:, None] + 0.5 + t) / PER_RADIAN
    sine, cosine = np.sin(angle), np.cos(angle)
    c1, c2, c3 = -(sine * x1 + cosine * y1), -(sine * x2 + cosine * y2), -(sine * x3 + cosine * y3)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = c1 / (np.sqrt(c2 * c2 - 3.0 * c3 * c1) - c2)
    u = np.where(segments[:, None] < 0, 0.0, np.where(segments[:, None] >= len(cubics), length, u))
    x, y = x0 + u * (x1 + u * (x2 + u * x3)), y0 + u * (y1 + u * (y2 + u * y3))
    return -(sine * x + cosine * y), sine * y - cosine * x


def _gathered(cells: Integers, start: Floats, end: Floats, coefficients: Floats) -> Floats:
    """Return the table of parts of cells; a cell that they do not fill has no polynomial."""
    found, rows, counts = np.unique(cells, return_index=True, return_counts=True)
    joined = np.append(cells[1:] != cells[:-1], True) | np.append(end[:-1] == start[1:], True)
    full = np.logical_and.reduceat(joined, rows) & (start[rows] <= -0.5) & (end[rows + counts - 1] >= 0.5)
    end[rows + counts - 1] = math.inf
    later = np.ones(len(cells), bool)
    later[rows] = False
    place = np.where(later, CELLS + np.cumsum(later) - 1, cells)
    table = np.full((CELLS + np.count_nonzero(later), DEGREE + 3), math.nan)
    table[place] = np.column_stack([end, np.append(place, 0)[1:], coefficients])
    filled = np.zeros(CELLS, bool)
    filled[found[full]] = True
    table[:CELLS][~filled] = [math.inf, 0.0] + [math.nan] * (DEGREE + 1)
    return table
