"""`knee-contact demo`: the real nodes in processes of their own, fed over real topics in a private ROS graph.

Usually a recorded joint reaction is played to the contact node. With parameters of the load node (`--from-sensors`) a
leg's sensors are played to that node before it. The example of an assist controller can listen as a companion in its
own process. With sensors it closes the loop: its torque is the `effort` in the played joint states, the load node
subtracts it from the net moment, and load and contact, to which the companion listens, change.

The results appear under their names when all is done; an interrupted demo leaves nothing behind.
"""

import os
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import click
import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Float64MultiArray

from ..bags.answers import read_answers, read_bag
from ..bags.bag import Bag, RawMessage
from ..bags.names import OWN_NAMES
from ..model.knee import KneeModel
from ..model.ringing import Ringing
from ..msg import KneeContact
from ..offline.bag_inputs import BagInputs
from ..offline.estimate_load import estimate_load
from ..offline.solve import solve
from ..offline.summary import read_summary
from ..parameters.files import load_parameters
from ..parameters.load_schema import ActuatedJoint, LoadParameters
from ..parameters.schema import Parameters, has_two_compartments
from ..results import begin_of, stamp_text
from ..streams.contact_pipeline import ContactPipeline
from ..streams.messages import decode_joint_state, encode_joint_state, stamp_in
from ..streams.topics import (
    INPUTS,
    JOINT_REACTION_FORCE,
    KNEE_CONTACT,
    LOAD_ESTIMATE,
    LOAD_INPUTS,
    MEDIAL,
    MESSAGE_TYPES,
    NANOSECONDS,
    stamp_to_ns,
    types_of,
)
from ..system.errors import UsageError
from ..system.files import require, share_folder
from ..system.output_files import partial_name, replace, work_folder
from ..system.processes import EXIT_PATIENCE, Child, child_process
from ..system.progress import progress
from ..system.ros import make_executor, one_line_ros_errors, private_graph
from ..system.terminal import as_json, say, warn
from ..view.output import (
    NOT_INSTALLED,
    find_viewer,
    has_display,
    run_viewer,
    viewer_command,
)
from ..view.picture import draw_knee, saved_figure
from .player import Command, Player
from .replay import Replayer
from .tables import count_text, show_summary

SENSOR_BAG = "gait2354_right_sensors"
"""Bundled bag with a leg's sensors"""
LOAD_BAG = "gait2354_right"
"""Bundled bag with the joint reaction of the same gait by a musculoskeletal model"""
LOAD_FILE = "load/gait2354.yaml"
"""Parameter file of the load node for `SENSOR_BAG`"""
FORCE_LIMIT = 700.0
"""Contact force [N] above which the companion lowers its torque with sensors, which never reach its default"""
_START_TIMEOUT = 300.0
"""Time [s] that the nodes may take to appear; they may have to compile first"""
_POLL_PERIOD = 0.05
"""Time [s] between two checks of files that are being completed"""
_LAST_ANSWERS = 3.0
"""Time [s] to wait for further answers after the last one"""
RECORDING = Path("recording") / "recording_0.mcap"
_LOAD_RECORDING = Path("load_recording") / "load_recording_0.mcap"
_RERUN_FILE = Path("knee_contact.rrd")
_PICTURE = Path("knee.png")
_NODE_LOG = Path("node.log")
_LOAD_LOG = Path("load.log")
_COMPANION_LOG = Path("companion.log")
_RESULTS = (
    RECORDING.parent,
    _LOAD_RECORDING.parent,
    _RERUN_FILE,
    _PICTURE,
    _NODE_LOG,
    _LOAD_LOG,
    _COMPANION_LOG,
)
"""Names of the results of all demos: a demo replaces those of an earlier one"""
_PICTURE_SIZE = (5.2, 6.0)
"""Size of the picture [in]"""
_PICTURE_DPI = 160
_PICTURE_STYLE: Any = {"font.size": 10, "axes.titlesize": 10.5, "figure.dpi": _PICTURE_DPI}
_COMPANION_COMMANDS = "knee_effort_controller/commands"
_CANNOT_SEE = (
    "people change how much they co-contract when assisted, and this estimate cannot see that: it only takes the "
    "torque off the net moment"
)


