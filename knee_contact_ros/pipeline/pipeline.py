"""The way of the data without ROS: bytes of messages in, answers out. The node and `solve` both feed it."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Mapping, Sequence

from knee_contact_ros.core.model import as_contact
from knee_contact_ros.core.ticks import PLACING
from knee_contact_ros.messages.answer import Answer, Ending, Input
from knee_contact_ros.messages.cdr_out import encode_contact_wrench, encode_numbers
from knee_contact_ros.messages.ros_types import deserialize
from knee_contact_ros.messages.topics import JOINT_REACTION_FORCE, JOINT_STATES
from knee_contact_ros.parameters.build import build_model, retuned
from knee_contact_ros.parameters.compartments import BY_MOMENT, Split
from knee_contact_ros.parameters.plausibility import doubts_about
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.pipeline.decode import Decoder, Deserialize
from knee_contact_ros.pipeline.samples import RefusedSampleError, angle_sample, load_sample
from knee_contact_ros.pipeline.synchronise import TIME_RESET, PairedSample, Synchroniser


class Pipeline:
    """Samples, pairing and model in one line."""

    def __init__(
        self,
        parameters: Parameters,
        deserialize: Deserialize = deserialize,
        *,
        compiled: bool,
        curves: Mapping[str, str] | None = None,
    ) -> None:
        """Build the model; see `build_model` for `compiled` and `curves`, and `Decoder` for `deserialize`."""
        self.parameters = parameters
        self.model = build_model(parameters, compiled=compiled, curves=curves)
        self.doubts = doubts_about(parameters, self.model)
        """What makes no sense: in the parameters, and in the answers that are told to it"""
        self.decoder = Decoder(deserialize)
        self.synchroniser = Synchroniser(parameters.pairing)
        self.stream = self.model.stream()
        self.split = Split(parameters.body_weight)
        """What the compartment gets, where the frontal moment decides"""
        self.ticks = 0
        self.last_refusal = ""
        self._pending: deque[PairedSample] = deque()  # what is being answered

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
        return self._answers(self.take_joint_state(data))

    def joint_reaction_force(self, data: bytes) -> Iterator[Answer]:
        """Take the bytes of a WrenchStamped on the tibia; give the answers that it makes possible."""
        return self._answers(self.take_joint_reaction_force(data))

    def finish(self) -> Iterator[Answer]:
        """Answer all that came: there will be no more."""
        return self._answers(self.synchroniser.finish())

    def take_joint_state(self, data: bytes) -> list[PairedSample]:
        """Take the bytes of a JointState; give the ticks that it makes possible, to be computed one by one."""
        try:
            sample = angle_sample(self.decoder.joint_state(data), self.parameters.knee, self.model.height_prescribed)
        except RefusedSampleError as refused:
            return self._refuse(refused)
        return self.synchroniser.push_angle(sample)

    def take_joint_reaction_force(self, data: bytes, arrived: float = 0.0) -> list[PairedSample]:
        """Take the bytes of a WrenchStamped, `arrived` [s] by the caller's clock; give the ticks, likewise."""
        try:
            sample = load_sample(self.decoder.joint_reaction_force(data), self.parameters.load, arrived)
        except RefusedSampleError as refused:
            return self._refuse(refused)
        return self.synchroniser.push_load(sample)

    def compute(self, pair: PairedSample) -> tuple[bytes, list[float]]:
        """Compute a tick: the answer as the bytes of a `KneeContact`, and its numbers as in `Stream.answer`."""
        if pair.status & TIME_RESET:
            self.stream = self.model.stream()
        load = pair.load
        self.stream.advance(load.stamp, pair.angle, load.load, pair.height)
        self.ticks += 1
        if self.parameters.load.compartment in BY_MOMENT:
            self.split.add(load.message.force[1], load.load)
        numbers = self.stream.answer.tolist()
        return encode_numbers(load.stamp, load.frame_id, numbers, pair.status), numbers

    def answer(self, pair: PairedSample, message: bytes, numbers: Sequence[float], latency: float = math.nan) -> Answer:
        """All that a computed tick leaves behind; `latency` as in `Answer`."""
        load = pair.load
        contact = as_contact(numbers, pair.status)
        femoral_x, *normal = numbers[PLACING]
        inputs: list[Input] = [(JOINT_STATES, angle.stamp, angle.message) for angle in pair.angles]
        inputs.append((JOINT_REACTION_FORCE, load.stamp, load.message))
        return Answer(
            stamp=load.stamp,
            frame_id=load.frame_id,
            contact=contact,
            femoral_x=femoral_x,
            normal=(normal[0], normal[1]),
            inputs=tuple(inputs),
            message=message,
            wrench=encode_contact_wrench(load.stamp, load.frame_id, contact, (normal[0], normal[1])),
            latency=latency,
        )

    def retune(self, parameters: Parameters) -> None:
        """Go on with other numbers, between two ticks; see `retuned` for those that count."""
        self.parameters = parameters
        self.model = retuned(self.model, parameters)
        self.stream.go_on_with(self.model)
        self.doubts.go_on_with(doubts_about(parameters, self.model))

    def reset(self) -> None:
        """Start anew from rest at the next tick, which says so (`TIME_RESET`)."""
        if self._pending:
            self._pending[0] = self._pending[0]._replace(status=self._pending[0].status | TIME_RESET)
        else:
            self.synchroniser.start_anew()

    def ending(self) -> Ending:
        """What a recording must hold beside the answers."""
        inputs = tuple((JOINT_STATES, sample.stamp, sample.message) for sample in self.synchroniser.rest())
        return Ending(inputs, dict(self.synchroniser.refused))

    def _refuse(self, refused: RefusedSampleError) -> list[PairedSample]:
        self.synchroniser.refuse(refused.reason)
        self.last_refusal = str(refused)
        return []

    def _answers(self, pairs: Sequence[PairedSample]) -> Iterator[Answer]:
        self._pending.extend(pairs)
        while self._pending:
            pair = self._pending.popleft()
            yield self.answer(pair, *self.compute(pair))
