"""What a contact pair is: a femoral surface over a tibial one, and where they are closest or deepest in each other.

Generalized contact kinematics of the paper, Eqs. 1 to 6: at the two points of closest approach the normals are parallel
(n x n' = 0) and the vector between the points lies along them (d x n = 0).
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

from knee_contact_ros.core.arrays import Floats
from knee_contact_ros.core.geometries.base import FemoralGeometry
from knee_contact_ros.core.kernel_source import kernel_interface


@kernel_interface
class Closest(NamedTuple):
    """The common normal of femur and tibia in one pose; tibia frame, unit normal n from tibia to femur."""

    depth: float
    """Signed penetration depth along n [m]: > 0 in overlap, < 0 apart"""
    extent: float
    """Distance of the femur's deepest point from the reference point, against n [m]: -r·n"""
    turning: float
    """Change of the depth when the femur turns about its reference point [m/rad]: -r·t, with t = (n_y, -n_x)"""
    normal_x: float
    normal_y: float

    def point(self, x: float, height: float) -> tuple[float, float]:
        """Contact point on the tibia [m], for the femoral reference point at (x, height) [m]."""
        along, across = -self.turning, self.depth - self.extent
        return (
            x + along * self.normal_y + across * self.normal_x,
            height - along * self.normal_x + across * self.normal_y,
        )


@kernel_interface
class Touch(Protocol):
    """The contact of a pair at a moment: its pose but for the height, and how that pose changes."""

    def touch(self, height: float) -> tuple[float, float, float]:
        """Signed depth [m], its rate with the height held [m/s], n_y; for the reference point's height [m].

        The depth's rate is the second less n_y times the height's velocity; n_y of the contact force acts along the
        height.
        """
        ...


@kernel_interface
class Kinematics(Protocol):
    """The part of a contact pair that the kernel calls: functions of the pose alone, same bits for the same pose."""

    def closest(self, angle: float, x: float, height: float) -> Closest:
        """The common normal with the femur turned by `angle` [rad] and its reference point at (x, height) [m]."""
        ...

    def at(self, angle: float, angle_rate: float, x: float, x_rate: float) -> Touch:
        """The contact at a moment, for any height; rates in rad/s and m/s."""
        ...

    def next_kink(self, start: float, end: float) -> float:
        """First flexion angle [rad] strictly between two, seen from `start`, at which the depth's rate jumps.

        Only those that are known beforehand; nan if there is none.
        """
        ...

    def is_non_convex(self) -> bool:
        """Whether the contact may leap from bump to bump where `next_kink` does not tell."""
        ...

    def knot_spacing(self) -> float:
        """Turn [rad] between two places where the femur is not smooth, see `Support`."""
        ...

    def largest_radius(self) -> float:
        """Bound of the distance [m] of the femur's points, see `Support`."""
        ...


class ContactPair(Kinematics, Protocol):
    """A femoral surface over a tibial one: a named tuple."""

    @property
    def femur(self) -> FemoralGeometry:
        """The femoral surface."""
        ...

    def outline(self, reach: float) -> Floats:
        """Points along the tibial surface, shape (n, 2) [m] in the tibia frame, to `reach` [m] on both sides."""
        ...
