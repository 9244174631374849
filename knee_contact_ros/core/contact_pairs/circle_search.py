"""The deepest point of a circle, which is in the direction of the nearest tibial point to its centre."""

from __future__ import annotations

from typing import NamedTuple

from knee_contact_ros.core.contact_pairs.base import Closest
from knee_contact_ros.core.contact_pairs.tibial_surface import TibialSurface


class CircleOver(NamedTuple):
    """A circle above a place of a tibial surface, as a `Search`."""

    tibia: TibialSurface
    radius: float
    """Radius of the circle [m]"""
    x: float
    """x of its centre [m]"""

    def deepest(self, height: float) -> Closest:
        """Return the common normal for the height [m] of the centre."""
        distance, normal_x, normal_y, _ = self.tibia.foot(self.x, height)
        return Closest(
            depth=self.radius - distance, extent=self.radius, turning=0.0, normal_x=normal_x, normal_y=normal_y,
        )  # fmt: skip


class CircleSearch(NamedTuple):
    """A circle whose deepest point can be found, as a `Searched`."""

    radius: float
    """Radius of the circle [m]"""

    def over(self, tibia: TibialSurface, angle: float, x: float) -> CircleOver:
        """Put its centre above `x` [m]; the angle [rad] has no effect."""
        return CircleOver(tibia, self.radius, x)
