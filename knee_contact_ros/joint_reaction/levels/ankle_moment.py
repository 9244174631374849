"""From the net moments at knee and ankle: the calf's part is known, and the extensors work against it."""

from __future__ import annotations

from knee_contact_ros.joint_reaction.inverse_dynamics import NetMoments, net_moments
from knee_contact_ros.joint_reaction.leg import Leg
from knee_contact_ros.joint_reaction.motion import Motion
from knee_contact_ros.joint_reaction.sensed import Ground, Joints


def with_calf(leg: Leg, joints: Joints, motion: Motion, ground: Ground) -> NetMoments:
    """What knee and ankle hold, by inverse dynamics of foot and shank."""
    return net_moments(leg, joints, motion, ground)
