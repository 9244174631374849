"""From the vertical ground force and the knee angle alone.

The shank carries the ground force. Extensors hold a body whose weight lies above the foot while the knee is bent: with
thigh and shank of about one length the knee is off the line between hip and ankle by half a flexion's sine of a shank.
A crude rule, and the only one that needs no other sensor. What muscles do beyond it is `Person.floor`.
"""

from __future__ import annotations

import math

from knee_contact_ros.joint_reaction.inverse_dynamics import NetMoments
from knee_contact_ros.joint_reaction.leg import GRAVITY, Leg
from knee_contact_ros.joint_reaction.motion import Motion
from knee_contact_ros.joint_reaction.sensed import UNKNOWN, Ground, Joints


def under_the_weight(leg: Leg, joints: Joints, _motion: Motion, ground: Ground) -> NetMoments:
    """What a knee holds under a vertical ground force at a flexion."""
    vertical = max(ground.force[1], 0.0)
    lever = leg.shank_length * math.sin(max(0.5 * joints.flexion, 0.0))
    weight = (leg.shank_mass + leg.foot_mass) * GRAVITY
    return NetMoments(vertical * lever, UNKNOWN, vertical - weight, UNKNOWN)
