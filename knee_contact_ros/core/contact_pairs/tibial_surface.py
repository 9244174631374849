"""Tibial surfaces: their signed distance and bounds of it.

The surface is the graph of a C1 function of x, which is straight far away on both sides. So it divides the plane into
above and below, the signed distance (> 0 above) changes by no more than the way of the point, and a ball that touches
the surface from above with a radius of at most 1/largest curvature lies above all of it (Blaschke).
"""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

from knee_contact_ros.core.arrays import Floats
from knee_contact_ros.core.kernel_source import in_kernel, kernel_interface

MOST_STEPS = 10
"""Largest number of Newton's steps; more mean that it does not converge"""
LAST_STEP = 1e-9
"""Length [m] of a step below which it is the last; it leaves an error of the order of its square times the
curvatures"""
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


@kernel_interface
class SignedDistance(Protocol):
    """The part of a tibial surface that the kernel calls."""

    def foot(self, x: float, y: float) -> Foot:
        """Return the nearest point of the surface to (x, y) [m]."""
        ...

    def bounds(self, x: float, y: float) -> tuple[float, float]:
        """Return a lower and an upper bound of the signed distance [m] of a point (x, y) [m]; quicker than `foot`."""
        ...

    def graph(self, x: float) -> tuple[float, float, float]:
        """Return height [m], slope and second derivative [1/m] of the surface at x [m]."""
        ...

    def cup(self, x: float) -> float:
        """The curvature [1/m], >= 0, of a ball that touches from above at x [m] and lies above all of the surface."""
        ...

    def curvatures(self) -> tuple[float, float]:
        """Return bounds of the curvature [1/m]: the lower one <= 0, the upper one >= 0."""
        ...

    def least_normal_y(self) -> float:
        """Return a lower bound of y of the unit normal, > 0."""
        ...


class TibialSurface(SignedDistance, Protocol):
    """A tibial surface in the tibia frame, below the femur: a named tuple."""

    def outline(self, reach: float) -> Floats:
        """Return points along the surface, shape (n, 2) [m], to `reach` [m] on both sides."""
        ...


@in_kernel
def level_curvatures(curvatures: tuple[float, float], lowest: float, highest: float) -> tuple[float, float]:
    """Return bounds of the curvature [1/m] of the lines of equal signed distance between two distances [m].

    `curvatures` are those of the surface. A line at a distance d over a curvature k has the curvature k/(1 - k d). The
    upper bound is infinite where the nearest point may not be the only one.
    """
    convex, concave = curvatures
    room = 1.0 - concave * highest
    return convex / max(1.0 - convex * lowest, 1.0 - DEEPEST_PART), concave / room if room > 0.0 else math.inf
