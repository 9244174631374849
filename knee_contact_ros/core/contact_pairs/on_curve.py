"""A femoral circle or profile on a curved tibia: the common normal of Eqs. 1 to 6 of the paper, found globally.

The signed depth is the largest depth of a femoral point under the tibial surface, or minus the least distance. Where
the femur's deepest point is not an end of its curve, the normals are parallel there and the vector between the two
points lies along them (Eq. 5).
"""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

from knee_contact_ros.core.arrays import Floats
from knee_contact_ros.core.contact_pairs.base import Closest, Pose, pose_at
from knee_contact_ros.core.contact_pairs.femoral_curve import femoral_curve
from knee_contact_ros.core.contact_pairs.profile_search import ProfileSearch
from knee_contact_ros.core.contact_pairs.tibial_surface import TibialSurface
from knee_contact_ros.core.geometries.circle import Circle
from knee_contact_ros.core.geometries.profile import Profile
from knee_contact_ros.core.kernel_source import kernel_interface


@kernel_interface
class Searched(Protocol):
    """A femoral surface whose deepest point under a tibial surface can be found."""

    def deepest(self, tibia: TibialSurface, pose: Pose, height: float) -> Closest:
        """Return the common normal at the deepest point in a pose, for a height of the reference point [m]."""
        ...


class CircleSearch(NamedTuple):
    """A circle, whose deepest point is in the direction of the nearest tibial point to its centre."""

    radius: float
    """Radius of the circle [m]"""

    def deepest(self, tibia: TibialSurface, pose: Pose, height: float) -> Closest:
        """Return the common normal at the deepest point; see `Searched.deepest`."""
        distance, normal_x, normal_y, _ = tibia.foot(pose.x, height)
        return Closest(
            depth=self.radius - distance, extent=self.radius, turning=0.0, normal_x=normal_x, normal_y=normal_y,
        )  # fmt: skip


class CurveTouch(NamedTuple):
    """The contact on a curved tibia at one time, as a `Touch`."""

    searched: Searched
    tibia: TibialSurface
    pose: Pose
    angle_rate: float
    """Rate of the flexion angle [rad/s]"""
    x_rate: float
    """Rate of the reference point's x [m/s]"""

    def touch(self, height: float) -> tuple[float, float, float]:
        """Return signed depth [m], its rate at a held height [m/s], and n_y; see `Touch.touch`."""
        closest = self.searched.deepest(self.tibia, self.pose, height)
        rate = closest.turning * self.angle_rate - closest.normal_x * self.x_rate
        return closest.depth, rate, closest.normal_y


class _CurveContact(NamedTuple):
    """Fields of a `CurveContact`."""

    femur: Circle | Profile
    tibia: TibialSurface
    searched: Searched
    """The femur in the form that the search needs"""
    non_convex: bool
    """Whether the femur has dents, or the tibia one that is narrower than the femur"""


class CurveContact(_CurveContact):
    """A femur on any curved tibial surface."""

    __slots__ = ()

    def __new__(cls, femur: Circle | Profile, tibia: TibialSurface) -> CurveContact:
        """Prepare the contact of `femur` on `tibia`."""
        # One kink is that of an open curve's two ends; a hollow that is narrower than the femur holds it on two edges.
        non_convex = tibia.curvatures()[1] > 1.0 / femur.support(0.0)[0]
        if isinstance(femur, Circle):
            return super().__new__(cls, femur, tibia, CircleSearch(femur.radius), non_convex)
        search = ProfileSearch(femoral_curve(femur))
        return super().__new__(cls, femur, tibia, search, non_convex or len(femur.kinks) > 1)

    def closest(self, angle: float, x: float, height: float) -> Closest:
        """Return the common normal at an angle [rad] and (x, height) [m]; see `Kinematics.closest`."""
        return self.searched.deepest(self.tibia, pose_at(angle, x), height)

    def at(self, angle: float, angle_rate: float, x: float, x_rate: float) -> CurveTouch:
        """Return the contact at an angle [rad] and x [m] with their rates [rad/s], [m/s]; see `Kinematics.at`."""
        return CurveTouch(self.searched, self.tibia, pose_at(angle, x), angle_rate, x_rate)

    def next_kink(self, start: float, end: float) -> float:
        """Return NaN: kinks depend on height and translation, so none is known beforehand."""
        return math.nan

    def is_non_convex(self) -> bool:
        """Whether the contact may leap from bump to bump; see `Kinematics.is_non_convex`."""
        return self.non_convex

    def knot_spacing(self) -> float:
        """Return the turn [rad] between two points where the femur is not smooth."""
        return self.femur.knot_spacing()

    def largest_radius(self) -> float:
        """Return an upper bound of the distance [m] of the femur's points from its reference point."""
        return self.femur.largest_radius()

    def outline(self, reach: float) -> Floats:
        """Return points along the tibial surface, shape (n, 2) [m], to `reach` [m] on both sides."""
        return self.tibia.outline(reach)
