"""Any femoral geometry on a plane through the tibia frame's origin (Eq. 7 of the paper): closed form, no search.

With the plane sloped by σ, n = (-sin σ, cos σ) and the depth is h(θ - σ) - n·(x, y), h being the femur's support.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from knee_contact_ros.core.arrays import Floats
from knee_contact_ros.core.contact_pairs.base import Closest
from knee_contact_ros.core.geometries.base import FemoralGeometry


class PlaneTouch(NamedTuple):
    """See `Touch`."""

    surface: float
    """Depth [m] at the height 0"""
    rate: float
    """Of the depth with the height held [m/s]"""
    cosine: float
    """Of the plane's slope"""

    def touch(self, height: float) -> tuple[float, float, float]:
        """See `Touch`."""
        return self.surface - self.cosine * height, self.rate, self.cosine


class _OnPlane(NamedTuple):
    """What the contact on a plane consists of."""

    femur: FemoralGeometry
    slope: float
    """[rad] > 0 when the plane's anterior edge is the higher one; less than a quarter turn"""
    sine: float
    """Of the slope"""
    cosine: float


class OnPlane(_OnPlane):
    """A femur on a plane."""

    __slots__ = ()

    def __new__(cls, femur: FemoralGeometry, slope: float = 0.0) -> OnPlane:
        """Put `femur` on a plane with a `slope` [rad]."""
        slope = float(slope)
        return super().__new__(cls, femur, slope, math.sin(slope), math.cos(slope))

    def closest(self, angle: float, x: float, height: float) -> Closest:
        """See `Kinematics`."""
        extent, turning = self.femur.support(angle - self.slope)
        depth = extent + x * self.sine - self.cosine * height
        return Closest(depth=depth, extent=extent, turning=turning, normal_x=-self.sine, normal_y=self.cosine)

    def at(self, angle: float, angle_rate: float, x: float, x_rate: float) -> PlaneTouch:
        """See `Kinematics`."""
        extent, turning = self.femur.support(angle - self.slope)
        return PlaneTouch(extent + x * self.sine, turning * angle_rate + x_rate * self.sine, self.cosine)

    def next_kink(self, start: float, end: float) -> float:
        """See `Kinematics`: that of the femur's support."""
        forwards = 1.0 if start < end else -1.0
        kink = self.femur.next_kink(start - self.slope, end - self.slope)
        while forwards * (kink + self.slope - start) <= 0.0:  # by rounding: `start` is a kink itself
            kink = self.femur.next_kink(kink, end - self.slope)
        kink += self.slope
        return kink if forwards * (end - kink) > 0.0 else math.nan

    def is_non_convex(self) -> bool:
        """See `Kinematics`."""
        return False

    def knot_spacing(self) -> float:
        """See `Kinematics`."""
        return self.femur.knot_spacing()

    def largest_radius(self) -> float:
        """See `Kinematics`."""
        return self.femur.largest_radius()

    def outline(self, reach: float) -> Floats:
        """See `ContactPair`."""
        along = np.array([[self.cosine, self.sine]])
        return np.concatenate([-reach * along, reach * along])
