"""A concave tibial plateau: an arc of a circle (95 mm in the paper), continued straight at both ends."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from knee_contact_ros.core.arrays import Floats
from knee_contact_ros.core.contact_pairs.tibial_surface import Foot

COSINE, SINE = 0.5, math.sqrt(0.75)
"""Cosine and sine of the arc's half angle, 60 degrees: far beyond any plateau, and the surface stays open upwards"""
OUTLINE_POINTS = 201
"""Number of points of an outline"""


class _TibialCircle(NamedTuple):
    """Fields of a `TibialCircle`."""

    radius: float
    """Radius of the arc [m], > 0"""


class TibialCircle(_TibialCircle):
    """An arc of +-60 degrees about the lowest point, which is the origin of the tibia frame, and its end tangents."""

    __slots__ = ()

    def __new__(cls, radius: float) -> TibialCircle:
        """Make the surface of a radius [m].

        Raises:
            ValueError: the radius is not a finite positive number.
        """
        if not (math.isfinite(radius) and radius > 0.0):
            raise ValueError(f"a tibial radius must be finite and > 0, got {radius}")
        return super().__new__(cls, float(radius))

    def foot(self, x: float, y: float) -> Foot:
        """Return the nearest point of the surface to (x, y) [m], in closed form."""
        below_centre = self.radius - y
        if COSINE * abs(x) >= SINE * below_centre:
            over_tangent = COSINE * y - SINE * abs(x) + (1.0 - COSINE) * self.radius
            return Foot(over_tangent, -math.copysign(SINE, x), COSINE, 0.0)
        from_centre = math.sqrt(x * x + below_centre * below_centre)
        distance = (y * (self.radius + below_centre) - x * x) / (self.radius + from_centre)
        return Foot(distance, -x / from_centre, below_centre / from_centre, 1.0 / self.radius)

    def bounds(self, x: float, y: float) -> tuple[float, float]:
        """Return the signed distance [m] of (x, y) [m] as both of its bounds."""
        distance = self.foot(x, y).distance
        return distance, distance

    def graph(self, x: float) -> tuple[float, float, float]:
        """Return height [m], slope and second derivative [1/m] at x [m]."""
        end = SINE * self.radius
        on_arc = min(abs(x), end)
        root = math.sqrt(self.radius * self.radius - on_arc * on_arc)
        slope = math.copysign(on_arc / root, x)
        height = on_arc * on_arc / (self.radius + root) + (abs(x) - on_arc) * abs(slope)
        return height, slope, self.radius * self.radius / (root * root * root) if abs(x) < end else 0.0

    def cup(self, x: float) -> float:
        """Return the curvature [1/m] of the arc."""
        return 1.0 / self.radius

    def curvatures(self) -> tuple[float, float]:
        """Return bounds of the curvature [1/m]."""
        return 0.0, 1.0 / self.radius

    def least_normal_y(self) -> float:
        """Return y of the unit normal of the straight ends."""
        return COSINE

    def outline(self, reach: float) -> Floats:
        """Return points along the surface, shape (n, 2) [m], to `reach` [m] on both sides."""
        x = np.linspace(-reach, reach, OUTLINE_POINTS)
        end = SINE * self.radius
        on_arc = np.minimum(np.abs(x), end)
        y = on_arc**2 / (self.radius + np.sqrt(self.radius**2 - on_arc**2)) + (np.abs(x) - on_arc) * SINE / COSINE
        return np.stack([x, y], axis=1)
