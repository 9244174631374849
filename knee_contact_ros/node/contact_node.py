"""The ROS 2 node `knee_contact`.

Subscribes to `joint_states` (sensor_msgs/JointState) and `joint_reaction_force` (geometry_msgs/WrenchStamped, what the
femur exerts on the tibia, tibia frame). Publishes `knee_contact` (knee_contact_ros/KneeContact) and
`knee_contact/wrench` (geometry_msgs/WrenchStamped), one each per force sample, `/diagnostics` once a second, and while
somebody looks `knee_contact/markers` (visualization_msgs/MarkerArray) and, once a stride, `knee_contact/stride`
(sensor_msgs/JointState).
Parameters: `parameters/schema.py`.
"""

import math
import os
import signal
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from importlib.util import find_spec
from typing import Any

import numpy as np
from geometry_msgs.msg import WrenchStamped
from rclpy.lifecycle import LifecycleNode
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from visualization_msgs.msg import MarkerArray

from ..bags.leg import DrawnLeg
from ..bags.provenance import provenance_record
from ..model.kernel import found_library
from ..model.ringing import damped, ringing_sentence
from ..model.types import FLAT, ROW, answer_struct
from ..msg import KneeContact
from ..parameters.curves import curve_texts
from ..parameters.schema import LATERAL_PREFIX, Parameters, has_two_compartments
from ..streams.contact_pipeline import ContactAnswer, ContactPipeline
from ..streams.output import RecordedKnee
from ..streams.topics import (
    KNEE_CONTACT,
    KNEE_CONTACT_MARKERS,
    KNEE_CONTACT_STRIDE,
    KNEE_CONTACT_WRENCH,
    TickOutput,
    knee_name,
    recorded_topics,
)
from ..system.errors import UsageError
from ..system.processes import OWN_PROCESS_GROUP, python_module, start_process
from ..view.anatomy import compartment_names, outlines_of_compartments
from ..view.output import server_address
from .diagnostics import Entry, Health
from .inputs import HandedInputs
from .marker_topic import (
    MARKER_DEPTH,
    MARKER_PERIOD,
    KneeMarkers,
    MarkerTopic,
)
from .parameters import NodeKind
from .problems import OK, warning_of
from .session import CHECK_PERIOD, OUTPUT_DEPTH, Session
from .stride_topic import STRIDE_PERIOD, StrideTopic

COUNTED = answer_struct("fidelity", "status")
"""Reader of the fields of an answer's rows that the health of the node depends on"""
_CHANGEABLE = frozenset(
    {
        "knee.flexion_offset",
        "orientations.standing",
        "load.offset",
        "load.share",
        "load.compartment_spacing",
        "femur.mass",
        "contact.stiffness",
        "contact.exponent",
        "contact.damping",
        "contact.layer_depth",
        "contact.stiffness_2",
        "contact.restitution",
        "contact.least_impact_speed",
        "fidelity.level",
        "fidelity.tolerance",
        "fidelity.force_tolerance",
        "fidelity.budget",
        "deadline",
        "record.path",
    }
)
CHANGEABLE_CONTACT_PARAMETERS = _CHANGEABLE | {
    LATERAL_PREFIX + name for name in _CHANGEABLE if name.startswith(("femur.", "contact."))
}
"""Parameters that may change while the node is configured: numbers of the model and of its inputs, and the
name of the next recording. They take effect between two ticks."""


