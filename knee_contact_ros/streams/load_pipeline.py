"""From the messages of a leg's sensors to its joint reaction force, without ROS: for the load node and `estimate-load`.

The joints' names, signs and axes are applied only here.
"""

import math
from typing import NamedTuple

from ..joint_reaction.conventions import LegCheck
from ..joint_reaction.estimator import (
    BIT_DOUBTFUL_LOAD,
    BIT_IMPLAUSIBLE,
    ESTIMATE_STRUCT,
    Estimator,
    LoadEstimateFields,
)
from ..joint_reaction.leg import (
    NOT_MEASURED,
    Ground,
    Joints,
    LegMotion,
    MotionFilter,
    Vector,
    inclination,
)
from ..joint_reaction.muscles import Person
from ..model.knee import LARGEST_ANGLE
from ..parameters.load_schema import (
    ActuatedJoint,
    GroundForce,
    LoadParameters,
    MeasuredJoint,
)
from .frames import ForceFrame
from .messages import (
    JointState,
    RefusedSampleError,
    WrenchStamped,
    checked_stamp,
    encode_wrench_stamped,
    header,
    number_of,
)
from .pairing import TIME_RESET, PairedSample
from .pipeline import Pipeline
from .timeline import AngleSample, LoadSample
from .topics import (
    GROUND_REACTION_FORCE,
    JOINT_REACTION_FORCE,
    JOINT_STATES,
    LOAD_ESTIMATE,
    Record,
)

LARGEST_TORQUE = 1e5
"""Largest torque of an actuator or of the ground [N m], and largest ground force [N]"""


def leg_sample(
    message: JointState, parameters: LoadParameters, data: bytes, delay: int
) -> AngleSample:
    """Sample with angles and actuators' torques from a JointState; `data` and `delay` as for `angle_sample`.

    Raises:
        RefusedSampleError: a joint that the parameters name is missing, lacks a position, or lacks an effort
            although it is assisted; a value is not finite or too large; or the stamp is not valid.
    """
    knee, ankle = parameters.knee, parameters.ankle
    flexion = _angle(message, knee)
    angles = _angle(message, parameters.hip), _angle(message, ankle)
    others = (*angles, _assistance(message, knee), _assistance(message, ankle))
    return AngleSample(
        checked_stamp(message.stamp, "joint_states") - delay, flexion, data, None, delay, others
    )


def joints_of(flexion: float, others: tuple[float, ...]) -> Joints:
    """Joints from the flexion angle and the other numbers of a sample made by `leg_sample`."""
    return Joints(flexion, *others)


def _angle(message: JointState, joint: MeasuredJoint) -> float:
    """Angle [rad] of a joint; NaN if it is not measured."""
    if not joint.joint_name:
        return NOT_MEASURED
    angle = joint.sign * number_of(message, joint.joint_name, "position") + joint.offset
    if abs(angle) > LARGEST_ANGLE:
        text = f"joint_states: angle of joint {joint.joint_name!r} is {angle:g} rad, beyond {LARGEST_ANGLE:g}"
        raise RefusedSampleError("out_of_range", text)
    return angle


def _assistance(message: JointState, joint: ActuatedJoint) -> float:
    """Torque [N m] of a joint's actuator, positive against its angle; 0 if the joint has no actuator."""
    if not joint.assisted:
        return 0.0
    effort = number_of(message, joint.joint_name, "effort")
    if abs(effort) > LARGEST_TORQUE:
        text = f"joint_states: effort of joint {joint.joint_name!r} is {effort:g} N m, beyond {LARGEST_TORQUE:g}"
        raise RefusedSampleError("out_of_range", text)
    return 0.0 - joint.sign * effort  # without effort it is 0, and not -0


