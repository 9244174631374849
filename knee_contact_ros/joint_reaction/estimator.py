"""Estimate the joint reaction of a knee from the leg's sensors, sample by sample."""

import math
import struct
from collections.abc import Callable
from enum import IntEnum
from typing import NamedTuple, get_type_hints

from .leg import (
    GRAVITY,
    NOT_MEASURED,
    Ground,
    Joints,
    Leg,
    LegMotion,
    NetMoments,
    leg_of,
    net_moments,
)
from .muscles import (
    ActivationLag,
    MuscledReaction,
    Person,
    reaction_of,
)
from .walking import (
    MEASURED_LOADS,
    NOT_WALKING,
    Movement,
    StrideLoads,
    StridePhase,
)


class Level(IntEnum):
    """Inputs of the estimate; the values are those of `LoadEstimate.msg`."""

    GROUND_FORCE = 0
    KNEE_MOMENT = 1
    ANKLE_MOMENT = 2
    NET_LOAD = 3


Dynamics = Callable[[Leg, Joints, LegMotion, Ground], NetMoments]
"""Computes the net moments at knee and ankle from the sensors; NaN stands for what it cannot know"""


class AxialDeviation(NamedTuple):
    """Standard deviation of an axial force, from a constant error and one that grows with the force."""

    floor: float
    """Constant error, relative to the body weight"""
    part: float
    """Growing error, relative to the axial force"""

    def deviation_of(self, axial: float, weight: float) -> float:
        """Return the standard deviation [N] of an axial force [N] for a body weight [N]."""
        return math.hypot(self.floor * weight, self.part * axial)


class EstimationLevel(NamedTuple):
    """A level: its dynamics, and the error of its axial force in the knees of three persons.

    docs/explanation/validation.md says how it was measured. In OpenSim's walk the errors are larger.
    """

    level: Level
    dynamics: Dynamics
    calibrated: AxialDeviation
    """Deviation with constants that were fitted to other trials of the same person"""
    uncalibrated: AxialDeviation
    """Deviation with constants that were fitted to another person"""


_KNEE_LEVER = 0.6
"""Lever of the body at a bent knee, relative to that of a body upright above it; trunk and momentum carry the rest.
Between 0.5 and 0.7 the error on the two measured knees is within 3 % of its minimum"""
_SWING_INERTIA = 0.5
"""Fraction of the shank's inertia that acts on the knee's own acceleration, as the thigh, which is not measured, turns
the other way. The two measured walkers' knee moments in swing fit 0.4 and 0.2, their loads 0.5"""


def ground_force_alone(leg: Leg, joints: Joints, motion: LegMotion, ground: Ground) -> NetMoments:
    """Compute the moment at the knee from the vertical ground force and the knee angle alone.

    The shank carries the ground force. Extensors hold up a body whose weight is above the foot while the knee is bent:
    with thigh and shank of similar length, the knee is off the line from hip to ankle by the sine of half the flexion
    times the shank's length. To the extent that the foot does not bear the body, muscles swing and stop the shank; the
    hamstrings do so before heel strike. These rules are crude, but they need no other sensor. `Person.floor` covers
    further muscle forces.
    """
    vertical = max(ground.force[1], 0.0)
    standing = vertical * _KNEE_LEVER * leg.shank_length * math.sin(max(0.5 * joints.flexion, 0.0))
    free = max(1.0 - vertical / leg.body_weight, 0.0)
    swinging = _SWING_INERTIA * leg.inertia_below * motion.flexion.acceleration * free
    return NetMoments(standing - swinging, NOT_MEASURED, vertical - leg.weight_below, NOT_MEASURED)


def knee_moment_alone(leg: Leg, joints: Joints, motion: LegMotion, ground: Ground) -> NetMoments:
    """Compute the moment at the knee by inverse dynamics of foot and shank as one body; the calf's is unknown.

    The foot is at a right angle to the shank; where the hip is not measured, flat on the ground.
    """
    if math.isfinite(joints.hip):
        joints = joints._replace(ankle=NOT_MEASURED)
    return net_moments(leg, joints, motion, ground)._replace(plantarflexion=NOT_MEASURED)


def net_load_given(_leg: Leg, _joints: Joints, _motion: LegMotion, ground: Ground) -> NetMoments:
    """Take net moment and net force of the knee as they are given, as `ground_of` turns them."""
    return NetMoments(ground.torque[2], NOT_MEASURED, ground.force[1], ground.torque[0])


