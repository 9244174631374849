"""What is prescribed between two ticks: load and flexion angle, linear in time, and the translation with flexion."""

from __future__ import annotations

from dataclasses import dataclass

from knee_contact_ros.core.contact_pairs.base import ContactPair, Touch
from knee_contact_ros.core.mechanisms.base import Mechanism


@dataclass(frozen=True)
class Interval:
    """Load and pose from one tick to the next, as functions of the time s [s] since the first of the two."""

    pair: ContactPair
    mechanism: Mechanism
    duration: float
    """[s]"""
    angle: float
    """Flexion angle at s = 0 [rad]"""
    angle_rate: float
    """[rad/s]"""
    start_load: float
    """[N] compressive"""
    load_rate: float
    """[N/s]"""

    def touch(self, s: float) -> Touch:
        """The contact at s, as a function of the femoral height."""
        angle = self.angle + self.angle_rate * s
        x, slope = self.mechanism.translation(angle)
        return self.pair.touch(angle, self.angle_rate, x, slope * self.angle_rate)

    def load(self, s: float) -> float:
        """Compressive load [N] at s."""
        return self.start_load + self.load_rate * s
