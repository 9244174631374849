"""Shape of a profile as the model takes it: curvature, normals, convexity and fitted circles."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from knee_contact_ros.model.types import Floats
from knee_contact_ros.tools.profiles.charts import chord_length, circle

PER_POINT = 10
"""Number of places per point at which the spline is evaluated"""
FEMORAL_WINDOWS = ((-15.0, 25.0), (20.0, 70.0), (60.0, 110.0))
"""Ranges of the direction of the outward normal [deg], 0 straight down, > 0 posterior: the flexion angle at which the
place is in contact"""
TIBIAL_WINDOWS = ((0.15, 0.75), (0.2, 0.8), (0.25, 0.75), (0.3, 0.7))
"""Ranges of the share of the plateau's width, from posterior"""
LEAST_PLACES = 8
STRAIGHT = 1.0
"""Magnitude of a negative curvature of a femur's profile [1/m] below which it counts as straight"""


class Shape(NamedTuple):
    """Points, curvatures and normals of a profile's spline, place by place."""

    points: Floats
    """Points, shape (n, 2) [m]"""
    curvature: Floats
    """Curvatures, shape (n,) [1/m], > 0 where a femur is convex or a tibia is concave"""
    normal: Floats
    """Directions of a femur's outward normal, shape (n,) [rad], 0 straight down, > 0 posterior"""


class FittedCircle(NamedTuple):
    """Circle fitted to a part of a profile by least squares."""

    window: tuple[float, float]
    """Ends of the part: directions of the normal [deg] for a femur, x [mm] for a tibia"""
    centre: Floats
    radius: float
    """Radius [m], < 0 where a tibia is convex"""
    part: Floats
    """Points of the part, shape (n, 2) [m]"""


def shape_of(points: Floats) -> Shape:
    """Evaluate the cubic spline over chord length through points of shape (n, 2) [m], as the model does."""
    from scipy.interpolate import CubicSpline

    way = chord_length(points)
    spline = CubicSpline(way, points)
    places = np.linspace(0.0, way[-1], PER_POINT * (len(points) - 1) + 1)
    (x1, y1), (x2, y2) = spline(places, 1).T, spline(places, 2).T
    normal = -np.unwrap(np.arctan2(y1, x1))
    normal -= 2.0 * np.pi * np.round(np.median(normal) / (2.0 * np.pi))
    return Shape(spline(places), (x1 * y2 - y1 * x2) / np.hypot(x1, y1) ** 3, normal)


def femoral_circles(shape: Shape) -> list[FittedCircle]:
    """Fit circles over those `FEMORAL_WINDOWS` that the profile covers."""
    degrees = np.degrees(shape.normal)
    circles = []
    for low, high in FEMORAL_WINDOWS:
        part = shape.points[(degrees >= low) & (degrees <= high)]
        if len(part) >= LEAST_PLACES and degrees.min() <= low + 1.0 and degrees.max() >= high - 1.0:
            circles.append(FittedCircle((low, high), *circle(part), part))
    return circles


def tibial_circles(shape: Shape) -> list[FittedCircle]:
    """Fit circles over `TIBIAL_WINDOWS`."""
    x = shape.points[:, 0]
    circles = []
    for low, high in TIBIAL_WINDOWS:
        begin, end = (x.min() + share * np.ptp(x) for share in (low, high))
        part = shape.points[(x >= begin) & (x <= end)]
        centre, radius = circle(part)
        window = (1e3 * float(begin), 1e3 * float(end))
        circles.append(FittedCircle(window, centre, radius if centre[1] > part[:, 1].mean() else -radius, part))
    return circles


def dented(shape: Shape) -> list[tuple[float, float]]:
    """Ranges of the normal's direction [rad] in which a femur's profile is not convex."""
    return runs(shape.curvature < -STRAIGHT, shape.normal)


def concave(shape: Shape) -> list[tuple[float, float]]:
    """Ranges of x [m] in which a tibia's profile is concave."""
    return runs(shape.curvature > 0.0, shape.points[:, 0])


def runs(where: Any, values: Floats) -> list[tuple[float, float]]:
    """First and last value of every run of adjacent places that are marked in `where`."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], np.asarray(where, np.int8), [0]])))
    return [(float(values[a]), float(values[b - 1])) for a, b in zip(edges[::2], edges[1::2], strict=True)]