class ContactHealth(Health):
    """Health of a contact node: also watches the load, its split and the depth."""

    def __init__(
        self, node: LifecycleNode, parameters: Parameters, pipeline: ContactPipeline
    ) -> None:
        """Begin to report."""
        super().__init__(node, parameters, pipeline)
        self.rows: list[bytes] = []
        """Rows of the answers that are not checked yet, those of one answer behind each other"""
        self.newest = np.zeros(0, ROW).view(FLAT)
        """Answers of the compartments at the last checked tick"""
        self._contacts = pipeline
        self.orientations: Any = None
        """`OrientationJoin` of the session, if it has one"""
        self.strides: StrideTopic
        """Strides of the session, which know how far the force rings"""

    def newest_words(self) -> list[str]:
        """Words about the contact force of each compartment at the newest tick."""
        self.check_answers()
        return [
            f"{compartment.topic}: {force:.0f} N"
            for compartment, force in zip(
                self._contacts.compartments, self.newest["contact_force"].tolist(), strict=False
            )
        ]

    def check_answers(self) -> None:
        """Look for implausible answers among those since the last call."""
        rows = np.frombuffer(b"".join(self.rows), ROW).view(FLAT)
        self.rows = []
        if not len(rows):
            return
        compartments = self._contacts.compartments
        self.newest = rows[-len(compartments) :]
        for number, compartment in enumerate(compartments):
            compartment.doubts.add_answers(rows[number :: len(compartments)])

    def load_entries(self) -> list[Entry]:
        """Entries for load (with split where that varies, and deviation), flexion and ringing; problems are logged."""
        pipeline = self._contacts
        doubts = pipeline.doubts
        inputs = doubts.inputs
        about_angle = inputs.about_angle
        about_load = "; ".join(each for each in doubts.about_inputs if each != about_angle)
        if self.orientations and not about_angle:
            about_angle = self.orientations.knee.doubt
        load: dict[str, str] = {}
        flexion: dict[str, str] = {}
        if doubts.ticks:
            load = {"from [N]": f"{inputs.min_load:.1f}", "to [N]": f"{inputs.max_load:.1f}"}
            flexion = {
                "from [deg]": f"{math.degrees(inputs.min_angle):.1f}",
                "to [deg]": f"{math.degrees(inputs.max_angle):.1f}",
            }
        if pipeline.varies:
            split = pipeline.split
            load["share of the axial load"] = split.text
            load["above 1"] = str(split.above)
            load["below 0"] = str(split.below)
            about_load = about_load or split.problem
        parameters = pipeline.parameters
        deviation = parameters.diagnostics.load_deviation * parameters.body_weight
        if deviation and doubts.ticks:
            for compartment in pipeline.compartments:
                (found,) = compartment.model.uncertainty(compartment.row, deviation)
                topic = compartment.topic
                load[f"{topic}: force +- [N]"] = f"{found['contact_force']:.1f}"
                load[f"{topic}: depth +- [mm]"] = f"{1e3 * found['penetration_depth']:.4f}"
        self.warn("load", about_load)
        self.warn("flexion", about_angle)
        rings = self.strides.ringing
        return [
            ("load", load, warning_of(about_load)),
            ("flexion", flexion, warning_of(about_angle)),
            *([("ringing", {}, (OK, rings))] if rings else []),
        ]

    def doubts(self) -> list[str]:
        """Sentences about the compartments whose depth or gap was implausible since the last report."""
        sentences: list[str] = []
        for compartment in self._contacts.compartments:
            if self.increase(f"{compartment.topic} implausible", compartment.doubts.implausible):
                sentences += compartment.doubts.about_answers
        return sentences


