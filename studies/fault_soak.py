"""An hour at 1 kHz with a fault every ten seconds, beside a busy process: what is lost, and is it computed again alike?

python -m studies.fault_soak [--minutes N] [--seed S] [--realtime] [--output FILE]
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Any, NamedTuple

import click
import psutil
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from benchmarks.latency.driver import PARAMETERS, QOS, Driver, joined, rests, samples
from benchmarks.report import Section, machine, save
from knee_contact_ros.bags.bag import Bag, RawMessage
from knee_contact_ros.bags.provenance import read_provenance
from knee_contact_ros.commands.demo import RECORDING, node_process
from knee_contact_ros.model.types import Status
from knee_contact_ros.offline.solve import solve
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.streams.messages import decode_joint_state
from knee_contact_ros.streams.topics import (
    JOINT_REACTION_FORCE,
    JOINT_STATES,
    KNEE_CONTACT,
    MESSAGE_TYPES,
    NANOSECONDS,
    deserialize,
)
from knee_contact_ros.system.ros import private_graph
from studies.cut_off import busy
from tests.ros.conftest import Peer, call
from tests.ros.faults import FAULTS, Fault

RATE = 1000.0
"""Rate of the samples [Hz]"""
BETWEEN = 10_000
"""Number of good samples from one fault to the next"""
PATIENCE = 600.0
"""Time [s] to wait for what must come; the viewer is the last in turn on a busy machine"""
SETTLED = 0.1
"""Part of the run after which memory must not grow"""
LEFT_OUT = ("time jumps back", "stop of no recording")
"""A bag is read in the order of its stamps, so time that jumps back is not computed again as it came. A recording is
being written, and not to be stopped."""
MB = 1e6
TEXT = """\
The real node (`healthy.yaml`, recording to MCAP, drawing to a Rerun file, `pairing.wait` 7 s) at 1 kHz beside one busy
process. Every 10 000 samples something goes wrong, drawn at random from the streams' part of the table in
[faults](../reference/faults.md), or its recorder or viewer stands still for two seconds. Lost: good samples without an
answer, as where a node is more than a second late on a busy machine: its subscriptions hold 1000 samples. Flagged:
answers between a fault and the next one whose status is not 0.

