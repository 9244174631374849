"""Memory while something stands still: an input, the recorder, the viewer, a subscriber.

python -m studies.standing_still [--seconds N] [--rate HZ] [--workers N] [--output FILE]
"""

from __future__ import annotations

import itertools
import multiprocessing
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

import click
import psutil

from benchmarks.latency.driver import PARAMETERS, joined
from benchmarks.report import Section, machine, save
from knee_contact_ros.commands.stage import node_process
from knee_contact_ros.streams.messages import JointState, WrenchStamped, encode_joint_state, encode_wrench_stamped
from knee_contact_ros.streams.topics import NANOSECONDS
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.ros import private_graph
from studies.fault_soak import PATIENCE, Peered

LOOK = 5.0
"""Time [s] between two looks at the memory"""
FULL = 75_000
"""Number of samples after which every queue is full that will be: `record.queue` takes 30 000"""
JOINTS = (*(f"joint_{number}" for number in range(11)), "knee")
MB = 1e6
TEXT = """\
The real node (`healthy.yaml`, recording to MCAP, drawing to a Rerun file), JointStates of 12 joints, while something
stands still all the time. Memory is that of the node's own process: when all queues are full that will be (after
75 000 samples), and at most until the end. An error or a warning in `/diagnostics` says which it is, and an exit code
other than 0 that a file was given up."""
HEADER = ("stands still", "answers", "heard", "with full queues [MB]", "growth since then [MB]", "/diagnostics", "exit")


class Case(NamedTuple):
    """What is stopped in a run, and where the diagnostics show it."""

    name: str
    angles: bool = True
    forces: bool = True
    stop: str = ""
    """Name of the output whose process is stopped"""
    listener: bool = False
    """Whether a subscriber is stopped"""
    entry: str = ""
    """Entry of /diagnostics that reports it"""


CASES = (
    Case("nothing"),
    Case("the forces", forces=False, entry="pairing"),
    Case("the angles", angles=False, entry="joint_states"),
    Case("the recorder", stop="recorder", entry="recorder"),
    Case("the viewer", stop="viewer", entry="viewer"),
    Case("a subscriber", listener=True),
)


def feed(peer: Peered, case: Case, seconds: float, rate: float, look: Callable[[], None]) -> None:
    """Publish the samples that do not stand still, on schedule."""
    begin, due = time.perf_counter(), LOOK
    for number in range(round(seconds * rate)):
        stamp = peer.stamp + round(number * NANOSECONDS / rate)
        angle = 0.3 + 0.2 * (number % 1000) * 1e-3
        if case.angles:
            values = (*(0.0,) * (len(JOINTS) - 1), angle)
            peer.angle.publish(encode_joint_state(JointState(stamp, "", JOINTS, values, values, ())))
        if case.forces:
            peer.force.publish(encode_wrench_stamped(WrenchStamped(stamp, "tibia_r", (0.0, -900.0, 0.0), (0.0,) * 3)))
        passed = time.perf_counter() - begin
        if passed >= due:
            look()
            due += LOOK
        while (left := number / rate - (time.perf_counter() - begin)) > 0.0:
            peer.spin(min(left, 0.001))


@contextmanager
def stopped_listener(wanted: bool) -> Iterator[None]:
    """Run a reliable subscriber that is stopped, if it is wanted."""
    if not wanted:
        yield
        return
    code = "import time; from tests.ros.listener import listen; listen()"
    listener = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    try:
        if listener.stdout:
            listener.stdout.readline()
        listener.send_signal(signal.SIGSTOP)
        yield
    finally:
        listener.kill()
        listener.wait()


def row(case: Case, seconds: float, rate: float) -> list[str]:
    """Run a case in a ROS graph of its own, and return its row of the table."""
    with tempfile.TemporaryDirectory() as folder, private_graph() as environment:
        os.environ.update(environment)
        return run(case, seconds, rate, Path(folder))


def run(case: Case, seconds: float, rate: float, work: Path) -> list[str]:
    """Run a case, and return its row of the table."""
    memory: list[tuple[float, float]] = []
    heard, answers, said, code = 0, "", "", 0
    with suppress(UsageError), joined(Peered) as peer, node_process([PARAMETERS], work, PATIENCE) as child:
        peer.wait_for_node(child.check)
        process, begin = psutil.Process(child.process.pid), time.monotonic()
        entries = [f"knee_contact: {name}" for name in ("recorder", "viewer")]
        peer.wait_until(lambda: all(entry in peer.diagnostics for entry in entries))
        if case.stop:
            os.kill(int(peer.diagnostics[f"knee_contact: {case.stop}"]["process"]), signal.SIGSTOP)
        peer.contacts.clear()
        with stopped_listener(case.listener):
            feed(
                peer, case, seconds, rate,
                lambda: memory.append((time.monotonic() - begin, process.memory_info().rss / MB)),
            )  # fmt: skip
            peer.spin(1.5)
        heard, answers = len(peer.contacts), peer.diagnostics["knee_contact: ticks"]["ticks"]
        said = peer.problems.get(f"knee_contact: {case.entry}", "-")
        child.process.send_signal(signal.SIGINT)
        code = child.process.wait(PATIENCE)
    full = [amount for at, amount in memory if at >= FULL / rate] or [memory[-1][1]]
    growth = max(full) - full[0]
    said = said.replace(f"{work}/", "")
    return [case.name, answers, str(heard), f"{full[0]:.1f}", f"{growth:.1f}", said, str(code)]


@click.command()
@click.option("--seconds", default=300.0, show_default=True)
@click.option("--rate", default=1000.0, show_default=True, help="[Hz]")
@click.option("--workers", default=1, show_default=True, help="So many cases at a time")
@click.option(
    "--output", type=click.Path(path_type=Path), default=Path("docs/studies/standing_still.md"), show_default=True
)
def main(seconds: float, rate: float, workers: int, output: Path) -> None:
    """Measure and write the page."""
    rows = []
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), max_tasks_per_child=1) as pool:
        for measured in pool.map(row, CASES, itertools.repeat(seconds), itertools.repeat(rate)):
            rows.append(measured)
            click.echo(" | ".join(measured), err=True)
    command = f"python -m studies.standing_still --seconds {seconds:g} --rate {rate:g} --workers {workers}"
    save(output, "Standing still", command, [Section("", TEXT, HEADER, rows)], machine())


if __name__ == "__main__":
    main()
