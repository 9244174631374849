"""What is missing in a recording when node, recorder or both are killed in mid-stream: the real node at 1 kHz.

python -m studies.cut_off [--kills NUMBER] [--busy NUMBER] [--output FILE]
"""

from __future__ import annotations

import itertools
import os
import random
import signal
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Timer
from typing import Any, NamedTuple

import click
import numpy as np
import psutil
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from benchmarks.latency.driver import CHECK, PARAMETERS, Driver, joined
from benchmarks.report import Section, machine, save
from knee_contact_ros.parameters.sections import RecordSection
from knee_contact_ros.streams.messages import stamp_in
from knee_contact_ros.streams.topics import KNEE_CONTACT
from knee_contact_ros.system.output_files import partial_name
from knee_contact_ros.system.processes import Child, child_process
from knee_contact_ros.system.ros import private_graph

RATE = 1000.0
"""Rate of the samples [Hz]"""
EARLIEST, LATEST, LATEST_BESIDE_BUSY = 0.3, 1.3, 10.0
"""When to kill [s] after the first sample; what starves falls behind by more and more"""
AFTER = 0.1
"""Time [s] for which samples continue after a kill"""
ALLOWED = 100.0
"""Loss [ms] that is allowed"""
SPAN = 1.0
"""Time [s] after which a recording continues in a new file"""
RECORDING = "knee.mcap"
END = 30.0
"""Time [s] within which a recorder without its node must complete the file"""
SEED = 1
WHERE_IT_BREAKS_OFF = (McapError, struct.error)
"""Errors that mcap's reader raises where a file breaks off"""
HEADER = ("killed", "kills", "median [ms]", "99 % [ms]", "max [ms]", "holes", "files afterwards")
TEXT = (
    f"The real node at 1 kHz (`healthy.yaml`, `record.flush_period` {RecordSection().flush_period:g} s) in a ROS graph "
    f"of its own. At a random moment between {EARLIEST} and {LATEST} s after the first sample a process gets SIGKILL: "
    "the node, the recorder, or both one right after the other. The recording goes on in a new file every second. A "
    "peer notes every answer and when it came. Of the answers that it had received before the kill, those are missing "
    "that mcap's `NonSeekingReader` does not find in the files; they are the last ones, and their number is that of "
    "milliseconds. Holes are answers that are missing before one that is there. The measuring process runs on the same "
    "two cores as the node. In the last row, busy processes (`while True: pass`, at the node's priority) run beside "
    f"all that, and the moment lies between {EARLIEST} and {LATEST_BESIDE_BUSY:g} s."
)


NODE, RECORDER, BOTH, BESIDE_BUSY = "node", "recorder", "both", "both, beside busy processes"
"""Processes that are killed"""


class Loss(NamedTuple):
    """Loss by one kill."""

    missing: float
    """Span [ms] of the answers that are missing at the end"""
    holes: int
    complete: bool
    """Whether all files have their final names"""


class Peer(Driver):
    """A driver that publishes on schedule and notes every answer."""

    def __init__(self, node: Any, executor: Any) -> None:
        super().__init__(node, executor)
        self.answers: list[tuple[int, float]] = []
        """Stamp [ns] of each answer, and the time [s] at which it came"""

    def _on_contact(self, data: bytes) -> None:
        self.answers.append((stamp_in(data), time.perf_counter()))
        super()._on_contact(data)

    def walk_until_kill(self, targets: list[psutil.Process], moment: float) -> list[int]:
        """Publish, and kill the targets `moment` [s] later; return the stamps [ns] of the answers received before."""
        self.answers = []
        killed: list[float] = []

        def kill() -> None:
            killed.append(time.perf_counter())
            for target in targets:
                target.kill()

        timer = Timer(moment, kill)
        timer.start()
        self.run(RATE, round((moment + AFTER) * RATE))
        timer.join()
        return [stamp for stamp, came in self.answers if came < killed[0]]

    def begin_recording(self, path: Path) -> None:
        """Have the node begin another recording, and wait until it is open; until then messages wait in the node."""
        name = Parameter("record.path", value=str(path)).to_parameter_msg()
        self._call(
            SetParameters, "knee_contact/set_parameters", SetParameters.Request(parameters=[name])
        )
        while not self._call(Trigger, "knee_contact/start_recording", Trigger.Request()).success:
            self._spin(CHECK)  # it has yet to notice that the other one is dead
        while not (partial_name(path).exists() and partial_name(path).stat().st_size):
            self._spin(CHECK)

    def _call(self, kind: Any, name: str, request: Any) -> Any:
        """Call a service, and return its response."""
        client = self._node.create_client(kind, name)
        while not client.service_is_ready():
            self._spin(CHECK)
        future = client.call_async(request)
        while not future.done():
            self._spin(CHECK)
        self._node.destroy_client(client)
        return future.result()


@contextmanager
def recording_node(folder: Path) -> Iterator[Child]:
    """Run the recording node in a process of its own, which may be killed."""
    arguments = [
        "-m",
        "knee_contact_ros.commands.main",
        "node",
        "--ros-args",
        "--params-file",
        str(PARAMETERS),
    ]
    arguments += [
        "-p",
        f'record.path:="{folder / RECORDING}"',
        "-p",
        f"record.max_duration:={SPAN}",
    ]
    folder.mkdir()
    with child_process("the node", arguments, folder / "node.log") as child:
        yield child
        if child.process.poll() == -signal.SIGKILL:
            child.process.returncode = 0  # that was us


