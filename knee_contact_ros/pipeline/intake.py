"""Bytes of both input streams in, pairs out, answers on request: what all pipelines have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterator, Sequence

from knee_contact_ros.messages.answer import Answer, Ending
from knee_contact_ros.messages.cdr import JointState, WrenchStamped
from knee_contact_ros.messages.topics import JOINT_STATES
from knee_contact_ros.parameters.sections import Pairing
from knee_contact_ros.pipeline.frames import ForceFrame
from knee_contact_ros.pipeline.samples import AngleSample, Decoder, Deserialize, LoadSample, RefusedSampleError
from knee_contact_ros.pipeline.synchronise import TIME_RESET, PairedSample, Synchroniser


class Intake(ABC):
    """Takes JointStates and forces, refuses and counts what cannot be used, and pairs the rest."""

    def __init__(self, force_topic: str, pairing: Pairing, frame: ForceFrame, deserialize: Deserialize) -> None:
        """Begin with nothing; see `Decoder` for `deserialize`."""
        self.force_topic = force_topic
        self.decoder = Decoder(deserialize)
        self.frame = frame
        self.synchroniser = Synchroniser(pairing)
        self.ticks = 0
        self.last_refusal = ""
        self._pending: deque[PairedSample] = deque()  # what is being answered

    @abstractmethod
    def angle_sample(self, message: JointState, data: bytes) -> AngleSample:
        """What counts of a JointState; `data` are the bytes under which it is recorded.

        Raises:
            RefusedSampleError: it cannot be used.
        """

    @abstractmethod
    def force_sample(self, message: WrenchStamped, data: bytes, arrived: float) -> LoadSample:
        """What counts of a force that came when `arrived` [s] says, likewise."""

    @abstractmethod
    def compute(self, pair: PairedSample) -> list[bytes]:
        """Compute a tick; give its messages."""

    @abstractmethod
    def answer(self, pair: PairedSample, messages: Sequence[bytes], latency: float = 0.0) -> Answer:
        """All that the tick computed last leaves behind: its `messages`, and what led to them.

        `latency` [s] is that of its publication, where it is measured.
        """

    @property
    def refused(self) -> int:
        """Number of refused samples."""
        return self.synchroniser.refused.total()

    def joint_state(self, data: bytes) -> Iterator[Answer]:
        """Take the bytes of a JointState; give the answers that it makes possible."""
        return self._answers(self.take_joint_state(data))

    def force(self, data: bytes) -> Iterator[Answer]:
        """Take the bytes of a WrenchStamped; give the answers that it makes possible."""
        return self._answers(self.take_force(data))

    def finish(self) -> Iterator[Answer]:
        """Answer all that came: there will be no more."""
        return self._answers(self.synchroniser.finish())

    def take_joint_state(self, data: bytes) -> list[PairedSample]:
        """Take the bytes of a JointState; give the ticks that it makes possible, to be computed one by one."""
        try:
            sample = self.angle_sample(*self.decoder.joint_state(data))
        except RefusedSampleError as refused:
            return self._refuse(refused)
        return self.synchroniser.push_angle(sample)

    def take_force(self, data: bytes, arrived: float = 0.0) -> list[PairedSample]:
        """Take the bytes of a WrenchStamped, `arrived` [s] by the caller's clock; give the ticks, likewise."""
        try:
            came, as_it_came = self.decoder.force(data, self.force_topic)
            sample = self.force_sample(*self.frame.turned(came, as_it_came), arrived)
        except RefusedSampleError as refused:
            return self._refuse(refused)
        if self.frame.is_held:
            return self.synchroniser.push_load(sample)
        refused_before = self.refused
        pairs = self.synchroniser.push_load(sample)
        if self.refused == refused_before:  # what is refused tells of no frame
            self.frame.hold(came.frame_id)
        return pairs

    def reset(self) -> None:
        """Start anew from rest at the next tick, which says so (`TIME_RESET`), with forces in any frame."""
        self.frame.forget()
        if self._pending:
            self._pending[0] = self._pending[0]._replace(status=self._pending[0].status | TIME_RESET)
        else:
            self.synchroniser.start_anew()

    def ending(self) -> Ending:
        """What a recording must hold beside the answers."""
        inputs = tuple((JOINT_STATES, sample.came_at, sample.data) for sample in self.synchroniser.rest())
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
