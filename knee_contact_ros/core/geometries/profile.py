"""A femoral condyle as a cubic spline through measured points, its support function in closed form.

On one spline segment, h is stationary where the tangent is parallel to the plane: a quadratic in the segment's
parameter. The largest value over the segments and their ends is the support of the whole curve, so a dent between noisy
points can never be taken for the contact. Which segments can hold the largest value is tabulated once over the angle.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.core.geometries.kinks import Segment, find_kinks

CELLS = 2048
"""Cells of the table of candidate segments over the full turn."""


class Profile:
    """An open curve through points of the femur frame: x anterior, y superior, origin at the reference point."""

    def __init__(self, x: Sequence[float] | NDArray[np.float64], y: Sequence[float] | NDArray[np.float64]) -> None:
        """Fit a C2 cubic spline over the chord length through all points `x`, `y` [m], ordered along the curve.

        A point that repeats the one before it counts once.

        Raises:
            ValueError: fewer than 4 different points, or a number that is not finite.
        """
        points = np.stack([np.asarray(x, float), np.asarray(y, float)])
        if not np.isfinite(points).all():
            raise ValueError("a profile point is not finite")
        repeated = np.all(points[:, 1:] == points[:, :-1], axis=0)
        points = np.delete(points, np.flatnonzero(repeated), axis=1)
        if points.shape[1] < 4:
            raise ValueError(f"a profile needs at least 4 different points, got {points.shape[1]}")
        from scipy.interpolate import CubicSpline  # 0.9 s to import, which a circle need not pay

        chords = np.hypot(*np.diff(points))
        spline = CubicSpline(np.concatenate([[0.0], np.cumsum(chords)]), points, axis=1)
        coefficients = spline.c[::-1]  # ascending powers; shape (4, segments, 2)
        self.segments = tuple(
            Segment(chord, (x0, x1, x2, x3), (y0, y1, y2, y3), start)
            for chord, (x0, x1, x2, x3), (y0, y1, y2, y3), start in zip(
                chords.tolist(),
                coefficients[:, :, 0].T.tolist(),
                coefficients[:, :, 1].T.tolist(),
                spline.x[:-1].tolist(),
                strict=True,
            )
        )
        self._cells = self._candidates()
        self.kinks = find_kinks(self.segments, self.lowest)
        directions = np.unwrap(np.arctan2(*np.diff(points)[::-1]))
        self.grain = float(np.abs(np.diff(directions)).mean())

    def support(self, angle: float) -> tuple[float, float]:
        """Return h [m] and dh/dangle [m/rad] at an angle [rad], positive in flexion."""
        sine, cosine = math.sin(angle), math.cos(angle)
        depth, x, y, _ = self.lowest(angle)
        return depth, sine * y - cosine * x

    def lowest(self, angle: float) -> tuple[float, float, float, float]:
        """Lowest point at an angle [rad]: its depth h, its x and y in the femur frame, its place on the curve [m]."""
        sine, cosine = math.sin(angle), math.cos(angle)
        cell = int(angle % math.tau * (CELLS / math.tau)) % CELLS
        return max(_lowest(segment, sine, cosine) for segment in self._cells[cell])

    def outline(self, points_per_segment: int = 4) -> NDArray[np.float64]:
        """Points along the curve, shape (n, 2) [m], for drawing."""
        part = np.linspace(0.0, 1.0, points_per_segment, endpoint=False)
        strips = [
            np.stack([np.polyval(axis[::-1], part * segment.length) for axis in (segment.x, segment.y)], axis=1)
            for segment in self.segments
        ]
        return np.concatenate(strips)

    def _candidates(self) -> tuple[tuple[Segment, ...], ...]:
        """Per cell of angle, the segments that may hold the lowest point somewhere in it.

        Between the middle of a cell and its ends, the support of one segment gains on that of another at most half the
        width times the distance between them (h' = -x). What lies further behind than that in the middle cannot win.
        """
        half_width = math.pi / CELLS
        angles = (2.0 * np.arange(CELLS, dtype=np.float64) + 1.0) * half_width
        depths = self._depths(angles)
        best = np.argmax(depths, axis=1)
        centres, radii = self._bounding_circles()
        distances = np.hypot(*np.moveaxis(centres[:, None] - centres[None, :], 2, 0)) + radii[:, None] + radii[None, :]
        behind = depths[np.arange(CELLS), best][:, None] - depths
        possible = behind <= half_width * distances[best]
        return tuple(tuple(self.segments[i] for i in np.flatnonzero(row)) for row in possible)

    def _depths(self, angles: NDArray[np.float64]) -> NDArray[np.float64]:
        """Support of every segment [m], shape (angles, segments)."""
        x, y = (np.array([getattr(segment, axis) for segment in self.segments]).T[:, None, :] for axis in "xy")
        length = np.array([segment.length for segment in self.segments])
        c0, c1, c2, c3 = -(np.sin(angles)[:, None] * x + np.cos(angles)[:, None] * y)
        with np.errstate(divide="ignore", invalid="ignore"):
            root = np.sqrt(4.0 * c2 * c2 - 12.0 * c3 * c1)
            q = -(c2 + np.copysign(0.5 * root, c2))
            roots = (c1 / q, q / (3.0 * c3))
        ends = (np.zeros_like(c0), np.broadcast_to(length, c0.shape))
        inside = [np.clip(np.nan_to_num(u, nan=0.0), 0.0, length) for u in (*ends, *roots)]
        return np.asarray(np.max([c0 + u * (c1 + u * (c2 + u * c3)) for u in inside], axis=0))

    def _bounding_circles(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Centre (segments, 2) and radius (segments,) [m] of a circle around each segment's Bezier control points."""
        controls = []
        for segment in self.segments:
            u = segment.length
            for c0, c1, c2, c3 in (segment.x, segment.y):
                controls.append(
                    [c0, c0 + u * c1 / 3, c0 + u * (2 * c1 + u * c2) / 3, c0 + u * (c1 + u * (c2 + u * c3))]
                )
        points = np.array(controls).reshape(len(self.segments), 2, 4)
        centres = points.mean(axis=2)
        return centres, np.asarray(np.hypot(*np.moveaxis(points - centres[:, :, None], 1, 0)).max(axis=1))


def _lowest(segment: Segment, sine: float, cosine: float) -> tuple[float, float, float, float]:
    """Lowest point of a turned segment: its depth below the reference point, its x, y, and its place on the curve."""
    c0, c1, c2, c3 = (-(sine * x + cosine * y) for x, y in zip(segment.x, segment.y, strict=True))
    best, where = c0, 0.0
    for u in (segment.length, *_stationary(c1, 2.0 * c2, 3.0 * c3)):
        if 0.0 < u <= segment.length:
            depth = c0 + u * (c1 + u * (c2 + u * c3))
            if depth > best:
                best, where = depth, u
    x0, x1, x2, x3 = segment.x
    y0, y1, y2, y3 = segment.y
    return (
        best,
        x0 + where * (x1 + where * (x2 + where * x3)),
        y0 + where * (y1 + where * (y2 + where * y3)),
        segment.start + where,
    )


def _stationary(constant: float, linear: float, square: float) -> tuple[float, ...]:
    """Real roots of constant + linear u + square u² = 0, without cancellation."""
    discriminant = linear * linear - 4.0 * square * constant
    if discriminant < 0.0:
        return ()
    q = -0.5 * (linear + math.copysign(math.sqrt(discriminant), linear))
    roots = []
    if q != 0.0:
        roots.append(constant / q)
    if square != 0.0:
        roots.append(q / square)
    return tuple(roots)
