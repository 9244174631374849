"""The loop from messages to answers, for the nodes, `solve`, `estimate-load` and studies.

A message is pushed; its sample is refused or paired, and every pair that it makes possible is answered. Answers come
one by one, each as soon as it is computed, so that it can be published before the next one is.
"""

import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from typing import Any, Generic, Protocol, TypeVar

from ..parameters.load_schema import LoadParameters
from ..parameters.schema import Parameters
from .conversion import written
from .frames import ForceFrame
from .joints import SpreadJoints
from .messages import (
    JOINT_STATE,
    WRENCH,
    JointState,
    RefusedSampleError,
    WrenchStamped,
    encode_joint_state,
)
from .output import ANSWERS_FLAGGED, RESET, STATUS, TICK, WAITING, Note, RunState
from .pairing import PairedSample, Pairs, Synchroniser
from .publisher_conflicts import PublisherConflict
from .timeline import AngleSample, LoadSample
from .topics import JOINT_STATES, NANOSECONDS, Ending, Record

LARGEST_ANGLE_SWING = 0.03
"""Difference [rad] above which two publishers of angles disagree"""
LARGEST_FORCE_SWING = 50.0
"""Difference [N] above which two publishers of forces disagree"""


OF_OTHERS = -1
"""Stamp of a message that concerns other joints only, or is used with a later one"""


def unused_words(parameters: Parameters | LoadParameters) -> dict[str, str]:
    """Words in refusals that name nothing in the user's messages, and what to say instead."""
    angles, forces = parameters.inputs()
    words = {}
    if angles.fields:
        words = {f" of joint {joint!r}": "" for joint in parameters.joints().values()}
    if forces.fields:
        names = ["force.x", "force.y", "force.z", "torque.x", "torque.y", "torque.z"]
        names = {1: ["force.y"], 2: ["force.y", "torque.z"]}.get(len(forces.fields), names)
        words |= dict(zip(names, map(written, forces.fields), strict=False))
    return words


class PairAnswer(Protocol):
    """Answer of a pipeline to a pair: what led to it, and what is published and recorded."""

    @property
    def pair(self) -> PairedSample:
        """Inputs of the tick."""

    def records(self) -> tuple[Record, ...]:
        """Messages to record: the angles up to the tick's stamp, the load, the answers."""


AnswerT = TypeVar("AnswerT", bound=PairAnswer)


