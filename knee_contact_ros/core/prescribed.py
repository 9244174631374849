"""What is prescribed between two ticks: load and flexion angle, linear in time, and the translation with flexion."""

from __future__ import annotations

from dataclasses import dataclass

from knee_contact_ros.core.contact_pairs.base import ContactPair, Touch
from knee_contact_ros.core.mechanisms.base import Mechanism

KINK_WIDTH = 2e-12
"""Of the flexion angle [rad], to both sides: more than a kink's place is rounded by"""


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

    def stretches(self) -> list[tuple[float, float]]:
        """The parts of the interval on which the surface's rate does not jump: begin and end of each [s].

        At a kink of the femoral profile one part ends shortly before it and the next begins shortly behind, so that
        rounding cannot put either on the wrong side.
        """
        end_angle = self.angle + self.angle_rate * self.duration
        begin, parts = 0.0, []
        for kink in self.pair.kinks(self.angle, end_angle):
            aside = KINK_WIDTH / abs(self.angle_rate)
            s = (kink - self.angle) / self.angle_rate
            if begin < s - aside and s + aside < self.duration:
                parts.append((begin, s - aside))
                begin = s + aside
        return [*parts, (begin, self.duration)]
