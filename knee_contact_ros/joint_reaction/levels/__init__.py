"""The levels at which a joint reaction is estimated: a file each, and each with its error."""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

from knee_contact_ros.joint_reaction.inverse_dynamics import NetMoments
from knee_contact_ros.joint_reaction.leg import Leg
from knee_contact_ros.joint_reaction.levels.ankle_moment import with_calf
from knee_contact_ros.joint_reaction.levels.ground_force import under_the_weight
from knee_contact_ros.joint_reaction.levels.knee_moment import without_calf
from knee_contact_ros.joint_reaction.motion import Motion
from knee_contact_ros.joint_reaction.reaction import Level
from knee_contact_ros.joint_reaction.sensed import Ground, Joints


class Dynamics(Protocol):
    """From what was sensed to what knee and ankle hold."""

    def __call__(self, leg: Leg, joints: Joints, motion: Motion, ground: Ground, /) -> NetMoments:
        """Give it."""


class Deviation(NamedTuple):
    """Standard deviation of an axial force: of an error that is always there, and of one that grows with the force."""

    floor: float
    """As part of the body weight"""
    part: float
    """Of the axial force"""

    def at(self, axial: float, weight: float) -> float:
        """[N] of an axial force [N], for a body weight [N]."""
        return math.hypot(self.floor * weight, self.part * axial)


class Measured(NamedTuple):
    """How far a level was off an instrumented knee."""

    calibrated: Deviation
    """With constants fitted to another trial of the same person"""
    uncalibrated: Deviation
    """With constants of nobody in particular"""


class Way(NamedTuple):
    """A level."""

    level: Level
    dynamics: Dynamics
    error: Measured
    """Of one man's knee, as `docs/load-validation.md` says; of OpenSim's walk estimates were farther off"""


LEVELS = {
    "ground_force": Way(Level.GROUND_FORCE, under_the_weight, Measured(Deviation(0.40, 0.10), Deviation(0.50, 0.20))),
    "knee_moment": Way(Level.KNEE_MOMENT, without_calf, Measured(Deviation(0.15, 0.20), Deviation(0.20, 0.30))),
    "ankle_moment": Way(Level.ANKLE_MOMENT, with_calf, Measured(Deviation(0.15, 0.20), Deviation(0.20, 0.30))),
}
"""By name, from the one that needs least to the one that knows most"""
