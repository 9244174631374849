"""The node's inputs: subscriptions that every publisher can serve, another node in the process, transforms."""

import math
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from fnmatch import fnmatchcase
from importlib import import_module
from typing import Any, NamedTuple

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.lifecycle import LifecycleNode
from rclpy.qos import DurabilityPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore
from tf2_msgs.msg import TFMessage

from ..parameters.sources import TopicSource
from ..streams.conversion import ANY, Convert
from ..streams.frames import (
    MOST_MOVING,
    TF_MOVING,
    TF_STATIC,
    ForceFrame,
    decode_transforms,
    encode_transform,
    isb_transform,
)
from ..system.errors import UsageError, suggest
from ..system.files import installed_share
from ..system.ros import resolve_topic
from .problems import (
    ERROR,
    LOG_PERIOD,
    STALE,
    WARN,
    Problem,
    at_most_every,
    first_problem,
)

SEARCH_PERIOD = 1.0
"""Time [s] between two searches for topics that match a pattern"""
INPUT_DEPTH = 1000
"""Number of messages that may wait: one second at 1 kHz"""


LARGEST_AGE = 3600.0
"""Age of a message [s] above which its stamp must be by another clock"""
OWN_CLOCK = 1.0
"""Usual age of messages [s] up to which their stamps are by this computer's clock, so that later ones are late"""
REPORTS = 5
"""Number of reports, one a second, whose least age is usual; with slower replay the ages of a second grow"""


class HandOver:
    """Hands messages from one node to another in the same process."""

    def __init__(self) -> None:
        self.taker: Callable[[bytes], object] | None = None
        """Function of the receiving node that takes a message; None if it does not listen"""
        self.source: TopicSource | None = None
        """Source of the giving node's messages"""

    def give_message(self, data: bytes) -> None:
        """Hand over a message, if the other node listens."""
        if self.taker:
            self.taker(data)


class HandedInputs(NamedTuple):
    """Both inputs of a node that another node in the same process provides."""

    angles: HandOver
    forces: HandOver


