"""From the bytes of a leg's sensors to the joint reaction force, without ROS: for the load node and `estimate-load`."""

from __future__ import annotations

from collections.abc import Sequence

from knee_contact_ros.joint_reaction.estimator import Estimate, Estimator
from knee_contact_ros.joint_reaction.inverse_dynamics import inclination
from knee_contact_ros.joint_reaction.sensed import Ground, Joints
from knee_contact_ros.messages.answer import Answer, Record
from knee_contact_ros.messages.cdr import JointState, WrenchStamped, encode_wrench_stamped
from knee_contact_ros.messages.estimate_out import encode_estimate
from knee_contact_ros.messages.ros_types import deserialize
from knee_contact_ros.messages.topics import GROUND_REACTION_FORCE, JOINT_REACTION_FORCE, JOINT_STATES, LOAD_ESTIMATE
from knee_contact_ros.parameters.load_schema import LoadParameters
from knee_contact_ros.pipeline.frames import ForceFrame
from knee_contact_ros.pipeline.intake import Intake
from knee_contact_ros.pipeline.leg_samples import ground_of, ground_sample, joints_of, leg_sample
from knee_contact_ros.pipeline.samples import AngleSample, Deserialize, LoadSample
from knee_contact_ros.pipeline.synchronise import INPUT_HELD, STALE_INPUT, TIME_RESET, PairedSample

UNSEEN = INPUT_HELD | STALE_INPUT
"""Bits of a sample whose joints were not seen: the next one tells where they are, and not how they came there"""
ANEW = UNSEEN | TIME_RESET
"""Bits of a sample before which the motion is to be forgotten; behind it, it is with `UNSEEN`"""


class LoadPipeline(Intake):
    """Samples, pairing and estimator in one line."""

    def __init__(self, parameters: LoadParameters, deserialize: Deserialize = deserialize) -> None:
        """Begin with nothing; see `Decoder` for `deserialize`."""
        frame = ForceFrame(parameters.frame.ground, GROUND_REACTION_FORCE)
        super().__init__(GROUND_REACTION_FORCE, parameters.pairing, frame, deserialize)
        self.parameters = parameters
        self.level = parameters.chosen_level
        self._estimator = Estimator(self.level, parameters.person.constants, parameters.motion_window, parameters.trust)
        self.estimate: Estimate | None = None
        """The last one"""

    def angle_sample(self, message: JointState, data: bytes) -> AngleSample:
        """The joints of the leg."""
        return leg_sample(message, self.parameters, data, self.synchroniser.angle_delay)

    def force_sample(self, message: WrenchStamped, data: bytes, arrived: float) -> LoadSample:
        """The ground force."""
        return ground_sample(message, self.parameters.ground, data, arrived)

    def sensed(self, pair: PairedSample) -> tuple[Joints, Ground]:
        """What the leg's sensors told at one stamp."""
        joints, wrench = joints_of(pair.angle, pair.others), pair.load.wrench
        assert wrench is not None  # noqa: S101  (by `ground_sample`)
        return joints, ground_of(wrench, self.parameters.ground, joints, inclination(joints))

    def compute(self, pair: PairedSample) -> list[bytes]:
        """Estimate the joint reaction; give it as the bytes of a WrenchStamped and of a `LoadEstimate`."""
        if pair.status & ANEW:
            self._estimator.start_anew()
        load, (joints, ground) = pair.load, self.sensed(pair)
        self.estimate = estimate = self._estimator.at(load.stamp, joints, ground, pair.status)
        if pair.status & UNSEEN:
            self._estimator.start_anew()
        self.ticks += 1
        frame = self.parameters.frame.tibia
        force, torque = (0.0, -estimate.axial_force, 0.0), (estimate.frontal_moment, 0.0, 0.0)
        return [
            encode_wrench_stamped(WrenchStamped(load.stamp, frame, force, torque)),
            encode_estimate(load.stamp, frame, estimate),
        ]

    def answer(self, pair: PairedSample, messages: Sequence[bytes], latency: float = 0.0) -> Answer:  # noqa: ARG002
        """What led to the estimate computed last, and its messages; no row, and no latency in it."""
        stamp, (reaction, estimate) = pair.load.stamp, messages
        records: tuple[Record, ...] = (
            *((JOINT_STATES, angle.came_at, angle.data) for angle in pair.angles),
            (GROUND_REACTION_FORCE, stamp, pair.load.data),
            (JOINT_REACTION_FORCE, stamp, reaction),
            (LOAD_ESTIMATE, stamp, estimate),
        )
        return Answer(b"", records, sum(len(data) for _, _, data in records))

    def retune(self, parameters: LoadParameters) -> None:
        """Go on with other numbers, between two ticks."""
        if _offsets(parameters) != _offsets(self.parameters):  # what the angles jump by is no motion
            self._estimator.start_anew()
        self.parameters, self.level = parameters, parameters.chosen_level
        self._estimator.go_on_with(self.level, parameters.person.constants, parameters.trust)


def _offsets(parameters: LoadParameters) -> tuple[float, ...]:
    return parameters.knee.offset, parameters.hip.offset, parameters.ankle.offset
