"""Managed ROS 2 node of any kind (`contact_node.py`, `load_node.py`): its life cycle, its process, and its signals.

The transition configure reads the parameters and opens the outputs, activate opens the inputs. With the parameter
`autostart` (the default) the node does both by itself.
"""

from __future__ import annotations

import json
import signal
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import rclpy
from rclpy import qos
from rclpy.executors import Executor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.signals import SignalHandlerOptions

from ..parameters.files import check_file, check_used, is_subject, sections_in
from ..streams.topics import INPUTS
from ..streams.watch import unanswered_sentence
from ..system.errors import UsageError, join_faults, suggest
from ..system.files import parameter_file
from ..system.realtime import LONGEST_RUN, end_realtime
from ..system.ros import make_executor, one_line_ros_errors, resolve_topic
from ..system.ros_files import (
    PARAMETERS_KEY,
    Sections,
    merge_sections,
    read_sections,
    values_for,
)
from .parameters import QOS_PREFIX, NodeKind, NodeParameters, given_by_user
from .problems import at_most_every
from .session import Session
from .watchdog import Watchdog

ROS_ARGUMENTS = "--ros-args"
SPIN_PERIOD = 0.1
"""Period [s] in which the main loop checks for a signal to stop"""
FAILURE_LOG_PERIOD = 5.0
"""Shortest time [s] between two reports of unexpected failures in the log"""
ServiceCallback = Callable[[Any, Any], Any]
"""Callback of a service: takes the request and an empty response, returns the response"""


class ManagedNode(LifecycleNode):
    """Managed node with its life cycle. Its `Session` does the work while it is configured."""

    def __init__(
        self,
        kind: NodeKind,
        stop: Stop,
        beside: Sequence[ManagedNode] = (),
        files: Sequence[Path] = (),
    ) -> None:
        """Read and check the parameters, also those that `files` and the node `beside` this one give for both.

        Raises:
            UsageError: a parameter is unknown or not allowed.
        """
        self._qos = set[str]()  # names of the QoS overrides that topics have asked for
        super().__init__(
            kind.schema.node,
            allow_undeclared_parameters=True,
            automatically_declare_parameters_from_overrides=True,
        )
        sections: Sections = {}
        for path in files:
            merge_sections(sections, read_sections(path))
        companion = f"{self.get_namespace().rstrip('/')}/{kind.schema.companion}"
        companions = values_for(sections, companion)
        for node in beside:
            companions |= node.node_parameters.given
        self.node_parameters: NodeParameters = NodeParameters(self, kind, companions)
        self.kind = kind
        self.session: Session | None = None
        self.complete = True
        """Whether the outputs of all sessions so far could be completed"""
        self._stop = stop
        for service in self.services:
            service.callback = self._service_callback(service.callback, service.srv_name)

    def declare_parameter(self, name: str, *details: Any, **named: Any) -> Any:
        """Declare a parameter; a QoS override of the user that a topic asks for is checked, as rclpy names none.

        Raises:
            UsageError: the value is none for this policy.
        """
        if name.startswith(QOS_PREFIX):
            self._qos.add(name)
            value, kind = (
                self.get_parameter_or(name).value,
                f"{name.rpartition('.')[2].title()}Policy",
            )
            words = getattr(qos, kind, qos.QoSPolicyEnum).__members__.keys() - {
                "UNKNOWN"
            }  # none for the depth
            fits = str(value).upper() in words if words else type(value) is int and value >= 0
            if not fits and value is not None:
                allowed = ", ".join(sorted(words)).lower() or "a whole number"
                raise UsageError(
                    f"parameter {name}: {value!r} is not allowed; it must be {allowed}"
                )
        return super().declare_parameter(name, *details, **named)

    def _service_callback(self, callback: ServiceCallback, name: str) -> ServiceCallback:
        """Callback of a service that reports a failing request in the log instead of raising."""

        def answered(request: Any, response: Any) -> Any:
            try:
                return callback(request, response)
            except Exception as error:
                self.get_logger().warning(f"{name}: the request is refused: {error}")
                return response

        return answered

    def configure(self) -> None:
        """Read the parameters, build the session, prepare it for its first tick and open the outputs.

        Raises:
            UsageError: a parameter, a file that it names or an output cannot be used.
            KeyboardInterrupt: a signal to stop came while the process compiled.
        """
        try:
            self.session = self.kind.session(self, self.node_parameters.read_parameters())
            if unset := self.node_parameters.unset_person():
                self.get_logger().info(unset)
            self.session.prepare(self._stop.interrupting)
            self.node_parameters.user = self.session
        except BaseException:
            self.finish_session()
            raise

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Configure the node; a bad parameter leaves it unconfigured."""
        try:
            if self.session is None:
                self.configure()
        except UsageError as error:
            self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        except KeyboardInterrupt:
            return TransitionCallbackReturn.FAILURE
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Open the inputs; a failure is logged, as the caller of the transition does not get the reason."""
        result = super().on_activate(state)
        if self.session:
            try:
                self.session.start_listening()
            except Exception as error:  # rclpy has many kinds
                self.get_logger().error(
                    f"cannot listen: {' '.join(str(error).split()) or repr(error)}"
                )
                return TransitionCallbackReturn.ERROR
            known, given = sorted(self._qos), sorted(given_by_user(self))
            if unused := [
                f"{name} has no effect: {suggest(name, known)}"
                for name in given
                if name not in known
            ]:
                self.get_logger().warning(join_faults(unused), once=True)
            topics = " and ".join(
                resolve_topic(self, stream.topic) for stream in self.session.inputs
            )
            self.get_logger().info(f"active, listening to {topics}")
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Close the inputs; answer waiting samples."""
        if self.session:
            self.session.stop_listening()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Close the outputs; all parameters may change again."""
        self.finish_session()
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Close the inputs and the outputs."""
        self.finish_session()
        return super().on_shutdown(state)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Close the outputs; afterwards the node is unconfigured and can be configured again."""
        self.get_logger().error("a transition has failed; the node is unconfigured")
        self.finish_session()
        return super().on_error(state)

    def report_standstill(self, age: float) -> None:
        """Publish, from another thread, that the node has not worked for a time [s]."""
        session = self.session
        if session:
            session.report_standstill(age)

    def finish_session(self) -> None:
        """End the session, if there is one: answer waiting samples, complete the files."""
        session, self.session = self.session, None
        self.node_parameters.user = None
        if session:
            session.stop_listening()
            self.complete &= session.complete_files()
            session.destroy_endpoints()
            paired = session.pipeline.synchroniser
            streams = paired.angle_time, paired.load_time
            missing = sum(each.holes.missing for each in streams)
            skipped = sum(each.holes.skipped for each in streams)
            refused = session.pipeline.refused
            self.get_logger().info(
                f"{session.pipeline.ticks} ticks, {refused} sample{'s' * (refused != 1)} refused"
                + (f", {missing} missing (holes in the stamps)" if missing else "")
                + (f", {skipped} where stamps paused or jumped" if skipped else "")
            )
            angles, forces = (stream.meter.received for stream in session.inputs)
            if unanswered := unanswered_sentence(session.pipeline, forces, angles > 0):
                self.get_logger().warning(unanswered)


