"""Cubic splines through points, and functions of many angles, with the same bytes on every processor.

Libraries for linear equations and numpy's own sines use what a processor offers, such as a product and a sum in one
step. SciPy's splines, for one, differ by a rounding error between processors, and an answer that has to choose one of
two steps then differs by more. Here numbers follow from single sums, products and quotients, which IEEE 754 rounds
alike everywhere, and from the C library's sine.
"""

import math

import numpy as np

from .types import Floats

NOT_A_KNOT = "not-a-knot"
"""The first two pieces are one cubic, and the last two are"""
NATURAL = "natural"
"""Without curvature at both ends"""
Ends = str | tuple[float, float]
"""What holds at the ends of a spline: `NOT_A_KNOT`, `NATURAL`, or the slopes there"""

sines = np.vectorize(math.sin, otypes=[np.float64])
"""Return the sines of angles [rad]."""
cosines = np.vectorize(math.cos, otypes=[np.float64])
"""Return the cosines of angles [rad]."""


def pieces_through(x: Floats, y: Floats, ends: Ends = NOT_A_KNOT) -> Floats:
    """Return the C2 cubic spline through points, straight before the first and behind the last, shape (n + 1, 5).

    A row has the place where a piece starts, and c0 to c3 of y = c0 + u (c1 + u (c2 + u c3)) with u = x - start. The
    first row holds before the first point, and starts there. `x` increases strictly. There are 2 points at least, and 4
    for `NOT_A_KNOT`.
    """
    width = np.diff(x)
    chord = np.diff(y) / width
    slope = np.array(_slopes(width.tolist(), chord.tolist(), ends))
    twist = (slope[:-1] + slope[1:] - 2.0 * chord) / width
    bend = (chord - slope[:-1]) / width - twist
    inner = np.column_stack([x[:-1], y[:-1], slope[:-1], bend, twist / width])
    before, behind = np.column_stack([x, y, slope, 0.0 * x, 0.0 * x])[[0, -1]]
    return np.vstack([before, inner, behind])


def _slopes(width: list[float], chord: list[float], ends: Ends) -> list[float]:
    """Return the slopes at the points, with which the curvature is the same on both sides of each.

    Row i of the equations is: before * slope[i - 1] + at * slope[i] + behind * slope[i + 1] = right.
    """
    first_slope, last_slope = (math.nan, math.nan) if isinstance(ends, str) else ends
    at, behind, right = _end(width[:2], chord[:2], ends, first_slope)
    rows = [(0.0, at, behind, right)]
    for i in range(1, len(width)):
        right = 3.0 * (width[i] * chord[i - 1] + width[i - 1] * chord[i])
        rows.append((width[i], 2.0 * (width[i - 1] + width[i]), width[i - 1], right))
    at, before, right = _end(width[:-3:-1], chord[:-3:-1], ends, last_slope)
    rows.append((before, at, 0.0, right))
    # Gauss's elimination without exchanges: the diagonal stays above zero.
    solved = [rows[0][1:]]
    for before, at, behind, right in rows[1:]:
        last_at, last_behind, last_right = solved[-1]
        factor = before / last_at
        solved.append((at - factor * last_behind, behind, right - factor * last_right))
    slopes = [0.0]
    for at, behind, right in reversed(solved):
        slopes.append((right - behind * slopes[-1]) / at)
    return slopes[:0:-1]


def _end(
    width: list[float], chord: list[float], ends: Ends, slope: float
) -> tuple[float, float, float]:
    """Return an end's factor of its own slope, that of the next one, and the right-hand side.

    `width` and `chord` are those of the two pieces nearest to the end, from there inwards.
    """
    if ends == NOT_A_KNOT:
        both = width[0] + width[1]
        outer = (width[0] + 2.0 * both) * width[1] * chord[0]
        return width[1], both, (outer + width[0] * width[0] * chord[1]) / both
    if ends == NATURAL:
        return 2.0, 1.0, 3.0 * chord[0]
    return 1.0, 0.0, slope
