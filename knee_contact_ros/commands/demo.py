"""`knee-contact demo`: the real nodes in processes of their own, fed over real topics in a private ROS graph.

`Recorded` plays a recorded joint reaction to the contact node, `Sensors` (`--from-sensors`) a leg's sensors to the load
node before it. With a companion the loop of the sensors is closed through the estimate: the torque that it commands is
the `effort` in the joint states that are played, the load node subtracts it from the net moment, and load and contact,
to which the companion listens, follow.

The results appear under their names when all is done; an interrupted demo leaves nothing behind.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, suppress
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import click
import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.bags.reader import OWN_NAMES, BagReader, RawMessage, answer_blocks, read_bag
from knee_contact_ros.commands import stage
from knee_contact_ros.commands.tables import counts, show_summary
from knee_contact_ros.model.types import Rows
from knee_contact_ros.offline.bag_inputs import BagInputs, check_joints
from knee_contact_ros.offline.estimate_load import estimate_load
from knee_contact_ros.offline.solve import solve
from knee_contact_ros.offline.summary import Summary, read_summary
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.parameters.schema import ActuatedJoint, LoadParameters, Parameters
from knee_contact_ros.streams.contact_stream import ContactStream, angle_sample
from knee_contact_ros.streams.messages import JOINT_STATE, RefusedSampleError, decode_joint_state, encode_joint_state
from knee_contact_ros.streams.topics import (
    INPUTS,
    JOINT_REACTION_FORCE,
    JOINT_STATES,
    LOAD_ESTIMATE,
    LOAD_INPUTS,
    MESSAGE_TYPES,
)
from knee_contact_ros.streams.watch import Doubts
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.files import share_folder
from knee_contact_ros.system.output_files import replace, work_folder
from knee_contact_ros.system.processes import Child
from knee_contact_ros.system.ros import private_graph
from knee_contact_ros.system.terminal import warn
from knee_contact_ros.view.picture import write_peak
from knee_contact_ros.view.viewer import NOT_INSTALLED, has_screen, look_at, viewer

PICTURE = Path("knee.png")
RESULTS = (
    stage.RECORDING.parent, stage.LOAD_RECORDING.parent, stage.RERUN_FILE, PICTURE, stage.NODE_LOG, stage.LOAD_LOG,
    stage.COMPANION_LOG,
)  # fmt: skip
"""Names of the results of all demos: a demo replaces those of an earlier one"""


class Recorded:
    """What a demo plays, to which nodes, and what it reports of it: a recorded joint reaction, to the contact node."""

    inputs: Sequence[str] = INPUTS
    """Names of the topics of the bag that are played, angles first"""
    heard: Sequence[str] = tuple(f"knee_contact: {topic}" for topic in INPUTS)
    """Inputs that the nodes must hear before the demo begins, as in `stage.Listener.heard`"""
    companion_values: Mapping[str, str] = MappingProxyType({})
    """Parameters of the companion"""

    def __init__(self, bag: Path, files: list[Path], companion: bool, **values: Any) -> None:
        """Play a bag, with the example of an assist controller listening too if there is a `companion`.

        Parameters of the contact node are those of `files` and further `values`.

        Raises:
            UsageError: a parameter file cannot be used.
        """
        self.bag, self.companion, self._files, self._values = bag, companion, files, values
        self.parameters: Parameters = load_parameters([*files, values])

    def check(self) -> Doubts:
        """Refuse what a node could only refuse; return the doubts about the parameters. The first angle is tried.

        Raises:
            UsageError: a profile cannot be used, a joint is missing from the bag, and the like.
        """
        pipeline = ContactStream(self.parameters, compiled=False)
        with BagReader(self.bag) as reader:
            angle = next(message.data for message in reader.raw_messages() if message.topic == f"/{JOINT_STATES}")
        try:
            message, _ = JOINT_STATE.read(angle, JOINT_STATES)
            angle_sample(message, pipeline.parameters.knee, pipeline.model.height_prescribed)
        except RefusedSampleError as refused:
            raise UsageError(f"bag {self.bag}: {refused} (parameters knee.*)") from None
        return pipeline.doubts

    def processes(self, work: Path) -> list[AbstractContextManager[Child]]:
        """Make the processes of the nodes and the companion, which leave their files in the folder `work`."""
        values = {name: str(value) for name, value in self._values.items()}
        companion = [stage.companion_process(work, self.companion_values)] if self.companion else []
        return [stage.node_process(self._files, work, values=values), *companion]

    def changed(self, message: RawMessage, torque: float) -> RawMessage:  # noqa: ARG002
        """Return an input as it is published while the companion commands a torque [N m]: as a rule unchanged."""
        return message

    def rows(self, work: Path, summary: Summary) -> dict[str, str]:  # noqa: ARG002
        """Return rows of the table that only this source has: as a rule none."""
        return {}

    def files(self, output: Path) -> dict[str, str]:  # noqa: ARG002
        """Return names and places of results that only this source has: as a rule none."""
        return {}


def run_demo(source: Recorded, output: Path, rate: float) -> None:
    """Run the demo and print its table.

    Raises:
        UsageError: the bag, a parameter or the output folder cannot be used, ROS cannot be joined, a node or the
            companion has failed, or the contact node has answered nothing.
    """
    doubts, types = source.check(), {f"/{topic}": MESSAGE_TYPES[topic] for topic in source.inputs}
    with BagReader(source.bag, types) as reader, work_folder(output) as work, private_graph() as environment:
        os.environ.update(environment)
        listener = stage.Listener(source.inputs[1])
        with ExitStack() as opened:
            children = [opened.enter_context(process) for process in source.processes(work)]

            def all_are_alive() -> None:
                for child in children:
                    child.check()

            options = stage.Play(rate, source.inputs, source.heard, source.companion, source.changed)
            stage.play(reader, options, listener, all_are_alive)
        summary = read_summary(work / stage.RECORDING.parent, source.parameters.body_weight, doubts)
        if not summary.ticks:
            raise UsageError(f"bag {source.bag}: the node has answered nothing; refused: {counts(summary.refused)}")
        rows = live_rows(listener, summary) | source.rows(work, summary)
        picture = draw_peak(work, output)
        for result in RESULTS:
            replace(work / result, output / result)
    files = source.files(output) | result_files(output, source.companion) | picture
    show_summary(summary, rows, files)
    warn(summary.sentences)
    if viewer():
        offer(output / stage.RERUN_FILE)


def draw_peak(work: Path, output: Path) -> dict[str, str]:
    """Draw the knee at the largest load; return the row with the picture's place, or with why there is none."""
    try:
        write_peak(work / stage.RECORDING.parent, work / PICTURE)
    except UsageError as error:
        return {"No picture": str(error)}
    return {"Knee at the peak": str(output / PICTURE)}