@dataclass
class Listener:
    """Counts published inputs and answers, and measures how long each answer took."""

    inputs: Sequence[str]
    """Names of the topics that are played: angles, and forces, each of which has an answer"""
    assisted: ActuatedJoint | None
    """Joint whose effort is the companion's torque"""
    published: dict[int, float] = field(default_factory=dict)
    """Time [s] at which the force of a stamp [ns] was published"""
    latencies: list[float] = field(default_factory=list)
    """Times [s] from publishing a force to receiving its answer"""
    torques: list[float] = field(default_factory=lambda: [0.0])
    """Torques [N m] that the companion commanded, after 0"""
    connected: set[str] = field(default_factory=set)
    """Inputs of nodes that have a publisher, by their diagnostics, as `knee_contact: joint_states`"""

    def listen(self, node: Node) -> None:
        """Subscribe to answers, to the companion's commands and to diagnostics.

        A node may find a publisher later than the publisher finds the node: its diagnostics say when it has.
        """

        def on_contact(message: KneeContact) -> None:
            if sent := self.published.get(stamp_to_ns(message.header.stamp)):
                self.latencies.append(time.perf_counter() - sent)

        def on_command(message: Float64MultiArray) -> None:
            self.torques.append(message.data[0])

        def on_diagnostics(message: DiagnosticArray) -> None:
            for status in message.status:
                publishers = {value.value for value in status.values if value.key == "publishers"}
                if publishers - {"0"}:
                    self.connected.add(status.name)

        qos = QoSProfile(depth=1000)
        node.create_subscription(KneeContact, KNEE_CONTACT, on_contact, qos)
        node.create_subscription(Float64MultiArray, _COMPANION_COMMANDS, on_command, qos)
        node.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, qos)

    def publish(self, message: RawMessage, replayer: Replayer) -> None:
        """Publish an input; note the time if it is a force, and add the companion's torque if it assists a joint."""
        is_force = message.topic == f"/{self.inputs[1]}"
        if self.assisted and not is_force:
            data = with_assistance(message.data, self.assisted, self.torques[-1])
            message = message._replace(data=data)
        replayer.publish(message)
        if is_force:
            self.published[stamp_in(message.data)] = time.perf_counter()

    @property
    def missing(self) -> int:
        """Number of forces without an answer so far."""
        return len(self.published) - len(self.latencies)


def run_demo(
    bag: Path | None,
    files: list[Path],
    load_files: list[Path],
    companion: bool,
    output: Path,
    rate: float,
) -> None:
    """Run the demo and print its table.

    Args:
        bag: Bag to play; None: a bundled one.
        files: Parameter files of the contact node.
        load_files: Parameter files of the load node, to which sensors are played; without any there is no such node.
        companion: Whether the example of an assist controller runs too.
        output: Folder of the results.
        rate: Seconds of the bag per second.

    Raises:
        UsageError: the bag, a parameter or the output folder cannot be used, ROS cannot be joined, a node or the
            companion has failed, or the contact node has answered nothing.
    """
    bag = bag or share_folder() / "bags" / (SENSOR_BAG if load_files else LOAD_BAG)
    assisted = {"knee.assisted": True} if companion and load_files else {}
    load = load_parameters([*load_files, assisted], LoadParameters) if load_files else None
    values = {"body_weight": load.person.constants.weight} if load else {}
    parameters = load_parameters([*files, values])
    stream = ContactPipeline(parameters, compiled=False)
    inputs = LOAD_INPUTS if load else INPUTS
    types = types_of(inputs)
    joints = parameters.joints() | (load.joints() if load else {})
    with Bag(bag) as opened_bag:
        BagInputs(opened_bag, load or parameters, OWN_NAMES).check_joints(joints)
        messages = list(opened_bag.select(types).raw_messages())
    needed = {f"knee_contact: {topic}" for topic in INPUTS}
    if load:
        needed |= {f"knee_load: {topic}" for topic in LOAD_INPUTS}
    listener = Listener(inputs, load.knee if load and assisted else None)
    with work_folder(output) as work, private_graph() as environment:
        os.environ.update(environment)
        processes: list[AbstractContextManager[Child]] = [node_process(files, work, values=values)]
        if companion:
            processes.append(companion_process(work, {"force_limit": FORCE_LIMIT} if load else {}))
        if load:
            processes.append(node_process(load_files, work, values=assisted, load=True))
        with ExitStack() as opened:
            children = [opened.enter_context(process) for process in processes]
            play_gait(messages, rate, listener, needed, companion, children)
        summary = read_summary(
            work / RECORDING.parent, parameters.body_weight, stream.doubts, Ringing(stream.model)
        )
        if not summary.ticks:
            raise UsageError(
                f"bag {bag}: the node has answered nothing; refused: {count_text(summary.refused)}"
            )
        rows = live_rows(listener, summary.ticks)
        if load:
            rows |= load_rows(bag, load, work)
        if load and assisted:
            largest_force = summary.peaks["contact_force"].contact_force
            rows |= assisted_rows(bag, load, parameters, work, largest_force)
        places = result_files(output, load is not None, companion)
        try:
            draw_peak(work / RECORDING.parent, stream.model, parameters, work / _PICTURE)
            places["Knee at the peak"] = str(output / _PICTURE)
        except UsageError as error:
            places["No picture"] = str(error)
        for result in _RESULTS:
            replace(work / result, output / result)
    show_summary(summary, rows, places)
    warn(summary.sentences)
    if find_viewer() and not as_json():
        offer(output / _RERUN_FILE)


