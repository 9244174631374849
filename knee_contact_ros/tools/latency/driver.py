"""The measuring process: one thread publishes samples on schedule and receives the answers meanwhile.

A sample is late if this process is; that is counted (`slips`), and a latency counts from when a force was published.
"""

from __future__ import annotations

import gc
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple, TypeVar

import rclpy
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState

from knee_contact_ros.msg import KneeContact
from knee_contact_ros.streams.messages import stamp_in
from knee_contact_ros.streams.topics import JOINT_REACTION_FORCE, JOINT_STATES, KNEE_CONTACT, NANOSECONDS
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.executor import executor_of
from knee_contact_ros.tools.latency.samples import Sample, samples

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
        self._feed = feed
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
        while not (self._peers() == [*self._feed.peers] and self._knock()):
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
        coming = self._feed.samples(rate, self._stamp)
        self._waiting, self._latencies = {}, []
        next(coming)  # so that what is prepared once is
        gc.collect()
        gc.disable()
        try:
            slips, sending = self._publish_all(coming, 1e9 / rate, number)
            end = time.perf_counter_ns()
            self._wait_for_answers()
        finally:
            gc.enable()
        return Run(number, self._latencies, slips, sending, max(self._last - end, 0) * 1e-9)

    def _publish_all(self, coming: Iterator[Sample], period: float, number: int) -> tuple[list[int], float]:
        """Publish on schedule, `period` in [ns]; return how late each was [ns] and how long it took [s]."""
        clock, spin, waiting = time.perf_counter_ns, self._spin, self._waiting
        publish_angle, publish_force = self._angle.publish, self._force.publish
        slips = []
        begin = clock()
        for index in range(number):
            stamp, angle, force = next(coming)
            due = begin + int(index * period)
            if waiting and clock() > due:
                spin(0.0)  # behind the schedule there is time for one answer per sample all the same
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
        sent = self._waiting.pop(stamp_in(data), None)
        if sent is not None:
            self._latencies.append(now - sent)
            self._last = now

    def _wait_for_answers(self) -> None:
        """Wait until all answers are there, or nothing has come for `LAST_ANSWERS`."""
        since = time.perf_counter_ns()
        while self._waiting and time.perf_counter_ns() - max(since, self._last) < LAST_ANSWERS * 1e9:
            self._spin(CHECK)

    def _knock(self) -> bool:
        """Publish one sample, and return whether it is answered."""
        self._waiting, self._latencies = {}, []
        self._publish_all(self._feed.samples(KNOCK_RATE, self._stamp), 1e9 / KNOCK_RATE, 1)
        end = time.monotonic() + 2.0 * CHECK
        while not self._latencies and time.monotonic() < end:
            self._spin(CHECK)
        return bool(self._latencies)

    def _peers(self) -> list[int]:
        """Count the subscribers to both inputs, and the publishers of answers."""
        listening = [publisher.get_subscription_count() for publisher in (self._angle, self._force)]
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
    executor = executor_of(node)
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
