"""Table of the places from which `closest` searches the common normal on a curved tibia."""

import math
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from .mechanisms import Mechanism
from .profiles import NO_TABLE, SHRUNK, Circle, KernelTable, Profile, curve_points
from .splines import cosines, sines
from .types import Floats, Indices

COLUMN_WIDTH = 0.0125
"""Width [rad] of the table's columns of angles"""
WIDE_FACTOR = 8.0
"""Factor for the width of columns on both sides of the angles of gait"""
WIDE_COLUMNS = 100
"""Number of wide columns on each side"""
NARROW_COLUMNS = 272
"""Number of columns between them, from -34 to 160 degrees"""
FIRST_ANGLE = -0.6
"""Angle [rad] at which the narrow columns begin"""
_BEYOND: Floats = WIDE_FACTOR * np.arange(WIDE_COLUMNS + 1, dtype=np.float64)
COLUMN_EDGES: Floats = FIRST_ANGLE + COLUMN_WIDTH * np.concatenate(
    [-_BEYOND[:0:-1], np.arange(NARROW_COLUMNS), _BEYOND + NARROW_COLUMNS]
)
"""Edges of the columns [rad]"""
_DEPTHS: Floats = 1e-3 * np.array(
    [-35, -22, -13, -7, -3.5, -1.5, -0.5, 0, 0.5, 1, 1.7, 2.5, 3.5, 10]
)
"""Depths [m] for which starts are tabulated: the levels of the table's corners"""
_SLACK = 2e-5
"""A place may be the deepest inside a cell if it is less deep by this at a corner [m], and by the next. Tuned;
tests/model/test_surfaces.py, which compares with brute force, would notice."""
_SLACK_PER_DISTANCE = 0.1
"""What is added to that, per distance from the deepest place. Tuned; as above"""
_SAME_START = 4e-4
"""Distance [m] of two tibial places up to which they are one start"""
_STEEPEST = 1.4
"""Largest slope angle [rad] of a tibia that is searched for contacts"""
_SPACING = 5e-5
"""Distance [m] of the points of the tibia and of the envelopes"""
_POINTS_PER_SEGMENT = 8
"""Number of points in a segment of a femoral profile"""
_FAR_BELOW = -1.0
"""Height [m] of what must not be the highest"""


def height_and_slope(pieces: Floats, x: Floats) -> tuple[Floats, Floats]:
    """Return height [m] and slope of a curved tibia, `Surfaces.tibia`, at places x [m]."""
    start, c0, c1, c2, c3 = pieces[np.searchsorted(pieces[1:, 0], x, side="right"), :5].T
    u = x - start
    return c0 + u * (c1 + u * (c2 + u * c3)), c1 + u * (2.0 * c2 + u * 3.0 * c3)


