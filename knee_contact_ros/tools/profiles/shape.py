"""What a profile is like as the model will take it: curvature, convexity, fitted circles."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from knee_contact_ros.core.arrays import Floats
from knee_contact_ros.tools.profiles.charts import circle

PER_POINT = 10
"""Places per point at which the spline is looked at"""
FEMORAL_WINDOWS = ((-15.0, 25.0), (20.0, 70.0), (60.0, 110.0))
"""Directions of the outward normal [deg]: 0 straight down, > 0 posterior, which is the flexion angle that touches
there"""
TIBIAL_WINDOWS = ((0.15, 0.75), (0.2, 0.8), (0.25, 0.75), (0.3, 0.7))
"""Shares of the plateau's width, from posterior"""
LEAST_PLACES = 8
STRAIGHT = 1.0
"""[1/m] A place of a femur's profile whose curvature is less below 0 is as good as straight"""


class Shape(NamedTuple):
    """A profile's spline, place by place."""

    points: Floats
    """Shape (n, 2) [m]"""
    curvature: Floats
    """Shape (n,) [1/m]; femur: > 0 where it is convex, tibia: > 0 where it is concave"""
    normal: Floats
    """Shape (n,) [rad]: direction of a femur's outward normal, 0 straight down, > 0 posterior"""


class FittedCircle(NamedTuple):
    """The circle of least squares through a part of a profile."""

    window: tuple[float, float]
    """Femur: from and to which normal [deg]; tibia: from and to which x [mm]"""
    centre: Floats
    radius: float
    """[m]; < 0 where a tibia is convex"""
    part: Floats
    """The points, shape (n, 2) [m]"""


def shape_of(points: Floats) -> Shape:
    """The cubic spline over the chord length through points of shape (n, 2) [m]: what the model makes of a profile."""
    from scipy.interpolate import CubicSpline

    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    spline = CubicSpline(way, points)
    places = np.linspace(0.0, way[-1], PER_POINT * (len(points) - 1) + 1)
    (x1, y1), (x2, y2) = spline(places, 1).T, spline(places, 2).T
    normal = -np.unwrap(np.arctan2(y1, x1))
    middle = np.median(normal)
    normal -= 2.0 * np.pi * np.round(middle / (2.0 * np.pi))
    return Shape(spline(places), (x1 * y2 - y1 * x2) / np.hypot(x1, y1) ** 3, normal)


def femoral_circles(shape: Shape) -> list[FittedCircle]:
    """Circles over `FEMORAL_WINDOWS`, as far as the profile reaches."""
    degrees = np.degrees(shape.normal)
    found = []
    for low, high in FEMORAL_WINDOWS:
        part = shape.points[(degrees >= low) & (degrees <= high)]
        if len(part) >= LEAST_PLACES and degrees.min() <= low + 1.0 and degrees.max() >= high - 1.0:
            found.append(FittedCircle((low, high), *circle(part), part))
    return found


def tibial_circles(shape: Shape) -> list[FittedCircle]:
    """Circles over `TIBIAL_WINDOWS`."""
    x = shape.points[:, 0]
    found = []
    for low, high in TIBIAL_WINDOWS:
        begin, end = (x.min() + share * np.ptp(x) for share in (low, high))
        part = shape.points[(x >= begin) & (x <= end)]
        centre, radius = circle(part)
        window = (1e3 * float(begin), 1e3 * float(end))
        found.append(FittedCircle(window, centre, radius if centre[1] > part[:, 1].mean() else -radius, part))
    return found


def dented(shape: Shape) -> list[tuple[float, float]]:
    """From where to where [rad] of the normal a femur's profile is not convex."""
    return runs(shape.curvature < -STRAIGHT, shape.normal)


def concave(shape: Shape) -> list[tuple[float, float]]:
    """From where to where [m] of x a tibia's profile is concave."""
    return runs(shape.curvature > 0.0, shape.points[:, 0])


def runs(where: Any, values: Floats) -> list[tuple[float, float]]:
    """First and last value of every run of places that are marked."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], np.asarray(where, np.int8), [0]])))
    return [(float(values[a]), float(values[b - 1])) for a, b in zip(edges[::2], edges[1::2], strict=True)]
