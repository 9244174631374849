"""The way of the data without ROS: messages in, answers out. The node and `solve` both feed it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

from knee_contact_ros.build import load_model
from knee_contact_ros.core.types import Contact, Status
from knee_contact_ros.parameters import Parameters
from knee_contact_ros.stream_in.samples import RefusedSampleError, angle_sample, load_sample
from knee_contact_ros.synchronise import PairedSample, Synchroniser
from knee_contact_ros.topics import JOINT_REACTION_FORCE, JOINT_STATES


class Answer(NamedTuple):
    """One tick, with the messages that led to it."""

    stamp: int
    """[ns]"""
    frame_id: str
    """The tibia frame"""
    contact: Contact
    femoral_x: float
    """[m] of the femoral reference point along the tibia's x axis"""
    normal: tuple[float, float]
    """Of the tibial surface at the contact point, from tibia to femur (x, y)"""
    inputs: tuple[tuple[str, int, Any], ...]
    """(topic, stamp [ns], message): the angles up to this stamp, then the load"""


class Ending(NamedTuple):
    """What is left to say when a stream ends."""

    inputs: tuple[tuple[str, int, Any], ...]
    """(topic, stamp [ns], message) that belong to no answer"""
    refused: dict[str, int]
    """Refused samples by reason"""


class Pipeline:
    """Samples, pairing and model in one line."""

    def __init__(self, parameters: Parameters, *, compiled: bool) -> None:
        """Build the model; see `load_model` for `compiled`."""
        self.parameters = parameters
        self.model = load_model(parameters, compiled=compiled)
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

    def joint_state(self, message: Any) -> Iterator[Answer]:
        """Take a JointState; give the answers that it makes possible."""
        try:
            sample = angle_sample(message, self.parameters.knee, self.model.height_prescribed)
        except RefusedSampleError as refused:
            return self._refuse(refused)
        return self._answers(self.synchroniser.push_angle(sample))

    def joint_reaction_force(self, message: Any) -> Iterator[Answer]:
        """Take a WrenchStamped on the tibia; give the answers that it makes possible."""
        try:
            sample = load_sample(message, self.parameters.load)
        except RefusedSampleError as refused:
            return self._refuse(refused)
        return self._answers(self.synchroniser.push_load(sample))

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
        contact = self.stream.tick_ns(pair.load.stamp, pair.angle, pair.load.load, pair.height)
        self.ticks += 1
        femoral_x, normal_x, normal_y = self.stream.placing
        inputs = [(JOINT_STATES, angle.stamp, angle.message) for angle in pair.angles]
        inputs.append((JOINT_REACTION_FORCE, pair.load.stamp, pair.load.message))
        return Answer(
            stamp=pair.load.stamp,
            frame_id=pair.load.frame_id,
            contact=contact._replace(status=contact.status | pair.status),
            femoral_x=femoral_x,
            normal=(normal_x, normal_y),
            inputs=tuple(inputs),
        )