def offer(scene: Path) -> None:
    """Ask whether to open the scene in a viewer, if there are a terminal and a screen."""
    if not (has_screen() and sys.stdin.isatty() and sys.stdout.isatty()):
        return
    with suppress(click.Abort):  # Ctrl-D or Ctrl-C: all is there, and said
        if click.confirm("Open the scene in the Rerun viewer?", default=True):
            look_at(scene)


def live_rows(listener: stage.Listener, summary: Summary) -> dict[str, str]:
    """Return the rows of the table that only a live run has."""
    rows = {"dropped": str(len(listener.published) - summary.ticks)}
    if listener.latencies:
        median, p99, largest = np.percentile(listener.latencies, [50, 99, 100]) * 1e3
        name = "latency" if listener.force_topic == JOINT_REACTION_FORCE else "sensors to contact"
        rows[name] = f"{median:.2f} ms median, {p99:.2f} ms p99, {largest:.2f} ms max"
    if listener.torques:
        highest = max(listener.torques)
        lowest = min(listener.torques[listener.torques.index(highest) :])
        rows["assist torque"] = f"{highest:.1f} N m, lowered to {lowest:.1f} N m"
    return rows


def result_files(output: Path, companion: bool) -> dict[str, str]:
    """Return the names and places of the results, and the command that shows them."""
    files = {"Recording": str(output / stage.RECORDING.parent), "Node's log": str(output / stage.NODE_LOG)}
    if companion:
        files["Companion's log"] = str(output / stage.COMPANION_LOG)
    if not viewer():
        return files | {"Not drawn": NOT_INSTALLED}
    to_see = f"{Path(sys.executable).with_name('knee-contact')} view {output / stage.RERUN_FILE}"
    return files | {"Rerun file": str(output / stage.RERUN_FILE), "To see it": to_see}


BAG, RECORDED = "gait2354_right_sensors", "gait2354_right"
"""Bundled bags: a leg's sensors, and the joint reaction of the same gait by a musculoskeletal model"""
LOAD_FILE = "load/gait2354.yaml"
"""Parameter file of the load node for `BAG`"""
FORCE_LIMIT = 700.0
"""Contact force [N] above which the companion lowers its torque; its default is above what the estimate reaches"""
NOT_KNOWN = (
    "people change how much they co-contract when assisted, and this estimate cannot see that: it only takes the "
    "torque off the net moment"
)


class Peak(NamedTuple):
    """The largest joint reaction of a bag."""

    axial: float
    """Axial force [N]"""
    deviation: float
    """Standard deviation [N] of an estimate; 0 for a joint reaction that is no estimate"""

    def text(self, weight: float) -> str:
        """Return the force in N and in body weights as text; `weight` is the body weight [N]."""
        deviation = f", standard deviation {self.deviation:.0f} N" if self.deviation else ""
        return f"{self.axial:.1f} N ({self.axial / weight:.2f} BW){deviation}"


