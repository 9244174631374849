"""A fixed flexion axis through the reference point: the hinge, and in the plane also the ball-and-socket joint."""

from __future__ import annotations

from typing import NamedTuple


class Hinge(NamedTuple):
    """A mechanism whose reference point stays above one place of the tibia at every flexion angle."""

    x: float = 0.0
    """x of that place [m], anterior positive; 0 is the origin of the tibia frame"""

    def translation(self, angle: float) -> tuple[float, float]:
        """Return x [m] and dx/dangle = 0 [m/rad], which do not depend on the angle [rad]."""
        return self.x, 0.0

    def largest_slope(self) -> float:
        """Return 0, the slope [m/rad] at all angles."""
        return 0.0
