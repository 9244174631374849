"""What a tibial surface is to a contact pair: its signed distance, and bounds of it.

The surface is the graph of a function of x, C1, and straight from some place on to either side. So it parts the plane
into above and below, the signed distance (> 0 above) changes by no more than the way of the point, and a ball that
touches the surface from above with a radius of at most 1/largest curvature lies above it altogether (Blaschke).
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

DEEPEST_PART = 0.9
"""Largest depth below a convex place of the surface that the bounds hold for, in radii of curvature"""


class Foot(NamedTuple):
    """The nearest point of the surface: signed distance from it [m], its unit normal (upwards), curvature [1/m].

    The curvature is > 0 where the surface is concave, like a cup.
    """

    distance: float
    normal_x: float
    normal_y: float
    curvature: float


class TibialSurface(Protocol):
    """A tibial surface in the tibia frame, with the femur above it."""

    @property
    def curvatures(self) -> tuple[float, float]:
        """Bounds of the curvature [1/m]: the lower one <= 0, the upper one >= 0."""
        ...

    @property
    def least_normal_y(self) -> float:
        """Lower bound of the vertical part of the unit normal, > 0."""
        ...

    def foot(self, x: float, y: float) -> Foot:
        """The nearest point of the surface to (x, y) [m]."""
        ...

    def distances(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Lower and upper bounds of the signed distances [m] of many points [m], of the shape of `x`."""
        ...

    def outline(self, reach: float) -> Floats:
        """Points along the surface, shape (n, 2) [m], to `reach` [m] on both sides."""
        ...


def level_curvatures(surface: TibialSurface, lowest: float, highest: float) -> tuple[float, float]:
    """Bounds of the curvature [1/m] of the lines of equal signed distance between two distances [m].

    A line at a distance d over a curvature k has the curvature k/(1 - k d). The upper bound is infinite where the
    nearest point may not be the only one.
    """
    convex, concave = surface.curvatures
    room = 1.0 - concave * highest
    return convex / max(1.0 - convex * lowest, 1.0 - DEEPEST_PART), concave / room if room > 0.0 else float("inf")
