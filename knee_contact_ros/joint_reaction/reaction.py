"""The joint reaction of a knee: the net force, and the forces of the muscles that balance the net moments."""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

from knee_contact_ros.joint_reaction.inverse_dynamics import NetMoments
from knee_contact_ros.joint_reaction.leg import GRAVITY
from knee_contact_ros.joint_reaction.muscles import Muscles, gastrocnemius_of, muscles_of
from knee_contact_ros.joint_reaction.sensed import Joints


class Level(IntEnum):
    """Inputs from which the joint reaction is estimated; the values are those of `LoadEstimate.msg`."""

    GROUND_FORCE = 0
    KNEE_MOMENT = 1
    ANKLE_MOMENT = 2


class Person(NamedTuple):
    """Constants of a person."""

    mass: float
    """Body mass [kg]"""
    height: float
    """Height [m]"""
    moment_arm_scale: float
    """Ratio of the person's moment arms to the published ones"""
    co_contraction: float
    """The part of the least muscle force that grows with the vertical ground force, relative to that"""
    tone: float
    """The constant part of the least muscle force, relative to the body weight"""

    @property
    def weight(self) -> float:
        """Body weight [N]."""
        return self.mass * GRAVITY

    def floor(self, vertical: float) -> float:
        """Give the least force [N] of extensors and flexors together, at a vertical ground force [N]."""
        return self.co_contraction * max(vertical, 0.0) + self.tone * self.weight


class Reaction(NamedTuple):
    """Joint reaction of a knee, and the muscle forces in it."""

    axial: float
    """Force along the tibia [N], positive in compression"""
    muscles: Muscles
    extension: float
    """Net moment of the muscles at the knee [N m], positive when they extend it"""
    plantarflexion: float
    """Net moment of the muscles at the ankle [N m], positive when they plantarflex it; not a number if not known"""


def reaction_of(person: Person, joints: Joints, net: NetMoments, vertical: float) -> Reaction:
    """Compute the joint reaction of a knee.

    Args:
        person: Constants of the person.
        joints: Angles, and torques of actuators, which are part of the net moments.
        net: Net moments at knee and ankle.
        vertical: Vertical ground force [N].
    """
    extension, plantarflexion = net.extension - joints.knee_assistance, net.plantarflexion - joints.ankle_assistance
    scale, calf = person.moment_arm_scale, 0.0
    if math.isfinite(plantarflexion):
        calf = gastrocnemius_of(plantarflexion, joints.ankle if math.isfinite(joints.ankle) else 0.0, scale)
    muscles = muscles_of(extension, joints.flexion, calf, person.floor(vertical), scale)
    return Reaction(net.compression + muscles.total, muscles, extension, plantarflexion)
