"""`knee-contact demo`: the real node in a process of its own, fed over real topics in a private ROS graph.

This process replays the bag and listens to the answers; the node computes, records and draws. The example of an assist
controller can listen beside it, as a companion in a third process. The results appear under their names when all is
done; an interrupted demo leaves nothing behind.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import click
import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Float64MultiArray

from knee_contact_ros.bags.reader import BagReader, RawMessage
from knee_contact_ros.messages.cdr import stamp_in
from knee_contact_ros.messages.ros_types import stamp_to_ns
from knee_contact_ros.messages.topics import INPUTS, JOINT_REACTION_FORCE, JOINT_STATES, KNEE_CONTACT
from knee_contact_ros.msg import KneeContact
from knee_contact_ros.offline.replay.keyboard import Command
from knee_contact_ros.offline.replay.player import Player
from knee_contact_ros.offline.replay.replay import Replayer
from knee_contact_ros.offline.summary import Summary, read_summary
from knee_contact_ros.offline.summary_table import show_summary
from knee_contact_ros.parameters.plausibility import Doubts
from knee_contact_ros.parameters.reading import load_parameters
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.pipeline.pipeline import Pipeline
from knee_contact_ros.pipeline.samples import RefusedSampleError, angle_sample
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.executor import executor_of
from knee_contact_ros.system.output_files import partial_name
from knee_contact_ros.system.processes import PATIENCE, Child, child_process
from knee_contact_ros.system.resources import share_folder
from knee_contact_ros.system.ros_graph import joining, private_graph
from knee_contact_ros.system.terminal import progress, warn
from knee_contact_ros.system.work_folder import replace, work_folder
from knee_contact_ros.view.picture import write_peak
from knee_contact_ros.view.window import NOT_INSTALLED, has_screen, viewer

NODE_START = 300.0
"""How long [s] the node may take to appear; it may have to compile first."""
LOOK = 0.05
"""How often [s] to look for files that are being completed"""
LAST_ANSWERS = 3.0
"""How long [s] to wait for the last answers once nothing more comes."""
RECORDING = Path("recording") / "recording_0.mcap"
RERUN_FILE = Path("knee_contact.rrd")
PICTURE = Path("knee.png")
NODE_LOG = Path("node.log")
COMPANION_LOG = Path("companion.log")
COMPANION_COMMANDS = "knee_effort_controller/commands"


@dataclass
class Listener:
    """Counts what was published and what was answered, and how long each answer took."""

    published: dict[int, float] = field(default_factory=dict)
    """Time [s] at which the force of a stamp [ns] was published"""
    latencies: list[float] = field(default_factory=list)
    """[s] from publishing a force to receiving its answer"""
    torques: list[float] = field(default_factory=list)
    """[N m] the companion's commands"""
    heard: set[str] = field(default_factory=set)
    """Inputs on which the node hears somebody, as it says itself"""

    def on_published(self, message: RawMessage) -> None:
        """Note a published input."""
        if message.topic == f"/{JOINT_REACTION_FORCE}":
            self.published[stamp_in(message.data)] = time.perf_counter()

    def on_contact(self, message: KneeContact) -> None:
        """Note an answer."""
        sent = self.published.get(stamp_to_ns(message.header.stamp))
        if sent is not None:
            self.latencies.append(time.perf_counter() - sent)

    def on_command(self, message: Float64MultiArray) -> None:
        """Note a command of the companion."""
        self.torques.append(message.data[0])

    def on_diagnostics(self, message: DiagnosticArray) -> None:
        """Note what the node hears: it may find a publisher later than the publisher finds it."""
        for status in message.status:
            counts = [value.value for value in status.values if value.key == "publishers"]
            if counts and counts != ["0"]:
                self.heard.add(status.name.rpartition(" ")[2])

    @property
    def missing(self) -> int:
        """Forces without an answer so far."""
        return len(self.published) - len(self.latencies)


def run_demo(bag: Path, parameter_files: list[Path], output: Path, rate: float, companion: bool) -> None:
    """Run the demo, with or without the companion, and print its table.

    Raises:
        UsageError: the bag, a parameter or the output folder cannot be used, ROS does not let us in, or the node or its
            companion has failed.
    """
    parameters = load_parameters(parameter_files)
    doubts = check_before(bag, parameters)
    with BagReader(bag) as reader, work_folder(output) as work, private_graph() as environment:
        os.environ.update(environment)
        listener = Listener()
        with ExitStack() as opened:
            processes = [opened.enter_context(node_process(parameter_files, work))]
            if companion:
                processes.append(opened.enter_context(companion_process(work)))

            def all_are_alive() -> None:
                for process in processes:
                    process.check()

            play(reader, rate, listener, all_are_alive, companion)
        summary = read_summary(work / RECORDING.parent, parameters.body_weight, doubts)
        picture = draw_peak(work)
        for result in (RECORDING.parent, RERUN_FILE, PICTURE, NODE_LOG, COMPANION_LOG):
            replace(work / result, output / result)
    show_summary(summary, live_rows(listener, summary), result_files(output, companion) | picture_row(output, picture))
    warn(summary.sentences)
    if viewer():
        offer(output / RERUN_FILE)


def draw_peak(work: Path) -> str:
    """Draw the knee at the largest load; give why there is no picture, nothing if there is one."""
    try:
        write_peak(work / RECORDING.parent, work / PICTURE)
    except UsageError as error:
        return str(error)
    return ""


def picture_row(output: Path, missing: str) -> dict[str, str]:
    """Where the picture is, or why it is missing."""
    return {"No picture": missing} if missing else {"Knee at the peak": str(output / PICTURE)}


