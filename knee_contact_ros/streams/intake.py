"""Base of all pipelines: bytes of two input streams become pairs of samples, and these become answers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterator, Sequence
from typing import Any

from knee_contact_ros.parameters.schema import Pairing
from knee_contact_ros.streams.frames import ForceFrame
from knee_contact_ros.streams.messages import Decoder, Deserialize, JointState, RefusedSampleError, WrenchStamped
from knee_contact_ros.streams.pairing import TIME_RESET, AngleSample, LoadSample, PairedSample, Synchroniser
from knee_contact_ros.streams.topics import JOINT_STATES, Answer, Ending


class Intake(ABC):
    """Takes JointStates and forces, refuses and counts those that cannot be used, and pairs the others."""

    def __init__(self, force_topic: str, pairing: Pairing, frame: ForceFrame, deserialize: Deserialize) -> None:
        """Begin without samples; see `Decoder` for `deserialize`."""
        self.force_topic = force_topic
        self.decoder = Decoder(deserialize)
        self.frame = frame
        self.synchroniser = Synchroniser(pairing)
        self.ticks = 0
        self.last_refusal = ""
        self._pending: deque[PairedSample] = deque()  # what is being answered

    @abstractmethod
    def angle_sample(self, message: JointState, data: bytes) -> AngleSample:
        """Sample in a JointState; `data` are the bytes under which it is recorded.

        Raises:
            RefusedSampleError: it cannot be used.
        """

    @abstractmethod
    def force_sample(self, message: WrenchStamped, data: bytes, arrived: float) -> LoadSample:
        """Sample in a force that arrived at a time [s] by the caller's clock; see `angle_sample`."""

    @abstractmethod
    def compute(self, pair: PairedSample) -> list[bytes]:
        """Compute a tick; return the bytes of its messages."""

    @abstractmethod
    def answer(self, pair: PairedSample, messages: Sequence[bytes], latency: float = 0.0) -> Answer:
        """Answer of the tick that was computed last: its `messages`, and the inputs that led to them.

        `latency` [s] is the time from the arrival of the force to the publication, where it is measured.
        """

    @abstractmethod
    def retune(self, parameters: Any) -> None:
        """Continue with other numbers among the parameters, between two ticks."""

    @property
    def refused(self) -> int:
        """Number of refused samples."""
        return self.synchroniser.refused.total()

    def joint_state(self, data: bytes) -> Iterator[Answer]:
        """Take the bytes of a JointState; yield the answers that it makes possible."""
        return self._answers(self.take_joint_state(data))

    def force(self, data: bytes) -> Iterator[Answer]:
        """Take the bytes of a WrenchStamped; yield the answers that it makes possible."""
        return self._answers(self.take_force(data))

    def finish(self) -> Iterator[Answer]:
        """Yield the answers to all that waits: no more samples will come."""
        return self._answers(self.synchroniser.finish())

    def take_joint_state(self, data: bytes) -> list[PairedSample]:
        """Take the bytes of a JointState; return the pairs that it makes possible, to be computed one by one."""
        try:
            sample = self.angle_sample(*self.decoder.joint_state(data))
        except RefusedSampleError as refused:
            return self._refuse(refused)
        return self.synchroniser.push_angle(sample)

    def take_force(self, data: bytes, arrived: float = 0.0) -> list[PairedSample]:
        """Take the bytes of a WrenchStamped that arrived at a time [s] by the caller's clock; return the pairs."""
        try:
            came, as_it_came = self.decoder.force(data, self.force_topic)
            sample = self.force_sample(*self.frame.turned(came, as_it_came), arrived)
        except RefusedSampleError as refused:
            return self._refuse(refused)
        if self.frame.is_held:
            return self.synchroniser.push_load(sample)
        refused_before = self.refused
        pairs = self.synchroniser.push_load(sample)
        if self.refused == refused_before:  # a refused sample does not decide on the frame
            self.frame.hold(came.frame_id)
        return pairs

    def reset(self) -> None:
        """Restart from rest at the next tick, which is flagged (`TIME_RESET`), with forces in any frame."""
        self.frame.forget()
        if self._pending:
            self._pending[0] = self._pending[0]._replace(status=self._pending[0].status | TIME_RESET)
        else:
            self.synchroniser.start_anew()

    def ending(self) -> Ending:
        """End of a recording: the angles that belong to no answer, and the counts of refused samples."""
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
