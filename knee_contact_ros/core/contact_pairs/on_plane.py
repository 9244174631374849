"""Any femoral geometry on a plane through the tibia frame's origin (Eq. 7 of the paper): closed form, no search.

With the plane sloped by σ, n = (-sin σ, cos σ) and the depth is h(θ - σ) - n·(x, y), h being the femur's support.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.core.contact_pairs.base import Closest, Touch
from knee_contact_ros.core.geometries.base import FemoralGeometry


@dataclass(frozen=True)
class OnPlane:
    """A femur on a plane."""

    femur: FemoralGeometry
    slope: float = 0.0
    """[rad] > 0 when the plane's anterior edge is the higher one; less than a quarter turn"""
    dented: ClassVar[bool] = False
    _sine: float = field(init=False, repr=False)
    _cosine: float = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_sine", math.sin(self.slope))
        object.__setattr__(self, "_cosine", math.cos(self.slope))

    def closest(self, angle: float, x: float, height: float) -> Closest:
        """See `ContactPair`."""
        support, turning = self.femur.support(angle - self.slope)
        depth = support + x * self._sine - self._cosine * height
        return Closest(depth, support, turning, -self._sine, self._cosine)

    def touch(self, angle: float, angle_rate: float, x: float, x_rate: float) -> Touch:
        """See `ContactPair`."""
        support, turning = self.femur.support(angle - self.slope)
        surface, cosine = support + x * self._sine, self._cosine
        rate = turning * angle_rate + x_rate * self._sine

        def touch(height: float) -> tuple[float, float, float]:
            return surface - cosine * height, rate, cosine

        return touch

    def kinks(self, start: float, end: float) -> list[float]:
        """See `ContactPair`: those of the femur's support, whole turns apart."""
        if not self.femur.kinks:
            return []
        low, high = sorted((start - self.slope, end - self.slope))
        turns = range(math.floor(low / math.tau), math.floor(high / math.tau) + 1)
        angles = [kink + turn * math.tau for turn in turns for kink in self.femur.kinks]
        found = [angle + self.slope for angle in angles if low < angle < high]
        return found if start < end else found[::-1]

    def outline(self, reach: float) -> NDArray[np.float64]:
        """See `ContactPair`."""
        along = np.array([[self._cosine, self._sine]])
        return np.concatenate([-reach * along, reach * along])
