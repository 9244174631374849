"""One configured life of the node: pipeline, outputs, and the streams between them."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Collection, Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from rclpy.lifecycle import LifecycleNode
from rclpy.qos import QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from knee_contact_ros.bags.provenance import PARAMETERS_CHANGED, RESET, TICK, change_record, provenance_record
from knee_contact_ros.core.types import ROW, reader
from knee_contact_ros.messages.answer import Ending
from knee_contact_ros.messages.dynamic_joint_states import as_joint_state
from knee_contact_ros.messages.topics import (
    DYNAMIC_JOINT_STATES,
    JOINT_REACTION_FORCE,
    JOINT_STATES,
    KNEE_CONTACT,
    KNEE_CONTACT_MARKERS,
    KNEE_CONTACT_WRENCH,
    knee_name,
    recorded_topics,
)
from knee_contact_ros.msg import KneeContact
from knee_contact_ros.node.diagnostics import (
    InputMeter,
    LagMeter,
)
from knee_contact_ros.node.health import REFUSAL_LOG_PERIOD, STEADY, Health, at_most_every
from knee_contact_ros.node.markers import MARKER_DEPTH, MARKER_PERIOD, MarkerTopic
from knee_contact_ros.node.outputs import Outputs
from knee_contact_ros.node.subscription import InputStream
from knee_contact_ros.node.transforms import StaticTransformTopic
from knee_contact_ros.parameters.curves import curve_texts
from knee_contact_ros.parameters.lateral import has_both
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.pipeline.frames import FORCE_TURNED
from knee_contact_ros.pipeline.pipeline import Pipeline
from knee_contact_ros.pipeline.synchronise import PairedSample
from knee_contact_ros.sinks.process import Listeners
from knee_contact_ros.sinks.protocol import Knee
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.output_files import stamped
from knee_contact_ros.view.markers import KneeMarkers
from knee_contact_ros.view.outlines import drawings_of
from knee_contact_ros.view.window import address

OUTPUT_DEPTH = 100
"""Messages that a publisher keeps for subscribers that are slow"""
DIAGNOSTICS_PERIOD = 1.0


COUNTED = reader("load", "penetration_depth", "fidelity", "status")
"""Of an answer's row"""
ROS_TYPES = {JOINT_STATES: JointState, JOINT_REACTION_FORCE: WrenchStamped}


def type_of_angles(source: str) -> Any:
    """The type of the topic that the angles come from.

    Raises:
        UsageError: it is not installed.
    """
    if source == JOINT_STATES:
        return JointState
    try:
        from control_msgs.msg import DynamicJointState
    except ImportError:
        raise UsageError(
            f"parameter knee.source: {source!r} needs the ROS 2 package control_msgs, which is not installed"
        ) from None
    return DynamicJointState


def deserialize(data: bytes, topic: str) -> Any:
    """An input message the ordinary way."""
    return deserialize_message(data, ROS_TYPES[topic])