class InputMeter:
    """Counts the messages of one input stream, and judges its rate and its pauses."""

    def __init__(
        self,
        warn_rate: float = 0.0,
        error_rate: float = 0.0,
        max_gap: float = math.inf,
        timeout: float = math.inf,
    ) -> None:
        """Begin to measure.

        Args:
            warn_rate: Rate [Hz] below which a warning is reported; 0: never.
            error_rate: Rate [Hz] below which an error is reported; 0: never.
            max_gap: Silence [s] from which a warning is reported.
            timeout: Silence [s] from which the stream is reported as stale.
        """
        self.warn_rate, self.error_rate, self.max_gap, self.timeout = (
            warn_rate,
            error_rate,
            max_gap,
            timeout,
        )
        self.received = 0
        """Number of messages that have come"""
        self.clock: Callable[[], float] = time.time
        """Time [s] by which messages have an age"""
        self.is_simulated = False
        """Whether that is simulated time, which jumps from one message of `/clock` to the next"""
        self.is_late = False
        """Whether the last message came later after its stamp than usual, by more than `max_gap`"""
        self.longest_pause = 0.0
        """Longest time [s] before a message, since the report before the last one"""
        self._longest_before = 0.0
        self.restart()

    def restart(self) -> None:
        """Start to measure; the time before counts neither for the rate nor as silence."""
        self.is_late, self._late_age = False, math.inf
        self._least_ages: deque[float] = deque(maxlen=REPORTS)  # of the last reports [s]
        self.last = self._reported = time.monotonic()
        self._pauses: list[float] = []  # [s] before each message since the last report
        self._ages: list[
            float
        ] = []  # [s] from their stamps to their arrivals, by the system's clock

    def count_message(self, stamp: int | None) -> None:
        """Count a message that has come now, with its stamp [ns] if it has one."""
        now = time.monotonic()
        self._pauses.append(now - self.last)
        self.received, self.last = self.received + 1, now
        if stamp is not None:
            age = self.clock() - 1e-9 * stamp
            self._ages.append(age)
            self.is_late = age > self._late_age

    def report_rate(self) -> tuple[dict[str, str], Problem]:
        """Values for the time since the last report, and what is wrong."""
        now, number = time.monotonic(), len(self._pauses)
        age, rate = now - self.last, number / max(now - self._reported, 1e-9)
        values = {"received": str(self.received), "rate [Hz]": f"{rate:.1f}"}
        longest = max(self._pauses, default=0.0)
        self.longest_pause = max(longest, self._longest_before)
        self._longest_before = longest
        if self._pauses:
            values["longest pause [ms]"] = f"{1e3 * longest:.1f}"
        if self._ages and abs(self._ages[-1]) > LARGEST_AGE:
            values["message age"] = "not known: the stamps are not by this computer's clock"
        elif self._ages:
            values["message age mean [ms]"] = f"{1e3 * sum(self._ages) / len(self._ages):.3f}"
            values["message age max [ms]"] = f"{1e3 * max(self._ages):.3f}"
        known = self.received > number  # the first messages came at some time of a second
        late = max(self._ages, default=0.0) - self._late_age + self.max_gap
        self._judge_ages()
        self._reported, self._pauses, self._ages = now, [], []
        return values, first_problem(
            (not self.received, STALE, "nothing received yet"),
            (age > self.timeout, STALE, f"timeout: silent for {age:.1f} s"),
            (age > self.max_gap, WARN, f"silent for {age:.1f} s"),
            (
                known and rate < self.error_rate,
                ERROR,
                f"rate low: {rate:.1f} Hz, below {self.error_rate:g} Hz",
            ),
            (
                known and rate < self.warn_rate,
                WARN,
                f"rate low: {rate:.1f} Hz, below {self.warn_rate:g} Hz",
            ),
            (
                late > self.max_gap,
                WARN,
                f"came up to {late:.2f} s later than usual: answers were flagged (STALE_INPUT)",
            ),
        )

    def _judge_ages(self) -> None:
        """Find the age from which messages are late, if their stamps are by this computer's clock."""
        if self._ages:
            self._least_ages.append(min(self._ages))
        usual = min(self._least_ages, default=math.inf)
        is_known = abs(usual) < OWN_CLOCK and not self.is_simulated
        self._late_age = usual + self.max_gap if is_known else math.inf


