"""Net moments at knee and ankle, and what the knee bears without muscles: foot and shank in the sagittal plane.

Newton and Euler from the ground up (Winter 2009, chapter 5, doi:10.1002/9780470549148). The hip is taken to move
steadily: its own acceleration, at most a few m/s^2 in walking, is left out.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from knee_contact_ros.joint_reaction.leg import GRAVITY, Leg
from knee_contact_ros.joint_reaction.motion import STANDING, STILL, Motion, Turning
from knee_contact_ros.joint_reaction.sensed import Ground, Joints


class NetMoments(NamedTuple):
    """What muscles and actuators exert together, and what is left to the joint."""

    extension: float
    """[N m] at the knee"""
    plantarflexion: float
    """[N m] at the ankle"""
    compression: float
    """[N] of the knee along the tibia, without muscles"""
    frontal: float
    """[N m] about the tibia's x axis, what the femur exerts on the tibia at the knee, without muscles; z to the right
    is lateral: a left leg's sensors are mirrored to this, as its joint reaction is"""


class Plane(NamedTuple):
    """A vector in the sagittal plane: x forward, y up."""

    x: float
    y: float

    def cross(self, other: Plane) -> float:
        """What it makes with another one along z: a force's moment about where its arm begins."""
        return self.x * other.y - self.y * other.x

    def plus(self, other: Plane) -> Plane:
        """Their sum."""
        return Plane(self.x + other.x, self.y + other.y)

    def times(self, factor: float) -> Plane:
        """As long as factor says."""
        return Plane(self.x * factor, self.y * factor)

    def swung(self, turning: Turning) -> Plane:
        """The acceleration of this arm's end as it turns about its beginning."""
        square = turning.rate * turning.rate
        return Plane(
            -self.y * turning.acceleration - self.x * square, self.x * turning.acceleration - self.y * square
        )  # fmt: skip


UPWARDS = Plane(0.0, GRAVITY)
"""[m/s^2] that the ground accelerates a body by which lies still"""


def inclination(joints: Joints) -> float:
    """Angle [rad] of the shank to the vertical, positive when the ankle is ahead of the knee.

    By the hip, or, where that is not measured, by the ankle of a foot that stands flat.
    """
    return joints.hip - joints.flexion if math.isfinite(joints.hip) else -joints.ankle


def net_moments(leg: Leg, joints: Joints, motion: Motion, ground: Ground) -> NetMoments:
    """Solve foot and shank for what holds them.

    Args:
        leg: the person's.
        joints: with the hip, or the ankle. Without the ankle the foot is at a right angle to the shank
            and turns with it.
        motion: of the joints; it counts where the hip is measured.
        ground: with a torque.
    """
    shank = inclination(joints)
    hip_angle, (bent, hip, turned) = (joints.hip, motion) if math.isfinite(joints.hip) else (0.0, STILL)
    foot, turned = (shank + joints.ankle, turned) if math.isfinite(joints.ankle) else (shank, STANDING)
    of_shank = Turning(hip.rate - bent.rate, hip.acceleration - bent.acceleration)
    of_foot = Turning(of_shank.rate + turned.rate, of_shank.acceleration + turned.acceleration)

    down = Plane(math.sin(shank), -math.cos(shank))
    to_knee = Plane(math.sin(hip_angle), -math.cos(hip_angle)).times(leg.thigh_length)
    to_ankle, to_shank_centre = down.times(leg.shank_length), down.times(leg.shank_centre)
    to_foot_centre = Plane(
        leg.foot_forward * math.cos(foot) + leg.foot_below * math.sin(foot),
        leg.foot_forward * math.sin(foot) - leg.foot_below * math.cos(foot),
    )
    knee = to_knee.swung(hip).plus(UPWARDS)
    ankle = knee.plus(to_ankle.swung(of_shank))
    holds_shank = knee.plus(to_shank_centre.swung(of_shank)).times(leg.shank_mass)
    holds_foot = ankle.plus(to_foot_centre.swung(of_foot)).times(leg.foot_mass)

    force_x, force_y, force_z = ground.force
    about_x, about_y, about_z = ground.torque
    on_foot = holds_foot.plus(Plane(-force_x, -force_y))
    dorsiflexion = leg.foot_inertia * of_foot.acceleration + to_foot_centre.cross(holds_foot) - about_z
    extension = dorsiflexion + leg.shank_inertia * of_shank.acceleration
    extension += to_shank_centre.cross(holds_shank) + to_ankle.cross(on_foot)
    on_shank = on_foot.plus(holds_shank)
    compression = on_shank.x * down.x + on_shank.y * down.y
    about_x = -about_x - to_ankle.y * force_z - leg.knee_offset * force_y
    about_y = -about_y + to_ankle.x * force_z + leg.knee_offset * force_x
    return NetMoments(extension, -dorsiflexion, compression, about_x * -down.y + about_y * down.x)
