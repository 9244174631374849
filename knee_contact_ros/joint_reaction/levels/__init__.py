"""The levels at which a joint reaction is estimated: a file each, and each with its error."""

from __future__ import annotations

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


class Measured(NamedTuple):
    """How far a level was off an instrumented knee: its error's RMS, as part of the body weight."""

    calibrated: float
    """With constants fitted to another trial of the same person"""
    uncalibrated: float
    """With the constants that are given here by default"""


class Way(NamedTuple):
    """A level."""

    level: Level
    dynamics: Dynamics
    error: Measured
    """The larger one of both trials in `docs/load-validation.md`"""


LEVELS = {
    "ground_force": Way(Level.GROUND_FORCE, under_the_weight, Measured(0.45, 0.60)),
    "knee_moment": Way(Level.KNEE_MOMENT, without_calf, Measured(0.35, 0.50)),
    "ankle_moment": Way(Level.ANKLE_MOMENT, with_calf, Measured(0.35, 0.50)),
}
"""By name, from the one that needs least to the one that knows most"""