class Input:
    """Subscriptions to the bytes of a topic, or of all topics of a type whose names match a pattern.

    Another node in the process may hand the messages over instead (`handed`).

    Subscriptions are best effort, as a reliable one gets nothing from a best-effort publisher, unless the user has
    decided. Matching topics that appear later are found within a second; topics without publishers are dropped.
    """

    def __init__(
        self,
        node: LifecycleNode,
        topic: str,
        on_message: Callable[[bytes], object],
        meter: InputMeter,
        message_type: Any = None,
        convert: Convert | None = None,
        handed: HandOver | None = None,
    ) -> None:
        """Prepare a subscription: `on_message` gets the bytes of a message, and counts it with `meter`.

        `convert` turns messages of other types into those that `on_message` takes.
        """
        self.topic, self.meter, self.handed = topic, meter, handed
        self._arrival: Callable[[], int] = time.time_ns
        self.reason = ""
        """Why nothing has come, as far as the graph shows"""
        self._node, self._type, self._on_message, self._convert = (
            node,
            message_type,
            on_message,
            convert,
        )
        self._subscriptions: dict[str, Any] = {}  # by topic
        self._unheard = set[str]()  # topics with a publisher that an override does not fit
        self._matches = ANY in topic
        self._due = math.inf  # when to look for topics that match

    def follow_clock(self) -> None:
        """Take times of arrival and ages from simulated time where the node has it."""
        clock = self._node.get_clock()
        self._arrival, self.meter.clock = time.time_ns, time.time
        self.meter.is_simulated = clock.ros_time_is_active
        if clock.ros_time_is_active:
            self._arrival = lambda: int(clock.now().nanoseconds)
            self.meter.clock = lambda: 1e-9 * clock.now().nanoseconds

    def start_listening(self) -> None:
        """Subscribe, or begin to look for topics or to take what is handed over."""
        if self.handed:
            self.handed.taker = self._on_message
        elif self._matches:
            self._due = 0.0
        else:
            self._subscribe(self.topic)

    def _subscribe(self, topic: str) -> None:
        left = [QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH, QoSPolicyKind.RELIABILITY]
        self._subscriptions[topic] = self._node.create_subscription(
            self._type,
            topic,
            self._on_foreign_message if self._convert else self._on_message,
            QoSProfile(depth=INPUT_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT),
            raw=True,
            event_callbacks=SubscriptionEventCallbacks(
                incompatible_qos=lambda _: self._unheard.add(topic)
            ),
            # To the user; nobody knows names that match before
            qos_overriding_options=QoSOverridingOptions([] if self._matches else left),
        )

    def _unsubscribe(self, topic: str) -> None:
        self._node.destroy_subscription(self._subscriptions.pop(topic))

    def stop_listening(self) -> None:
        """Stop taking messages."""
        if self.handed:
            self.handed.taker = None
        self._due = math.inf
        self._unheard.clear()
        for topic in list(self._subscriptions):
            self._unsubscribe(topic)

    @property
    def reliability(self) -> str:
        """Reliabilities of the subscriptions; empty if there are none."""
        if self.handed:
            return "handed over"
        found = {
            each.qos_profile.reliability.name.lower() for each in self._subscriptions.values()
        }
        return ", ".join(sorted(found))

    @property
    def publishers(self) -> int:
        """Number of publishers that are heard."""
        return (
            1
            if self.handed
            else sum(each.get_publisher_count() for each in self._subscriptions.values())
        )

    def look_for_publishers(self) -> None:
        """Name publishers that an override of the user does not fit; look for topics once a second.

        Do not call it from the subscription's own callbacks.
        """
        for topic in self._unheard:
            name = self._node.resolve_topic_name(topic)
            text = f"a publisher of {name} cannot be heard: its QoS does not fit the override"
            self._node.get_logger().warning(text)
        self._unheard.clear()
        if time.monotonic() >= self._due:
            self._due = time.monotonic() + SEARCH_PERIOD
            self._search_topics()

    def _search_topics(self) -> None:
        """Subscribe to new topics that match, and unsubscribe from those that are gone."""
        pattern = resolve_topic(self._node, self.topic)
        kind = f"{self._type.__module__.split('.')[0]}/msg/{self._type.__name__}"
        topics = {
            name
            for name, types in self._node.get_topic_names_and_types()
            if kind in types and fnmatchcase(name, pattern) and self._node.count_publishers(name)
        }
        for name in self._subscriptions.keys() - topics:
            self._unsubscribe(name)
        for name in sorted(topics - self._subscriptions.keys()):
            self._node.get_logger().info(f"listening to {name}")
            self._subscribe(name)

    def _on_foreign_message(self, data: bytes) -> None:
        assert self._convert is not None  # noqa: S101  (by `_subscribe`)
        for made in self._convert(data, self._arrival()):  # the events executor gives no times
            self._on_message(made)


def message_class(source: TopicSource, by: str) -> type:
    """Class of the messages of a source, which the parameter `by` names.

    Raises:
        UsageError: it is not installed.
    """
    package, _, name = source.type.split("/")
    try:
        found: type = getattr(import_module(f"{package}.msg"), name)
    except ImportError:
        raise UsageError(
            f"parameter {by}: {source.topic!r} needs the ROS 2 package {package}, which is not installed"
        ) from None
    except AttributeError:
        raise UsageError(
            f"parameter {by}: the ROS 2 package {package} has no message {name}"
        ) from None
    return found


