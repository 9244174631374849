"""A fixed flexion axis through the reference point: the hinge, and in the plane also the ball-and-socket joint."""

from __future__ import annotations


class Hinge:
    """The reference point stays above the tibia's origin at every flexion angle."""

    def translation(self, angle: float) -> tuple[float, float]:
        """Return x = 0 [m] and dx/dangle = 0 [m/rad], whatever the angle [rad]."""
        del angle  # the axis is fixed
        return 0.0, 0.0