def starts_table(femur: Circle | Profile, tibia: Floats, mechanism: Mechanism) -> KernelTable:
    """Tabulate where a search for the common normal starts, by brute force over angles, depths and femoral points.

    The femur has a gap g where it touches the upper envelope of balls of radius g about the tibia's points, and a depth
    d where it touches the lower envelope. A corner of the table has an angle and a depth. There, the femoral points
    that may be deepest are those with the smallest vertical clearance above the envelope, each with all tibial points
    that may be nearest.
    """
    cubics = femur.cubics
    angles = COLUMN_EDGES
    sine: Any = sines(angles)[:, None]
    cosine: Any = cosines(angles)[:, None]
    parts = _POINTS_PER_SEGMENT
    inner = 0.0
    if isinstance(femur, Circle):
        # It looks the same at every angle. Its spline is a smaller circle, and has points enough.
        sine, cosine = 0.0, 1.0
        parts = 1
        inner = SHRUNK * femur.radius
    px, py = curve_points(cubics, parts)
    moved = np.array([mechanism.translation(angle)[0] for angle in angles.tolist()])
    # Femoral points relative to the tibia, at height 0 of the femoral reference point; shape (angles, points)
    x = moved[:, None] + cosine * px - sine * py
    y = sine * px + cosine * py + np.zeros_like(x)
    place = np.arange(x.min(), x.max() + _SPACING, _SPACING)
    found = []
    heights = np.empty((len(angles), len(_DEPTHS)))
    for level, depth in enumerate((_DEPTHS - inner).tolist()):
        # Balls whose feet are on the tibia, and which touch the femur at `place`: their highest or lowest tops
        sign = -1.0 if depth > 0.0 else 1.0
        reach = math.ceil(abs(depth) * math.sin(_STEEPEST) / _SPACING) + 1
        offset = _SPACING * np.arange(-reach, reach + 1)
        top = np.sqrt(np.maximum(depth * depth - offset**2, 0.0))
        ball = np.where(abs(offset) <= abs(depth), top, _FAR_BELOW)
        beside = place[0] + _SPACING * np.arange(-reach, len(place) + reach)
        rise, _ = height_and_slope(tibia, beside)
        tops = sliding_window_view(sign * rise, len(offset)) + ball
        best = np.clip(tops.argmax(axis=1), 1, 2 * reach - 1)
        before, at, behind = (tops[np.arange(len(place)), best + k] for k in (-1, 0, 1))
        # The envelope is the top of a parabola through the highest ball and its neighbours.
        bend = np.maximum(2.0 * at - before - behind, 1e-12)
        envelope = sign * (at + (behind - before) ** 2 / (8.0 * bend))
        clear = y - np.interp(x, place, envelope)
        lowest = clear.argmin(axis=1)
        least = clear[np.arange(len(angles)), lowest]
        heights[:, level] = -least
        # Femoral points that are less clear than their neighbours, unless the slack rules them out
        edge = np.full((len(angles), 1), math.inf)
        left = np.hstack([edge, clear[:, :-1]])
        right = np.hstack([clear[:, 1:], edge])
        columns, points = np.nonzero((clear <= left) & (clear < right))
        deepest = lowest[columns]
        touched = _places_of(x[columns, points], place)
        other = _places_of(x[columns, deepest], place)
        away = np.hypot(px[points] - px[deepest], py[points] - py[deepest])
        higher = clear[columns, points] - least[columns]
        shift = place[touched] - place[other] - offset[best[other]]
        distance = away + abs(shift + offset[best[touched]])
        kept = higher <= _SLACK_PER_DISTANCE * distance + _SLACK
        columns, points, touched = columns[kept], points[kept], touched[kept]
        away, higher, shift = away[kept], higher[kept], shift[kept]
        which = np.arange(len(points))
        foot = best[touched]
        if depth < 0.0:
            # Apart, other tops of the tibia may become the nearest ones to the same femoral point.
            near = tops[touched]
            inside = near[:, 1:-1]
            which, foot = np.nonzero((inside > near[:, :-2]) & (inside >= near[:, 2:]))
            foot += 1
        lower = at[touched[which]] - tops[touched[which], foot]
        distance = away[which] + abs(shift[which] + offset[foot])
        kept = higher[which] + lower <= _SLACK_PER_DISTANCE * distance + _SLACK
        which, foot = which[kept], foot[kept]
        feet = place[touched[which]] + offset[foot]
        found.append(np.stack([columns[which], np.full(len(which), level), points[which], feet]))
    return _cells(np.concatenate(found, axis=1), heights, cubics, tibia, parts)


def _places_of(x: Floats, place: Floats) -> Indices:
    """Return the indices of the places nearest to x [m]."""
    return np.asarray((x - place[0]) / _SPACING + 0.5).astype(np.intp)


def _cells(
    corners: Floats, heights: Floats, cubics: Floats, tibia: Floats, parts: int
) -> KernelTable:
    """Assign each cell of the table the starts of its four corners: column, level, femoral point and tibial x [m]."""
    rows = len(_DEPTHS) - 1
    columns, levels, points, places = corners
    middle = 0.5 * (heights[1:] + heights[:-1])
    around = [(columns - i, levels - j, points, places) for i in (0, 1) for j in (0, 1)]
    columns, levels, points, places = np.concatenate(np.array(around), axis=1)
    inside = (columns >= 0) & (columns < len(heights) - 1) & (levels >= 0) & (levels < rows)
    cells = (columns * rows + levels)[inside].astype(np.int64)
    points, places = points[inside], places[inside]
    order = np.lexsort((places, points, cells))
    cells, points, places = cells[order], points[order], places[order]
    # In a cell with at most four starts there is one place, which moves from corner to corner.
    crowded = np.bincount(cells)[cells] > 4
    separation = np.where(crowded, _SAME_START, 4.0 * _SAME_START)
    apart = np.abs(np.diff(places, prepend=-9.0)) > separation
    apart |= crowded & (np.diff(points, prepend=-9.0) > 1.0)
    new = np.flatnonzero((np.diff(cells, prepend=-1) != 0) | apart)
    number = np.diff(new, append=len(cells))
    points = np.add.reduceat(points, new) / number
    places = np.add.reduceat(places, new) / number
    segments = np.minimum(points // parts, len(cubics) - 1)
    u = (points / parts - segments) * cubics[segments.astype(np.int64), 0]
    pieces = np.searchsorted(tibia[1:, 0], places, side="right")
    begins = np.searchsorted(cells[new], np.arange(len(middle) * rows + 1)).astype(np.int64)
    starts = np.column_stack([segments, u, pieces, places])
    return KernelTable(middle, begins, starts, cubics, NO_TABLE.kinks)