_CALIBRATED = AxialDeviation(0.30, 0.10)
"""Measured deviation with own constants, at each level; see docs/explanation/validation.md"""
_BY_MOMENTS = AxialDeviation(0.35, 0.05)
"""Measured deviation of the levels with net moments, with constants of other persons"""
_BY_GROUND_FORCE = AxialDeviation(0.375, 0.10)
"""That of the level with the ground force alone"""
LOAD_LEVELS = {
    "ground_force": EstimationLevel(
        Level.GROUND_FORCE, ground_force_alone, _CALIBRATED, _BY_GROUND_FORCE
    ),
    "knee_moment": EstimationLevel(Level.KNEE_MOMENT, knee_moment_alone, _CALIBRATED, _BY_MOMENTS),
    "ankle_moment": EstimationLevel(Level.ANKLE_MOMENT, net_moments, _CALIBRATED, _BY_MOMENTS),
    "net_load": EstimationLevel(Level.NET_LOAD, net_load_given, _CALIBRATED, _BY_MOMENTS),
}
"""The levels by name, from the one with the fewest sensors to the one with the most; the last one needs none"""


_MAX_JOINT_ANGLE = math.pi
"""Largest joint angle [rad]; larger ones are usually degrees read as radians"""
_MAX_COMPRESSION = 10.0
"""Largest compression of the knee [body weights]: an instrumented hip measured 8.7 while stumbling (Bergmann et al.
1993, doi:10.1016/0021-9290(93)90058-M), and knees bear less"""
MAX_PULL = 1.0
"""Largest force [body weights] with which a swinging leg pulls at its knee"""
_MAX_GROUND_PULL = 0.25
"""Largest force [body weights] with which the ground may seem to pull at the foot, as sensors drift"""
MIN_BODY_WEIGHT = 150.0
"""Body weight [N] below which the number must be in kg: it is the weight of 15 kg"""
MIN_RANGE_OF_MOTION = math.radians(3.5)
"""Range of motion [rad] below which a joint does not move, or its angles in rad were read as degrees"""
MIN_LOAD_PEAK = 0.75
"""Smallest plausible load peak [BW]: the smallest measured ones are 1.07 on two legs (OrthoLoad)"""
MAX_LOAD_PEAK = 8.0
"""Largest plausible load peak [BW]: the largest measured ones are about 6 in stumbling (OrthoLoad)"""


def body_weight_doubt(weight: float) -> str:
    """Return a sentence about a body weight [N] that is likely in kg; empty if it is not."""
    if weight >= MIN_BODY_WEIGHT:
        return ""
    return f"body_weight {weight:.7g} N: is it kg? {weight:.7g} kg weigh {weight * GRAVITY:.1f} N"


def is_implausible(joints: Joints, ground: Ground, axial: float, weight: float) -> bool:
    """Whether angles, ground force or the axial force [N] cannot be those of a person of a body weight [N]."""
    angles = (joints.flexion, joints.hip, joints.ankle)
    return (
        not -MAX_PULL * weight <= axial <= _MAX_COMPRESSION * weight
        or ground.force[1] < -_MAX_GROUND_PULL * weight
        or any(abs(angle) > _MAX_JOINT_ANGLE for angle in angles)
    )


class LoadEstimateFields(NamedTuple):
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
    sensed_force: float
    expected_force: float
    level: int
    calibrated: bool
    status: int


_STRUCT_CODES = {"float": "d", "int": "B", "bool": "?"}
"""Format characters of `struct` for the types of the fields"""
ESTIMATE_STRUCT = struct.Struct(
    "<"
    + "".join(_STRUCT_CODES[kind.__name__] for kind in get_type_hints(LoadEstimateFields).values())
)
"""Layout of an estimate in CDR, where it begins at a multiple of 8 B"""


# Bits of `status` in `LoadEstimate.msg`
BIT_TIME_RESET = 2
"""The stamps went back"""
BIT_INPUT_HELD = 4
"""The angles are those of an earlier stamp"""
BIT_IMPLAUSIBLE = 32
"""See `is_implausible`"""
BIT_DOUBTFUL_LOAD = 64
"""See `Movement`"""


