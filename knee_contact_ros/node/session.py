"""One configured life of a node: its inputs, its pipeline, and its outputs."""

from __future__ import annotations

import gc
import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, ClassVar

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.lifecycle import LifecycleNode
from rclpy.qos import QoSPolicyKind, QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from std_srvs.srv import Trigger

from ..bags.provenance import (
    PARAMETERS_CHANGED,
    STATE,
    beginning,
    change_record,
)
from ..model.types import Status
from ..parameters.sources import WRENCH_STAMPED_TYPE, source_of
from ..streams.conversion import converters
from ..streams.frames import FORCE_TURNED
from ..streams.output import Note, RecordedKnee
from ..streams.pipeline import OF_OTHERS, Pipeline
from ..streams.topics import JOINT_STATES, TickOutput
from ..system.errors import UsageError
from ..system.output_files import check_writable, expand_stamp, free_names
from ..system.realtime import begin_realtime, end_realtime
from .diagnostics import Health
from .inputs import (
    HandedInputs,
    Input,
    InputMeter,
    Inputs,
    StaticTransformTopic,
    installed_types,
    message_class,
)
from .other_publishers import OtherPublishers
from .outputs import Outputs
from .problems import LOG_PERIOD, STEADY, at_most_every
from .regular_work import LONGEST_PAUSE, RegularWork

OUTPUT_DEPTH = 100
"""Number of messages that a publisher keeps for slow subscribers"""
OVERRIDABLE = (
    QoSPolicyKind.HISTORY,
    QoSPolicyKind.DEPTH,
    QoSPolicyKind.RELIABILITY,
    QoSPolicyKind.DURABILITY,
    QoSPolicyKind.DEADLINE,
    QoSPolicyKind.LIFESPAN,
    QoSPolicyKind.LIVELINESS,
    QoSPolicyKind.LIVELINESS_LEASE_DURATION,
)
"""Policies of an output that the user may override: a subscriber that asks for more than is offered gets nothing"""
DIAGNOSTICS = "/diagnostics"
DIAGNOSTICS_PERIOD = 1.0
"""Time [s] between two messages of the diagnostics"""
CHECK_PERIOD = 0.9
"""Time [s] between two checks of the samples for publishers that disagree, and of the answers"""
LONGEST_WAIT_PERIOD = 0.025
"""Longest time [s] between two checks for late angles, and so for regular work while no answers come"""
SEND_PERIOD = 0.01
"""Time [s] between two checks whether an output has gathered answers for long enough"""


