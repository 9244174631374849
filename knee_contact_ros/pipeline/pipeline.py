"""The way of the data without ROS: bytes of messages in, answers out. The node and `solve` both feed it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence

from knee_contact_ros.core.model import KneeModel
from knee_contact_ros.core.types import Rows
from knee_contact_ros.messages.answer import Answer, Ending, Record
from knee_contact_ros.messages.answer_out import encode_answer, encode_answer_wrench
from knee_contact_ros.messages.ros_types import deserialize
from knee_contact_ros.messages.topics import JOINT_REACTION_FORCE, JOINT_STATES, KNEE_CONTACT, KNEE_CONTACT_WRENCH
from knee_contact_ros.parameters.build import build_model, retuned
from knee_contact_ros.parameters.compartments import BY_MOMENT, Split
from knee_contact_ros.parameters.plausibility import doubts_about
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.pipeline.frames import ForceFrame
from knee_contact_ros.pipeline.samples import Decoder, Deserialize, RefusedSampleError, angle_sample, load_sample
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
        self.frame = ForceFrame(parameters.frame.tibia)
        self.synchroniser = Synchroniser(parameters.pairing)
        self.stream = self.model.stream()
        self.split = Split(parameters.body_weight)
        """What the compartment gets, where the frontal moment decides"""
        self.ticks = 0
        self.last_refusal = ""
        self._pending: deque[PairedSample] = deque()  # what is being answered

    def compile(self, kernel: Callable[[KneeModel], KneeModel] | None = None) -> None:
        """Go on with the compiled kernel, or as `kernel` has it; before the first sample."""
        from knee_contact_ros.compiled.kernel import compiled  # half a second to import

        self.model = (kernel or compiled)(self.model)
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
            message, written = self.decoder.joint_state(data)
            sample = angle_sample(message, self.parameters.knee, self.model.height_prescribed, written)
        except RefusedSampleError as refused:
            return self._refuse(refused)
        return self.synchroniser.push_angle(sample)

    def take_joint_reaction_force(self, data: bytes, arrived: float = 0.0) -> list[PairedSample]:
        """Take the bytes of a WrenchStamped, `arrived` [s] by the caller's clock; give the ticks, likewise."""
        try:
            came, as_it_came = self.decoder.joint_reaction_force(data)
            message, written = self.frame.turned(came, as_it_came)
            sample = load_sample(message, self.parameters.load, arrived, written)
        except RefusedSampleError as refused:
            return self._refuse(refused)
        if self.frame.is_held:
            return self.synchroniser.push_load(sample)
        refused_before = self.refused
        pairs = self.synchroniser.push_load(sample)
        if self.refused == refused_before:  # what is refused tells of no frame
            self.frame.hold(came.frame_id)
        return pairs

    @property
    def row(self) -> Rows:
        """The answer to the last tick, shape (1,); the next one is written over it."""
        return self.stream.answer

    def compute(self, pair: PairedSample) -> bytes:
        """Compute a tick; give the answer as the bytes of a `KneeContact`, and leave it in `row`."""
        if pair.status & TIME_RESET:
            self.stream = self.model.stream()
        load = pair.load
        self.stream.advance(load.stamp, pair.angle, load.load, pair.height)
        if pair.status:
            self.row["status"] |= pair.status
        self.ticks += 1
        if self.parameters.load.compartment in BY_MOMENT:
            self.split.add(load.axial, load.load)
        return encode_answer(load.stamp, load.frame_id, self.row.tobytes())

    def answer(self, pair: PairedSample, message: bytes, latency: float = 0.0) -> Answer:
        """All that the tick computed last leaves behind: `row` and its `message`, and what led to them.

        `latency` [s] is that of its publication, where it is measured.
        """
        self.stream.latency[0] = latency
        load, row = pair.load, self.row.tobytes()
        records: list[Record] = [(JOINT_STATES, angle.stamp, angle.data) for angle in pair.angles]
        records.append((JOINT_REACTION_FORCE, load.stamp, load.data))
        records.append((KNEE_CONTACT, load.stamp, message))
        wrench = encode_answer_wrench(load.stamp, load.frame_id, row)
        records.append((KNEE_CONTACT_WRENCH, load.stamp, wrench))
        size = len(load.data) + len(message) + len(wrench)
        for angle in pair.angles:
            size += len(angle.data)
        return Answer(row, tuple(records), size)

    def retune(self, parameters: Parameters) -> None:
        """Go on with other numbers, between two ticks; see `retuned` for those that count."""
        self.parameters = parameters
        self.model = retuned(self.model, parameters)
        self.stream.go_on_with(self.model)
        self.doubts.go_on_with(doubts_about(parameters, self.model))

    def reset(self) -> None:
        """Start anew from rest at the next tick, which says so (`TIME_RESET`), with forces in any frame."""
        self.frame.forget()
        if self._pending:
            self._pending[0] = self._pending[0]._replace(status=self._pending[0].status | TIME_RESET)
        else:
            self.synchroniser.start_anew()

    def ending(self) -> Ending:
        """What a recording must hold beside the answers."""
        inputs = tuple((JOINT_STATES, sample.stamp, sample.data) for sample in self.synchroniser.rest())
        return Ending(inputs, dict(self.synchroniser.refused))

    def _refuse(self, refused: RefusedSampleError) -> list[PairedSample]:
        self.synchroniser.refuse(refused.reason)
        self.last_refusal = str(refused)
        return []

    def _answers(self, pairs: Sequence[PairedSample]) -> Iterator[Answer]:
        self._pending.extend(pairs)
        while self._pending:
            pair = self._pending.popleft()
            yield self.answer(pair, self.compute(pair))
