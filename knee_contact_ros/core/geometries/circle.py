"""A circular femoral condyle about the reference point (the paper's sphere, 34 mm)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Circle:
    """A circle centred at the reference point: its depth does not depend on the flexion angle."""

    radius: float
    """[m]"""
    kinks: ClassVar[tuple[float, ...]] = ()
    grain: ClassVar[float] = math.inf

    def support(self, angle: float) -> tuple[float, float]:
        """Return the radius and 0, whatever the angle [rad]."""
        del angle  # a circle looks the same from everywhere
        return self.radius, 0.0

    def outline(self) -> NDArray[np.float64]:
        """Points around the circle, shape (n, 2) [m], for drawing."""
        angles = np.linspace(0.0, math.tau, 181)
        return self.radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
