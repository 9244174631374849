"""A femoral profile in one pose over a tibial surface: the signed distance along the curve, and bounds of it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from knee_contact_ros.core.contact_pairs.least import Bends, Function, Sample
from knee_contact_ros.core.contact_pairs.tibial_surface import Floats, TibialSurface, level_curvatures
from knee_contact_ros.core.geometries.profile import Profile

Cubic = tuple[float, float, float, float]

TINY = 1e-300
"""Keeps a straight segment, which has no sag, from a division by zero"""


class Arc(NamedTuple):
    """One cubic segment of the curve, relative to the reference point."""

    length: float
    """Of the parameter u [m]"""
    x: Cubic
    y: Cubic
    speed: float
    """Upper bound of the length of the first derivative p'"""
    bend: float
    """Largest length of the second derivative p'' [1/m]; it is linear in u"""

    def turned(self, angle: float) -> Arc:
        """The same with the femur turned by `angle` [rad]."""
        sine, cosine = math.sin(angle), math.cos(angle)
        (x0, x1, x2, x3), (y0, y1, y2, y3) = self.x, self.y
        return self._replace(
            x=(cosine * x0 - sine * y0, cosine * x1 - sine * y1, cosine * x2 - sine * y2, cosine * x3 - sine * y3),
            y=(sine * x0 + cosine * y0, sine * x1 + cosine * y1, sine * x2 + cosine * y2, sine * x3 + cosine * y3),
        )

    def point(self, u: float) -> tuple[float, float]:
        """Place of a parameter, relative to the reference point [m]."""
        (x0, x1, x2, x3), (y0, y1, y2, y3) = self.x, self.y
        return x0 + u * (x1 + u * (x2 + u * x3)), y0 + u * (y1 + u * (y2 + u * y3))

    def distance(self, surface: TibialSurface, x: float, height: float) -> tuple[Function, Bends]:
        """Signed distance [m] above a surface as a function of u, and bounds of its second derivative.

        By the envelope theorem its slope is p'·n. The normal n turns with the curvature k of the line of equal
        distance, so the second derivative is p''·n - k (p'·t)².
        """
        (_, x1, x2, x3), (_, y1, y2, y3) = self.x, self.y

        def function(u: float) -> Sample:
            p_x, p_y = self.point(u)
            distance, n_x, n_y, curvature = surface.foot(x + p_x, height + p_y)
            x_slope, y_slope = x1 + u * (2.0 * x2 + 3.0 * u * x3), y1 + u * (2.0 * y2 + 3.0 * u * y3)
            x_bend, y_bend = 2.0 * x2 + 6.0 * u * x3, 2.0 * y2 + 6.0 * u * y3
            along, room = x_slope * n_y - y_slope * n_x, 1.0 - curvature * distance
            turning = curvature / room * along * along if room > 0.0 else 0.0
            slope, bend = x_slope * n_x + y_slope * n_y, x_bend * n_x + y_bend * n_y
            return Sample(u, distance, slope, bend - turning, (n_x, n_y))

        def bends(a: Sample, b: Sample) -> tuple[float, float]:
            way = self.speed * (b.place - a.place)
            middle = 0.5 * (a.value + b.value)
            convex, concave = level_curvatures(surface, middle - 0.5 * way, middle + 0.5 * way)
            n_x, n_y = a.normal
            ends = [(2.0 * x2 + 6.0 * u * x3) * n_x + (2.0 * y2 + 6.0 * u * y3) * n_y for u in (a.place, b.place)]
            turned = self.bend * min(max(-convex, concave) * way, 2.0)  # n turns by no more than curvature times way
            squared = self.speed * self.speed
            low = max(min(ends) - turned, -self.bend) - concave * squared
            return low, min(max(ends) + turned, self.bend) - convex * squared

        return function, bends


class FemoralCurve:
    """All segments of a profile, also as arrays."""

    def __init__(self, profile: Profile) -> None:
        """Gather the segments of `profile` and their bounds."""
        segments = profile.segments
        u = np.array([segment.length for segment in segments])
        x, y = (np.array([getattr(segment, axis) for segment in segments]).T for axis in "xy")
        last = segments[-1]
        self.nodes = np.array(
            [[*axis[0], np.polyval(end[::-1], last.length)] for axis, end in ((x, last.x), (y, last.y))]
        )
        """All points of the profile, shape (2, segments + 1) [m]"""
        self.lengths = u
        controls = [
            (axis[1], axis[1] + u * axis[2], axis[1] + u * (2.0 * axis[2] + 3.0 * u * axis[3])) for axis in (x, y)
        ]
        self.speeds = np.hypot(*np.array(controls)).max(axis=0)
        bends = [(2.0 * axis[2], 2.0 * axis[2] + 6.0 * u * axis[3]) for axis in (x, y)]
        self.bends = np.hypot(*np.array(bends)).max(axis=0)
        self.arcs = [
            Arc(*segment[:3], speed, bend)
            for segment, speed, bend in zip(segments, self.speeds.tolist(), self.bends.tolist(), strict=True)
        ]

    def least_distances(self, surface: TibialSurface, angle: float, x: float, height: float) -> tuple[Floats, float]:
        """Lower bounds of the signed distance of each segment [m], and an upper bound of the least of them."""
        sine, cosine = math.sin(angle), math.cos(angle)
        node_x, node_y = self.nodes
        lower, upper = surface.distances(
            x + (cosine * node_x - sine * node_y), height + (sine * node_x + cosine * node_y)
        )
        convex, _ = level_curvatures(surface, float(lower.min()) - float(self.lengths.max()), math.inf)
        sag = 0.125 * self.lengths**2 * (self.bends - convex * self.speeds**2)
        rise = np.abs(np.diff(lower))
        tilt = np.maximum(1.0 - 0.25 * rise / (sag + TINY), 0.0)
        return np.minimum(lower[:-1], lower[1:]) - sag * tilt * tilt, float(upper.min())