def installed_types(source: TopicSource, by: str) -> Typestore:
    """Definitions of the type of a source and of all types in it, as they are installed.

    Raises:
        UsageError: one of them is not installed, or cannot be read; it names the parameter `by`.
    """
    store, wanted = get_typestore(Stores.EMPTY), [source.type]
    while wanted:
        name = wanted.pop()
        if name in store.fielddefs:
            continue
        package, _, message = name.split("/")
        share = installed_share(package)
        if share is None:
            raise UsageError(
                f"parameter {by}: {name} needs the ROS 2 package {package}, which is not installed"
            )
        definition = share / "msg" / f"{message}.msg"
        if not definition.exists():
            hint = suggest(message, [each.stem for each in definition.parent.glob("*.msg")])
            raise UsageError(f"parameter {by}: {package} has no message {message}; {hint}")
        try:
            store.register(get_types_from_msg(definition.read_text(encoding="utf-8"), name))
        except Exception as error:  # a definition by somebody else
            reason = " ".join(str(error).split())
            raise UsageError(
                f"parameter {by}: the definition of {name} cannot be read: {reason}"
            ) from None
        fields: Any = store.fielddefs[name][1]
        for _, (kind, detail) in fields:
            inner, of = (
                detail[0] if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE) else (kind, detail)
            )
            wanted += [of] if inner is Nodetype.NAME else []
    return store


Inputs = tuple[Input, Input]
"""Streams of angles and of forces"""


LATCHED = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""QoS of `/tf_static`, the same as in tf2: late subscribers get all earlier messages"""
ANY_PUBLISHER = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
"""QoS that every publisher of `/tf` fits"""


class StaticTransformTopic:
    """Publisher and subscription of `/tf_static`, if `frame.tibia` names a frame; `/tf` is heard for its error only."""

    def __init__(self, node: LifecycleNode, frame: ForceFrame) -> None:
        """Publish the pose of the tibia frame if its name implies it, and hand the transforms of others to `frame`."""
        self._node, self._frame = node, frame
        self._publisher: Any = None
        self._subscription: Any = None
        self._moving: Any = None  # subscription of `/tf`, until the way to the tibia is known
        self._moving_left = MOST_MOVING
        if not frame.wanted:
            return
        own = isb_transform(frame.wanted)
        if own:
            self._publisher = node.create_publisher(TFMessage, TF_STATIC, LATCHED)
            self._publisher.publish(encode_transform(own, node.get_clock().now().nanoseconds))
        self._subscription = node.create_subscription(
            TFMessage, TF_STATIC, self._on_transforms, LATCHED, raw=True
        )
        self._moving = node.create_subscription(
            TFMessage, TF_MOVING, self._on_moving, ANY_PUBLISHER, raw=True
        )

    def leave_moving(self) -> None:
        """Leave `/tf` as soon as it can tell nothing more. Do not call it from a callback of a subscription."""
        if self._moving and (self._frame.is_held or self._moving_left <= 0):
            self._node.destroy_subscription(self._moving)
            self._moving = None

    def _on_moving(self, data: bytes) -> None:
        self._moving_left -= 1
        with suppress(ValueError):
            self._frame.note_moving(decode_transforms(data))

    def withdraw(self) -> None:
        """Close publisher and subscription."""
        self._node.destroy_publisher(self._publisher)  # which does nothing without one
        self._node.destroy_subscription(self._subscription)
        self._node.destroy_subscription(self._moving)

    def _on_transforms(self, data: bytes) -> None:
        try:
            problems = self._frame.add_transforms(decode_transforms(data))
        except ValueError as error:
            problems = [str(error)]
        if problems:
            more = f" (and {len(problems) - 1} more like that)" if len(problems) > 1 else ""
            text = f"{TF_STATIC}: {problems[0]}{more}"
            self._node.get_logger().warning(text, **at_most_every(LOG_PERIOD))
