"""Sample by sample from what a leg's sensors tell to the joint reaction of its knee."""

from __future__ import annotations

import struct
from typing import NamedTuple, get_type_hints

from knee_contact_ros.joint_reaction.leg import leg_of
from knee_contact_ros.joint_reaction.levels import LEVELS, Deviation
from knee_contact_ros.joint_reaction.motion import MotionFilter
from knee_contact_ros.joint_reaction.reaction import Person, reaction_of
from knee_contact_ros.joint_reaction.sensed import Ground, Joints


class Estimate(NamedTuple):
    """What `LoadEstimate.msg` tells behind its header: under its names, in its order, with its types and units."""

    flexion_angle: float
    axial_force: float
    standard_deviation: float
    resultant_force: float
    quadriceps_force: float
    hamstrings_force: float
    gastrocnemius_force: float
    knee_moment: float
    ankle_moment: float
    frontal_moment: float
    assistance: float
    level: int
    calibrated: bool
    status: int


CODES = {"float": "d", "int": "B", "bool": "?"}
PACKING = struct.Struct("<" + "".join(CODES[kind.__name__] for kind in get_type_hints(Estimate).values()))
"""The bytes of an estimate, as CDR has them where a multiple of 8 B is reached"""


class Trust(NamedTuple):
    """How far an estimate is to be trusted."""

    calibrated: bool
    """Whether the person's constants were fitted to a measured knee of this person"""
    deviation: float = 0.0
    """Standard deviation as part of the body weight, whatever the force is; 0: as it was measured for the level"""


class Estimator:
    """One knee; of samples before it remembers the last angles only."""

    def __init__(self, level: str, person: Person, window: float, trust: Trust) -> None:
        """An estimator of one of `LEVELS`, for a person, that sees motion in a window [s] (`MotionFilter`)."""
        self._motion = MotionFilter(window)
        self.go_on_with(level, person, trust)

    def go_on_with(self, level: str, person: Person, trust: Trust) -> None:
        """Go on with other constants, between two samples."""
        self._way, self._person, self._calibrated = LEVELS[level], person, trust.calibrated
        self._leg = leg_of(person.mass, person.height)
        measured = self._way.error.calibrated if trust.calibrated else self._way.error.uncalibrated
        self._deviation = Deviation(trust.deviation, 0.0) if trust.deviation else measured

    def start_anew(self) -> None:
        """Forget the angles before."""
        self._motion.forget()

    def at(self, stamp: int, joints: Joints, ground: Ground, status: int = 0) -> Estimate:
        """The joint reaction at a stamp [ns], later than all before; `status` are bits that it is to carry."""
        motion = self._motion.at(stamp, joints)
        net = self._way.dynamics(self._leg, joints, motion, ground)
        reaction = reaction_of(self._person, joints, net, ground.force[1])
        muscles = reaction.muscles
        return Estimate(
            joints.flexion, reaction.axial, self._deviation.at(reaction.axial, self._person.weight), net.compression,
            muscles.quadriceps, muscles.hamstrings, muscles.gastrocnemius,
            reaction.extension, reaction.plantarflexion, net.frontal, joints.knee_assistance,
            self._way.level, self._calibrated, status,
        )  # fmt: skip
