"""What no leg does, so that something is wrong with sensors or parameters: units, signs, another person's mass."""

from __future__ import annotations

import math

from knee_contact_ros.joint_reaction.sensed import Ground, Joints

LARGEST_ANGLE = math.pi
"""[rad] of a joint: beyond, degrees are taken for radians, as a rule"""
LARGEST_REACTION = 10.0
"""Body weights of compression: an implant of the hip measured 8.7 as its bearer stumbled (Bergmann et al. 1993,
doi:10.1016/0021-9290(93)90058-M); knees bear less"""
LARGEST_PULL = 1.0
"""Body weights with which a swinging leg pulls at its knee"""
LARGEST_UPSIDE_DOWN = 0.25
"""Body weights with which the ground may pull at the foot: sensors drift"""


def is_implausible(joints: Joints, ground: Ground, axial: float, weight: float) -> bool:
    """Whether angles, ground force or the axial force [N] of a person of a weight [N] are those of no leg."""
    angles = (joints.flexion, joints.hip, joints.ankle)
    return (
        not -LARGEST_PULL * weight <= axial <= LARGEST_REACTION * weight
        or ground.force[1] < -LARGEST_UPSIDE_DOWN * weight
        or any(abs(angle) > LARGEST_ANGLE for angle in angles)
    )
