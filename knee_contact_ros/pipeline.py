"""The way of the data without ROS: bytes of messages in, answers out. The node and `solve` both feed it."""

from __future__ import annotations

from collections.abc import Iterator

from knee_contact_ros.answer import Answer, Ending, Input
from knee_contact_ros.build import load_model, retuned
from knee_contact_ros.cdr_out import encode_contact, encode_contact_wrench
from knee_contact_ros.core.types import Status
from knee_contact_ros.messages import deserialize
from knee_contact_ros.parameters import Parameters
from knee_contact_ros.stream_in.decode import Decoder, Deserialize
from knee_contact_ros.stream_in.samples import RefusedSampleError, angle_sample, load_sample
from knee_contact_ros.synchronise import PairedSample, Synchroniser
from knee_contact_ros.topics import JOINT_REACTION_FORCE, JOINT_STATES


class Pipeline:
    """Samples, pairing and model in one line."""

    def __init__(self, parameters: Parameters, deserialize: Deserialize = deserialize, *, compiled: bool) -> None:
        """Build the model; see `load_model` for `compiled` and `Decoder` for `deserialize`."""
        self.parameters = parameters
        self.model = load_model(parameters, compiled=compiled)
        self.decoder = Decoder(deserialize)
        self.synchroniser = Synchroniser(parameters.pairing)
        self.stream = self.model.stream()
        self.ticks = 0
        self.last_refusal = ""

    def compile(self) -> None:
        """Go on with the compiled kernel; before the first sample."""
        from knee_contact_ros.compiled import compiled  # half a second to import

        self.model = compiled(self.model)
        self.stream = self.model.stream()

    @property
    def refused(self) -> int:
        """Number of refused samples."""
        return self.synchroniser.refused.total()

    def joint_state(self, data: bytes) -> Iterator[Answer]:
        """Take the bytes of a JointState; give the answers that it makes possible."""
        try:
            sample = angle_sample(self.decoder.joint_state(data), self.parameters.knee, self.model.height_prescribed)
        except RefusedSampleError as refused:
            return self._refuse(refused)
        return self._answers(self.synchroniser.push_angle(sample))

    def joint_reaction_force(self, data: bytes, arrived: float = 0.0) -> Iterator[Answer]:
        """Take the bytes of a WrenchStamped on the tibia; give the answers that it makes possible.

        `arrived` [s] by the caller's clock is handed on to the answer.
        """
        try:
            sample = load_sample(self.decoder.joint_reaction_force(data), self.parameters.load, arrived)
        except RefusedSampleError as refused:
            return self._refuse(refused)
        return self._answers(self.synchroniser.push_load(sample))

    def retune(self, parameters: Parameters) -> None:
        """Go on with other numbers, between two ticks; see `retuned` for those that count."""
        self.parameters = parameters
        self.model = retuned(self.model, parameters)
        self.stream.go_on_with(self.model)

    def reset(self) -> None:
        """Start anew from rest at the next tick, which says so (`TIME_RESET`)."""
        self.synchroniser.start_anew()

    def give_up(self) -> Iterator[Answer]:
        """Answer the loads that wait for an angle with the last angle."""
        return self._answers(self.synchroniser.give_up())

    def ending(self) -> Ending:
        """What a recording must hold beside the answers."""
        inputs = tuple((JOINT_STATES, sample.stamp, sample.message) for sample in self.synchroniser.rest())
        return Ending(inputs, dict(self.synchroniser.refused))

    def _refuse(self, refused: RefusedSampleError) -> Iterator[Answer]:
        self.synchroniser.refuse(refused.reason)
        self.last_refusal = str(refused)
        return iter(())

    def _answers(self, pairs: list[PairedSample]) -> Iterator[Answer]:
        return (self._answer(pair) for pair in pairs)

    def _answer(self, pair: PairedSample) -> Answer:
        if pair.status & Status.TIME_RESET:
            self.stream = self.model.stream()
        stamp, frame_id = pair.load.stamp, pair.load.frame_id
        contact = self.stream.tick_ns(stamp, pair.angle, pair.load.load, pair.height)
        if pair.status:
            contact = contact._replace(status=contact.status | pair.status)
        self.ticks += 1
        femoral_x, normal_x, normal_y = self.stream.placing
        normal = normal_x, normal_y
        inputs: list[Input] = [(JOINT_STATES, angle.stamp, angle.message) for angle in pair.angles]
        inputs.append((JOINT_REACTION_FORCE, pair.load.stamp, pair.load.message))
        return Answer(
            stamp=stamp,
            frame_id=frame_id,
            contact=contact,
            femoral_x=femoral_x,
            normal=normal,
            inputs=tuple(inputs),
            message=encode_contact(stamp, frame_id, contact),
            wrench=encode_contact_wrench(stamp, frame_id, contact, normal),
            arrived=pair.load.arrived,
        )