def ground_sample(
    message: WrenchStamped, parameters: GroundForce, data: bytes, arrived: float
) -> LoadSample:
    """Sample with the ground force on the foot, from a WrenchStamped; `data` and `arrived` as for `load_sample`.

    Raises:
        RefusedSampleError: a component that is used is not finite or too large, or the stamp is not valid.
    """
    components, what = {
        "vertical": ((message.force[1],), "force.y"),
        "full": ((*message.force, *message.torque), "force and torque"),
        "net": ((message.force[1], message.torque[2]), "force.y and torque.z"),
    }[parameters.components]
    if not all(map(math.isfinite, components)):
        numbers = ", ".join(f"{number:g}" for number in components)
        raise RefusedSampleError("not_finite", f"{GROUND_REACTION_FORCE}: {what}: {numbers}")
    if max(map(abs, components)) > LARGEST_TORQUE:
        largest = f"{max(components, key=abs):g} N or N m"
        raise RefusedSampleError(
            "out_of_range", f"{GROUND_REACTION_FORCE}: {largest}, beyond {LARGEST_TORQUE:g}"
        )
    stamp = checked_stamp(message.stamp, GROUND_REACTION_FORCE)
    return LoadSample(
        stamp, message.force[1], NOT_MEASURED, message.frame_id, data, arrived, message
    )


def ground_of(
    wrench: WrenchStamped, parameters: GroundForce, joints: Joints, inclination: float
) -> Ground:
    """Ground force about the ankle in upright axes; `inclination` [rad] is the shank's (`inverse_dynamics`).

    Of a net load it is the net wrench at the knee, its force on the thigh: up in compression; see `net_load_given`.
    A sensor that turns with the foot is assumed to be upright if the ankle is not measured.
    """
    if parameters.components == "net":
        return Ground((NOT_MEASURED, -wrench.force[1], NOT_MEASURED), wrench.torque)
    if parameters.components == "vertical":
        return Ground((0.0, wrench.force[1], 0.0), (NOT_MEASURED, NOT_MEASURED, NOT_MEASURED))
    (force_x, force_y, force_z), (about_x, about_y, about_z) = wrench.force, wrench.torque
    at_x, at_y = parameters.ankle_x, parameters.ankle_y
    force = (force_x, force_y, force_z)
    about = (
        about_x - at_y * force_z,
        about_y + at_x * force_z,
        about_z - at_x * force_y + at_y * force_x,
    )
    turn = inclination + joints.ankle
    if parameters.axes == "ground" or not math.isfinite(turn):
        return Ground(force, about)
    return Ground(_turned(force, turn), _turned(about, turn))


def _turned(vector: Vector, angle: float) -> Vector:
    """Rotate a vector by an angle [rad] about z."""
    x, y, z = vector
    cosine, sine = math.cos(angle), math.sin(angle)
    return cosine * x - sine * y, sine * x + cosine * y, z


class Sensed(NamedTuple):
    """Inputs of the load estimator at a stamp."""

    stamp: int
    """Stamp [ns] of the ground force"""
    joints: Joints
    motion: LegMotion
    ground: Ground
    status: int
    """Bits of `Status`"""


class LoadAnswer(NamedTuple):
    """Estimate of the joint reaction at one tick, and the inputs that led to it."""

    pair: PairedSample
    sensed: Sensed
    """Inputs of the estimator"""
    estimate: LoadEstimateFields
    reaction: bytes
    """Bytes of the WrenchStamped of the joint reaction"""
    message: bytes
    """Bytes of the `LoadEstimate`"""

    def records(self) -> tuple[Record, ...]:
        """Messages to record, the estimate last."""
        load = self.pair.load
        return (
            *[(JOINT_STATES, angle.message_stamp, angle.data) for angle in self.pair.angles],
            (GROUND_REACTION_FORCE, load.stamp, load.data),
            (JOINT_REACTION_FORCE, load.stamp, self.reaction),
            (LOAD_ESTIMATE, load.stamp, self.message),
        )