class ContactSession(Session):
    """Configured life of a contact node."""

    pipeline: ContactPipeline
    health: ContactHealth
    parameters: Parameters

    def __init__(
        self,
        node: LifecycleNode,
        parameters: Parameters,
        handed: HandedInputs | None = None,
    ) -> None:
        """Build the model and open the outputs.

        Args:
            node: The node.
            parameters: Parameters of the node.
            handed: Source of the inputs if another node in this process hands them over.

        Raises:
            UsageError: a profile cannot be used or an output file cannot be written.
        """
        self._curves = curve_texts(parameters, {})
        pipeline = ContactPipeline(parameters, compiled=False, curves=self._curves)
        health = ContactHealth(node, parameters, pipeline)
        super().__init__(node, parameters, pipeline, health)
        self.inputs = self._input_streams(handed)
        health.orientations = self.orientations
        for doubt in pipeline.doubts_about_parameters:
            node.get_logger().warning(doubt)
        if damped(pipeline.compartments[0].model):
            node.get_logger().info(ringing_sentence())
        topics = recorded_topics(has_two_compartments(parameters))
        self._names = {topic: node.resolve_topic_name(topic) for topic in topics}
        contacts = [compartment.topic for compartment in pipeline.compartments]
        self._advertise(
            {
                **dict.fromkeys(contacts, (KneeContact, OUTPUT_DEPTH)),
                KNEE_CONTACT_WRENCH: (WrenchStamped, OUTPUT_DEPTH),
                KNEE_CONTACT_STRIDE: (JointState, OUTPUT_DEPTH),
                KNEE_CONTACT_MARKERS: (MarkerArray, MARKER_DEPTH),
            }
        )
        # Bytes go straight to rclpy's own publisher: ticks come only while the node is active, which is all that a
        # lifecycle publisher would check.
        self._publish_contact = [self._publishers[topic].handle.publish_raw for topic in contacts]
        self._publish_wrench = self._publishers[KNEE_CONTACT_WRENCH].handle.publish_raw
        self._leg = DrawnLeg()
        models = [compartment.model for compartment in pipeline.compartments]
        knees = compartment_names(knee_name(self._names[KNEE_CONTACT]), models)
        markers = KneeMarkers(outlines_of_compartments(models, knees, parameters.body_weight))
        self._markers = MarkerTopic(self._publishers[KNEE_CONTACT_MARKERS], markers)
        self._strides = StrideTopic(
            self._publishers[KNEE_CONTACT_STRIDE],
            parameters.body_weight,
            lambda: [compartment.model for compartment in pipeline.compartments],
        )
        health.strides = self._strides
        self._calls += [
            (MARKER_PERIOD, self._markers.publish_markers),
            (STRIDE_PERIOD, self._strides.publish_strides),
            (CHECK_PERIOD, health.check_answers),
        ]
        self._open_outputs()
        rerun = parameters.rerun
        if rerun.path and rerun.mode != "file":
            node.get_logger().warning(
                f"rerun.path {rerun.path!r} is not written: rerun.mode is {rerun.mode}, not file"
            )
        if rerun.mode in ("serve", "spawn"):
            url = server_address(rerun.port)
            node.get_logger().info(
                f"the scene is served on this machine at {url}; to see it: knee-contact view {url}"
            )

    def prepare(self, interrupting: Callable[[], AbstractContextManager[None]]) -> None:
        """Wait until the outputs are open, and load the library of the model; without it the plain one computes.

        A library that is missing is built in its own process, which can simply be killed: a signal while LLVM works
        would leave its objects half made, and crash at the end. A signal while that process starts waits until the
        process is known; otherwise it would go on.
        """
        super().prepare(interrupting)
        if find_spec("numba") and not found_library():
            self.node.get_logger().info("building the model, once, which takes about 8 s")
            process = start_process(
                output=None,
                **OWN_PROCESS_GROUP,
                **python_module("knee_contact_ros.model.kernel"),
            )
            try:
                with interrupting():
                    process.wait()
            finally:
                with suppress(ProcessLookupError):  # it has ended
                    os.killpg(process.pid, signal.SIGKILL)  # with the process that translates
                process.wait()
        with interrupting():
            self.pipeline.compile_model()

    def stop_listening(self) -> None:
        """Close the inputs, answer waiting samples, stop showing markers, and log how far the force rang."""
        was_listening = self._timer
        super().stop_listening()
        self._markers.newest = None
        if was_listening:
            self._strides.publish_strides()
            if self._strides.ringing:
                self.node.get_logger().info(self._strides.ringing)

    def retune(self, parameters: Parameters, changes: dict[str, Any]) -> None:
        """Continue with changed parameters, and warn of those that are implausible; see `Session.retune`."""
        self.health.check_answers()  # by the limits that held for these answers
        known = self.pipeline.doubts_about_parameters
        super().retune(parameters, changes)
        if self.orientations and "orientations.standing" in changes:
            self.orientations.retune(parameters)
        for doubt in self.pipeline.doubts_about_parameters:
            if doubt not in known:
                self.node.get_logger().warning(doubt)

    def _services_by_name(self) -> dict[str, Callable[[], str]]:
        return {**super()._services_by_name(), "tare": self._tare, "zero": self._zero}

    def _tare(self) -> str:
        """Set the parameter load.offset so that the last second's mean load is 0."""
        forces = self.inputs[1].meter
        silent = time.monotonic() - forces.last > self.parameters.diagnostics.timeout
        if silent or not forces.received:
            raise UsageError("no force comes")
        offset = self.pipeline.measured_offset()
        return self._set("load.offset", offset, f"load.offset is {offset:.3f} N now")

    def _zero(self) -> str:
        """Set the parameter orientations.standing to the mean pose of the last second."""
        if not self.orientations:
            raise UsageError("orientations.thigh is not set: ~/zero is for two inertial sensors")
        pose = self.orientations.measured_standing()
        return self._set("orientations.standing", pose, f"orientations.standing is {pose!r} now")

    def _set(self, name: str, value: float | str, text: str) -> str:
        """Set a parameter, log what it is now, and return this text."""
        (result,) = self.node.set_parameters([Parameter(name, value=value)])
        if not result.successful:
            raise UsageError(result.reason)
        self.node.get_logger().info(text)
        return text

    def _recorded_knee(self, parameters: Parameters) -> RecordedKnee:
        ticks = self.pipeline.ticks
        state = self.pipeline.run_state()
        provenance = provenance_record(
            self.parameters, self._curves, ticks_before=ticks, state=state
        )
        models = {each.topic: each.model for each in self.pipeline.compartments}
        return RecordedKnee(parameters, models, self._names, provenance)

    def _publish(self, answer: ContactAnswer, begin: float) -> None:
        for publish, message in zip(self._publish_contact, answer.messages, strict=True):
            publish(message)
        end = time.perf_counter()
        self._publish_wrench(answer.wrench)
        latency = end - answer.pair.load.arrived
        rows = answer.rows_with_latency(latency)
        self.outputs.put_item(TickOutput.of(rows, self._leg.records_with_leg(answer)))
        self._markers.newest = answer
        self._strides.add_answer(answer)
        self.health.rows.append(rows)
        status = 0
        for level, bits in COUNTED.iter_unpack(rows):  # noqa: B007  (that of the last one counts)
            status |= bits
        deadline = self.parameters.deadline
        self.health.counts.count_answer(level, status, end - begin, latency, deadline)


CONTACT_NODE = NodeKind(Parameters, CHANGEABLE_CONTACT_PARAMETERS, ContactSession)
