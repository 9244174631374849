"""Contact pairs: a femoral surface over a tibial one, and where they are closest or overlap most.

Generalized contact kinematics of the paper, Eqs. 1 to 6: at the two points of closest approach the normals are parallel
(n x n' = 0) and the vector between the points lies along them (d x n = 0).
"""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

from knee_contact_ros.core.arrays import Floats
from knee_contact_ros.core.geometries.base import FemoralGeometry
from knee_contact_ros.core.kernel_source import in_kernel, kernel_interface


@kernel_interface
class Closest(NamedTuple):
    """The common normal of femur and tibia in one pose, in the tibia frame; the unit n points from tibia to femur."""

    depth: float
    """Signed penetration depth along n [m]: > 0 in overlap, < 0 apart"""
    extent: float
    """Distance of the femur's deepest point from the reference point, against n [m]: -r·n"""
    turning: float
    """Change of the depth when the femur turns about its reference point [m/rad]: -r·t, with t = (n_y, -n_x)"""
    normal_x: float
    """x of the unit normal n"""
    normal_y: float
    """y of the unit normal n"""

    def point(self, x: float, height: float) -> tuple[float, float]:
        """Return the contact point on the tibia [m], for the femoral reference point at (x, height) [m]."""
        along, across = -self.turning, self.depth - self.extent
        return (
            x + along * self.normal_y + across * self.normal_x,
            height - along * self.normal_x + across * self.normal_y,
        )


class Pose(NamedTuple):
    """Pose of the femur without its height."""

    x: float
    """x of the reference point [m]"""
    angle: float
    """Flexion angle [rad]"""
    sine: float
    """Sine of the flexion angle"""
    cosine: float
    """Cosine of the flexion angle"""


@in_kernel
def pose_at(angle: float, x: float) -> Pose:
    """Return the pose at a flexion angle [rad] with the reference point at x [m]."""
    return Pose(x, angle, math.sin(angle), math.cos(angle))


@kernel_interface
class Touch(Protocol):
    """The contact of a pair at one time, as a function of the femoral height: the rest of the pose and its rates."""

    def touch(self, height: float) -> tuple[float, float, float]:
        """Return signed depth [m], its rate at a held height [m/s], and n_y, for a height of the reference point [m].

        The rate of the depth is the second number less n_y times the velocity of the height; along the height acts n_y
        times the contact force.
        """
        ...


@kernel_interface
class Kinematics(Protocol):
    """The part of a contact pair that the kernel calls: pure functions of the pose."""

    def closest(self, angle: float, x: float, height: float) -> Closest:
        """The common normal, with the femur turned by `angle` [rad] and its reference point at (x, height) [m]."""
        ...

    def at(self, angle: float, angle_rate: float, x: float, x_rate: float) -> Touch:
        """Return the contact at an angle [rad] and x [m] with their rates [rad/s], [m/s], for any height."""
        ...

    def next_kink(self, start: float, end: float) -> float:
        """Return the first flexion angle [rad] strictly between `start` and `end` at which the depth's rate jumps.

        Only kinks that do not depend on height and translation are known; NaN if there is none. `start` may be the
        larger one of the two.
        """
        ...

    def is_non_convex(self) -> bool:
        """Whether the contact may leap from bump to bump at angles that `next_kink` does not know."""
        ...

    def knot_spacing(self) -> float:
        """Return the turn [rad] between two points where the femur is not smooth; see `Support.knot_spacing`."""
        ...

    def largest_radius(self) -> float:
        """Return an upper bound of the distance [m] of the femur's points from its reference point."""
        ...


class ContactPair(Kinematics, Protocol):
    """A femoral surface over a tibial one: a named tuple."""

    @property
    def femur(self) -> FemoralGeometry:
        """The femoral surface."""
        ...

    def outline(self, reach: float) -> Floats:
        """Return points along the tibial surface, shape (n, 2) [m] in the tibia frame, to `reach` [m] on both sides."""
        ...