class Session(ABC):
    """Configured life of a node: made by configure, started by activate, stopped by deactivate, closed by cleanup."""

    streaming: ClassVar[set[Session]] = set()
    """Started sessions of this process; the garbage collector is off as long as there is one"""

    def __init__(
        self, node: LifecycleNode, parameters: Any, pipeline: Pipeline[Any], health: Health
    ) -> None:
        """Make a session without inputs and outputs.

        Args:
            node: The node.
            parameters: Parameters of the kind of node.
            pipeline: Computes the answers.
            health: Reports on them.
        """
        self.node = node
        self.parameters = parameters
        self.pipeline = pipeline
        self.health = health
        self.inputs: Inputs
        self.orientations: Any = None
        """`OrientationJoin` if the angles are made of the orientations of thigh and shank"""
        self._thigh: Input | None = None
        self.outputs: Outputs
        self._transforms: StaticTransformTopic
        self._frame_doubt = ""  # as it was last told
        self._others: OtherPublishers
        self._publishers: dict[str, Any] = {}
        """Publishers by their topics"""
        self._services: list[Any] = []
        self._timer: Any = None
        self._ticks_before = 0  # when the timer last fired
        self._calls: list[tuple[float, Callable[[], object]]] = [
            (0.9 * self._wait_period, self._answer_late),  # surely due when the timer fires
            (DIAGNOSTICS_PERIOD, self._watch_publishers),
            (DIAGNOSTICS_PERIOD, self._publish_diagnostics),
            (CHECK_PERIOD, pipeline.angle_conflict.check_samples),
            (CHECK_PERIOD, pipeline.force_conflict.check_samples),
        ]
        """Functions that are called regularly while the session is started, each with its period [s]"""
        self._work: RegularWork

    @abstractmethod
    def _publish(self, answer: Any, begin: float) -> None:
        """Publish an answer whose computation began at a time [s], and then record and count it."""

    @abstractmethod
    def _recorded_knee(self, parameters: Any) -> RecordedKnee:
        """Description for outputs that begin now, with these parameters."""

    def prepare(self, interrupting: Callable[[], AbstractContextManager[None]]) -> None:
        """Wait until the outputs are open; signals may interrupt this within `interrupting`."""
        if self.parameters.realtime:
            end_realtime()  # another node in this process may be active
        with interrupting():
            self.outputs.wait_until_known()

    def _input_streams(self, handed: HandedInputs | None = None) -> Inputs:
        """Streams of angles and of forces, from their topics or from another node in this process (`handed`).

        Raises:
            UsageError: a type that the parameters name is not installed, or lacks a field.
        """
        limits = self.parameters.diagnostics
        max_gap = self.parameters.pairing.max_gap
        by = self.parameters.force_source
        angles, forces = self.parameters.inputs()
        angle_meter = InputMeter(
            limits.angle_warn_rate, limits.angle_error_rate, max_gap, limits.timeout
        )
        force_meter = InputMeter(
            limits.force_warn_rate, limits.force_error_rate, max_gap, limits.timeout
        )
        thigh = self.parameters.thigh()
        if thigh:
            from ..streams.orientations import OrientationJoin

            self.orientations = OrientationJoin(self.parameters)
        convert_angle, convert_force, convert_thigh = converters(
            self.parameters, installed_types, self.orientations
        )
        angle_arguments = self.node, angles.topic, self._on_joint_state, angle_meter
        force_arguments = self.node, forces.topic, self._on_force, force_meter
        if handed and forces != source_of(self.parameters.usual_forces, WRENCH_STAMPED_TYPE):
            fault = f"parameter {by}: {forces.topic!r} is not allowed with --with-contact: the force comes from the"
            raise UsageError(f"{fault} load node; leave it out, or run `knee-contact node`")
        if handed and (angles.topic == JOINT_STATES or angles == handed.angles.source):
            angle_input = Input(*angle_arguments, handed=handed.angles)
        else:
            angle_input = Input(
                *angle_arguments,
                message_class(angles, self.parameters.angle_source),
                convert_angle,
            )
        if thigh:
            kind = message_class(thigh, "orientations.thigh")
            arguments = self.node, thigh.topic, self._on_joint_state, angle_meter
            self._thigh = Input(*arguments, kind, convert_thigh)
        if handed:
            return angle_input, Input(*force_arguments, handed=handed.forces)
        return angle_input, Input(*force_arguments, message_class(forces, by), convert_force)

    @property
    def _every_input(self) -> list[Input]:
        """Angles, forces, and the thigh's orientations if there are any."""
        return [*self.inputs, *filter(None, [self._thigh])]

    def _advertise(self, topics: Mapping[str, tuple[Any, int]]) -> None:
        """Advertise topics, each with its type and depth, and the diagnostics.

        Raises:
            UsageError: a topic cannot be advertised, as the middleware does not know one of the QoS overrides.
        """
        self._others = OtherPublishers(self.node, list(topics))
        by_user = QoSOverridingOptions(OVERRIDABLE)
        try:
            for topic, (kind, depth) in {
                **topics,
                DIAGNOSTICS: (DiagnosticArray, OUTPUT_DEPTH),
            }.items():
                profile = QoSProfile(depth=depth)  # one for each topic: overrides change it
                self._publishers[topic] = self.node.create_lifecycle_publisher(
                    kind, topic, profile, qos_overriding_options=by_user
                )
        except Exception as error:  # rclpy has many ways to say so
            reason = " ".join(str(error).split())
            raise UsageError(f"a topic cannot be offered: {reason}") from None

    def _open_outputs(self) -> None:
        """Open the transforms, the services and the outputs; files come last, when everything else works."""
        self._transforms = StaticTransformTopic(self.node, self.pipeline.frame)
        try:
            for name, act in self._services_by_name().items():
                self._services.append(self._service(name, act))
            self.outputs = Outputs(self._knee(), self.node.get_logger(), self.pipeline.run_state)
            self._calls.append((SEND_PERIOD, self.outputs.send_gathered))
        except BaseException:
            self.destroy_endpoints()
            raise

    def _services_by_name(self) -> dict[str, Callable[[], str]]:
        """Functions of the services `~/NAME`, which return what they have done."""
        return {
            "reset": self._reset,
            "start_recording": self._start_recording,
            "stop_recording": self._stop_recording,
            "save_snapshot": self._save_snapshot,
        }

    def start_listening(self) -> None:
        """Open the inputs, and begin the regular work."""
        # Freeze what exists: the collector stays off in ticks, whose garbage has no cycles, and a timer collects.
        gc.unfreeze()  # what an earlier session has left while another one streams
        gc.collect()
        gc.freeze()
        gc.disable()
        self.streaming.add(self)
        if self.pipeline.ticks:  # it was active before, and time may have gone anywhere since
            self._reset()
        if self.node.get_clock().ros_time_is_active:
            self.node.get_logger().info(
                "use_sim_time: stamps on arrival and the age of messages follow /clock; pairing.wait, deadline and "
                "rates are in time of this computer"
            )
        for stream in self._every_input:
            stream.follow_clock()
            stream.meter.restart()
            stream.start_listening()
        self._watch_publishers()
        self.health.counts.start_timer()
        if self.parameters.realtime and (forbidden := begin_realtime()):
            self.node.get_logger().warning(forbidden)
        self._work = RegularWork(self._calls)
        self._timer = self.node.create_timer(self._wait_period, self._on_timer, clock=STEADY)

    @property
    def _wait_period(self) -> float:
        """Time [s] between two checks for late angles."""
        return float(min(max(0.25 * self.parameters.pairing.wait, 0.01), LONGEST_WAIT_PERIOD))

    def stop_listening(self) -> None:
        """Close the inputs; answer waiting samples."""
        if self._timer:
            self._publish_all(self.pipeline.finish_streams())
            self.pipeline.synchroniser.clear_streams()
            self.pipeline.synchroniser.clear_angles()
            self.pipeline.frame.forget_frame()
        self.streaming.discard(self)
        if not self.streaming:
            gc.enable()
            gc.unfreeze()
            if self.parameters.realtime:
                end_realtime()
        for stream in self._every_input:
            stream.stop_listening()
        if self._timer:
            self.node.destroy_timer(self._timer)
            self._timer = None

    def retune(self, parameters: Any, changes: dict[str, Any]) -> None:
        """Continue with changed parameters; `changes` has the values that have changed, by dotted name."""
        self.parameters = self.health.parameters = parameters
        self.pipeline.retune(parameters)
        self.outputs.put_item(
            Note(PARAMETERS_CHANGED, change_record(self.pipeline.ticks, changes))
        )

    def request_end(self) -> None:
        """Stop, and request that the files complete, without waiting."""
        self.stop_listening()
        self.outputs.request_end(self.pipeline.ending())

    def complete_files(self) -> bool:
        """Complete the files, and return whether that worked for all of them."""
        return self.outputs.complete_files(self.pipeline.ending())

    def destroy_endpoints(self) -> None:
        """Withdraw topics and services."""
        self._transforms.withdraw()
        for service in self._services:
            self.node.destroy_service(service)
        for publisher in self._publishers.values():
            self.node.destroy_lifecycle_publisher(publisher)

    def _on_joint_state(self, data: bytes) -> None:
        """Take a JointState and answer."""
        self._publish_pushed(self.pipeline.push_joint_state(data), self.inputs[0].meter)

    def _on_force(self, data: bytes) -> None:
        """Take a force and answer."""
        answers = self.pipeline.push_force(data, time.perf_counter())
        if self.pipeline.frame.turn_note:
            note = self.pipeline.frame.take_turn_note()
            text = f"forces are turned from {note['from']} to {note['to']}"
            self.node.get_logger().info(text, **at_most_every(LOG_PERIOD))
            self.outputs.put_item(Note(FORCE_TURNED, note))
        self._publish_pushed(answers, self.inputs[1].meter)

    def _publish_pushed(self, answers: Iterator[Any], meter: InputMeter) -> None:
        """Count the message that was pushed, and publish the answers; they are flagged if it came late."""
        stamp = self.pipeline.message_stamp
        if stamp != OF_OTHERS:
            meter.count_message(stamp)
            if meter.is_late:
                self._flag_late(Status.STALE_INPUT)
        self._publish_all(answers)

    def _flag_late(self, bits: Status) -> None:
        """Give the answers these bits, because messages come late, or none."""
        self.pipeline.synchroniser.flag_from_now("late", int(bits))

    def _service(self, name: str, act: Callable[[], str]) -> Any:
        """Service that calls a function and answers with its message, or with the reason why it failed."""

        def answer(_request: Any, response: Any) -> Any:
            try:
                response.success, response.message = True, act()
            except UsageError as error:
                response.success, response.message = False, str(error)
            except (
                Exception
            ) as error:  # whatever it is, the caller must know, and the node runs on
                response.success, response.message = False, f"{type(error).__name__}: {error}"
                self.node.get_logger().error(f"~/{name}: {response.message}")
            return response

        return self.node.create_service(Trigger, f"~/{name}", answer)

    def _reset(self) -> str:
        self._publish_all(self.pipeline.finish_streams())
        note = self.pipeline.reset()
        self._hand_over_notes()
        self.outputs.put_item(note)
        return "the next tick starts from rest"

    def _start_recording(self) -> str:
        path = self.outputs.start_recording(self._knee())
        if self.pipeline.synchroniser.lasting:
            self.outputs.put_item(self.pipeline.flags_note)
        return f"recording to {path}"

    def _stop_recording(self) -> str:
        path = self.outputs.stop_recording(self.pipeline.ending())
        return f"{path} will be complete in a moment"

    def _save_snapshot(self) -> str:
        items, duration, state = self.outputs.ring.kept_items()
        answers = sum(isinstance(item, TickOutput) for item in items)
        if not answers:
            raise UsageError(
                "there is nothing to save: no answer since the parameters changed, or record.snapshot is 0"
            )
        path = Path(expand_stamp(self.parameters.record.path) or f"{self.node.get_name()}.mcap")
        check_writable(path)
        path = next(free_names(path.with_name(f"{path.stem}_snapshot{path.suffix}")))
        record = self.parameters.record.model_copy(update={"path": str(path)})
        knee = self._recorded_knee(self.parameters.model_copy(update={"record": record}))
        provenance = dict(knee.provenance)
        provenance.pop(STATE, None)  # that after the last answer
        provenance |= beginning(self.pipeline.ticks - answers, state)
        ending = self.pipeline.ending()._replace(refused={})  # some are of earlier answers
        self.outputs.save_snapshot(items, ending, knee._replace(provenance=provenance))
        return f"{path} will be complete in a moment: {answers} answers, {duration:.3f} s"

    def _knee(self) -> RecordedKnee:
        """Description for outputs that begin now, with the time in the names of their files."""
        sections = {name: getattr(self.parameters, name, None) for name in ("record", "rerun")}
        update = {
            name: part.model_copy(update={"path": expand_stamp(part.path)})
            for name, part in sections.items()
            if part
        }
        return self._recorded_knee(self.parameters.model_copy(update=update))

    def _on_timer(self) -> None:
        """Note the lag; do the regular work while no answers come, or they come too rarely; end subscriptions."""
        if not self._timer:
            return  # the executor had it in hand when it was destroyed
        self.health.counts.note_timer(self._wait_period)
        before, self._ticks_before = self._ticks_before, self.pipeline.ticks
        overdue = self._wait_period if before < self.pipeline.ticks else 0.0
        self._work.do_due(time.perf_counter() - overdue, math.inf)
        # Not after an answer, as that is in a callback of the subscriptions that end here:
        self._transforms.leave_moving()
        for stream in self._every_input:
            stream.look_for_publishers()

    def _answer_late(self) -> None:
        """Answer loads whose angle is late; end the flags of late messages; tell doubts; free some memory."""
        if not any(stream.meter.is_late for stream in self.inputs):
            self._flag_late(Status.OK)
        arrived_by = time.perf_counter() - self.parameters.pairing.wait
        self._publish_all(self.pipeline.flush_expired(arrived_by))
        self.health.tell_first_second(self.inputs)
        if self.pipeline.frame.doubt not in ("", self._frame_doubt):
            self._frame_doubt = self.pipeline.frame.doubt
            self.node.get_logger().warning(self._frame_doubt)
        gc.collect(0)  # often and little: in a second there is much to look through

    def _publish_all(self, answers: Iterator[Any]) -> None:
        """Publish answers one after another, each as soon as it is computed; then do regular work that is due."""
        begin = time.perf_counter()
        if self.pipeline.notes:
            self._hand_over_notes()
        answer = None
        for answer in answers:
            self._publish(answer, begin)
            begin = time.perf_counter()
        if answer:
            self._work.do_due(begin, begin + LONGEST_PAUSE)
        if self.pipeline.last_refusal:
            text = f"sample refused: {self.pipeline.last_refusal}"
            self.node.get_logger().warning(text, **at_most_every(LOG_PERIOD))
            self.pipeline.last_refusal = ""

    def _hand_over_notes(self) -> None:
        """Hand the notes of the pipeline to the outputs."""
        while self.pipeline.notes:
            self.outputs.put_item(self.pipeline.notes.pop(0))

    def _watch_publishers(self) -> None:
        """Flag the answers while others publish on their topics, and say so."""
        before = self.health.mixed, self.health.namesake
        self.health.mixed, self.health.namesake = found = (
            self._others.mixed_sentence(),
            self._others.name_sentence(),
        )
        bits = Status.SEVERAL_PUBLISHERS if found[0] else Status.OK
        self.pipeline.synchroniser.flag_from_now("several publishers", int(bits))
        for text in set(found) - {*before, ""}:
            self.node.get_logger().error(text)
        if before[0] and not found[0]:
            self.node.get_logger().info("the answers have no other publisher any more")

    def _publish_diagnostics(self) -> None:
        report = self.health.report_diagnostics(self.inputs, self.outputs)
        self._publishers[DIAGNOSTICS].publish(report)

    def report_standstill(self, age: float) -> None:
        """Publish, from another thread, that the node has not worked for a time [s]."""
        if self._timer:
            self._publishers[DIAGNOSTICS].publish(self.health.standstill_report(age))
