"""Publish a bag's input topics in time, over real ROS topics."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import click
import rclpy
from builtin_interfaces.msg import Time
from geometry_msgs.msg import WrenchStamped
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from knee_contact_ros.graph import joining
from knee_contact_ros.messages import NANOSECONDS
from knee_contact_ros.salvage.source import in_a_line
from knee_contact_ros.stream_in.bag import BagReader, RawMessage
from knee_contact_ros.terminal import progress
from knee_contact_ros.topics import JOINT_REACTION_FORCE, JOINT_STATES

QOS = QoSProfile(depth=1000)


class Timing(NamedTuple):
    """How to time a replay."""

    rate: float = 1.0
    """Seconds of the bag per second"""
    loop: bool = False
    clock: bool = False
    """Publish /clock too"""
    wait: float = 10.0
    """How long [s] to wait for a subscriber of each topic; then publish all the same"""


class Replayer:
    """Publishers for the input topics of a bag."""

    def __init__(self, node: Node, bag: BagReader, clock: bool = False) -> None:
        """Read the whole bag; with `clock`, /clock will be published too."""
        self.messages = list(bag.raw_messages())
        self.publishers = {
            f"/{JOINT_STATES}": node.create_publisher(JointState, JOINT_STATES, QOS),
            f"/{JOINT_REACTION_FORCE}": node.create_publisher(WrenchStamped, JOINT_REACTION_FORCE, QOS),
        }
        self._clock = node.create_publisher(Clock, "/clock", QOS) if clock else None

    def wait_for_subscribers(self, seconds: float, spin: Callable[[float], None]) -> bool:
        """Wait until each topic has a subscriber; False if the time runs out."""
        deadline = time.monotonic() + seconds
        while not all(publisher.get_subscription_count() for publisher in self.publishers.values()):
            if time.monotonic() > deadline:
                return False
            spin(0.02)
        return True

    def run(self, rate: float, spin: Callable[[float], None], published: Callable[[RawMessage, int], None]) -> None:
        """Publish all messages, each when its log time comes, at `rate` seconds of the bag per second.

        `spin` is called with the time [s] to the next message; `published` after each, with how many it makes.
        """
        begin = time.perf_counter()
        first = self.messages[0].log_time
        for number, message in enumerate(self.messages, start=1):
            due = begin + (message.log_time - first) / NANOSECONDS / rate
            while (left := due - time.perf_counter()) > 0.0:
                spin(left)
            if self._clock:
                seconds, nanoseconds = divmod(message.log_time, NANOSECONDS)
                self._clock.publish(Clock(clock=Time(sec=seconds, nanosec=nanoseconds)))
            self.publishers[message.topic].publish(message.data)
            published(message, number)


def run_replay(bag: Path, timing: Timing) -> None:
    """`knee-contact replay`: publish a bag's inputs in time, with a progress bar.

    Raises:
        UsageError: the bag cannot be used, or ROS does not let us in.
    """
    with BagReader(bag) as reader:
        if reader.damage:
            click.echo(f"bag {bag} is damaged; publishing what can be read: {in_a_line(reader.damage)}", err=True)
        with joining():
            rclpy.init(args=None, signal_handler_options=SignalHandlerOptions.NO)
            node = Node("knee_contact_replay")
        try:
            replayer = Replayer(node, reader, timing.clock)
            if not replayer.wait_for_subscribers(timing.wait, time.sleep):
                click.echo(f"no subscriber on every topic after {timing.wait:g} s; publishing all the same", err=True)
            run_once(replayer, bag.name, timing.rate)
            while timing.loop:
                run_once(replayer, bag.name, timing.rate)
            for publisher in replayer.publishers.values():
                publisher.wait_for_all_acked(Duration(seconds=timing.wait))
        finally:
            node.destroy_node()
            rclpy.shutdown()


def run_once(replayer: Replayer, name: str, rate: float) -> None:
    """Replay from beginning to end, with a progress bar."""
    total = len(replayer.messages)
    with progress(f"Replaying {name}") as advance:

        def published(_message: RawMessage, number: int) -> None:
            advance(number, total)

        replayer.run(rate, time.sleep, published)
