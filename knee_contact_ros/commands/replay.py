"""`knee-contact replay`: publish a bag's input topics in time over ROS 2 topics, as `ros2 bag play` does."""

import gc
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from itertools import repeat
from pathlib import Path
from typing import NamedTuple

import click
import rclpy
from builtin_interfaces.msg import Time
from geometry_msgs.msg import WrenchStamped
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from tf2_msgs.msg import TFMessage

from ..bags.bag import Bag, RawMessage, TopicReader
from ..bags.names import OWN_NAMES, Names, absolute
from ..offline.bag_inputs import transform_messages
from ..streams.frames import TF_STATIC
from ..streams.topics import INPUTS, JOINT_STATES, NANOSECONDS, types_of
from ..system.errors import UsageError, join_faults
from ..system.keyboard import Keyboard, has_terminal
from ..system.processes import unwinding_on_signals
from ..system.progress import progress
from ..system.ros import one_line_ros_errors
from ..system.terminal import say
from .player import (
    HELP,
    Lateness,
    Player,
    commands_of,
)

_QOS = QoSProfile(depth=1000)
_LATCHED_QOS = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_LAST_ACKNOWLEDGEMENTS = 0.5
"""Time [s] that subscribers have to acknowledge messages when a signal ends the replay"""
_SETTLING_TIME = 2.0
"""Time [s] without a new subscriber before playing: ROS finds those of two nodes up to 1.6 s apart"""


class Timing(NamedTuple):
    """Options of the timing of a replay."""

    rate: float = 1.0
    """Rate in seconds of the bag per second"""
    loop: bool = False
    """Whether to start over at the end"""
    clock: float | None = None
    """Rate [Hz] at which /clock is published; 0: with every message; None: not at all"""
    wait: float = 10.0
    """Longest wait [s] for a subscriber of every topic; then messages are published anyway"""
    start_offset: float = 0.0
    """Time [s] to leave out at the beginning of the bag"""
    duration: float | None = None
    """Time [s] of the bag to play; None: up to its end"""
    delay: float = 0.0
    """Time [s] to wait before the first message"""
    start_paused: bool = False
    """Whether to begin with a pause, which a key ends"""


class Replayer:
    """Publishers for the input topics of a bag."""

    def __init__(
        self,
        node: Node,
        *,
        inputs: Sequence[str] = INPUTS,
        clock: bool = False,
        transforms: Sequence[bytes] = (),
    ) -> None:
        """Make publishers of the topics `inputs`, and of /clock if `clock` is true; publish `transforms` at once."""
        types = {JOINT_STATES: JointState}
        self.publishers = {
            f"/{topic}": node.create_publisher(types.get(topic, WrenchStamped), topic, _QOS)
            for topic in inputs
        }
        self._clock = node.create_publisher(Clock, "/clock", _QOS) if clock else None
        if transforms:
            publisher = node.create_publisher(TFMessage, TF_STATIC, _LATCHED_QOS)
            for data in transforms:
                publisher.publish(data)

    def wait_for_subscribers(self, seconds: float, spin: Callable[[float], object]) -> bool:
        """Wait until each topic has a subscriber and no new one comes; return False if that takes over `seconds`."""
        now = time.monotonic()
        deadline = now + seconds
        settled = now + _SETTLING_TIME
        counts = self._subscribers()
        while now < (settled if all(counts) else deadline) and now < deadline:
            spin(0.02)
            now = time.monotonic()
            if counts != (counts := self._subscribers()):
                settled = now + _SETTLING_TIME
        return all(counts)

    def _subscribers(self) -> list[int]:
        """Return the number of subscribers of each topic."""
        return [publisher.get_subscription_count() for publisher in self.publishers.values()]

    def publish(self, message: RawMessage) -> None:
        """Publish a message as it was recorded, with its stamp."""
        self.publishers[message.topic].publish(message.data)

    def publish_clock(self, now: int) -> None:
        """Publish the bag's time [ns]."""
        if self._clock:
            seconds, nanoseconds = divmod(now, NANOSECONDS)
            self._clock.publish(Clock(clock=Time(sec=seconds, nanosec=nanoseconds)))

    def wait_for_acknowledgements(self, seconds: float) -> None:
        """Wait until subscribers have acknowledged all messages, for `seconds` at most."""
        deadline = time.monotonic() + seconds
        for publisher in self.publishers.values():
            publisher.wait_for_all_acked(Duration(seconds=max(0.0, deadline - time.monotonic())))