def live_rows(listener: Listener, ticks: int) -> dict[str, str]:
    """Return the rows of the table that only a live run has."""
    rows = {"dropped": str(len(listener.published) - ticks)}
    if listener.latencies:
        median, p99, most = np.percentile(listener.latencies, [50, 99, 100]) * 1e3
        name = "force" if JOINT_REACTION_FORCE in listener.inputs else "sensors"
        rows[f"{name} to answer"] = (
            f"{median:.2f} ms (median), {p99:.2f} ms (p99), {most:.2f} ms (largest)"
        )
    if len(torques := listener.torques) > 1:
        highest = max(torques)
        rows["assist torque"] = (
            f"{highest:.1f} N m, lowered to {min(torques[torques.index(highest) :]):.1f} N m"
        )
    return rows


def draw_peak(recording: Path, model: KneeModel, parameters: Parameters, picture: Path) -> str:
    """Draw a PNG of the medial (or only) knee of a recording where the load is largest; return its title.

    Where the femoral height drives the model, the largest contact force counts.

    Raises:
        UsageError: matplotlib is not installed.
    """
    require("report", "matplotlib")
    answers = read_answers(recording)
    what = "contact_force" if model.height_prescribed else "load"
    # The load of a doubtful answer may be NaN, which argmax would take for the largest.
    peak = answers[int(np.nan_to_num(answers[what], nan=-np.inf).argmax())]
    which = f"{MEDIAL} compartment, " if has_two_compartments(parameters) else ""
    when = stamp_text(int(peak["stamp"]), begin_of(int(answers["stamp"][0])))
    title = f"{which}largest {what.replace('_', ' ')}, at {when} s"
    angle, height, force = (
        float(peak[name]) for name in ("flexion_angle", "femoral_height", "contact_force")
    )
    with saved_figure({"png": picture}, _PICTURE_SIZE, _PICTURE_DPI, **_PICTURE_STYLE) as figure:
        knee = figure.subplots()
        draw_knee(knee, model, angle, height, force, parameters.body_weight)
        knee.set_title(title)
    return title


def result_files(output: Path, load: bool, companion: bool) -> dict[str, str]:
    """Return the names and places of the results, and the command that shows them."""
    places = {}
    if load:
        places["Load's recording"] = output / _LOAD_RECORDING.parent
        places["Load's log"] = output / _LOAD_LOG
    places["Recording"] = output / RECORDING.parent
    places["Node's log"] = output / _NODE_LOG
    if companion:
        places["Companion's log"] = output / _COMPANION_LOG
    names = {name: str(place) for name, place in places.items()}
    if not find_viewer():
        return names | {"Not drawn": NOT_INSTALLED}
    scene = str(output / _RERUN_FILE)
    command = Path(sys.executable).with_name("knee-contact")
    return names | {"Rerun file": scene, "To see it": f"{command} view {scene}"}


