"""Estimates the joint reaction force from the messages of a leg's sensors: for the load node and `estimate-load`.

Needs no ROS.
"""

from __future__ import annotations

from collections.abc import Sequence

from knee_contact_ros.joint_reaction.estimator import PACKING, Estimate, Estimator
from knee_contact_ros.joint_reaction.leg import Ground, Joints, Motion, MotionFilter, inclination
from knee_contact_ros.messages.answer import Answer, Record
from knee_contact_ros.messages.answer_out import header
from knee_contact_ros.messages.cdr import JointState, WrenchStamped, encode_wrench_stamped
from knee_contact_ros.messages.ros_types import deserialize
from knee_contact_ros.messages.topics import GROUND_REACTION_FORCE, JOINT_REACTION_FORCE, JOINT_STATES, LOAD_ESTIMATE
from knee_contact_ros.parameters.load_schema import LoadParameters
from knee_contact_ros.pipeline.frames import ForceFrame
from knee_contact_ros.pipeline.intake import Intake
from knee_contact_ros.pipeline.leg_samples import ground_of, ground_sample, joints_of, leg_sample
from knee_contact_ros.pipeline.samples import AngleSample, Deserialize, LoadSample
from knee_contact_ros.pipeline.synchronise import TIME_RESET, PairedSample


class LoadPipeline(Intake):
    """Pipeline of the load node: samples, pairing and estimator."""

    def __init__(self, parameters: LoadParameters, deserialize: Deserialize = deserialize) -> None:
        """Begin without samples; see `Decoder` for `deserialize`."""
        frame = ForceFrame(parameters.frame.ground, GROUND_REACTION_FORCE)
        super().__init__(GROUND_REACTION_FORCE, parameters.pairing, frame, deserialize)
        self.parameters = parameters
        self.level = parameters.chosen_level
        self._motion = MotionFilter(parameters.motion_window)
        self._estimator = Estimator(self.level, parameters.person.constants, parameters.trust)
        self.estimate: Estimate | None = None
        """Last estimate; None before the first tick"""

    def angle_sample(self, message: JointState, data: bytes) -> AngleSample:
        """Angles and actuators' torques of the leg; see `leg_sample`."""
        return leg_sample(message, self.parameters, data, self.synchroniser.angle_delay)

    def force_sample(self, message: WrenchStamped, data: bytes, arrived: float) -> LoadSample:
        """Ground force; see `ground_sample`."""
        return ground_sample(message, self.parameters.ground, data, arrived)

    def sense(self, pair: PairedSample) -> tuple[Joints, Motion, Ground]:
        """Joints, motion and ground force at a pair's stamp. To be called for every pair in order.

        The motion follows from the measured angles: interpolated or held ones would distort it.
        """
        if pair.status & TIME_RESET:
            self._motion.forget()
        for angle in pair.angles:
            self._motion.see(angle.stamp, joints_of(angle.angle, angle.others))
        joints, wrench = joints_of(pair.angle, pair.others), pair.load.wrench
        assert wrench is not None  # noqa: S101  (by `ground_sample`)
        ground = ground_of(wrench, self.parameters.ground, joints, inclination(joints))
        return joints, self._motion.now(pair.load.stamp), ground

    def compute(self, pair: PairedSample) -> list[bytes]:
        """Estimate the joint reaction; return the bytes of its WrenchStamped and of its `LoadEstimate`."""
        load = pair.load
        self.estimate = estimate = self._estimator.at(*self.sense(pair), pair.status)
        self.ticks += 1
        frame = self.parameters.frame.tibia
        force, torque = (0.0, -estimate.axial_force, 0.0), (estimate.frontal_moment, 0.0, 0.0)
        return [
            encode_wrench_stamped(WrenchStamped(load.stamp, frame, force, torque)),
            encode_estimate(load.stamp, frame, estimate),
        ]

    def answer(self, pair: PairedSample, messages: Sequence[bytes], latency: float = 0.0) -> Answer:  # noqa: ARG002
        """Answer with the inputs and messages of the last estimate; it has no row, and no latency."""
        stamp, (reaction, estimate) = pair.load.stamp, messages
        records: tuple[Record, ...] = (
            *((JOINT_STATES, angle.came_at, angle.data) for angle in pair.angles),
            (GROUND_REACTION_FORCE, stamp, pair.load.data),
            (JOINT_REACTION_FORCE, stamp, reaction),
            (LOAD_ESTIMATE, stamp, estimate),
        )
        return Answer(b"", records, sum(len(data) for _, _, data in records))

    def retune(self, parameters: LoadParameters) -> None:
        """Continue with other numbers among the parameters, between two ticks."""
        if _offsets(parameters) != _offsets(self.parameters):  # the jump of the angles is no motion
            self._motion.forget()
        self.parameters, self.level = parameters, parameters.chosen_level
        self._estimator = Estimator(self.level, parameters.person.constants, parameters.trust)


def encode_estimate(stamp: int, frame_id: str, estimate: Estimate) -> bytes:
    """Bytes of a `LoadEstimate` message with a stamp [ns].

    Raises:
        ValueError: the stamp is beyond what ROS can hold.
    """
    return header(stamp, frame_id) + PACKING.pack(*estimate)


def _offsets(parameters: LoadParameters) -> tuple[float, ...]:
    return parameters.knee.offset, parameters.hip.offset, parameters.ankle.offset
