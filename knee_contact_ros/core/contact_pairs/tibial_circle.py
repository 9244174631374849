"""A concave tibial plateau: an arc of a circle (the paper's 95 mm), straight on from both ends."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from knee_contact_ros.core.contact_pairs.tibial_surface import Floats, Foot

COSINE, SINE = 0.5, math.sqrt(0.75)
"""Of the arc's half angle, 60 degrees: far beyond any plateau, and the surface stays open to the femur's side"""
OUTLINE_POINTS = 201
"""Of a drawing"""


@dataclass(frozen=True)
class TibialCircle:
    """An arc of +-60 degrees about the lowest point, which is the origin of the tibia frame, and its end tangents."""

    radius: float
    """[m], > 0"""

    def __post_init__(self) -> None:
        """Refuse a radius that is none.

        Raises:
            ValueError: the radius is not a finite positive number.
        """
        if not (math.isfinite(self.radius) and self.radius > 0.0):
            raise ValueError(f"a tibial radius must be finite and > 0, got {self.radius}")

    @property
    def curvatures(self) -> tuple[float, float]:
        """Bounds of the curvature [1/m]."""
        return 0.0, 1.0 / self.radius

    @property
    def least_normal_y(self) -> float:
        """Vertical part of the normal of the end tangents."""
        return COSINE

    def foot(self, x: float, y: float) -> Foot:
        """The nearest point of the surface to (x, y) [m], in closed form."""
        below_centre = self.radius - y
        if COSINE * abs(x) >= SINE * below_centre:
            over_tangent = COSINE * y - SINE * abs(x) + (1.0 - COSINE) * self.radius
            return Foot(over_tangent, -math.copysign(SINE, x), COSINE, 0.0)
        from_centre = math.hypot(x, below_centre)
        distance = (y * (self.radius + below_centre) - x * x) / (self.radius + from_centre)
        return Foot(distance, -x / from_centre, below_centre / from_centre, 1.0 / self.radius)

    def distances(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Signed distances [m] of many points: the bounds coincide."""
        below_centre = self.radius - y
        over_arc = (y * (self.radius + below_centre) - x * x) / (self.radius + np.hypot(x, below_centre))
        side = np.abs(x)
        over_tangent = COSINE * y - SINE * side + (1.0 - COSINE) * self.radius
        distances = np.where(COSINE * side >= SINE * below_centre, over_tangent, over_arc)
        return distances, distances

    def outline(self, reach: float) -> Floats:
        """Points along the surface, shape (n, 2) [m], to `reach` [m] on both sides."""
        x = np.linspace(-reach, reach, OUTLINE_POINTS)
        end = SINE * self.radius
        on_arc = np.minimum(np.abs(x), end)
        y = on_arc**2 / (self.radius + np.sqrt(self.radius**2 - on_arc**2)) + (np.abs(x) - on_arc) * SINE / COSINE
        return np.stack([x, y], axis=1)
