"""A circular femoral condyle about the reference point (the paper's sphere, 34 mm)."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Circle:
    """A circle centred at the reference point: its depth does not depend on the flexion angle."""

    radius: float
    """[m]"""

    def support(self, angle: float) -> tuple[float, float]:
        """Return the radius and 0, whatever the angle [rad]."""
        del angle  # a circle looks the same from everywhere
        return self.radius, 0.0