class Sensors(Recorded):
    """A leg's sensors, played to the load node, whose estimate the contact node answers."""

    inputs = LOAD_INPUTS
    heard = (*(f"knee_load: {topic}" for topic in LOAD_INPUTS), *Recorded.heard)
    companion_values = MappingProxyType({"force_limit": str(FORCE_LIMIT)})

    def __init__(self, bag: Path | None, files: list[Path], load_files: list[Path], companion: bool) -> None:
        """Read the parameter files of both nodes.

        Args:
            bag: The bag to play; None: the bundled one.
            files: Parameter files of the contact node, which gets the person's body weight too.
            load_files: Parameter files of the load node.
            companion: Whether the example of an assist controller closes the loop.

        Raises:
            UsageError: a parameter file cannot be used.
        """
        self._load_files = load_files
        assisted = {"knee.assisted": True} if companion else {}
        self.load_parameters: LoadParameters = load_parameters([*load_files, assisted], LoadParameters)
        self.weight = self.load_parameters.person.constants.weight
        """Body weight [N] of the person"""
        super().__init__(bag or share_folder() / "bags" / BAG, files, companion, body_weight=self.weight)

    def check(self) -> Doubts:
        """See `Recorded.check`; all joints that the nodes need are looked for."""
        pipeline = ContactStream(self.parameters, compiled=False)
        with BagInputs(self.bag, self.load_parameters, OWN_NAMES) as inputs:
            check_joints(inputs, self.load_parameters.joints())
            check_joints(inputs, self.parameters.joints())
        return pipeline.doubts

    def processes(self, work: Path) -> list[AbstractContextManager[Child]]:
        """See `Recorded.processes`."""
        assisted = {"knee.assisted": "true"} if self.companion else {}
        return [*super().processes(work), stage.load_process(self._load_files, work, assisted)]

    def changed(self, message: RawMessage, torque: float) -> RawMessage:
        """Return an input; joint states get the companion's torque as the effort of the knee."""
        if not self.companion or message.topic != f"/{JOINT_STATES}":
            return message
        return message._replace(data=with_assistance(message.data, self.load_parameters.knee, torque))

    def rows(self, work: Path, summary: Summary) -> dict[str, str]:
        """Return rows on the estimated and the recorded load, and on the contact with and without assistance."""
        calibrated = "yes" if self.load_parameters.calibrated else "no: for looking, not for gating anything"
        rows = {"load's level": self.load_parameters.chosen_level, "calibrated": calibrated}
        rows["estimated load"] = largest(work / stage.LOAD_RECORDING.parent, LOAD_ESTIMATE).text(self.weight)
        if self.bag.resolve() == (share_folder() / "bags" / BAG).resolve():
            recorded = largest(self.bag.with_name(RECORDED), JOINT_REACTION_FORCE)
            rows["recorded load"] = f"{recorded.text(self.weight)}, by OpenSim from muscles"
        return rows | (self._assisted_rows(work, summary) if self.companion else {})

    def files(self, output: Path) -> dict[str, str]:
        """See `Recorded.files`."""
        return {
            "Load's recording": str(output / stage.LOAD_RECORDING.parent),
            "Load's log": str(output / stage.LOAD_LOG),
        }

    def _assisted_rows(self, work: Path, summary: Summary) -> dict[str, str]:
        """Return rows that compare the contact with that of the same bag without assistance, computed offline."""
        loads, blocks = work / "without_assistance.mcap", list[Rows]()
        parameters = load_parameters([self.load_parameters, {"knee.assisted": False}], LoadParameters)
        estimate_load(self.bag, parameters, loads, lambda _done, _total: None)
        keep = lambda rows: blocks.append(rows[0])  # noqa: E731
        without = solve(loads, self.parameters, None, lambda _done, _total: None, keep=keep).peaks["contact_force"]
        less = relief(np.concatenate(blocks), np.concatenate([*answer_blocks(work / stage.RECORDING.parent)]))
        return {
            "gives way above": f"{FORCE_LIMIT:.0f} N of contact force",
            "largest contact": f"{without.value:.1f} N without assistance, "
            f"{summary.peaks['contact_force'].value:.1f} N with it",
            "at one moment": f"up to {max(less.max(), 0.0):.1f} N less with assistance, "
            f"or {max(-less.min(), 0.0):.1f} N more",
            "warning": NOT_KNOWN,
        }


def relief(without: Rows, assisted: Rows) -> NDArray[np.float64]:
    """Return how much less the contact force [N] is with assistance, at the stamps that both answers have."""
    _, first, second = np.intersect1d(without["stamp"], assisted["stamp"], return_indices=True)
    less: NDArray[np.float64] = without["contact_force"][first] - assisted["contact_force"][second]
    return less


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


def largest(bag: Path, topic: str) -> Peak:
    """Return the largest joint reaction of a bag, on the topic `joint_reaction_force` or `load_estimate`."""
    messages = [message.message for message in read_bag(bag, {f"/{topic}": MESSAGE_TYPES[topic]})]
    if topic == LOAD_ESTIMATE:
        return max(Peak(message.axial_force, message.standard_deviation) for message in messages)
    return max(Peak(-message.wrench.force.y, 0.0) for message in messages)