def run_nodes(arguments: list[str], kinds: Sequence[NodeKind]) -> int:
    """Run nodes in one process until SIGINT or SIGTERM, then complete their files.

    Returns:
        Exit code: 0, or 1 if a file could not be completed.

    Raises:
        UsageError: a parameter is unknown or not allowed, an output file cannot be written, or the ROS graph cannot be
            joined.
    """
    if (
        arguments and arguments[0] != ROS_ARGUMENTS
    ):  # ROS would ignore them, and the node run without them
        raise UsageError(
            f"{arguments[0]}: the node takes ROS arguments only, after {ROS_ARGUMENTS}"
        )
    with ExitStack() as folders:
        return _run_nodes([*_for_ros(arguments, folders)], kinds)


def _for_ros(arguments: Sequence[str], folders: ExitStack) -> Iterator[str]:
    """Yield ROS arguments with the places of parameter files; subject files are written as such into `folders`."""
    for flag, word in pairwise(["", *arguments]):
        if flag != "--params-file":
            yield word
            continue
        path = parameter_file(word)  # ROS knows no short names
        if path.is_file() and is_subject(read_sections(path)):
            nodes = {name: {PARAMETERS_KEY: values} for name, values in sections_in(path).items()}
            folder = folders.enter_context(TemporaryDirectory(prefix="knee_contact_subject_"))
            path = Path(folder, "subject.yaml")
            path.write_text(json.dumps(nodes))  # JSON is YAML
        yield str(path)


def _run_nodes(arguments: list[str], kinds: Sequence[NodeKind]) -> int:
    """Do what `run_nodes` does, with arguments that ROS understands."""
    files = [Path(word) for flag, word in pairwise(arguments) if flag == "--params-file"]
    for path in files:
        for kind in kinds:
            with of_node(kind, kinds):
                check_file(path, kind.schema)
    try:
        rclpy.init(
            args=["knee-contact", *arguments], signal_handler_options=SignalHandlerOptions.NO
        )
    except RuntimeError as error:  # rclpy's own errors derive from it
        raise UsageError(f"ROS arguments: {str(error).splitlines()[0]}") from None
    except UnicodeEncodeError as error:  # bytes that are no text
        raise UsageError(f"ROS arguments: {error.object!r} is not UTF-8") from None
    stop, nodes = Stop(), list[ManagedNode]()
    try:
        with one_line_ros_errors():
            for kind in kinds:
                with of_node(kind, kinds):
                    nodes.append(ManagedNode(kind, stop, nodes, files))
        check_names(nodes)
        check_targets(arguments, [node.get_fully_qualified_name() for node in nodes])
        start_nodes([node for node in nodes if node.node_parameters.read_parameters().autostart])
        executor = make_executor(*nodes)
        watchdog = Watchdog([node.report_standstill for node in nodes])
        signal.signal(signal.SIGXCPU, partial(on_long_run, nodes[0]))
        while not stop.requested:
            spin(executor, nodes[0])
            watchdog.note_life()
        watchdog.end()
    finally:
        finish_nodes(nodes)  # recordings are completed, whatever has happened
        rclpy.shutdown()
    return 0 if all(node.complete for node in nodes) else 1


