"""A circle's deepest point lies where the nearest point to its centre is: there is nothing to search."""

from __future__ import annotations

from typing import NamedTuple

from knee_contact_ros.core.contact_pairs.base import Closest
from knee_contact_ros.core.contact_pairs.tibial_surface import TibialSurface


class CircleOver(NamedTuple):
    """A circle over a tibial surface; see `Search`."""

    tibia: TibialSurface
    radius: float
    """[m]"""
    x: float
    """Of its centre [m]"""

    def deepest(self, height: float) -> Closest:
        """See `Search`."""
        distance, normal_x, normal_y, _ = self.tibia.foot(self.x, height)
        return Closest(
            depth=self.radius - distance, extent=self.radius, turning=0.0, normal_x=normal_x, normal_y=normal_y,
        )  # fmt: skip


class CircleSearch(NamedTuple):
    """A circle whose deepest point is asked for; see `Searched`."""

    radius: float
    """[m]"""

    def over(self, tibia: TibialSurface, angle: float, x: float) -> CircleOver:
        """See `Searched`."""
        return CircleOver(tibia, self.radius, x)