def has_inputs(bag: Path, namespace: str, inputs: Sequence[str]) -> bool:
    """Return whether a bag has one of the inputs in a namespace."""
    with Bag(bag) as opened:
        topics = opened.topics
    return bool(namespace) and any(absolute(topic, namespace) in topics for topic in inputs)


def run_replay(
    bag: Path,
    timing: Timing,
    names: Names = OWN_NAMES,
    inputs: Sequence[str] = INPUTS,
    namespace: str = "",
) -> None:
    """Publish a bag's inputs in time into a namespace, with a progress bar and keys; print how late they were.

    Raises:
        UsageError: the bag cannot be used, no message is in the span, no key could end the pause at the beginning, or
            ROS cannot be joined.
    """
    if timing.start_paused and not has_terminal():
        raise UsageError(
            "--start-paused needs a terminal at standard input: there is no key to end the pause"
        )
    with ExitStack() as opened:
        opened.enter_context(unwinding_on_signals())
        open_bag = opened.enter_context(Bag(bag))
        reader = open_bag.select(types_of(inputs), names)
        if open_bag.damage:
            say(
                f"bag {bag} is damaged; publishing what can be read: {join_faults(open_bag.damage)}",
                err=True,
            )
        span = span_of(reader, timing)
        with one_line_ros_errors():
            rclpy.init(args=None, signal_handler_options=SignalHandlerOptions.NO)
            opened.callback(rclpy.shutdown)
            node = Node("knee_contact_replay", namespace=namespace.strip("/"))
            opened.callback(node.destroy_node)
        transforms = transform_messages(open_bag)
        replayer = Replayer(
            node, inputs=inputs, clock=timing.clock is not None, transforms=transforms
        )
        if not replayer.wait_for_subscribers(timing.wait, time.sleep):
            say(
                f"not every topic has a subscriber after {timing.wait:g} s; publishing anyway",
                err=True,
            )
        time.sleep(timing.delay)
        play_bag(reader, span, replayer, timing)


def span_of(reader: TopicReader, timing: Timing) -> tuple[int, int]:
    """Return the part of the bag that is played: log times [ns] of the first message, and after the last one.

    Raises:
        UsageError: no message is in this part.
    """
    bag = reader.bag
    message = next(reader.raw_messages(), None)
    if message is None:
        raise UsageError(
            f"bag {bag.path} has none of the {reader.message_count} messages that its metadata.yaml counts"
        )
    first = message.log_time
    start = first + round(timing.start_offset * NANOSECONDS)
    stop = bag.end if timing.duration is None else start + round(timing.duration * NANOSECONDS)
    if next(reader.raw_messages(start=start, stop=stop), None) is None:
        lasts = (bag.end - 1 - first) / NANOSECONDS
        raise UsageError(
            f"--start-offset {timing.start_offset:g}: bag {bag.path} has no message there; it lasts {lasts:.3f} s"
        )
    return start, min(stop, bag.end)


def play_bag(
    reader: TopicReader, span: tuple[int, int], replayer: Replayer, timing: Timing
) -> None:
    """Play the span once or in a loop; the report on lateness is printed even if a signal ends the replay."""
    start, stop = span
    lateness = Lateness()
    patience = _LAST_ACKNOWLEDGEMENTS
    keys = f" ({HELP})" if has_terminal() else ""

    def described(rate: float, paused: bool) -> str:
        state = "Paused" if paused else "Replaying"
        return f"{state} {reader.bag.path.name} at rate {rate:.3g}{keys}"

    player = Player(
        rate=timing.rate,
        paused=timing.start_paused,
        publish_time=replayer.publish_clock,
        clock_rate=timing.clock or 0.0,
        on_change=lambda rate, paused: bar.describe(described(rate, paused)),
    )
    # The collector would stop the interpreter for milliseconds to look through what stays anyway.
    gc.collect()
    gc.freeze()
    with ExitStack() as opened:
        # Called last, when bar and keyboard have left the terminal.
        opened.callback(lambda: click.echo(str(lateness)))
        bar = opened.enter_context(progress(described(timing.rate, timing.start_paused)))
        keyboard = opened.enter_context(Keyboard(player.leave_out))
        player.wait = lambda seconds: commands_of(keyboard.wait_for_keys(seconds))
        try:
            for _ in repeat(None) if timing.loop else (None,):
                for message, delay in player.play(reader.raw_messages(start=start, stop=stop)):
                    if timing.clock == 0.0:
                        replayer.publish_clock(message.log_time)
                    replayer.publish(message)
                    lateness.count_message(delay)
                    bar(message.log_time - start, stop - start)
            patience = timing.wait
        finally:
            replayer.wait_for_acknowledgements(patience)
