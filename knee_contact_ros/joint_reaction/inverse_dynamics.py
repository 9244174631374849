"""Inverse dynamics of foot and shank in the sagittal plane: net moments at knee and ankle, and the net force there.

Newton-Euler equations from the ground up (Winter 2009, chapter 5, doi:10.1002/9780470549148). The hip is assumed to
move at a constant velocity: its own acceleration, at most a few m/s^2 in walking, is left out.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from knee_contact_ros.joint_reaction.leg import GRAVITY, Leg
from knee_contact_ros.joint_reaction.motion import STANDING, STILL, Motion, Turning
from knee_contact_ros.joint_reaction.sensed import Ground, Joints


class NetMoments(NamedTuple):
    """Net moments of muscles and actuators, and the force and the moment that the knee transmits without muscles."""

    extension: float
    """Net moment at the knee [N m], positive when it extends"""
    plantarflexion: float
    """Net moment at the ankle [N m], positive when it plantarflexes"""
    compression: float
    """Force along the tibia at the knee without muscles [N], positive in compression"""
    frontal: float
    """Moment about the tibia's x axis that the femur exerts on the tibia at the knee, without muscles [N m]

    z to the right is lateral: the sensors of a left leg are mirrored to this, as its joint reaction is.
    """


class Plane(NamedTuple):
    """A vector in the sagittal plane: x forward, y up."""

    x: float
    y: float

    def cross(self, other: Plane) -> float:
        """Give the z component of the cross product with another vector: the moment of a force on this lever arm."""
        return self.x * other.y - self.y * other.x

    def plus(self, other: Plane) -> Plane:
        """Give the sum with another vector."""
        return Plane(self.x + other.x, self.y + other.y)

    def times(self, factor: float) -> Plane:
        """Give the product with a factor."""
        return Plane(self.x * factor, self.y * factor)

    def swung(self, turning: Turning) -> Plane:
        """Give the acceleration of this arm's end, relative to its beginning, as it turns about that."""
        square = turning.rate * turning.rate
        return Plane(
            -self.y * turning.acceleration - self.x * square, self.x * turning.acceleration - self.y * square
        )  # fmt: skip


UPWARDS = Plane(0.0, GRAVITY)
"""Acceleration [m/s^2] by which the ground supports a body at rest"""


def inclination(joints: Joints) -> float:
    """Give the angle [rad] of the shank to the vertical, positive when the ankle is ahead of the knee.

    It follows from the hip; where that is not measured, from the ankle, with the foot flat on the ground.
    """
    return joints.hip - joints.flexion if math.isfinite(joints.hip) else -joints.ankle


def net_moments(leg: Leg, joints: Joints, motion: Motion, ground: Ground) -> NetMoments:
    """Solve the equations of motion of foot and shank for the moments and forces that hold them.

    Args:
        leg: Lengths, masses and inertias of the person's leg.
        joints: Angles, of which hip or ankle must be measured. Without the ankle the foot is at a right angle to the
            shank, and turns with it.
        motion: How the joints turn; it counts only where the hip is measured.
        ground: Force and torque of the ground on the foot; the torque must be measured.
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
