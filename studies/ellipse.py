"""A femur with a closed-form support, so that no spline's error is measured."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Ellipse(NamedTuple):
    """An ellipse about the reference point."""

    a: float
    """Half axis, anterior [m]"""
    b: float
    """Half axis, superior [m]"""

    def support(self, angle: float) -> tuple[float, float]:
        """See `FemoralGeometry`."""
        a, b = self.a, self.b
        sine, cosine = math.sin(angle), math.cos(angle)
        h = math.sqrt(a * a * sine * sine + b * b * cosine * cosine)
        return h, (a * a - b * b) * sine * cosine / h

    def next_kink(self, start: float, end: float) -> float:
        """See `FemoralGeometry`."""
        return math.nan

    def knot_spacing(self) -> float:
        """See `FemoralGeometry`."""
        return math.inf

    def largest_radius(self) -> float:
        """See `FemoralGeometry`."""
        return max(self.a, self.b)

    def outline(self) -> NDArray[np.float64]:
        """See `FemoralGeometry`."""
        turn = np.linspace(0.0, math.tau, 181)
        return np.stack([self.a * np.cos(turn), self.b * np.sin(turn)], axis=1)