@contextmanager
def of_node(kind: NodeKind, kinds: Sequence[NodeKind]) -> Iterator[None]:
    """Begin errors with the name of the node, if the process has nodes of several kinds."""
    try:
        yield
    except UsageError as error:
        raise UsageError(
            f"{kind.schema.node}: {error}" if len(kinds) > 1 else str(error)
        ) from None


def finish_nodes(nodes: Sequence[ManagedNode]) -> None:
    """End nodes: first tell all outputs to end, then wait for them."""
    for session in [node.session for node in nodes if node.session]:
        session.request_end()
    for node in nodes:
        node.finish_session()
        node.destroy_node()


def check_names(nodes: Sequence[ManagedNode]) -> None:
    """Check that nodes in one process have different names, and the same names for the topics that they share.

    Raises:
        UsageError: two nodes have the same name, or a topic has different names in two nodes.
    """
    for giver, taker in pairwise(nodes):
        names = giver.get_fully_qualified_name(), taker.get_fully_qualified_name()
        if names[0] == names[1]:
            own = giver.kind.schema.node
            raise UsageError(
                f"two nodes would have the name {names[0]}; rename one of them, as -r {own}:__node:=NAME"
            )
        for topic in INPUTS:
            given, taken = giver.resolve_topic_name(topic), taker.resolve_topic_name(topic)
            if given != taken:
                raise UsageError(
                    f"in one process {names[1]} takes {given} from {names[0]}, and cannot listen to {taken}: give "
                    "both the same names and namespace, or run each in its own process"
                )


def check_targets(arguments: Sequence[str], nodes: Sequence[str]) -> None:
    """Check that each parameter file and each `-p NODE:NAME:=VALUE` is for a node of this process, by absolute name.

    Raises:
        UsageError: ROS would ignore one.
    """
    for flag, word in pairwise(arguments):
        target, colon, _ = word.partition(":=")[0].partition(":")
        if flag == "--params-file":
            check_used(sections_in(Path(word)), word, nodes)
        elif flag in ("-p", "--param") and colon:
            hints = [
                f"; in a namespace, use a file with {node}"
                for node in nodes
                if node.endswith(f"/{target}")
            ]
            check_used([target], f"{flag} {word}", nodes, "".join(hints))


def spin(executor: Executor, node: ManagedNode) -> None:
    """Let the executor work for a moment; an unexpected failure is logged, and the node runs on."""
    try:
        executor.spin_once(timeout_sec=SPIN_PERIOD)
    except Exception:
        text = f"this should not happen; the node continues: {traceback.format_exc()}"
        node.get_logger().error(text, **at_most_every(FAILURE_LOG_PERIOD))


def on_long_run(node: ManagedNode, _number: int, _frame: object) -> None:
    """End real-time scheduling after work without a pause, which others may have to wait for."""
    end_realtime()
    text = f"a thread worked for {LONGEST_RUN} s without a pause: real-time scheduling is off until the next activation"
    node.get_logger().error(text)


def start_nodes(nodes: Sequence[ManagedNode]) -> None:
    """Configure the nodes, and activate them when all are ready; a signal to stop ends this early.

    Raises:
        UsageError: see `run_nodes`.
    """
    with suppress(KeyboardInterrupt):
        for node in nodes:
            node.configure()
            node.trigger_configure()
        for node in nodes:
            if node.trigger_activate() != TransitionCallbackReturn.SUCCESS:
                raise UsageError("the node could not be activated; its log says why")


MEANINGLESS = (
    signal.SIGUSR1,
    signal.SIGUSR2,
    signal.SIGALRM,
    signal.SIGVTALRM,
    signal.SIGPROF,
    signal.SIGPIPE,
)
"""Signals without a meaning for a node, which would end a process that does not handle them"""


class Stop:
    """Handler of the signals that end the node: SIGINT, SIGTERM and SIGHUP. Other ones do not end it.

    Usually a signal is only noted (`requested`); while the model compiles, the first one interrupts.
    """

    def __init__(self) -> None:
        self.requested = False
        self._interrupts = False
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            if (number, signal.getsignal(number)) != (
                signal.SIGHUP,
                signal.SIG_IGN,
            ):  # as nohup has it
                signal.signal(number, self._on_signal)
        for number in MEANINGLESS:
            signal.signal(number, signal.SIG_IGN)

    @contextmanager
    def interrupting(self) -> Iterator[None]:
        """Make the first signal raise KeyboardInterrupt within the `with` block, immediately if it came earlier."""
        self._interrupts = True
        try:
            if self.requested:
                raise KeyboardInterrupt
            yield
        finally:
            self._interrupts = False

    def _on_signal(self, _number: int, _frame: object) -> None:
        self.requested = True
        if self._interrupts:
            self._interrupts = (
                False  # another one must not interrupt the cleaning up after this one
            )
            raise KeyboardInterrupt
