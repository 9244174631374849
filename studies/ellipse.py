"""A femur with a closed-form support, so that no spline's error is measured."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.trade.reference_femur import ellipse


@dataclass(frozen=True)
class Ellipse:
    """An ellipse about the reference point."""

    a: float
    """Half axis, anterior [m]"""
    b: float
    """Half axis, superior [m]"""
    kinks: ClassVar[tuple[float, ...]] = ()
    grain: ClassVar[float] = math.inf

    def support(self, angle: float) -> tuple[float, float]:
        """See `FemoralGeometry`."""
        h, slope, _ = ellipse(self.a, self.b)(angle)
        return h, slope

    def outline(self) -> NDArray[np.float64]:
        """See `FemoralGeometry`."""
        turn = np.linspace(0.0, math.tau, 181)
        return np.stack([self.a * np.cos(turn), self.b * np.sin(turn)], axis=1)
