"""Values that no leg has: they are a sign of wrong units, signs or masses in sensors or parameters."""

from __future__ import annotations

import math

from knee_contact_ros.joint_reaction.sensed import Ground, Joints

LARGEST_ANGLE = math.pi
"""Largest joint angle [rad]; larger ones are usually degrees that were taken for radians"""
LARGEST_REACTION = 10.0
"""Largest compression of the knee [body weights]: an instrumented hip measured 8.7 as the person stumbled (Bergmann et
al. 1993, doi:10.1016/0021-9290(93)90058-M), and knees bear less"""
LARGEST_PULL = 1.0
"""Largest force [body weights] by which a swinging leg pulls at its knee"""
LARGEST_UPSIDE_DOWN = 0.25
"""Largest force [body weights] by which the ground may seem to pull at the foot, as sensors drift"""


def is_implausible(joints: Joints, ground: Ground, axial: float, weight: float) -> bool:
    """Whether angles, ground force or the axial force [N] cannot be those of a person of a body weight [N]."""
    angles = (joints.flexion, joints.hip, joints.ankle)
    return (
        not -LARGEST_PULL * weight <= axial <= LARGEST_REACTION * weight
        or ground.force[1] < -LARGEST_UPSIDE_DOWN * weight
        or any(abs(angle) > LARGEST_ANGLE for angle in angles)
    )
