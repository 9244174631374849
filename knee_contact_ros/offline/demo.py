"""`knee-contact demo`: the real node in a process of its own, fed over real topics in a private ROS graph.

A `Source` says what is played to which nodes: a recorded joint reaction to the contact node (`Recorded`), or a leg's
sensors to the load node before it (`demo_sensors.py`). The results appear under their names when all is done; an
interrupted demo leaves nothing behind.
"""

from __future__ import annotations

import os
import sys
from abc import ABC, abstractmethod
from collections.abc import Sequence
from contextlib import AbstractContextManager, ExitStack, suppress
from pathlib import Path

import click
import numpy as np

from knee_contact_ros.bags.reader import BagReader, RawMessage
from knee_contact_ros.offline import stage
from knee_contact_ros.offline.summary import Summary, read_summary
from knee_contact_ros.offline.summary_table import counts, show_summary
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.streams.contact_stream import ContactStream, angle_sample
from knee_contact_ros.streams.messages import JOINT_STATE, RefusedSampleError
from knee_contact_ros.streams.topics import INPUTS, JOINT_REACTION_FORCE, JOINT_STATES, MESSAGE_TYPES
from knee_contact_ros.streams.watch import Doubts
from knee_contact_ros.system.errors import UsageError
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


class Source(ABC):
    """What a demo plays, to which nodes, and what it reports of it."""

    inputs: Sequence[str]
    """Names of the topics of the bag that are played, angles first"""
    heard: Sequence[str]
    """Inputs that the nodes must hear before the demo begins, as in `stage.Listener.heard`"""

    def __init__(self, bag: Path, companion: bool, parameters: Parameters) -> None:
        """Play `bag`, with the example of an assist controller listening too if there is a `companion`.

        `parameters` are those of the contact node.
        """
        self.bag, self.companion, self.parameters = bag, companion, parameters

    @abstractmethod
    def check(self) -> Doubts:
        """Refuse what a node could only refuse; return the doubts about the parameters.

        Raises:
            UsageError: a profile cannot be used, a joint is missing from the bag, and the like.
        """

    @abstractmethod
    def processes(self, work: Path) -> Sequence[AbstractContextManager[Child]]:
        """Make the processes of the nodes and the companion, which leave their files in the folder `work`."""

    def changed(self, message: RawMessage, torque: float) -> RawMessage:  # noqa: ARG002
        """Return an input as it is published while the companion commands a torque [N m]: as a rule unchanged."""
        return message

    def rows(self, work: Path, summary: Summary) -> dict[str, str]:  # noqa: ARG002
        """Return rows of the table that only this source has: as a rule none."""
        return {}

    def files(self, output: Path) -> dict[str, str]:  # noqa: ARG002
        """Return names and places of results that only this source has: as a rule none."""
        return {}


class Recorded(Source):
    """A recorded joint reaction, played to the contact node alone."""

    inputs: Sequence[str] = INPUTS
    heard: Sequence[str] = tuple(f"knee_contact: {topic}" for topic in INPUTS)

    def __init__(self, bag: Path, parameter_files: list[Path], companion: bool) -> None:
        """Read the parameter files of the contact node.

        Raises:
            UsageError: a parameter file cannot be used.
        """
        super().__init__(bag, companion, load_parameters(parameter_files))
        self._files = parameter_files

    def check(self) -> Doubts:
        """See `Source.check`; the first angle of the bag is tried."""
        pipeline = ContactStream(self.parameters, compiled=False)
        with BagReader(self.bag) as reader:
            angle = next(message.data for message in reader.raw_messages() if message.topic == f"/{JOINT_STATES}")
        try:
            message, _ = JOINT_STATE.read(angle, JOINT_STATES)
            angle_sample(message, pipeline.parameters.knee, pipeline.model.height_prescribed)
        except RefusedSampleError as refused:
            raise UsageError(f"bag {self.bag}: {refused} (parameters knee.*)") from None
        return pipeline.doubts

    def processes(self, work: Path) -> Sequence[AbstractContextManager[Child]]:
        """See `Source.processes`."""
        return [stage.node_process(self._files, work), *([stage.companion_process(work, {})] if self.companion else [])]


def run_demo(source: Source, output: Path, rate: float) -> None:
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