@contextmanager
def walking(folder: Path) -> Iterator[tuple[Peer, psutil.Process]]:
    """Run a peer and a node that answers it, in a ROS graph that knows no earlier node."""
    with private_graph() as environment:
        os.environ.update(environment)
        with joined(Peer) as peer, recording_node(folder) as child:
            peer.wait_for_node(child.check)
            yield peer, psutil.Process(child.process.pid)
            child.process.kill()
            child.process.wait()


@contextmanager
def busy(number: int) -> Iterator[None]:
    """Run a number of processes that keep a processor busy."""
    processes = [
        subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(number)
    ]
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()


def node_loss(what: str, folder: Path, moment: float, beside: int = 0) -> Loss:
    """Start a node, kill it, its recorder or both, beside a number of busy processes, and measure the loss."""
    with walking(folder) as (peer, node):
        recorder = recorder_of(node)
        with busy(beside):
            received = peer.walk_until_kill([node] if what == NODE else [node, recorder], moment)
        psutil.wait_procs([recorder], END)
    return loss(received, folder)


def recorder_losses(folder: Path, moments: list[float]) -> Iterator[Loss]:
    """Start a node, kill one recorder after the other, and measure the losses."""
    with walking(folder) as (peer, node):
        for number, moment in enumerate(moments):
            recorder = recorder_of(node)
            received = peer.walk_until_kill([recorder], moment)
            psutil.wait_procs([recorder], END)
            yield loss(received, folder)
            folder = folder.with_name(f"{RECORDER}_{number + 1}")
            peer.begin_recording(folder / RECORDING)


def recorder_of(node: psutil.Process) -> psutil.Process:
    """The one child of a node that records and does not draw."""
    (recorder,) = node.children()
    return recorder


def readable_stamps(path: Path) -> set[int]:
    """Stamps [ns] of the answers in a file that may break off."""
    stamps: set[int] = set()
    with path.open("rb") as file:
        messages = NonSeekingReader(file).iter_messages(f"/{KNEE_CONTACT}", log_time_order=False)
        with suppress(*WHERE_IT_BREAKS_OFF):
            for _, _, message in messages:
                stamps.add(message.log_time)
    return stamps


def loss(received: list[int], folder: Path) -> Loss:
    """Loss of a folder against the answers that were received (stamps [ns])."""
    files = [path for path in folder.iterdir() if ".mcap" in path.suffixes]
    recorded = set().union(*map(readable_stamps, files))
    tail = len(list(itertools.takewhile(lambda stamp: stamp not in recorded, reversed(received))))
    holes = sum(stamp not in recorded for stamp in received[: len(received) - tail])
    return Loss(1e3 * tail / RATE, holes, complete=all(path.suffix == ".mcap" for path in files))


def measure(
    kills: int, beside: int, work: Path, seen: Callable[[str], None]
) -> dict[str, list[Loss]]:
    """Kill each target `kills` times, and once more beside a number of busy processes."""
    dice = random.Random(SEED)  # noqa: S311  (not for secrets)
    losses: dict[str, list[Loss]] = {NODE: [], RECORDER: [], BOTH: [], BESIDE_BUSY: []}

    def note(what: str, found: Loss) -> None:
        losses[what].append(found)
        seen(f"{what}: {found}")

    for found in recorder_losses(
        work / RECORDER, [dice.uniform(EARLIEST, LATEST) for _ in range(kills)]
    ):
        note(RECORDER, found)
    for number, what in itertools.product(range(kills), (NODE, BOTH)):
        note(what, node_loss(what, work / f"{what}_{number}", dice.uniform(EARLIEST, LATEST)))
    for number in range(kills):
        moment = dice.uniform(EARLIEST, LATEST_BESIDE_BUSY)
        note(BESIDE_BUSY, node_loss(BESIDE_BUSY, work / f"busy_{number}", moment, beside))
    return losses


def row(what: str, losses: list[Loss]) -> list[str]:
    """Row of the table for a kind of kill."""
    median, high, largest = np.percentile([each.missing for each in losses], [50, 99, 100])
    complete = sum(each.complete for each in losses)
    afterwards = (
        "complete" if complete == len(losses) else f"the last one `.partial`, {complete} complete"
    )
    holes = sum(each.holes for each in losses)
    return [
        what,
        str(len(losses)),
        f"{median:.0f}",
        f"{high:.0f}",
        f"{largest:.0f}",
        str(holes),
        afterwards,
    ]


@click.command()
@click.option(
    "--kills", type=click.IntRange(1), default=50, show_default=True, help="Of each kind."
)
@click.option(
    "--busy",
    "beside",
    type=click.IntRange(1),
    default=2,
    show_default=True,
    help="Processes, in the last row.",
)
@click.option("--output", type=click.Path(path_type=Path), default=Path("docs/studies/cut_off.md"))
def main(kills: int, beside: int, output: Path) -> None:
    """Measure and write the table."""
    load = os.getloadavg()[1]
    with tempfile.TemporaryDirectory() as work:
        losses = measure(kills, beside, Path(work), lambda text: click.echo(text, err=True))
    largest = max(each.missing for found in losses.values() for each in found)
    verdict = (
        f"The largest loss is {largest:.0f} ms; the aim is {ALLOWED:.0f} ms at most. Processes that wanted one of the "
        f"{os.cpu_count()} processors, this study's among them (load average of 5 minutes): {load:.1f} at the "
        f"beginning, {os.getloadavg()[1]:.1f} at the end. On a busy machine a recorder waits for others."
    )
    sections = [
        Section(
            "",
            f"{TEXT}\n\n{verdict}",
            HEADER,
            [row(what, found) for what, found in losses.items()],
        )
    ]
    save(
        output,
        "Recordings that are cut off",
        f"python -m studies.cut_off --kills {kills}",
        sections,
        machine(),
    )


if __name__ == "__main__":
    main()
