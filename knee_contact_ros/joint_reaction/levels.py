"""The levels at which a joint reaction is estimated, each with its standard deviation."""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

from knee_contact_ros.joint_reaction.inverse_dynamics import NetMoments, net_moments
from knee_contact_ros.joint_reaction.leg import GRAVITY, Leg
from knee_contact_ros.joint_reaction.motion import Motion
from knee_contact_ros.joint_reaction.reaction import Level
from knee_contact_ros.joint_reaction.sensed import UNKNOWN, Ground, Joints


class Dynamics(Protocol):
    """A function that computes the net moments at knee and ankle from what was sensed."""

    def __call__(self, leg: Leg, joints: Joints, motion: Motion, ground: Ground, /) -> NetMoments:
        """Compute the net moments; what the level cannot know is not a number."""


class Deviation(NamedTuple):
    """Standard deviation of an axial force, from an error that is always there and one that grows with the force."""

    floor: float
    """Constant error, relative to the body weight"""
    part: float
    """Growing error, relative to the axial force"""

    def at(self, axial: float, weight: float) -> float:
        """Give the standard deviation [N] of an axial force [N] for a body weight [N]."""
        return math.hypot(self.floor * weight, self.part * axial)


class Measured(NamedTuple):
    """Standard deviation of a level's axial force from that of an instrumented knee."""

    calibrated: Deviation
    """Deviation with constants that were fitted to another trial of the same person"""
    uncalibrated: Deviation
    """Deviation with the default constants"""


class EstimationLevel(NamedTuple):
    """A level: its dynamics, and its error."""

    level: Level
    dynamics: Dynamics
    error: Measured
    """Error for one man's knee, as `docs/load-validation.md` says; in OpenSim's walk the errors are larger"""


def ground_force_alone(leg: Leg, joints: Joints, _motion: Motion, ground: Ground) -> NetMoments:
    """Compute the moment at the knee from the vertical ground force and the knee angle alone.

    The shank carries the ground force. Extensors hold a body whose weight lies above the foot while the knee is bent:
    with thigh and shank of about one length the knee is off the line between hip and ankle by half a flexion's sine of
    a shank. This is a crude rule, and the only one that needs no other sensor. What muscles do beyond it is
    `Person.floor`.
    """
    vertical = max(ground.force[1], 0.0)
    lever = leg.shank_length * math.sin(max(0.5 * joints.flexion, 0.0))
    weight = (leg.shank_mass + leg.foot_mass) * GRAVITY
    return NetMoments(vertical * lever, UNKNOWN, vertical - weight, UNKNOWN)


def knee_moment_alone(leg: Leg, joints: Joints, motion: Motion, ground: Ground) -> NetMoments:
    """Compute the moment at the knee by inverse dynamics of foot and shank as one body; that of the calf is not known.

    The foot is at a right angle to the shank; where the hip is not measured, flat on the ground.
    """
    if math.isfinite(joints.hip):
        joints = joints._replace(ankle=UNKNOWN)
    return net_moments(leg, joints, motion, ground)._replace(plantarflexion=UNKNOWN)


LEVELS = {
    "ground_force": EstimationLevel(
        Level.GROUND_FORCE, ground_force_alone, Measured(Deviation(0.40, 0.10), Deviation(0.50, 0.20))
    ),
    "knee_moment": EstimationLevel(
        Level.KNEE_MOMENT, knee_moment_alone, Measured(Deviation(0.15, 0.20), Deviation(0.20, 0.30))
    ),
    "ankle_moment": EstimationLevel(
        Level.ANKLE_MOMENT, net_moments, Measured(Deviation(0.15, 0.20), Deviation(0.20, 0.30))
    ),
}
"""The levels by name, from the one that needs the fewest sensors to the one that knows most"""