class Pipeline(ABC, Generic[AnswerT]):
    """Base of all computations on two streams, of angles and of forces.

    What the `push` methods and `finish_streams` return must be iterated to its end before the next call of one of them.
    """

    def __init__(
        self, force_topic: str, parameters: Parameters | LoadParameters, frame: ForceFrame
    ) -> None:
        """Begin without samples."""
        self.force_topic = force_topic
        angles, forces = parameters.inputs()
        self.sources = {JOINT_STATES: angles.topic, force_topic: forces.topic}
        """Topics from which the inputs come, by their usual names, for the sentences about refused samples"""
        self.frame = frame
        self.synchroniser = Synchroniser(parameters.pairing)
        self.synchroniser.on_flags = self._note_flags
        self._joints = SpreadJoints(
            parameters.joints().values(), round(parameters.pairing.max_gap * NANOSECONDS)
        )
        self.ticks = 0
        """Number of answers"""
        self._unused_words = unused_words(parameters)
        self.angle_conflict = PublisherConflict(angles.topic, LARGEST_ANGLE_SWING, "rad")
        """Whether the angles come from publishers that disagree"""
        self.force_conflict = PublisherConflict(forces.topic, LARGEST_FORCE_SWING, "N")
        """Whether the forces come from publishers that disagree"""
        self.message_stamp: int | None = None
        """Stamp [ns] of the last message; None if its bytes are not a message, `OF_OTHERS` if it was not used"""
        self.notes: list[Note] = []
        """Notes to record before the next answer"""
        self.last_refusal = ""
        """Sentence about the last refused sample"""

    @abstractmethod
    def angle_sample(self, message: JointState, data: bytes) -> AngleSample:
        """Sample of a JointState that is recorded as `data`; raises RefusedSampleError."""

    @abstractmethod
    def load_sample(self, message: WrenchStamped, data: bytes, arrived: float) -> LoadSample:
        """Sample of a WrenchStamped in the wanted frame; see `push_force`; raises RefusedSampleError."""

    @abstractmethod
    def answer_pair(self, pair: PairedSample) -> AnswerT:
        """Compute the answer to a pair; to be called for every pair, in order."""

    def check_retune(self, parameters: Any) -> None:
        """Check that `retune` will accept these parameters; raises the reason if not, and changes nothing."""

    @abstractmethod
    def retune(self, parameters: Any) -> None:
        """Continue with changed numbers among the parameters, between two ticks."""

    def push_joint_state(self, data: bytes) -> Iterator[AnswerT]:
        """Push the bytes of a JointState; return the answers that it makes possible."""
        self.message_stamp = None
        try:
            message, recorded = JOINT_STATE.read_message(data, JOINT_STATES)
            self.message_stamp = message.stamp
            if not message.stamp:
                self._refuse_unset_stamp(JOINT_STATES)
            try:
                sample = self.angle_sample(message, recorded)
            except RefusedSampleError:
                if self._joints.are_in(message):
                    raise
                joined = self._join(message)
                if joined is None:
                    self.message_stamp = OF_OTHERS
                    return iter(())
                sample = self.angle_sample(joined, encode_joint_state(joined))
        except RefusedSampleError as refused:
            return self._refuse_sample(refused)
        self.angle_conflict.add_sample(sample.message_stamp, sample.angle)
        return self._answers(self.synchroniser.push_angle(sample))

    def _join(self, message: JointState) -> JointState | None:
        """Join a message without all joints with others; see `SpreadJoints.join`."""
        if self.synchroniser.angle_time.last is not None:
            self._joints.note_complete()
        return self._joints.join(message)

    def push_force(self, data: bytes, arrived: float = 0.0) -> Iterator[AnswerT]:
        """Push the bytes of a WrenchStamped that arrived at a time [s] by the caller's clock; return the answers."""
        self.message_stamp = None
        try:
            message, recorded = WRENCH.read_message(data, self.force_topic)
            self.message_stamp = message.stamp
            if not message.stamp:
                self._refuse_unset_stamp(self.force_topic)
            wrench, recorded = self.frame.turn_wrench(message, recorded)
            sample = self.load_sample(wrench, recorded, arrived)
        except RefusedSampleError as refused:
            return self._refuse_sample(refused)
        self.force_conflict.add_sample(message.stamp, sample.axial)
        if self.frame.is_held:
            return self._answers(self.synchroniser.push_load(sample))
        refused_before = self.refused
        pairs = self.synchroniser.push_load(sample)
        if self.refused == refused_before:
            self.frame.hold_frame(message.frame_id)  # all others are expected in it
        return self._answers(pairs)

    def push_messages(self, messages: Iterable[tuple[int, int, bytes]]) -> Iterator[AnswerT]:
        """Push messages in their order, and yield the answers.

        A message is its stream (0: angles, 1: forces), a time that is not used, and its bytes, as in blocks of a bag.
        """
        for stream, _, data in messages:
            yield from self.push_force(data) if stream else self.push_joint_state(data)

    def flush_expired(self, arrived_by: float) -> Iterator[AnswerT]:
        """Answer the forces that arrived until a time [s] and still wait for an angle."""
        return self._answers(self.synchroniser.flush_expired(arrived_by))

    def finish_streams(self) -> Iterator[AnswerT]:
        """Yield the answers to all waiting samples, because no more will come."""
        self.angle_conflict.check_samples()
        self.force_conflict.check_samples()
        return self._answers(self.synchroniser.finish_streams())

    def run_state(self) -> RunState | None:
        """Return what the next tick depends on, besides the samples that have not been answered yet, if it is known."""
        return None

    def reset(self) -> Note:
        """Restart from rest at the next tick, which is flagged (`TIME_RESET`), with forces in any frame.

        Returns the note to record; all samples that came are answered before (`finish_streams`).
        """
        self.synchroniser.clear_streams()
        self.frame.forget_frame()
        self.synchroniser.restart()
        return Note(RESET, {TICK: str(self.ticks), WAITING: str(self.synchroniser.unpaired)})

    @property
    def flags_note(self) -> Note:
        """Note of the bits that every later answer has, so that `solve` repeats them."""
        values = {TICK: str(self.ticks), STATUS: str(self.synchroniser.lasting)}
        return Note(ANSWERS_FLAGGED, values)

    def _note_flags(self) -> None:
        self.notes.append(self.flags_note)

    def ending(self) -> Ending:
        """End of a recording now: the angles that belong to no answer yet, and the counts of refused samples."""
        unpaired = self.synchroniser.all_unpaired
        inputs = tuple((JOINT_STATES, angle.message_stamp, angle.data) for angle in unpaired)
        return Ending(inputs, dict(self.synchroniser.refused))

    @property
    def refused(self) -> int:
        """Number of refused samples."""
        return self.synchroniser.refused.total()

    def _answers(self, pairs: Pairs) -> Iterator[AnswerT]:
        """Yield the answers to pairs."""
        for pair in pairs:
            answer = self.answer_pair(pair)
            self.ticks += 1
            yield answer

    def _refuse_unset_stamp(self, topic: str) -> None:
        """Refuse a sample with the stamp 0, unless it may be the first one of a recording that begins there.

        Raises:
            RefusedSampleError: the last sample of the topic also has that stamp.
        """
        time: Any = self.synchroniser.load_time
        first = 0
        if topic == JOINT_STATES:
            time = self.synchroniser.angle_time
            first = -self.synchroniser.angle_delay
        if time.last == first or any(sample.stamp == first for sample in time.held_back):
            raise RefusedSampleError("no_stamp", f"{topic}: header.stamp is not set (0)")

    def _refuse_sample(self, refused: RefusedSampleError) -> Iterator[AnswerT]:
        """Count a sample that cannot be used; it has no answers."""
        self.synchroniser.refused.count_refused(refused.reason)
        topic, *_ = re.split("[: ]", str(refused), maxsplit=1)
        text = str(refused).removeprefix(topic)
        for unused, used in self._unused_words.items():
            text = text.replace(unused, used)
        self.last_refusal = self.sources.get(topic, topic) + text
        return iter(())
