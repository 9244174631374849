"""Pipeline of the contact node without ROS: from the bytes of messages to answers. The node and `solve` use it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from knee_contact_ros.messages.answer import Answer, Record
from knee_contact_ros.messages.answer_out import encode_answer, encode_answer_wrench
from knee_contact_ros.messages.cdr import JointState, WrenchStamped
from knee_contact_ros.messages.ros_types import deserialize
from knee_contact_ros.messages.topics import JOINT_REACTION_FORCE, JOINT_STATES, KNEE_CONTACT_WRENCH
from knee_contact_ros.model.knee import KneeModel
from knee_contact_ros.parameters.compartments import BY_MOMENT, COMPARTMENTS, VARYING, Rule, Split
from knee_contact_ros.parameters.curves import curve_texts
from knee_contact_ros.parameters.lateral import lateral_knee
from knee_contact_ros.parameters.measured_share import MeasuredShare
from knee_contact_ros.parameters.plausibility import Doubts
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.pipeline.compartment import compartments_of, half_spacing, summed_wrench
from knee_contact_ros.pipeline.frames import ForceFrame
from knee_contact_ros.pipeline.intake import Intake
from knee_contact_ros.pipeline.samples import AngleSample, Deserialize, LoadSample, angle_sample, load_sample
from knee_contact_ros.pipeline.synchronise import TIME_RESET, PairedSample


class Pipeline(Intake):
    """Pipeline of the contact node: samples, pairing and model."""

    def __init__(
        self,
        parameters: Parameters,
        deserialize: Deserialize = deserialize,
        *,
        compiled: bool,
        curves: Mapping[str, str] | None = None,
    ) -> None:
        """Build the model; see `build_model` for `curves`, and `Decoder` for `deserialize`."""
        frame = ForceFrame(parameters.frame.tibia, JOINT_REACTION_FORCE)
        super().__init__(JOINT_REACTION_FORCE, parameters.pairing, frame, deserialize)
        self.parameters = parameters
        self._texts = curve_texts(parameters, {}) if curves is None else curves
        self.compartments = compartments_of(parameters, self._texts)
        """The only compartment, or medial and lateral"""
        self.split = Split(parameters.body_weight)
        """Statistics of the medial share, where it varies"""
        self._divide(parameters)
        if compiled:
            self.compile()

    def compile(self) -> None:
        """Use the compiled model, if there can be one; to be called before the first sample."""
        for compartment in self.compartments:
            compartment.compile()

    @property
    def model(self) -> KneeModel:
        """Model of the medial compartment, or the only one."""
        return self.compartments[0].model

    @property
    def doubts(self) -> Doubts:
        """Implausible parameters and answers of the medial compartment, or the only one."""
        return self.compartments[0].doubts

    @property
    def doubts_about_parameters(self) -> list[str]:
        """Sentences about implausible parameters of either compartment, each once."""
        return list(dict.fromkeys(doubt for part in self.compartments for doubt in part.doubts.about_parameters))

    def angle_sample(self, message: JointState, data: bytes) -> AngleSample:
        """Flexion angle, and femoral height with the displacement drive; see `samples.angle_sample`."""
        knee, delay = self.parameters.knee, self.synchroniser.angle_delay
        return angle_sample(message, knee, self.model.height_prescribed, data, delay)

    def force_sample(self, message: WrenchStamped, data: bytes, arrived: float) -> LoadSample:
        """Joint reaction on the tibia; see `samples.load_sample`."""
        return load_sample(message, self.by_moment, arrived, data)

    def compute(self, pair: PairedSample) -> list[bytes]:
        """Compute a tick; return the answer of each compartment as the bytes of a `KneeContact`."""
        load = pair.load
        medial = self.rule(load.axial, load.moment, pair.angle)
        messages = []
        for compartment, part in zip(self.compartments, (medial, load.axial - medial), strict=False):
            if pair.status & TIME_RESET:
                compartment.start_anew()
            compartment.advance(load.stamp, pair.angle, part, pair.height, pair.status)
            messages.append(encode_answer(load.stamp, load.frame_id, compartment.row.tobytes()))
        self.ticks += 1
        if self.varies:
            self.split.add(load.axial, medial, self.beyond is not None and self.beyond(load.axial, pair.angle))
        return messages

    def answer(self, pair: PairedSample, messages: Sequence[bytes], latency: float = 0.0) -> Answer:
        """Answer of the tick that was computed last: rows, their `messages`, and the inputs that led to them.

        `latency` [s] is the time from the arrival of the force to the publication, where it is measured.
        """
        load, rows = pair.load, []
        records: list[Record] = [(JOINT_STATES, angle.came_at, angle.data) for angle in pair.angles]
        records.append((JOINT_REACTION_FORCE, load.stamp, load.data))
        for compartment, message in zip(self.compartments, messages, strict=True):
            compartment.stream.latency[0] = latency
            rows.append(compartment.row.tobytes())
            records.append((compartment.topic, load.stamp, message))
        wrench = encode_answer_wrench(load.stamp, load.frame_id, summed_wrench(rows))
        records.append((KNEE_CONTACT_WRENCH, load.stamp, wrench))
        size = 0
        for _, _, data in records:
            size += len(data)
        return Answer(b"".join(rows), tuple(records), size)

    def retune(self, parameters: Parameters) -> None:
        """Continue with other numbers among the parameters, between two ticks; `retuned` says which are used."""
        self.parameters = parameters
        self._divide(parameters)
        medial, *lateral = self.compartments
        medial.retune(parameters, -half_spacing(parameters))
        for compartment in lateral:
            compartment.retune(lateral_knee(parameters), half_spacing(parameters))

    def _divide(self, parameters: Parameters) -> None:
        """Set up the rule by which the medial load follows from the joint reaction."""
        name = parameters.load.rule
        self.rule = COMPARTMENTS[name](parameters, self._texts)
        self.by_moment: Rule | None = self.rule if name in BY_MOMENT else None
        self.varies = name in VARYING
        self.beyond = self.rule.beyond if isinstance(self.rule, MeasuredShare) else None
