"""Parts that demos share: nodes and companion in processes of their own, and a bag that is played to them.

This process replays the bag and listens to the answers; the nodes compute, record and draw. The example of an assist
controller can listen beside them, as a companion in a further process.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Float64MultiArray

from knee_contact_ros.bags.reader import BagReader, RawMessage
from knee_contact_ros.commands.player import Command, Player
from knee_contact_ros.commands.replay import Replayer
from knee_contact_ros.msg import KneeContact
from knee_contact_ros.streams.messages import stamp_in
from knee_contact_ros.streams.topics import KNEE_CONTACT, stamp_to_ns
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.files import share_folder
from knee_contact_ros.system.output_files import partial_name
from knee_contact_ros.system.processes import PATIENCE, Child, child_process
from knee_contact_ros.system.ros import executor_of, joining
from knee_contact_ros.system.terminal import progress
from knee_contact_ros.view.viewer import viewer

NODE_START = 300.0
"""Time [s] that the nodes may take to appear; they may have to compile first"""
POLL_PERIOD = 0.05
"""Time [s] between two looks at files that are being completed"""
LAST_ANSWERS = 3.0
"""Time [s] to wait for further answers after the last one"""
RECORDING = Path("recording") / "recording_0.mcap"
LOAD_RECORDING = Path("load_recording") / "load_recording_0.mcap"
RERUN_FILE = Path("knee_contact.rrd")
NODE_LOG = Path("node.log")
LOAD_LOG = Path("load.log")
COMPANION_LOG = Path("companion.log")
NODE_NAMES = {"node": "the node", "load": "the load node"}
"""Names of the nodes in messages, by command"""
COMPANION_COMMANDS = "knee_effort_controller/commands"


@dataclass
class Listener:
    """Counts published inputs and answers, and measures how long each answer took."""

    force_topic: str
    """Name of the topic of the forces, each of which has an answer"""
    published: dict[int, float] = field(default_factory=dict)
    """Time [s] at which the force of a stamp [ns] was published"""
    latencies: list[float] = field(default_factory=list)
    """Times [s] from publishing a force to receiving its answer"""
    torques: list[float] = field(default_factory=list)
    """Torques [N m] that the companion commanded"""
    heard: set[str] = field(default_factory=set)
    """Inputs of nodes that have a publisher, by their diagnostics, as `knee_contact: joint_states`"""

    def on_published(self, message: RawMessage) -> None:
        """Note the time at which an input was published, if it is a force."""
        if message.topic == f"/{self.force_topic}":
            self.published[stamp_in(message.data)] = time.perf_counter()

    def on_contact(self, message: KneeContact) -> None:
        """Note the latency of an answer."""
        sent = self.published.get(stamp_to_ns(message.header.stamp))
        if sent is not None:
            self.latencies.append(time.perf_counter() - sent)

    def on_command(self, message: Float64MultiArray) -> None:
        """Note the torque that the companion commands."""
        self.torques.append(message.data[0])

    def on_diagnostics(self, message: DiagnosticArray) -> None:
        """Note which inputs have a publisher: a node may find a publisher later than the publisher finds the node."""
        for status in message.status:
            counts = [value.value for value in status.values if value.key == "publishers"]
            if counts and counts != ["0"]:
                self.heard.add(status.name)

    @property
    def torque(self) -> float:
        """Newest torque [N m] that the companion commanded; 0 before the first one."""
        return self.torques[-1] if self.torques else 0.0

    @property
    def missing(self) -> int:
        """Number of forces without an answer so far."""
        return len(self.published) - len(self.latencies)


class Play(NamedTuple):
    """Options of playing a bag."""

    rate: float
    """Rate in seconds of the bag per second"""
    inputs: Sequence[str]
    """Names of the topics that are played"""
    heard: Collection[str]
    """Inputs that must have a publisher before the bag is played, as in `Listener.heard`"""
    companion: bool
    """Whether there is a companion to wait for"""
    changed: Callable[[RawMessage, float], RawMessage]
    """Function that returns an input as it is published while the companion commands a torque [N m]"""


def play(reader: BagReader, options: Play, listener: Listener, all_are_alive: Callable[[], None]) -> None:
    """Replay the bag, and collect the answers and the companion's commands.

    `all_are_alive` raises an error if a process has ended.

    Raises:
        UsageError: the nodes did not appear in time.
    """
    with joining():
        rclpy.init(args=None, signal_handler_options=SignalHandlerOptions.NO)
        node = Node("knee_contact_demo")
    executor = executor_of(node)
    try:
        node.create_subscription(KneeContact, KNEE_CONTACT, listener.on_contact, QoSProfile(depth=1000))
        node.create_subscription(Float64MultiArray, COMPANION_COMMANDS, listener.on_command, QoSProfile(depth=1000))
        node.create_subscription(DiagnosticArray, "/diagnostics", listener.on_diagnostics, QoSProfile(depth=100))
        messages = list(reader.raw_messages())
        replayer = Replayer(node, inputs=options.inputs)

        def spin(seconds: float) -> Sequence[Command]:
            executor.spin_once(timeout_sec=seconds)
            return ()

        with progress("Starting the node (a new kind of knee is compiled)") as advance:
            deadline = time.monotonic() + NODE_START
            while not (
                replayer.wait_for_subscribers(0.1, spin)
                and node.count_publishers(KNEE_CONTACT)
                and listener.heard >= set(options.heard)
                and (not options.companion or (node.count_publishers(COMPANION_COMMANDS) and listener.torques))
            ):
                spin(0.1)
                all_are_alive()
                if time.monotonic() > deadline:
                    raise UsageError(f"the node did not appear within {NODE_START:g} s")
        with progress("Walking") as advance:
            player = Player(
                lambda message: replayer.publish(options.changed(message, listener.torque)), spin, rate=options.rate
            )
            for number, (message, _) in enumerate(player.play(messages), start=1):
                listener.on_published(message)
                advance(number, len(messages))
        wait_for_last_answers(listener, spin)
        all_are_alive()
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown()


def wait_for_last_answers(listener: Listener, spin: Callable[[float], object]) -> None:
    """Wait until every force is answered, or until no answer has come for `LAST_ANSWERS`; `spin` waits so long [s]."""
    missing, since = listener.missing, time.monotonic()
    while missing and time.monotonic() - since < LAST_ANSWERS:
        spin(0.1)
        if listener.missing != missing:
            missing, since = listener.missing, time.monotonic()


def node_process(
    parameter_files: list[Path], work: Path, patience: float = PATIENCE, values: Mapping[str, str] | None = None
) -> AbstractContextManager[Child]:
    """Run the contact node in a process of its own, which records, and draws if Rerun is installed, in `work`.

    `values` are further parameters, as ROS 2 spells them on the command line; for `patience` [s] see `child_process`.
    """
    outputs = {"record.path": work / RECORDING} | ({"rerun.path": work / RERUN_FILE} if viewer() else {})
    drawing = {"rerun.mode": '"file"'} if viewer() else {}
    return _node("node", parameter_files, outputs, {**drawing, **(values or {})}, work / NODE_LOG, patience)


def load_process(parameter_files: list[Path], work: Path, values: Mapping[str, str]) -> AbstractContextManager[Child]:
    """Run the load node in a process of its own, which records in `work`; `values` are further parameters."""
    outputs = {"record.path": work / LOAD_RECORDING}
    return _node("load", parameter_files, outputs, values, work / LOAD_LOG, PATIENCE)


@contextmanager
def _node(
    command: str, parameter_files: list[Path], outputs: Mapping[str, Path], values: Mapping[str, str], log: Path,
    patience: float,
) -> Iterator[Child]:  # fmt: skip
    """Run a command that is a node, with parameter files, paths of outputs by parameter, and further parameters."""
    arguments = ["-m", "knee_contact_ros.commands.main", command, "--ros-args"]
    for path in parameter_files:
        arguments += ["--params-file", str(path)]
    for name, value in {**{name: f'"{path}"' for name, path in outputs.items()}, **values}.items():
        arguments += ["-p", f"{name}:={value}"]
    with child_process(NODE_NAMES[command], arguments, log, patience) as node:
        yield node
    wait_until_complete(outputs.values(), patience)


def wait_until_complete(outputs: Collection[Path], patience: float) -> None:
    """Wait for files, for `patience` [s] at most: on a busy machine they are completed after their node has ended."""
    deadline = time.monotonic() + patience
    while any(partial_name(path).exists() for path in outputs) and time.monotonic() < deadline:
        time.sleep(POLL_PERIOD)


@contextmanager
def companion_process(work: Path, values: Mapping[str, str]) -> Iterator[Child]:
    """Run the example of an assist controller in a process of its own; `values` are parameters that differ."""
    example = share_folder() / "examples" / "assist_as_needed.py"
    arguments = [str(example), "--ros-args", "--params-file", str(example.with_suffix(".yaml"))]
    for name, value in values.items():
        arguments += ["-p", f"{name}:={value}"]
    with child_process("the companion", arguments, work / COMPANION_LOG) as companion:
        yield companion