At the end the recording is computed again from itself, and the bytes of its `knee_contact` messages are compared, but
for those from a force that was answered without its angle to the next start from rest (what was not there in time live
is there offline), and for the bit INPUT_REJECTED (what was refused is not recorded). Memory is that of the node's own
process."""


class Peered(Driver):
    """A driver with the methods that faults use of the tests' peer."""

    client, introduce = Peer.client, Peer.introduce
    send_angle, send_force, send = Peer.send_angle, Peer.send_force, Peer.send

    def __init__(self, node: Any, executor: Any) -> None:
        super().__init__(node, executor)
        self.node = node
        self.angle, self.force = (
            node.create_publisher(kind, topic, QOS)
            for kind, topic in ((JointState, JOINT_STATES), (WrenchStamped, JOINT_REACTION_FORCE))
        )
        self._angle, self._force = self.angle, self.force
        self.contacts: list[bytes] = []
        """Serialised answers since the fault"""
        self.diagnostics: dict[str, dict[str, str]] = {}
        self.problems: dict[str, str] = {}
        self.stalled: list[subprocess.Popen[str]] = []
        self.node_process = 0
        self.between = 0.0
        self.clients: dict[Any, Any] = {}
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)

    @property
    def stamp(self) -> int:
        """Stamp of the next good sample [ns]."""
        return self._stamp

    def pass_time(self, duration: int) -> None:
        """Move the stamps of further samples on by a duration [ns]."""
        self._stamp += duration

    def spin(self, seconds: float) -> None:
        """Handle events for a time [s]."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._spin(0.02)

    def wait_until(self, done: Callable[[], Any]) -> None:
        """Handle events until a condition holds."""
        deadline = time.monotonic() + PATIENCE
        while not done():
            if time.monotonic() > deadline:
                raise TimeoutError("it did not happen in time")
            self._spin(0.05)

    def _on_contact(self, data: bytes) -> None:
        super()._on_contact(data)
        self.contacts.append(data)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self.diagnostics[status.name] = {value.key: value.value for value in status.values}
            self.problems[status.name] = status.message


class Stretch(NamedTuple):
    """The good samples from one fault to the next, and their answers."""

    fault: str
    first: int
    """Stamp [ns] of the first good sample"""
    samples: int
    lost: int
    slowest: float
    """Largest latency [s]"""
    memory: int
    """Memory of the node afterwards [B]"""


def stood_still(which: str) -> Fault:
    """Fault: the process of an output is stopped for two seconds."""

    def inject(peer: Any, _stamp: int) -> None:
        number = int(peer.diagnostics[f"knee_contact: {which}"]["process"])
        os.kill(number, signal.SIGSTOP)
        peer.stalled.append(
            subprocess.Popen(["/bin/sh", "-c", f"sleep 2; kill -CONT {number}; exec sleep 60"])
        )

    return Fault(f"{which} stands still", inject)


def soak(peer: Peered, stretches: int, dice: random.Random) -> list[Stretch]:
    """Publish good samples and faults in turn, and collect the stretches."""
    faults = [fault for fault in FAULTS if fault.name not in LEFT_OUT]
    faults += [stood_still("recorder"), stood_still("viewer")]
    node, found, fault = (
        psutil.Process(peer.node_process),
        [],
        Fault("none yet", lambda _peer, _stamp: None),
    )
    for number in range(stretches):
        first = peer.stamp
        run = peer.run(RATE, BETWEEN)
        found.append(
            Stretch(
                fault.name,
                first,
                run.published,
                run.lost,
                1e-9 * max(run.latencies),
                node.memory_info().rss,
            )
        )
        click.echo(f"{number + 1} of {stretches}: {found[-1]}", err=True)
        for process in peer.stalled:
            process.kill()
            process.wait()
        peer.stalled.clear()
        fault = dice.choice(faults)
        peer.contacts.clear()
        peer.between = angle_between(peer)
        step = round(NANOSECONDS / RATE)
        fault.inject(peer, peer.stamp - step // 2)  # type: ignore[arg-type]
        if fault.name == "angle lost":  # what was held live is there offline
            call(peer, Trigger, "/knee_contact/reset", Trigger.Request())  # type: ignore[arg-type]
        peer.spin(0.05)
        peer.pass_time(fault.shift)
    return found


def angle_between(peer: Peered) -> float:
    """The flexion angle half way from the last good sample to the next one: samples begin anew in each stretch."""
    number = len(rests(RATE))
    coming = samples(RATE, peer.stamp)
    every = [next(coming).angle for _ in range(number)]
    ends = [decode_joint_state(every[index % number]) for index in (0, BETWEEN - 1)]
    return sum(end.position[0] for end in ends if end) / len(ends)


class Again(NamedTuple):
    """Contents of a recording, and how its answers compare with those computed again."""

    answers: int
    computed: int
    compared: int
    different: int
    flags: list[Counter[str]]
    """Bits in the status of the answers of each stretch, counted"""


def again(recording: Path, firsts: Sequence[int]) -> Again:
    """Compute a recording again; `firsts` are the stamps [ns] with which stretches begin."""
    offline = recording.with_name("offline.mcap")
    with Bag(recording) as bag:
        solve(bag, read_provenance(bag) or Parameters(), offline)
    types = {f"/{KNEE_CONTACT}": MESSAGE_TYPES[KNEE_CONTACT]}
    answers = computed = compared = different = stretch = 0
    flags: list[Counter[str]] = [Counter() for _ in firsts]
    held = False
    with Bag(recording) as one, Bag(offline) as other:
        each = (bag.select(types).raw_messages() for bag in (one, other))
        for mine, theirs in zip_longest(*each):
            answers += mine is not None
            computed += theirs is not None
            if mine is None or theirs is None:
                different += 1
                continue
            status = Status(status_of(mine))
            while stretch + 1 < len(firsts) and mine.log_time >= firsts[
                stretch + 1
            ] - NANOSECONDS // round(RATE):
                stretch += 1
            flags[stretch].update(bit.name or "" for bit in Status if bit & status)
            held = (held or bool(status & Status.INPUT_HELD)) and not status & Status.TIME_RESET
            compared += not held
            different += not held and not alike(mine, theirs)
    return Again(answers, computed, compared, different, flags)


def status_of(message: RawMessage) -> int:
    """The bits of an answer."""
    return int(deserialize(message.data, KNEE_CONTACT).status)


def alike(live: RawMessage, offline: RawMessage) -> bool:
    """Whether two answers have the same bytes, apart from INPUT_REJECTED: refused input is not in a recording."""
    if live == offline:
        return True
    one, other = (deserialize(message.data, KNEE_CONTACT) for message in (live, offline))
    one.status &= ~Status.INPUT_REJECTED
    return live.log_time == offline.log_time and one == other


def rows(stretches: Sequence[Stretch], flags: Sequence[Counter[str]]) -> list[list[str]]:
    """Rows of the table: one per fault."""
    table = []
    for fault in sorted({stretch.fault for stretch in stretches}):
        of = [number for number, stretch in enumerate(stretches) if stretch.fault == fault]
        flagged = sum((flags[number] for number in of), Counter[str]())
        said = ", ".join(
            f"{name} {count / len(of):.3g}" for name, count in sorted(flagged.items())
        )
        lost = sum(stretches[number].lost for number in of)
        slowest = max(stretches[number].slowest for number in of)
        table.append([fault, str(len(of)), str(lost), said or "-", f"{1e3 * slowest:.0f}"])
    return table


def figures(stretches: Sequence[Stretch], found: Again, refused: str) -> list[list[str]]:
    """Rows of the table of figures of the whole run."""
    settled = stretches[round(SETTLED * len(stretches)) :]
    memory = [stretch.memory / MB for stretch in settled]
    return [
        ["good samples", str(sum(stretch.samples for stretch in stretches))],
        ["lost", str(sum(stretch.lost for stretch in stretches))],
        ["faults", str(len(stretches) - 1)],
        ["samples refused", refused],
        ["answers recorded", str(found.answers)],
        ["answers computed again", str(found.computed)],
        ["compared", str(found.compared)],
        ["not identical", str(found.different)],
        [f"node's memory after {100 * SETTLED:g} % of the time [MB]", f"{memory[0]:.1f}"],
        ["its largest growth since then [MB]", f"{max(memory) - memory[0]:.1f}"],
    ]


@click.command()
@click.option("--minutes", default=60.0, show_default=True)
@click.option("--seed", default=0, show_default=True)
@click.option("--busy", "beside", default=1, show_default=True, help="Busy processes beside.")
@click.option("--realtime", is_flag=True, help="Schedule the node before ordinary processes.")
@click.option(
    "--output",
    type=click.Path(path_type=Path),
    default=Path("docs/studies/fault_soak.md"),
    show_default=True,
)
def main(minutes: float, seed: int, beside: int, realtime: bool, output: Path) -> None:
    """Measure and write the page."""
    dice = random.Random(seed)  # noqa: S311  (no secret)
    with tempfile.TemporaryDirectory() as folder, private_graph() as environment:
        os.environ.update(environment)
        work, more = Path(folder) / "node", Path(folder) / "more.yaml"
        work.mkdir()
        more.write_text(
            "/**:\n  ros__parameters:\n    pairing:\n      wait: 7.0\n", encoding="utf-8"
        )
        values = {"realtime": "true"} if realtime else {}
        with (
            joined(Peered) as peer,
            node_process([PARAMETERS, more], work, PATIENCE, values) as child,
        ):
            peer.wait_for_node(child.check)
            peer.node_process = child.process.pid
            peer.wait_until(lambda: "knee_contact: viewer" in peer.diagnostics)
            with busy(beside):
                stretches = soak(peer, round(60.0 * minutes * RATE / BETWEEN), dice)
                peer.spin(2.0)
                refused = peer.diagnostics["knee_contact: refused samples"]["total"]
            call(peer, Trigger, "/knee_contact/stop_recording", Trigger.Request())  # type: ignore[arg-type]
            peer.wait_until((work / RECORDING).exists)
            peer.wait_until(lambda: peer.diagnostics["knee_contact: viewer"]["backlog"] == "0")
        found = again(work / RECORDING, [stretch.first for stretch in stretches])
    header_ = ("fault before", "times", "lost", "answers flagged, per time", "slowest answer [ms]")
    sections = [
        Section("", TEXT, ("whole run", "value"), figures(stretches, found, refused)),
        Section("By fault", "", header_, rows(stretches, found.flags)),
    ]
    command = f"python -m studies.fault_soak --minutes {minutes:g} --seed {seed} --busy {beside}"
    if realtime:
        command += " --realtime"
    save(output, "Faults at 1 kHz", command, sections, machine())


if __name__ == "__main__":
    main()
