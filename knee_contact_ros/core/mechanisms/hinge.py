"""A fixed flexion axis through the reference point: the hinge, and in the plane also the ball-and-socket joint."""

from __future__ import annotations

from typing import NamedTuple


class Hinge(NamedTuple):
    """The reference point stays above one place of the tibia at every flexion angle."""

    x: float = 0.0
    """Of that place [m], anterior positive; 0: the tibia's origin"""

    def translation(self, angle: float) -> tuple[float, float]:
        """Return x [m] and dx/dangle = 0 [m/rad], whatever the angle [rad]."""
        return self.x, 0.0

    def largest_slope(self) -> float:
        """See `Mechanism`."""
        return 0.0
