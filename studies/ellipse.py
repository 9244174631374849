"""A femur with a closed-form support, so that no spline's error is measured."""

from __future__ import annotations

import math
from typing import NamedTuple


class Ellipse(NamedTuple):
    """An ellipse about the reference point."""

    a: float
    """Half axis, anterior [m]"""
    b: float
    """Half axis, superior [m]"""

    def support(self, angle: float) -> tuple[float, float]:
        """Return the support [m] at a flexion angle [rad], and its slope [m/rad]."""
        a, b = self.a, self.b
        sine, cosine = math.sin(angle), math.cos(angle)
        h = math.sqrt(a * a * sine * sine + b * b * cosine * cosine)
        return h, (a * a - b * b) * sine * cosine / h
