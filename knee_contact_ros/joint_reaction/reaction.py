"""From the net moments to what the knee bears: the joint reaction, with the muscles of a person."""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

from knee_contact_ros.joint_reaction.inverse_dynamics import NetMoments
from knee_contact_ros.joint_reaction.leg import GRAVITY
from knee_contact_ros.joint_reaction.muscles import Muscles, gastrocnemius_of, muscles_of
from knee_contact_ros.joint_reaction.sensed import Joints


class Level(IntEnum):
    """What the joint reaction is estimated from; the values are those of `LoadEstimate.msg`."""

    GROUND_FORCE = 0
    KNEE_MOMENT = 1
    ANKLE_MOMENT = 2


class Person(NamedTuple):
    """Personal constants."""

    mass: float
    """[kg]"""
    height: float
    """[m]"""
    moment_arm_scale: float
    """Of the moment arms to the published ones"""
    co_contraction: float
    """Of the vertical ground force: with how much antagonists pull at least, as it grows"""
    tone: float
    """Of the body weight: likewise, whatever the ground force is"""

    @property
    def weight(self) -> float:
        """The body's, [N]."""
        return self.mass * GRAVITY

    def floor(self, vertical: float) -> float:
        """[N] with which antagonists pull at least, both sides together, at a vertical ground force [N]."""
        return self.co_contraction * max(vertical, 0.0) + self.tone * self.weight


class Reaction(NamedTuple):
    """What a knee bears."""

    axial: float
    """[N] compression along the tibia"""
    muscles: Muscles
    extension: float
    """[N m] net moment of the muscles at the knee"""
    plantarflexion: float
    """[N m] likewise at the ankle; not a number where it is not known"""


def reaction_of(person: Person, joints: Joints, net: NetMoments, vertical: float) -> Reaction:
    """What a knee bears under net moments, those of an actuator among them, and a vertical ground force [N]."""
    extension, plantarflexion = net.extension - joints.knee_assistance, net.plantarflexion - joints.ankle_assistance
    scale, calf = person.moment_arm_scale, 0.0
    if math.isfinite(plantarflexion):
        calf = gastrocnemius_of(plantarflexion, joints.ankle if math.isfinite(joints.ankle) else 0.0, scale)
    muscles = muscles_of(extension, joints.flexion, calf, person.floor(vertical), scale)
    return Reaction(net.compression + muscles.total, muscles, extension, plantarflexion)
