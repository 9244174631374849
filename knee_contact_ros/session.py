"""One configured life of the node: pipeline, outputs, and the streams between them."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Protocol

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNode
from rclpy.qos import QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from knee_contact_ros.diagnostics import InputMeter, TickMeter, diagnostic_array, diagnostic_status
from knee_contact_ros.msg import KneeContact
from knee_contact_ros.parameters import NODE_NAME, Parameters
from knee_contact_ros.pipeline import Answer, Ending, Pipeline
from knee_contact_ros.record import BagWriter
from knee_contact_ros.record_answers import AnswerWriter, RecorderThread
from knee_contact_ros.topics import INPUTS, JOINT_REACTION_FORCE, JOINT_STATES, KNEE_CONTACT, KNEE_CONTACT_WRENCH

INPUT_QOS = QoSProfile(depth=1000)
OUTPUT_QOS = QoSProfile(depth=100)
DIAGNOSTICS_PERIOD = 1.0
REFUSAL_LOG_PERIOD = 5.0
SILENCE = 5.0
"""How long [s] an input may be silent after the start before the log says so."""
SILENCE_LOG_PERIOD = 30.0


ROS_TYPES = {JOINT_STATES: JointState, JOINT_REACTION_FORCE: WrenchStamped}


def deserialize(data: bytes, topic: str) -> Any:
    """An input message the ordinary way."""
    return deserialize_message(data, ROS_TYPES[topic])


class Sink(Protocol):
    """A thread that takes answers off the tick path: recorder or viewer."""

    failure: str

    def put(self, answer: Answer) -> None:
        """Hand over an answer; never waits."""

    def diagnostics(self) -> dict[str, str]:
        """What `/diagnostics` shall say."""

    def close(self, ending: Ending) -> None:
        """Finish the file."""


class Session:
    """Made by configure, started by activate, stopped by deactivate, closed by cleanup."""

    def __init__(self, node: LifecycleNode, parameters: Parameters) -> None:
        """Build the model and open the outputs.

        Raises:
            UsageError: a profile cannot be used or an output file cannot be written.
        """
        self.node = node
        self.parameters = parameters
        self.pipeline = Pipeline(parameters, deserialize, compiled=False)
        self.inputs = {topic: InputMeter() for topic in INPUTS}
        self.ticks = TickMeter()
        self.sinks = self._open_sinks()
        self._contact = node.create_lifecycle_publisher(KneeContact, KNEE_CONTACT, OUTPUT_QOS)
        self._wrench = node.create_lifecycle_publisher(WrenchStamped, KNEE_CONTACT_WRENCH, OUTPUT_QOS)
        self._diagnostics = node.create_lifecycle_publisher(DiagnosticArray, "/diagnostics", OUTPUT_QOS)
        self._subscriptions: list[Any] = []
        self._timers: list[Any] = []
        self._waiting_since: float | None = None
        self._started = 0.0

    def start(self) -> None:
        """Listen."""
        self._started = time.monotonic()
        node, qos = self.node, QoSOverridingOptions.with_default_policies()
        for message_type, topic, callback in (
            (JointState, JOINT_STATES, self._on_joint_state),
            (WrenchStamped, JOINT_REACTION_FORCE, self._on_force),
        ):
            subscription = node.create_subscription(
                message_type, topic, callback, INPUT_QOS, qos_overriding_options=qos, raw=True
            )
            self._subscriptions.append(subscription)
        steady = Clock(clock_type=ClockType.STEADY_TIME)  # both must run on when simulated time stands still
        self._timers = [
            node.create_timer(max(0.25 * self.parameters.pairing.wait, 0.01), self._on_wait_timer, clock=steady),
            node.create_timer(DIAGNOSTICS_PERIOD, self._on_diagnostics_timer, clock=steady),
        ]

    def stop(self) -> None:
        """Listen no more; answer what still waits."""
        if self._subscriptions:
            self._publish(self.pipeline.give_up())
        for subscription in self._subscriptions:
            self.node.destroy_subscription(subscription)
        for timer in self._timers:
            self.node.destroy_timer(timer)
        self._subscriptions, self._timers = [], []

    def close(self) -> None:
        """Complete the files."""
        ending = self.pipeline.ending()
        for sink in self.sinks.values():
            sink.close(ending)
        self.sinks = {}

    def destroy_publishers(self) -> None:
        """Offer the topics no more."""
        for publisher in (self._contact, self._wrench, self._diagnostics):
            self.node.destroy_publisher(publisher)

    def _open_sinks(self) -> dict[str, Sink]:
        """Open all output files, then start their threads; if one cannot be opened, none is left behind."""
        parameters, log_error = self.parameters, self.node.get_logger().error
        sinks: dict[str, Sink] = {}
        with ExitStack() as undo:
            if parameters.record.path:
                bag = BagWriter(Path(parameters.record.path))
                undo.callback(bag.discard)
            if parameters.rerun.mode == "file":
                from knee_contact_ros.visualise import RerunFile, RerunThread  # 1 s that only Rerun's users pay

                scene = RerunFile(Path(parameters.rerun.path), self.pipeline.model, parameters.body_weight)
                sinks["viewer"] = RerunThread(scene, log_error)
            undo.pop_all()
        if parameters.record.path:
            topics = (*INPUTS, KNEE_CONTACT, KNEE_CONTACT_WRENCH)
            names = {topic: self.node.resolve_topic_name(topic) for topic in topics}
            writer = AnswerWriter(bag, names)
            sinks["recorder"] = RecorderThread(writer, parameters.record.flush_period, log_error)
        return sinks

    def _on_joint_state(self, data: bytes) -> None:
        self.inputs[JOINT_STATES].count()
        self._publish(self.pipeline.joint_state(data))

    def _on_force(self, data: bytes) -> None:
        self.inputs[JOINT_REACTION_FORCE].count()
        self._publish(self.pipeline.joint_reaction_force(data))

    def _on_wait_timer(self) -> None:
        """Answer loads whose angle is late."""
        since = self._waiting_since
        if since is not None and time.monotonic() - since >= self.parameters.pairing.wait:
            self._publish(self.pipeline.give_up())

    def _publish(self, answers: Iterator[Answer]) -> None:
        """Compute and publish answers, then hand them to the sinks."""
        begin = time.perf_counter()
        for answer in answers:
            self._contact.publish(answer.message)
            self._wrench.publish(answer.wrench)
            for sink in self.sinks.values():
                sink.put(answer)
            end = time.perf_counter()
            self.ticks.count(answer.contact, end - begin)
            begin = end
        if not self.pipeline.synchroniser.waiting:
            self._waiting_since = None
        elif self._waiting_since is None:
            self._waiting_since = time.monotonic()
        if self.pipeline.last_refusal:
            text = f"sample refused: {self.pipeline.last_refusal}"
            self.node.get_logger().warning(text, throttle_duration_sec=REFUSAL_LOG_PERIOD)
            self.pipeline.last_refusal = ""

    def _on_diagnostics_timer(self) -> None:
        refused = self.pipeline.synchroniser.refused
        entries = []
        for topic, meter in self.inputs.items():
            problem = "" if meter.received else "nothing received yet"
            entries.append(diagnostic_status(f"{NODE_NAME}: {topic}", meter.values(DIAGNOSTICS_PERIOD), problem))
        silent = [self.node.resolve_topic_name(topic) for topic, meter in self.inputs.items() if not meter.received]
        if silent and time.monotonic() - self._started > SILENCE:
            text = f"nothing received yet on {' and '.join(silent)}"
            self.node.get_logger().warning(text, throttle_duration_sec=SILENCE_LOG_PERIOD)
        counts = {"total": str(refused.total())} | {reason: str(count) for reason, count in refused.items()}
        problem = "samples were refused" if refused else ""
        entries.append(diagnostic_status(f"{NODE_NAME}: refused samples", counts, problem))
        entries.append(diagnostic_status(f"{NODE_NAME}: ticks", self.ticks.values()))
        entries += [
            diagnostic_status(f"{NODE_NAME}: {name}", sink.diagnostics(), sink.failure)
            for name, sink in self.sinks.items()
        ]
        self._diagnostics.publish(diagnostic_array(self.node.get_clock().now().to_msg(), entries))
