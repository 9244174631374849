"""A circular femoral condyle about the reference point (the paper's sphere, 34 mm)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from knee_contact_ros.core.arrays import Floats


class Circle(NamedTuple):
    """A circle centred at the reference point: its depth does not depend on the flexion angle."""

    radius: float
    """Radius of the circle [m]"""

    def support(self, angle: float) -> tuple[float, float]:
        """Return the radius [m] and 0 [m/rad], which do not depend on the angle [rad]."""
        return self.radius, 0.0

    def next_kink(self, start: float, end: float) -> float:
        """Return NaN: a circle has no kinks."""
        return math.nan

    def knot_spacing(self) -> float:
        """Return infinity: a circle is smooth everywhere."""
        return math.inf

    def largest_radius(self) -> float:
        """Return the radius [m]."""
        return self.radius

    def outline(self) -> Floats:
        """Return points around the circle, shape (n, 2) [m], for drawing."""
        angles = np.linspace(0.0, math.tau, 181)
        return self.radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
