"""What is missing in a recording when node, recorder or both are killed in mid-stream: the real node at 1 kHz.

python -m studies.cut_off [--kills NUMBER] [--output FILE]
"""

from __future__ import annotations

import itertools
import os
import random
import signal
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Timer
from typing import Any, NamedTuple

import click
import numpy as np
import psutil
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader

from knee_contact_ros.cdr_in import stamp_in
from knee_contact_ros.graph import private_graph
from knee_contact_ros.latency.candidates import PARAMETERS
from knee_contact_ros.latency.driver import Driver, joined
from knee_contact_ros.processes import Child, child_process
from knee_contact_ros.topics import KNEE_CONTACT
from studies.report import Section, machine, save

RATE = 1000.0
"""[Hz]"""
EARLIEST, LATEST = 0.3, 1.3
"""When to kill [s] after the first sample"""
AFTER = 0.1
"""How long [s] samples go on"""
ALLOWED = 100.0
"""[ms]"""
SPAN = 1.0
"""[s] after which a recording goes on in a new file"""
END = 30.0
"""How long [s] a recorder without its node may take to complete the file"""
SEED = 1
HEADER = ("killed", "kills", "median [ms]", "99 % [ms]", "max [ms]", "holes", "files afterwards")
TEXT = (
    "The real node at 1 kHz (`healthy.yaml`, `record.flush_period` 0.05 s) in a ROS graph of its own. At a random "
    f"moment between {EARLIEST} and {LATEST} s after the first sample a process gets SIGKILL: the node, the "
    "recorder, or both one right after the other. The recording goes on in a new file every second. A peer notes "
    "every answer and when it came. Of the answers that it had received before the kill, those are missing that "
    "mcap's `NonSeekingReader` does not find in the files; they are the last ones, and their number is that of "
    "milliseconds. Holes are answers that are missing before one that is there. The measuring process runs on the "
    "same two cores as the node."
)


class Kill(NamedTuple):
    """What is killed."""

    name: str
    node: bool
    recorder: bool

    def targets(self, node: psutil.Process, recorder: psutil.Process) -> list[psutil.Process]:
        """In the order of dying."""
        return [node] * self.node + [recorder] * self.recorder


KILLS = (Kill("node", True, False), Kill("recorder", False, True), Kill("both", True, True))


class Loss(NamedTuple):
    """What a kill has cost."""

    missing: float
    """[ms] of answers at the end"""
    holes: int
    complete: bool
    """Whether all files have their final names"""


class Peer(Driver):
    """Publishes on schedule and notes every answer."""

    def __init__(self, node: Any, executor: Any) -> None:
        super().__init__(node, executor)
        self.answers: list[tuple[int, float]] = []
        """Stamp [ns], and when the answer came [s]"""

    def _on_contact(self, data: bytes) -> None:
        self.answers.append((stamp_in(data), time.perf_counter()))
        super()._on_contact(data)

    def walk_until_kill(self, targets: list[psutil.Process], moment: float) -> list[int]:
        """Publish and kill `moment` [s] later; the stamps [ns] of the answers that were there before."""
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


@contextmanager
def recording_node(folder: Path) -> Iterator[Child]:
    """The node, recording, in a process of its own; it may be killed."""
    arguments = ["-m", "knee_contact_ros.cli", "node", "--ros-args", "--params-file", str(PARAMETERS)]
    arguments += ["-p", f'record.path:="{folder / "knee.mcap"}"', "-p", f"record.max_duration:={SPAN}"]
    folder.mkdir()
    with child_process("the node", arguments, folder / "node.log") as child:
        yield child
        if child.process.poll() == -signal.SIGKILL:
            child.process.returncode = 0  # that was us


def kill_once(folder: Path, kill: Kill, moment: float) -> Loss:
    """Start a node, kill, and look at the file; in a graph where nobody remembers an earlier node."""
    with private_graph() as environment:
        os.environ.update(environment)
        with joined(Peer) as peer:
            received = killed_meanwhile(peer, folder, kill, moment)
    files = [path for path in folder.iterdir() if ".mcap" in path.suffixes]
    recorded = set().union(*map(readable_stamps, files))
    return loss(received, recorded, complete=all(path.suffix == ".mcap" for path in files))


def killed_meanwhile(peer: Peer, folder: Path, kill: Kill, moment: float) -> list[int]:
    """Have a node record, kill, and see nobody left; the stamps [ns] of the answers that were there before."""
    with recording_node(folder) as child:
        peer.wait_for_node(child.check)
        node = psutil.Process(child.process.pid)
        (recorder,) = node.children()
        received = peer.walk_until_kill(kill.targets(node, recorder), moment)
        if kill.recorder:
            child.process.kill()
        child.process.wait()
        psutil.wait_procs([recorder], END)
    return received


def readable_stamps(path: Path) -> set[int]:
    """Stamps [ns] of the answers in a file that may break off."""
    stamps: set[int] = set()
    with path.open("rb") as file:
        messages = NonSeekingReader(file).iter_messages(f"/{KNEE_CONTACT}", log_time_order=False)
        try:
            for _, _, message in messages:
                stamps.add(message.log_time)
        except McapError:
            pass  # where it breaks off
    return stamps


def loss(received: list[int], recorded: set[int], complete: bool) -> Loss:
    """What is missing of the answers that were received (stamps [ns])."""
    tail = len(list(itertools.takewhile(lambda stamp: stamp not in recorded, reversed(received))))
    holes = sum(stamp not in recorded for stamp in received[: len(received) - tail])
    return Loss(1e3 * tail / RATE, holes, complete)


def measure(kills: int, work: Path, seen: Callable[[str], None]) -> dict[Kill, list[Loss]]:
    """Kill each that many times, in turn."""
    moments = random.Random(SEED)  # noqa: S311  (not for secrets)
    losses: dict[Kill, list[Loss]] = {kill: [] for kill in KILLS}
    for number, kill in itertools.product(range(kills), KILLS):
        moment = moments.uniform(EARLIEST, LATEST)
        losses[kill].append(kill_once(work / f"{kill.name}_{number}", kill, moment))
        seen(f"{kill.name}, after {moment:.3f} s: {losses[kill][-1]}")
    return losses


def row(kill: Kill, losses: list[Loss]) -> list[str]:
    """Of the table."""
    median, high, largest = np.percentile([each.missing for each in losses], [50, 99, 100])
    complete = sum(each.complete for each in losses)
    afterwards = "complete" if complete == len(losses) else f"the last one `.partial`, {complete} complete"
    holes = sum(each.holes for each in losses)
    return [kill.name, str(len(losses)), f"{median:.0f}", f"{high:.0f}", f"{largest:.0f}", str(holes), afterwards]


@click.command()
@click.option("--kills", type=click.IntRange(1), default=50, show_default=True, help="Of each kind.")
@click.option("--output", type=click.Path(path_type=Path), default=Path("docs/studies/cut_off.md"))
def main(kills: int, output: Path) -> None:
    """Measure and write the table."""
    with tempfile.TemporaryDirectory() as work:
        losses = measure(kills, Path(work), lambda text: click.echo(text, err=True))
    largest = max(each.missing for found in losses.values() for each in found)
    verdict = f"The largest loss is {largest:.0f} ms; the aim is {ALLOWED:.0f} ms at most."
    sections = [Section("", f"{TEXT}\n\n{verdict}", HEADER, [row(kill, found) for kill, found in losses.items()])]
    save(output, "Recordings that are cut off", "python -m studies.cut_off", sections, machine())


if __name__ == "__main__":
    main()
