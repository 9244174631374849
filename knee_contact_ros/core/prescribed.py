"""What is prescribed between two ticks: load and flexion angle, both linear in time."""

from __future__ import annotations

from dataclasses import dataclass

from knee_contact_ros.core.geometries.base import FemoralGeometry


@dataclass(frozen=True)
class Interval:
    """Load and femoral surface from one tick to the next, as functions of the time s [s] since the first of the two."""

    geometry: FemoralGeometry
    duration: float
    """[s]"""
    angle: float
    """Flexion angle relative to the plateau at s = 0 [rad]"""
    angle_rate: float
    """[rad/s]"""
    start_load: float
    """[N] compressive"""
    load_rate: float
    """[N/s]"""

    def surface(self, s: float) -> tuple[float, float]:
        """Support h [m] of the femur at s and its time derivative [m/s]."""
        height, slope = self.geometry.support(self.angle + self.angle_rate * s)
        return height, slope * self.angle_rate

    def load(self, s: float) -> float:
        """Compressive load [N] at s."""
        return self.start_load + self.load_rate * s
