"""From the net moment at the knee; what the calf does is not known, as foot and shank are taken as one body."""

from __future__ import annotations

import math

from knee_contact_ros.joint_reaction.inverse_dynamics import NetMoments, net_moments
from knee_contact_ros.joint_reaction.leg import Leg
from knee_contact_ros.joint_reaction.motion import Motion
from knee_contact_ros.joint_reaction.sensed import UNKNOWN, Ground, Joints


def without_calf(leg: Leg, joints: Joints, motion: Motion, ground: Ground) -> NetMoments:
    """What a knee holds, by inverse dynamics with the foot at a right angle to the shank; without the hip, flat."""
    if math.isfinite(joints.hip):
        joints = joints._replace(ankle=UNKNOWN)
    return net_moments(leg, joints, motion, ground)._replace(plantarflexion=UNKNOWN)
