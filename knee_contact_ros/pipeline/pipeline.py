"""The way of the data without ROS: bytes of messages in, answers out. The node and `solve` both feed it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from knee_contact_ros.core.model import KneeModel
from knee_contact_ros.messages.answer import Answer, Record
from knee_contact_ros.messages.answer_out import encode_answer, encode_answer_wrench
from knee_contact_ros.messages.cdr import JointState, WrenchStamped
from knee_contact_ros.messages.ros_types import deserialize
from knee_contact_ros.messages.topics import JOINT_REACTION_FORCE, JOINT_STATES, KNEE_CONTACT_WRENCH
from knee_contact_ros.parameters.compartments import BY_MOMENT, COMPARTMENTS, VARYING, Rule, Split
from knee_contact_ros.parameters.curves import curve_texts
from knee_contact_ros.parameters.lateral import lateral_knee
from knee_contact_ros.parameters.measured_share import MeasuredShare
from knee_contact_ros.parameters.plausibility import Doubts
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.pipeline.compartment import aside, compartments_of, summed_wrench
from knee_contact_ros.pipeline.frames import ForceFrame
from knee_contact_ros.pipeline.intake import Intake
from knee_contact_ros.pipeline.samples import AngleSample, Deserialize, LoadSample, angle_sample, load_sample
from knee_contact_ros.pipeline.synchronise import TIME_RESET, PairedSample


class Pipeline(Intake):
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
        frame = ForceFrame(parameters.frame.tibia, JOINT_REACTION_FORCE)
        super().__init__(JOINT_REACTION_FORCE, parameters.pairing, frame, deserialize)
        self.parameters = parameters
        self._texts = curve_texts(parameters, {}) if curves is None else curves
        self.compartments = compartments_of(parameters, self._texts)
        """The only one, or medial and lateral"""
        self.split = Split(parameters.body_weight)
        """What the compartment gets, where its share varies"""
        self._divide(parameters)
        if compiled:
            self.compile()

    def compile(self, kernel: Callable[[KneeModel], KneeModel] | None = None) -> None:
        """Go on with the compiled kernel, or as `kernel` has it; before the first sample."""
        from knee_contact_ros.compiled.kernel import compiled  # LLVM

        for compartment in self.compartments:
            compartment.compile(kernel or compiled)

    @property
    def model(self) -> KneeModel:
        """Of the medial compartment, or the only one."""
        return self.compartments[0].model

    @property
    def doubts(self) -> Doubts:
        """What makes no sense there: in the parameters, and in the answers that are told to it."""
        return self.compartments[0].doubts

    @property
    def doubts_about_parameters(self) -> list[str]:
        """What makes no sense in the parameters, of either compartment."""
        return list(dict.fromkeys(told for each in self.compartments for told in each.doubts.about_parameters))

    def angle_sample(self, message: JointState, data: bytes) -> AngleSample:
        """The flexion angle, and with the displacement drive the femoral height; see `samples.angle_sample`."""
        knee, delay = self.parameters.knee, self.synchroniser.angle_delay
        return angle_sample(message, knee, self.model.height_prescribed, data, delay)

    def force_sample(self, message: WrenchStamped, data: bytes, arrived: float) -> LoadSample:
        """The joint reaction on the tibia; see `samples.load_sample`."""
        return load_sample(message, self.by_moment, arrived, data)

    def compute(self, pair: PairedSample) -> list[bytes]:
        """Compute a tick; give the answer of each compartment as the bytes of a `KneeContact`."""
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
        """All that the tick computed last leaves behind: rows and their `messages`, and what led to them.

        `latency` [s] is that of its publication, where it is measured.
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
        """Go on with other numbers, between two ticks; see `retuned` for those that count."""
        self.parameters = parameters
        self._divide(parameters)
        medial, *lateral = self.compartments
        medial.retune(parameters, -aside(parameters))
        for compartment in lateral:
            compartment.retune(lateral_knee(parameters), aside(parameters))

    def _divide(self, parameters: Parameters) -> None:
        """Have the compartment's load follow from the joint reaction as parameters say."""
        name = parameters.load.rule
        self.rule = COMPARTMENTS[name](parameters, self._texts)
        self.by_moment: Rule | None = self.rule if name in BY_MOMENT else None
        self.varies = name in VARYING
        self.beyond = self.rule.beyond if isinstance(self.rule, MeasuredShare) else None
