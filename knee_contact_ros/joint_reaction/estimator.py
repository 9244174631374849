"""Estimate the joint reaction of a knee from what the sensors of the leg measure, sample by sample."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from enum import IntEnum
from typing import NamedTuple, get_type_hints

from knee_contact_ros.joint_reaction.leg import (
    GRAVITY,
    UNKNOWN,
    Ground,
    Joints,
    Leg,
    Motion,
    NetMoments,
    leg_of,
    net_moments,
)
from knee_contact_ros.joint_reaction.muscles import Person, reaction_of


class Level(IntEnum):
    """Inputs from which the joint reaction is estimated; the values are those of `LoadEstimate.msg`."""

    GROUND_FORCE = 0
    KNEE_MOMENT = 1
    ANKLE_MOMENT = 2


Dynamics = Callable[[Leg, Joints, Motion, Ground], NetMoments]
"""Computes the net moments at knee and ankle from what was sensed; what it cannot know is not a number"""


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
    return NetMoments(vertical * lever, UNKNOWN, vertical - leg.weight_below, UNKNOWN)


def knee_moment_alone(leg: Leg, joints: Joints, motion: Motion, ground: Ground) -> NetMoments:
    """Compute the moment at the knee by inverse dynamics of foot and shank as one body; that of the calf is not known.

    The foot is at a right angle to the shank; where the hip is not measured, flat on the ground.
    """
    if math.isfinite(joints.hip):
        joints = joints._replace(ankle=UNKNOWN)
    return net_moments(leg, joints, motion, ground)._replace(plantarflexion=UNKNOWN)


OF_MOMENTS = Measured(Deviation(0.15, 0.20), Deviation(0.20, 0.30))
LEVELS = {
    "ground_force": EstimationLevel(
        Level.GROUND_FORCE, ground_force_alone, Measured(Deviation(0.40, 0.10), Deviation(0.50, 0.20))
    ),
    "knee_moment": EstimationLevel(Level.KNEE_MOMENT, knee_moment_alone, OF_MOMENTS),
    "ankle_moment": EstimationLevel(Level.ANKLE_MOMENT, net_moments, OF_MOMENTS),
}
"""The levels by name, from the one that needs the fewest sensors to the one that knows most"""


LARGEST_ANGLE = math.pi
"""Largest joint angle [rad]; larger ones are usually degrees that were taken for radians"""
LARGEST_REACTION = 10.0
"""Largest compression of the knee [body weights]: an instrumented hip measured 8.7 as the person stumbled (Bergmann et
al. 1993, doi:10.1016/0021-9290(93)90058-M), and knees bear less"""
LARGEST_PULL = 1.0
"""Largest force [body weights] by which a swinging leg pulls at its knee"""
LARGEST_UPSIDE_DOWN = 0.25
"""Largest force [body weights] by which the ground may seem to pull at the foot, as sensors drift"""
LIGHTEST = 150.0
"""Body weight [N] below which the number must be in kg: the weight of 15 kg"""
STIFF = math.radians(3.5)
"""Range of motion [rad] below which a joint does not move, or its angles in rad were taken for degrees"""
LEAST_PEAK, MOST_PEAK = 0.75, 8.0
"""Plausible range of load peaks [BW]: measured ones are from 1.07 on two legs to some 6 in stumbling (OrthoLoad)"""


def weight_doubt(weight: float) -> str:
    """Sentence about a body weight [N] that is likely in kg; empty if it is not."""
    if weight >= LIGHTEST:
        return ""
    return f"body_weight {weight:.7g} N: is it kg? {weight:.7g} kg weigh {weight * GRAVITY:.1f} N"


def is_implausible(joints: Joints, ground: Ground, axial: float, weight: float) -> bool:
    """Whether angles, ground force or the axial force [N] cannot be those of a person of a body weight [N]."""
    angles = (joints.flexion, joints.hip, joints.ankle)
    return (
        not -LARGEST_PULL * weight <= axial <= LARGEST_REACTION * weight
        or ground.force[1] < -LARGEST_UPSIDE_DOWN * weight
        or any(abs(angle) > LARGEST_ANGLE for angle in angles)
    )


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