def offer(scene: Path) -> None:
    """On a terminal with a screen, ask whether to open the scene, and do."""
    if not (has_screen() and sys.stdin.isatty() and sys.stdout.isatty()):
        return
    from knee_contact_ros.offline.view import look_at  # Rerun, which may be missing

    with suppress(click.Abort):  # Ctrl-D or Ctrl-C: all is there, and said
        if click.confirm("Open the scene in the Rerun viewer?", default=True):
            look_at(scene)


def check_before(bag: Path, parameters: Parameters) -> Doubts:
    """Tell what the node could only refuse: a bad profile, a bag without topics, a joint that is not there.

    Returns what makes no sense in the parameters.

    Raises:
        UsageError: one of these.
    """
    pipeline = Pipeline(parameters, compiled=False)
    with BagReader(bag) as reader:
        angle = next(message.data for message in reader.raw_messages() if message.topic == f"/{JOINT_STATES}")
    try:
        message, _ = pipeline.decoder.joint_state(angle)
        angle_sample(message, pipeline.parameters.knee, pipeline.model.height_prescribed)
    except RefusedSampleError as refused:
        raise UsageError(f"bag {bag}: {refused} (parameters knee.*)") from None
    return pipeline.doubts


def play(
    reader: BagReader, rate: float, listener: Listener, all_are_alive: Callable[[], None], companion: bool
) -> None:
    """Replay the bag and collect the answers, and the companion's commands."""
    with joining():
        rclpy.init(args=None, signal_handler_options=SignalHandlerOptions.NO)
        node = Node("knee_contact_demo")
    executor = executor_of(node)
    try:
        node.create_subscription(KneeContact, KNEE_CONTACT, listener.on_contact, QoSProfile(depth=1000))
        node.create_subscription(Float64MultiArray, COMPANION_COMMANDS, listener.on_command, QoSProfile(depth=1000))
        node.create_subscription(DiagnosticArray, "/diagnostics", listener.on_diagnostics, QoSProfile(depth=100))
        messages = list(reader.raw_messages())
        replayer = Replayer(node)

        def spin(seconds: float) -> Sequence[Command]:
            executor.spin_once(timeout_sec=seconds)
            return ()

        with progress("Starting the node (the first time it compiles, for half a minute or a minute)") as advance:
            deadline = time.monotonic() + NODE_START
            while not (
                replayer.wait_for_subscribers(0.1, spin)
                and node.count_publishers(KNEE_CONTACT)
                and listener.heard == set(INPUTS)
                and (not companion or (node.count_publishers(COMPANION_COMMANDS) and listener.torques))
            ):
                spin(0.1)
                all_are_alive()
                if time.monotonic() > deadline:
                    raise UsageError(f"the node did not appear within {NODE_START:g} s")
        with progress("Walking") as advance:
            player = Player(replayer.publish, spin, rate=rate)
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
    """Wait until every force is answered, or until nothing has come for a while."""
    missing, since = listener.missing, time.monotonic()
    while missing and time.monotonic() - since < LAST_ANSWERS:
        spin(0.1)
        if listener.missing != missing:
            missing, since = listener.missing, time.monotonic()


@contextmanager
def node_process(parameter_files: list[Path], work: Path, patience: float = PATIENCE) -> Iterator[Child]:
    """The node in a process of its own, which records, and draws if Rerun is installed, in the folder `work`.

    See `child_process`.

    On a busy machine its files are complete some time after it has ended: they are waited for.
    """
    arguments = ["-m", "knee_contact_ros.cli.main", "node", "--ros-args"]
    for path in parameter_files:
        arguments += ["--params-file", str(path)]
    drawing = {"rerun.mode": "file", "rerun.path": work / RERUN_FILE} if viewer() else {}
    for name, value in {"record.path": work / RECORDING, **drawing}.items():
        arguments += ["-p", f'{name}:="{value}"']
    with child_process("the node", arguments, work / NODE_LOG, patience) as node:
        yield node
    deadline = time.monotonic() + patience
    while any(partial_name(work / name).exists() for name in (RECORDING, RERUN_FILE)) and time.monotonic() < deadline:
        time.sleep(LOOK)


@contextmanager
def companion_process(work: Path) -> Iterator[Child]:
    """The example of an assist controller in a process of its own."""
    example = share_folder() / "examples" / "assist_as_needed.py"
    arguments = [str(example), "--ros-args", "--params-file", str(example.with_suffix(".yaml"))]
    with child_process("the companion", arguments, work / COMPANION_LOG) as companion:
        yield companion


def live_rows(listener: Listener, summary: Summary) -> dict[str, str]:
    """Rows of the table that only a live run has."""
    rows = {"dropped": str(len(listener.published) - summary.ticks)}
    if listener.latencies:
        median, p99, largest = np.percentile(listener.latencies, [50, 99, 100]) * 1e3
        rows["latency"] = f"{median:.2f} ms median, {p99:.2f} ms p99, {largest:.2f} ms max"
    if listener.torques:
        highest = max(listener.torques)
        lowest = min(listener.torques[listener.torques.index(highest) :])
        rows["assist torque"] = f"{highest:.1f} N m, lowered to {lowest:.1f} N m"
    return rows


def result_files(output: Path, companion: bool) -> dict[str, str]:
    """Where the results are, and how to look at them."""
    files = {"Recording": str(output / RECORDING.parent), "Node's log": str(output / NODE_LOG)}
    if companion:
        files["Companion's log"] = str(output / COMPANION_LOG)
    if not viewer():
        return files | {"Not drawn": NOT_INSTALLED}
    to_see = f"{Path(sys.executable).with_name('knee-contact')} view {output / RERUN_FILE}"
    return files | {"Rerun file": str(output / RERUN_FILE), "To see it": to_see}