class Estimator:
    """Estimates the joint reaction of one knee from its samples in order."""

    def __init__(
        self,
        level: str,
        person: Person,
        calibrated: bool = False,
        deviation: float = 0.0,
        loads: StrideLoads = MEASURED_LOADS,
    ) -> None:
        """Make an estimator that expects `loads` over a stride; see `configure`."""
        self._lag = ActivationLag()
        self._unassisted_lag = ActivationLag()
        """Lag of the forces that the muscles would have without actuators"""
        self._stride = StridePhase(loads)
        self.configure(level, person, calibrated, deviation)

    def configure(self, level: str, person: Person, calibrated: bool, deviation: float) -> None:
        """Continue with another level or person; the muscles keep their present forces.

        Args:
            level: Name in `LOAD_LEVELS`.
            person: Constants of the person.
            calibrated: Whether they were fitted to a measured knee of this person.
            deviation: Standard deviation relative to the body weight, for any force; 0: that of the level.
        """
        self._level = LOAD_LEVELS[level]
        self._person = person
        self._calibrated = calibrated
        self._leg = leg_of(person.mass, person.height)
        measured = self._level.calibrated if calibrated else self._level.uncalibrated
        self._deviation = AxialDeviation(deviation, 0.0) if deviation else measured
        self._movement = Movement(person.weight)

    def estimate(
        self, stamp: int, joints: Joints, motion: LegMotion, ground: Ground, status: int = 0
    ) -> LoadEstimateFields:
        """Estimate the joint reaction at a stamp [ns]; `status` has the bits that are known already."""
        net = self._level.dynamics(self._leg, joints, motion, ground)
        reaction, status = self.react(stamp, joints, ground, net, status)
        muscles = reaction.muscles
        return LoadEstimateFields(
            joints.flexion,
            reaction.axial,
            self._deviation.deviation_of(reaction.axial, self._person.weight),
            net.compression,
            muscles.quadriceps,
            muscles.hamstrings,
            muscles.gastrocnemius,
            reaction.extension,
            reaction.plantarflexion,
            net.frontal,
            joints.knee_assistance,
            reaction.sensed,
            reaction.expected,
            self._level.level,
            self._calibrated,
            status,
        )

    def forget_forces(self) -> None:
        """Forget the present muscle forces."""
        self._lag.forget_forces()
        self._unassisted_lag.forget_forces()

    def react(
        self, stamp: int, joints: Joints, ground: Ground, net: NetMoments, status: int
    ) -> tuple[MuscledReaction, int]:
        """Compute the joint reaction at a stamp [ns] from net moments, and the status with the bits that follow.

        In level walking the load that is expected at this moment of a stride counts as much as `person.expected_load`
        says. It is that of a person without actuators: what they change is taken from the sensors as a whole. For an
        implausible sample the muscles act without delay. Neither it nor a held sample changes their forces later.
        """
        person, vertical = self._person, ground.force[1]
        if self._level.level is Level.NET_LOAD:  # the ground's force, if shank and foot are still
            vertical = net.compression + self._leg.weight_below
        reaction = reaction_of(person, joints, net, vertical)
        if status & BIT_TIME_RESET:
            self.forget_forces()
            self._stride.forget_strides()
        if is_implausible(joints, ground, reaction.axial, person.weight):
            return reaction, status | BIT_IMPLAUSIBLE
        needed = [reaction.muscles, reaction.muscles]
        if joints.knee_assistance or joints.ankle_assistance:
            needed[1] = reaction_of(person, joints.unassisted, net, vertical).muscles
        delay, is_measured = person.electromechanical_delay, not status & BIT_INPUT_HELD
        muscles = self._lag.forces_at(stamp, needed[0], delay, is_measured)
        unassisted = self._unassisted_lag.forces_at(stamp, needed[1], delay, is_measured)
        sensed = net.compression + muscles.total
        walking = self._stride.expect_load(stamp, vertical / person.weight)
        if self._movement.is_other(stamp, joints.flexion, vertical):
            status |= BIT_DOUBTFUL_LOAD
            walking = NOT_WALKING
        if not walking.certainty:
            return reaction._replace(axial=sensed, sensed=sensed, muscles=muscles), status
        expected = walking.load * person.weight
        share = walking.certainty * person.expected_load
        axial = sensed + share * (expected - net.compression - unassisted.total)
        return MuscledReaction(
            axial, muscles, reaction.extension, reaction.plantarflexion, sensed, expected
        ), status