class Session:
    """Made by configure, started by activate, stopped by deactivate, closed by cleanup."""

    def __init__(self, node: LifecycleNode, parameters: Parameters, qos_given: Collection[str]) -> None:
        """Build the model and open the outputs. `qos_given` names the QoS overrides that the user has given.

        Raises:
            UsageError: a profile cannot be used or an output file cannot be written.
        """
        self.node = node
        self.parameters = parameters
        self._curves = curve_texts(parameters, {})
        self.pipeline = Pipeline(parameters, deserialize, compiled=False, curves=self._curves)
        self.angles, self.forces = self._input_streams(parameters, qos_given)
        self.inputs = (self.angles, self.forces)
        self.health = Health(node, parameters, self.pipeline)
        for doubt in self.pipeline.doubts_about_parameters:
            node.get_logger().warning(doubt)
        topics = recorded_topics(has_both(parameters))
        names = {topic: node.resolve_topic_name(topic) for topic in topics}
        self._names = names
        models = [each.model for each in self.pipeline.compartments]
        shown = KneeMarkers(drawings_of(models, knee_name(names[KNEE_CONTACT]), parameters.body_weight))
        tell = Listeners(node.get_logger().error, node.get_logger().warning)
        by_user = QoSOverridingOptions.with_default_policies()
        offered = {
            KNEE_CONTACT: (KneeContact, OUTPUT_DEPTH),
            KNEE_CONTACT_WRENCH: (WrenchStamped, OUTPUT_DEPTH),
            "/diagnostics": (DiagnosticArray, OUTPUT_DEPTH),
            KNEE_CONTACT_MARKERS: (MarkerArray, MARKER_DEPTH),
            **{each.topic: (KneeContact, OUTPUT_DEPTH) for each in self.pipeline.compartments[1:]},
        }
        try:
            self._publishers = [  # each with a profile of its own: overrides change it
                node.create_lifecycle_publisher(
                    message_type, topic, QoSProfile(depth=depth), qos_overriding_options=by_user
                )
                for topic, (message_type, depth) in offered.items()
            ]
        except Exception as error:  # one that the middleware does not know, say: rclpy has many ways to say so
            raise UsageError(f"a topic cannot be offered: {' '.join(str(error).split())}") from None
        contact, self._wrench, self._diagnostics, markers, *lateral = self._publishers
        self._contacts = (contact, *lateral)
        self._markers = MarkerTopic(markers, shown)
        self._transforms = StaticTransformTopic(node, self.pipeline.frame)
        self._services: list[Any] = []
        acts = {"reset": self._reset, "start_recording": self._start_recording, "stop_recording": self._stop_recording}
        try:  # a file is opened when all else is well
            for name, act in acts.items():
                self._services.append(self._service(name, act))
            self.outputs = Outputs(self._knee(), tell)
        except BaseException:
            self.destroy_endpoints()
            raise
        if parameters.rerun.mode in ("serve", "spawn"):
            url = address(parameters.rerun.port)
            node.get_logger().info(f"the scene is served on this machine at {url}; to see it: knee-contact view {url}")
        self._timers: list[Any] = []

    def _input_streams(self, parameters: Parameters, qos_given: Collection[str]) -> tuple[InputStream, InputStream]:
        """The streams of angles and of forces."""
        asked, max_gap = parameters.diagnostics, parameters.pairing.max_gap
        source, on_angle = parameters.knee.source, self._on_joint_state
        if source == DYNAMIC_JOINT_STATES:
            on_angle = self._on_dynamic_joint_state
        meters = (
            InputMeter(asked.angle_warn_rate, asked.angle_error_rate, max_gap, asked.timeout),
            InputMeter(asked.force_warn_rate, asked.force_error_rate, max_gap, asked.timeout),
        )
        return (
            InputStream(self.node, type_of_angles(source), source, on_angle, qos_given, meters[0]),
            InputStream(self.node, WrenchStamped, JOINT_REACTION_FORCE, self._on_force, qos_given, meters[1]),
        )

    def start(self) -> None:
        """Listen."""
        # What is there now stays; what ticks leave behind is freed by reference counting, or once a second.
        gc.collect()
        gc.freeze()
        gc.disable()
        if self.pipeline.ticks:  # it was active before, and time may have gone anywhere since
            self._reset()
        for stream in self.inputs:
            stream.meter.begin()
            stream.open()
        self.health.lag = LagMeter(max(0.25 * self.parameters.pairing.wait, 0.01))
        self._timers = [
            self.node.create_timer(self.health.lag.period, self._on_wait_timer, clock=STEADY),
            self.node.create_timer(DIAGNOSTICS_PERIOD, self._on_diagnostics_timer, clock=STEADY),
            self.node.create_timer(MARKER_PERIOD, self._markers.publish, clock=STEADY),
        ]

    def stop(self) -> None:
        """Listen no more; answer what still waits."""
        if self._timers:
            self._answer_all()
            self.pipeline.synchroniser.forget_angles()
            self.pipeline.frame.forget()
            self._markers.newest = None
        gc.enable()
        gc.unfreeze()
        for stream in self.inputs:
            stream.close()
        for timer in self._timers:
            self.node.destroy_timer(timer)
        self._timers = []

    def retune(self, parameters: Parameters, changes: dict[str, Any]) -> None:
        """Go on with parameters of which some have changed."""
        self.parameters = self.health.parameters = parameters
        known = self.pipeline.doubts_about_parameters
        self.pipeline.retune(parameters)
        for doubt in self.pipeline.doubts_about_parameters:
            if doubt not in known:
                self.node.get_logger().warning(doubt)
        self.outputs.note(PARAMETERS_CHANGED, change_record(self.pipeline.ticks, changes))

    def close(self) -> bool:
        """Complete the files; whether none had to be given up."""
        return self.outputs.close(self.pipeline.ending())

    def destroy_endpoints(self) -> None:
        """Offer topics and services no more."""
        for service in self._services:
            self.node.destroy_service(service)
        self._destroy_publishers()
        self._transforms.close()

    def _destroy_publishers(self) -> None:
        for publisher in self._publishers:
            self.node.destroy_lifecycle_publisher(publisher)

    def _on_joint_state(self, data: bytes) -> None:
        self._answer(self.pipeline.take_joint_state(data))

    def _on_dynamic_joint_state(self, data: bytes) -> None:
        self._on_joint_state(as_joint_state(data))

    def _on_force(self, data: bytes) -> None:
        pairs = self.pipeline.take_force(data, time.perf_counter())
        if self.pipeline.frame.turn_note:
            note = self.pipeline.frame.told()
            text = f"forces are turned from {note['from']} to {note['to']}"
            self.node.get_logger().info(text, **at_most_every(REFUSAL_LOG_PERIOD))
            self.outputs.note(FORCE_TURNED, note)
        self._answer(pairs)

    def _service(self, name: str, act: Callable[[], str]) -> Any:
        """A service that does something and says what, or why not."""

        def answer(_request: Any, response: Any) -> Any:
            try:
                response.success, response.message = True, act()
            except UsageError as error:
                response.success, response.message = False, str(error)
            except Exception as error:  # whatever it is, the caller shall know, and the node go on
                response.success, response.message = False, f"{type(error).__name__}: {error}"
                self.node.get_logger().error(f"~/{name}: {response.message}")
            return response

        return self.node.create_service(Trigger, f"~/{name}", answer)

    def _answer_all(self) -> None:
        """Answer what waits or was kept aside, and hold nothing of the streams any more."""
        self._answer(self.pipeline.synchroniser.finish())
        self.pipeline.synchroniser.forget()

    def _reset(self) -> str:
        self._answer_all()
        self.pipeline.reset()
        self.outputs.note(RESET, {TICK: str(self.pipeline.ticks)})
        return "the next tick starts from rest"

    def _start_recording(self) -> str:
        return f"recording to {self.outputs.start_recording(self._knee())}"

    def _knee(self) -> Knee:
        """What outputs that begin now are described from."""
        provenance = provenance_record(self.parameters, self._curves, ticks_before=self.pipeline.ticks)
        record, rerun = (
            section.model_copy(update={"path": stamped(section.path)})
            for section in (self.parameters.record, self.parameters.rerun)
        )
        parameters = self.parameters.model_copy(update={"record": record, "rerun": rerun})
        models = {each.topic: each.model for each in self.pipeline.compartments}
        return Knee(parameters, models, self._names, provenance)

    def _stop_recording(self) -> str:
        path = self.outputs.stop_recording(Ending((), dict(self.pipeline.synchroniser.refused)))
        return f"{path} will be complete in a moment"

    def _on_wait_timer(self) -> None:
        """Answer loads whose angle is late; listen to publishers that could not be heard."""
        self.health.lag.count()
        arrived_by = time.perf_counter() - self.parameters.pairing.wait
        self._answer(self.pipeline.synchroniser.give_up(arrived_by))
        for stream in self.inputs:
            stream.adapt()

    def _answer(self, pairs: Sequence[PairedSample]) -> None:
        """Compute and publish one after the other; what is not needed for that comes after the publishing."""
        clock, pipeline = time.perf_counter, self.pipeline
        for pair in pairs:
            begin = clock()
            messages = pipeline.compute(pair)
            for publisher, message in zip(self._contacts, messages, strict=True):
                publisher.publish(message)
            end = clock()
            latency = end - pair.load.arrived
            answer = pipeline.answer(pair, messages, latency)
            _, _, wrench = answer.records[-1]
            self._wrench.publish(wrench)
            self.outputs.put(answer)
            self._markers.newest = (pair.load, answer.row)
            told, begin_of_row = 0, 0
            for compartment in pipeline.compartments:
                load, depth, fidelity, status = COUNTED.unpack_from(answer.row, begin_of_row)
                compartment.doubts.add(pair.load.stamp, load, depth, status)
                told, begin_of_row = told | status, begin_of_row + ROW.itemsize
            self.health.count(fidelity, told, end - begin, latency)
        if pipeline.last_refusal:
            text = f"sample refused: {pipeline.last_refusal}"
            self.node.get_logger().warning(text, **at_most_every(REFUSAL_LOG_PERIOD))
            pipeline.last_refusal = ""

    def _on_diagnostics_timer(self) -> None:
        """Report, and free what reference counting does not."""
        self._diagnostics.publish(self.health.report(self.inputs, self.outputs))
        gc.collect(0)
