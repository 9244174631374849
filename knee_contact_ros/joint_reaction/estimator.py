"""Estimate the joint reaction of a knee from what the sensors of the leg measure, sample by sample."""

from __future__ import annotations

import struct
from typing import NamedTuple, get_type_hints

from knee_contact_ros.joint_reaction.leg import leg_of
from knee_contact_ros.joint_reaction.levels import LEVELS, Deviation
from knee_contact_ros.joint_reaction.motion import Motion
from knee_contact_ros.joint_reaction.plausibility import is_implausible
from knee_contact_ros.joint_reaction.reaction import Person, reaction_of
from knee_contact_ros.joint_reaction.sensed import Ground, Joints


class Estimate(NamedTuple):
    """Content of `LoadEstimate.msg` after the header: fields of the same names, order, types and units."""

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
"""Layout of an estimate in CDR, where it begins at a multiple of 8 B"""


IMPLAUSIBLE = 32
"""Bit of `status` in `LoadEstimate.msg`, see `is_implausible`"""


class Trust(NamedTuple):
    """How far an estimate can be trusted."""

    calibrated: bool
    """Whether the person's constants were fitted to a measured knee of this person"""
    deviation: float = 0.0
    """Standard deviation relative to the body weight, whatever the force is; 0: as it was measured for the level"""


class Estimator:
    """Estimates the joint reaction of one knee; it keeps nothing from one sample to the next."""

    def __init__(self, level: str, person: Person, trust: Trust) -> None:
        """Make an estimator for a person; `level` is a name in `LEVELS`."""
        self._level, self._person, self._calibrated = LEVELS[level], person, trust.calibrated
        self._leg = leg_of(person.mass, person.height)
        measured = self._level.error.calibrated if trust.calibrated else self._level.error.uncalibrated
        self._deviation = Deviation(trust.deviation, 0.0) if trust.deviation else measured

    def at(self, joints: Joints, motion: Motion, ground: Ground, status: int = 0) -> Estimate:
        """Estimate the joint reaction of a sample; `status` has the bits that are known already."""
        net = self._level.dynamics(self._leg, joints, motion, ground)
        reaction = reaction_of(self._person, joints, net, ground.force[1])
        muscles, weight = reaction.muscles, self._person.weight
        if is_implausible(joints, ground, reaction.axial, weight):
            status |= IMPLAUSIBLE
        return Estimate(
            joints.flexion, reaction.axial, self._deviation.at(reaction.axial, weight), net.compression,
            muscles.quadriceps, muscles.hamstrings, muscles.gastrocnemius,
            reaction.extension, reaction.plantarflexion, net.frontal, joints.knee_assistance,
            self._level.level, self._calibrated, status,
        )  # fmt: skip