class LoadPipeline(Pipeline[LoadAnswer]):
    """Pipeline of the load node: samples, pairing and estimator."""

    def __init__(self, parameters: LoadParameters) -> None:
        """Begin without samples."""
        frame = ForceFrame(parameters.frame.ground, GROUND_REACTION_FORCE)
        super().__init__(GROUND_REACTION_FORCE, parameters, frame)
        self.parameters = parameters
        self.level = parameters.chosen_level
        self._motion = MotionFilter(parameters.motion_window)
        self._estimator = Estimator(*_constants(parameters))
        self.conventions = _check_of(parameters)
        """Whether angles and ground force follow our conventions"""

    def angle_sample(self, message: JointState, data: bytes) -> AngleSample:
        """Sample with angles and actuators' torques of the leg; see `leg_sample`."""
        return leg_sample(message, self.parameters, data, self.synchroniser.angle_delay)

    def load_sample(self, message: WrenchStamped, data: bytes, arrived: float) -> LoadSample:
        """Sample with the ground force; see `ground_sample`."""
        return ground_sample(message, self.parameters.ground, data, arrived)

    def answer_pair(self, pair: PairedSample) -> LoadAnswer:
        """Estimate the joint reaction."""
        sensed = self._sense(pair)
        self.conventions.add_sample(sensed.stamp, sensed.joints, sensed.ground)
        estimate = self._estimator.estimate(*sensed)
        stamp = pair.load.stamp
        frame = self.parameters.frame.tibia
        # A torque.y of NaN beside a number in torque.z marks a doubtful load, see `load_sample`.
        is_doubtful = estimate.status & (BIT_IMPLAUSIBLE | BIT_DOUBTFUL_LOAD)
        torque = (estimate.frontal_moment, NOT_MEASURED if is_doubtful else 0.0, 0.0)
        wrench = WrenchStamped(stamp, frame, (0.0, -estimate.axial_force, 0.0), torque)
        message = encode_estimate(stamp, frame, estimate)
        return LoadAnswer(pair, sensed, estimate, encode_wrench_stamped(wrench), message)

    def _sense(self, pair: PairedSample) -> Sensed:
        """Joints, motion and ground force at a pair's stamp. To be called for every pair in order.

        The motion is computed from the measured angles; interpolated or held ones would distort it.
        """
        if pair.status & TIME_RESET:
            self._motion.forget_angles()
        for angle in pair.angles:
            self._motion.add_angles(angle.stamp, joints_of(angle.angle, angle.others))
        joints = joints_of(pair.angle, pair.others)
        stamp = pair.load.stamp
        wrench = pair.load.wrench
        assert wrench is not None  # noqa: S101  (by `ground_sample`)
        ground = ground_of(wrench, self.parameters.ground, joints, inclination(joints))
        return Sensed(stamp, joints, self._motion.motion_at(stamp), ground, pair.status)

    def retune(self, parameters: LoadParameters) -> None:
        """Continue with changed numbers among the parameters, between two ticks."""
        if _offsets(parameters) != _offsets(
            self.parameters
        ):  # the jump of the angles is no motion
            self._motion.forget_angles()
            self._estimator.forget_forces()
            self.conventions = _check_of(parameters)
        self.parameters, self.level = parameters, parameters.chosen_level
        self._estimator.configure(*_constants(parameters))


def encode_estimate(stamp: int, frame_id: str, estimate: LoadEstimateFields) -> bytes:
    """Bytes of a `LoadEstimate` message with a stamp [ns].

    Raises:
        ValueError: the stamp is beyond what ROS can hold.
    """
    return header(stamp, frame_id) + ESTIMATE_STRUCT.pack(*estimate)


def _check_of(parameters: LoadParameters) -> LegCheck:
    """Return a check of conventions for what the parameters say is measured."""
    return LegCheck(parameters.person.constants.weight, parameters.ground.components == "net")


def _constants(parameters: LoadParameters) -> tuple[str, Person, bool, float]:
    return (
        parameters.chosen_level,
        parameters.person.constants,
        parameters.calibrated,
        parameters.standard_deviation,
    )


def _offsets(parameters: LoadParameters) -> tuple[float, ...]:
    return parameters.knee.offset, parameters.hip.offset, parameters.ankle.offset