def tell_in_a_pipe(what: str) -> None:
    """Say what happens where no progress bar shows it."""
    if not sys.stderr.isatty():
        say(f"knee-contact demo: {what}", err=True)


def play_gait(
    messages: Sequence[RawMessage],
    rate: float,
    listener: Listener,
    needed: set[str],
    companion: bool,
    children: Sequence[Child],
) -> None:
    """Replay messages at a rate, and let the `listener` collect the answers and the companion's commands.

    It waits until the inputs `needed` have a publisher, as in `Listener.connected`, and the companion commands
    something.

    Raises:
        UsageError: the nodes did not appear in time, or a process has ended.
    """
    with one_line_ros_errors():
        rclpy.init(args=None, signal_handler_options=SignalHandlerOptions.NO)
        node = Node("knee_contact_demo")
    executor = make_executor(node)

    def spin(seconds: float) -> Sequence[Command]:
        executor.spin_once(timeout_sec=seconds)
        return ()

    def check() -> None:
        for child in children:
            child.check()

    try:
        listener.listen(node)
        replayer = Replayer(node, inputs=listener.inputs)
        tell_in_a_pipe("starting the node, which takes 5 to 30 s")
        with progress("Starting the node"):
            deadline = time.monotonic() + _START_TIMEOUT
            while not (
                replayer.wait_for_subscribers(0.1, spin)
                and node.count_publishers(KNEE_CONTACT)
                and listener.connected >= needed
                and (not companion or len(listener.torques) > 1)
            ):
                spin(0.1)
                check()
                if time.monotonic() > deadline:
                    raise UsageError(f"the node did not appear within {_START_TIMEOUT:g} s")
        seconds = (messages[-1].log_time - messages[0].log_time) / NANOSECONDS / rate
        tell_in_a_pipe(f"walking for {seconds:.1f} s")
        with progress("Walking") as advance:
            for number, (message, _) in enumerate(Player(spin, rate=rate).play(messages), start=1):
                listener.publish(message, replayer)
                advance(number, len(messages))
        missing = listener.missing
        since = time.monotonic()
        while missing and time.monotonic() - since < _LAST_ANSWERS:
            spin(0.1)
            if listener.missing != missing:
                missing = listener.missing
                since = time.monotonic()
        check()
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown()


@contextmanager
def node_process(
    files: list[Path],
    work: Path,
    patience: float = EXIT_PATIENCE,
    values: Mapping[str, Any] | None = None,
    load: bool = False,
) -> Iterator[Child]:
    """Run the contact node, or the `load` node, in its own process, with parameter files and further `values`.

    It records in `work`, and the contact node also draws there if Rerun is installed; for `patience` [s] see
    `child_process`.
    """
    outputs = {"record.path": work / (_LOAD_RECORDING if load else RECORDING)}
    values = dict(values or {})
    if find_viewer() and not load:
        outputs["rerun.path"] = work / _RERUN_FILE
        values["rerun.mode"] = '"file"'
    paths = {name: f'"{path}"' for name, path in outputs.items()}
    command = ["-m", "knee_contact_ros.commands.main", "load" if load else "node"]
    arguments = [*command, *ros_arguments(files, paths | values)]
    name = "the load node" if load else "the node"
    log = work / (_LOAD_LOG if load else _NODE_LOG)
    with child_process(name, arguments, log, patience) as node:
        yield node
    # A busy machine completes the files after their node has ended.
    deadline = time.monotonic() + patience
    unfinished = [partial_name(path) for path in outputs.values()]
    while any(path.exists() for path in unfinished) and time.monotonic() < deadline:
        time.sleep(_POLL_PERIOD)


