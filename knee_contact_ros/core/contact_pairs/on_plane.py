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
    """The contact on a plane at one time, as a `Touch`."""

    surface: float
    """Depth [m] at a height of 0"""
    rate: float
    """Rate of the depth at a held height [m/s]"""
    cosine: float
    """Cosine of the plane's slope"""

    def touch(self, height: float) -> tuple[float, float, float]:
        """Return signed depth [m], its rate at a held height [m/s], and n_y; see `Touch.touch`."""
        return self.surface - self.cosine * height, self.rate, self.cosine


class _OnPlane(NamedTuple):
    """Fields of `OnPlane`."""

    femur: FemoralGeometry
    slope: float
    """Slope of the plane [rad], > 0 if its anterior edge is the higher one; less than a quarter turn"""
    sine: float
    """Sine of the slope"""
    cosine: float
    """Cosine of the slope"""


class OnPlane(_OnPlane):
    """A femur on a plane through the origin of the tibia frame."""

    __slots__ = ()

    def __new__(cls, femur: FemoralGeometry, slope: float = 0.0) -> OnPlane:
        """Put `femur` on a plane with a `slope` [rad]."""
        slope = float(slope)
        return super().__new__(cls, femur, slope, math.sin(slope), math.cos(slope))

    def closest(self, angle: float, x: float, height: float) -> Closest:
        """Return the common normal at an angle [rad] and (x, height) [m]; see `Kinematics.closest`."""
        extent, turning = self.femur.support(angle - self.slope)
        depth = extent + x * self.sine - self.cosine * height
        return Closest(depth=depth, extent=extent, turning=turning, normal_x=-self.sine, normal_y=self.cosine)

    def at(self, angle: float, angle_rate: float, x: float, x_rate: float) -> PlaneTouch:
        """Return the contact at an angle [rad] and x [m] with their rates [rad/s], [m/s]; see `Kinematics.at`."""
        extent, turning = self.femur.support(angle - self.slope)
        return PlaneTouch(extent + x * self.sine, turning * angle_rate + x_rate * self.sine, self.cosine)

    def next_kink(self, start: float, end: float) -> float:
        """The first kink [rad] of the femur's support strictly between two angles [rad]; NaN if there is none."""
        forwards = 1.0 if start < end else -1.0
        kink = self.femur.next_kink(start - self.slope, end - self.slope)
        while forwards * (kink + self.slope - start) <= 0.0:  # by rounding: `start` is a kink itself
            kink = self.femur.next_kink(kink, end - self.slope)
        kink += self.slope
        return kink if forwards * (end - kink) > 0.0 else math.nan

    def is_non_convex(self) -> bool:
        """Return False: `next_kink` knows all leaps of the contact."""
        return False

    def knot_spacing(self) -> float:
        """Return the turn [rad] between two points where the femur is not smooth."""
        return self.femur.knot_spacing()

    def largest_radius(self) -> float:
        """Return an upper bound of the distance [m] of the femur's points from its reference point."""
        return self.femur.largest_radius()

    def outline(self, reach: float) -> Floats:
        """Return the ends of the plane, shape (2, 2) [m], at `reach` [m] on both sides."""
        along = np.array([[self.cosine, self.sine]])
        return np.concatenate([-reach * along, reach * along])
