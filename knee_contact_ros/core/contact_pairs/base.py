"""What a contact pair is: a femoral surface over a tibial one, and where they are closest or deepest in each other.

Generalized contact kinematics of the paper, Eqs. 1 to 6: at the two points of closest approach the normals are parallel
(n x n' = 0) and the vector between the points lies along them (d x n = 0).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.core.geometries.base import FemoralGeometry


class Closest(NamedTuple):
    """The common normal of femur and tibia in one pose; tibia frame, unit normal n from tibia to femur."""

    depth: float
    """Signed penetration depth along n [m]: > 0 in overlap, < 0 apart"""
    support: float
    """Distance of the femur's deepest point from the reference point, against n [m]: -r·n"""
    turning: float
    """Change of the depth when the femur turns about its reference point [m/rad]: -r·t, with t = (n_y, -n_x)"""
    normal_x: float
    normal_y: float

    def point(self, x: float, height: float) -> tuple[float, float]:
        """Contact point on the tibia [m], for the femoral reference point at (x, height) [m]."""
        along, across = -self.turning, self.depth - self.support
        return (
            x + along * self.normal_y + across * self.normal_x,
            height - along * self.normal_x + across * self.normal_y,
        )


Touch = Callable[[float], tuple[float, float, float]]
"""Height of the reference point [m] to (signed depth [m], its rate with the height held [m/s], n_y).

The depth's rate is the second less n_y times the height's velocity; n_y of the contact force acts along the height.
"""


class ContactPair(Protocol):
    """A femoral surface over a tibial one. All functions of the pose alone, the same bits for the same pose."""

    @property
    def femur(self) -> FemoralGeometry:
        """The femoral surface."""
        ...

    @property
    def dented(self) -> bool:
        """Whether the contact may leap from bump to bump where `kinks` does not tell."""
        ...

    def closest(self, angle: float, x: float, height: float) -> Closest:
        """The common normal with the femur turned by `angle` [rad] and its reference point at (x, height) [m]."""
        ...

    def touch(self, angle: float, angle_rate: float, x: float, x_rate: float) -> Touch:
        """The contact at a moment, as a function of the height; rates in rad/s and m/s."""
        ...

    def kinks(self, start: float, end: float) -> list[float]:
        """Flexion angles [rad] between two, in their order, at which the rate of `touch` is known to jump."""
        ...

    def outline(self, reach: float) -> NDArray[np.float64]:
        """Points along the tibial surface, shape (n, 2) [m] in the tibia frame, to `reach` [m] on both sides."""
        ...