def companion_process(work: Path, values: Mapping[str, Any]) -> AbstractContextManager[Child]:
    """Run the example of an assist controller in a process of its own; `values` are parameters that differ."""
    example = share_folder() / "examples" / "assist_as_needed.py"
    arguments = [str(example), *ros_arguments([example.with_suffix(".yaml")], values)]
    return child_process("the companion", arguments, work / _COMPANION_LOG)


def ros_arguments(files: Iterable[Path], values: Mapping[str, Any]) -> list[str]:
    """Return the arguments of a node with parameter files and further parameters."""
    arguments = ["--ros-args"]
    for path in files:
        arguments += ["--params-file", str(path)]
    for name, value in values.items():
        arguments += ["-p", f"{name}:={value}"]
    return arguments


def offer(scene: Path) -> None:
    """Ask whether to open the scene in a viewer, if there are a terminal and a screen."""
    if not (has_display() and sys.stdin.isatty() and sys.stdout.isatty()):
        return
    with suppress(click.Abort):  # Ctrl-D or Ctrl-C: all is there, and said
        if click.confirm("Open the scene in the Rerun viewer?", default=True):
            run_viewer(viewer_command(str(scene)))


def largest_load(bag: Path) -> float:
    """Return the largest joint reaction of a bag [N]."""
    topic = f"/{JOINT_REACTION_FORCE}"
    messages = read_bag(bag, {topic: MESSAGE_TYPES[JOINT_REACTION_FORCE]})
    return float(max(-message.message.wrench.force.y for message in messages))


def load_rows(bag: Path, load: LoadParameters, work: Path) -> dict[str, str]:
    """Return rows on the estimated load, and on the recorded one of the bundled bag."""
    weight = load.person.constants.weight
    calibrated = "no: for looking, nothing may be limited or triggered by it"
    rows = {
        "load's level": load.chosen_level,
        "calibrated": "yes" if load.calibrated else calibrated,
    }
    types = {f"/{LOAD_ESTIMATE}": MESSAGE_TYPES[LOAD_ESTIMATE]}
    estimates = [message.message for message in read_bag(work / _LOAD_RECORDING.parent, types)]
    peak = max(estimates, key=lambda estimate: estimate.axial_force)
    rows["estimated load"] = (
        f"{peak.axial_force:.1f} N ({peak.axial_force / weight:.2f} BW), "
        f"standard deviation {peak.standard_deviation:.0f} N"
    )
    if bag.resolve() == (share_folder() / "bags" / SENSOR_BAG).resolve():
        recorded = largest_load(bag.with_name(LOAD_BAG))
        rows["recorded load"] = (
            f"{recorded:.1f} N ({recorded / weight:.2f} BW), by OpenSim from muscles"
        )
    return rows


def assisted_rows(
    bag: Path, load: LoadParameters, parameters: Any, work: Path, most: float
) -> dict[str, str]:
    """Return rows that compare the contact, `most` [N], with that of the same bag without assistance, offline."""
    loads = work / "without_assistance.mcap"
    unassisted = load_parameters([load, {"knee.assisted": False}], LoadParameters)
    with Bag(bag) as sensors:
        estimate_load(sensors, unassisted, loads)
    with Bag(loads) as estimated:
        alone = solve(estimated, parameters, None).peaks["contact_force"].contact_force
    return {
        "gives way above": f"{FORCE_LIMIT:.0f} N of contact force",
        "largest contact": f"{alone:.1f} N without assistance, {most:.1f} N with it",
        "warning": _CANNOT_SEE,
    }


def with_assistance(data: bytes, knee: ActuatedJoint, torque: float) -> bytes:
    """Return a JointState, as bytes, in which an actuator exerts a torque [N m] that extends the knee.

    An effort is in the sense of its joint's position: where that grows with flexion (`knee.sign` 1), it is minus the
    torque. A message without the knee, or one that only ROS can decode, is returned unchanged.
    """
    message = decode_joint_state(data)
    if message is None or knee.joint_name not in message.name:
        return data
    efforts = [*message.effort, *[0.0] * (len(message.name) - len(message.effort))]
    efforts[message.name.index(knee.joint_name)] = -knee.sign * torque
    return encode_joint_state(message._replace(effort=tuple(efforts)))
