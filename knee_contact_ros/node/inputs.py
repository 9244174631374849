"""The node's inputs: subscriptions as reliable as their publishers allow, another node in the process, transforms."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection
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

from knee_contact_ros.node.diagnostics import HANDED_OVER, LOG_PERIOD, InputMeter, at_most_every
from knee_contact_ros.parameters.sources import Source
from knee_contact_ros.streams.conversion import Convert
from knee_contact_ros.streams.frames import TF_STATIC, ForceFrame, decode_transforms, encode_transforms, isb_transform
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.files import installed_share
from knee_contact_ros.system.ros import resolved

LOOK_PERIOD = 1.0
"""Time [s] between two looks for topics that match a pattern"""
DEPTH = 1000
"""Number of messages that may wait: one second at 1 kHz"""


class HandOver:
    """Hands messages from one node to another in the same process."""

    def __init__(self) -> None:
        self.taker: Callable[[bytes], object] | None = None
        """Function of the receiving node that takes a message; None if it does not listen"""
        self.source: Source | None = None
        """Source of the giving node's messages"""

    def give(self, data: bytes) -> None:
        """Hand over a message, if the other node listens."""
        if self.taker:
            self.taker(data)


class HandedInputs(NamedTuple):
    """Both inputs of a node that another node in the same process provides."""

    angles: HandOver
    forces: HandOver


class HandedStream:
    """Input that comes from a node in the same process, not from its topic; used like an `InputStream`."""

    reliability, publishers = HANDED_OVER, 1

    def __init__(self, topic: str, on_data: Callable[[bytes], int | None], meter: InputMeter, source: HandOver) -> None:
        """Take the messages of `source`: `on_data` gets the bytes of one and returns its stamp, `meter` counts it."""
        self.topic, self.meter = topic, meter
        self._on_data, self._source = on_data, source

    def open(self) -> None:
        """Begin to take messages."""
        self._source.taker = self._on_message

    def close(self) -> None:
        """Take no more messages."""
        self._source.taker = None

    def adapt(self) -> None:
        """Do nothing: there is no publisher to adapt to."""

    def _on_message(self, data: bytes) -> None:
        stamp = self._on_data(data)
        self.meter.arrivals.append((time.monotonic(), time.time(), stamp))


class InputStream:
    """Subscription to the bytes of a topic.

    A reliable subscription gets nothing from a best-effort publisher, and a best-effort one may miss samples. So it
    begins as reliable, and becomes best effort when it meets a best-effort publisher, unless the user has decided.
    """

    def __init__(
        self,
        node: LifecycleNode,
        message_type: type,
        topic: str,
        on_data: Callable[[bytes], int | None],
        qos_given: Collection[str],
        meter: InputMeter,
        convert: Convert | None = None,
    ) -> None:
        """Prepare a subscription: `on_data` gets the bytes of a message and returns its stamp, `meter` counts it.

        `qos_given` has the names of the QoS overrides that the user has given; `convert` turns messages of other types
        into those that `on_data` takes.
        """
        self.topic = topic
        self._convert = convert
        self.meter = meter
        self.best_effort = False
        self.has_overrides = True
        """Whether a user may override QoS policies"""
        self._node = node
        self._type = message_type
        self._on_data = on_data
        self._unheard = False  # there is a publisher whose samples cannot come
        name = f"qos_overrides.{node.resolve_topic_name(topic)}.subscription.reliability"
        self._decided_by_user = name in qos_given
        self._subscription: Any = None

    def open(self) -> None:
        """Subscribe."""
        reliability = ReliabilityPolicy.BEST_EFFORT if self.best_effort else ReliabilityPolicy.RELIABLE
        self._unheard = False
        self._subscription = self._node.create_subscription(
            self._type,
            self.topic,
            self._on_other_message if self._convert else self._on_message,
            QoSProfile(depth=DEPTH, reliability=reliability),
            raw=True,
            event_callbacks=SubscriptionEventCallbacks(incompatible_qos=self._on_incompatible_qos),
            qos_overriding_options=QoSOverridingOptions(self._left_to_user()),
        )

    def _left_to_user(self) -> list[QoSPolicyKind]:
        """QoS policies that a user may override; once declared, the reliability would stay as it was at first."""
        if not self.has_overrides:
            return []
        ours = self.best_effort and not self._decided_by_user
        reliability = [] if ours else [QoSPolicyKind.RELIABILITY]
        return [QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH, *reliability]

    def close(self) -> None:
        """End the subscription."""
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
        self._subscription = None

    @property
    def reliability(self) -> str:
        """Reliability of the subscription; empty if there is none."""
        return self._subscription.qos_profile.reliability.name.lower() if self._subscription is not None else ""

    @property
    def publishers(self) -> int:
        """Number of publishers that the subscription is matched with."""
        return self._subscription.get_publisher_count() if self._subscription is not None else 0

    def adapt(self) -> None:
        """Subscribe as best effort if a publisher could not be received.

        Not to be called from the subscription's own callbacks.
        """
        if not self._unheard or self.best_effort:
            return
        self._unheard = False
        name = self._node.resolve_topic_name(self.topic)
        if self._decided_by_user:
            self._node.get_logger().warning(f"a publisher of {name} cannot be heard: its QoS does not fit the override")
            return
        self.best_effort = True
        self.close()
        self.open()
        self._node.get_logger().info(f"a publisher of {name} is best effort; the node listens in the same way")

    def _on_message(self, data: bytes) -> None:
        stamp = self._on_data(data)
        self.meter.arrivals.append((time.monotonic(), time.time(), stamp))

    def _on_other_message(self, data: bytes) -> None:
        assert self._convert is not None  # noqa: S101  (by `open`)
        self._on_message(self._convert(data, time.time_ns()))  # the events executor gives no times

    def _on_incompatible_qos(self, event: Any) -> None:
        self._unheard = event.last_policy_kind == QoSPolicyKind.RELIABILITY or self._decided_by_user


class MatchingStreams:
    """Subscriptions to all topics of a type whose names match a pattern; used like an `InputStream`.

    Topics that come later are found within a second, those whose publishers are gone are left.
    """

    def __init__(self, node: LifecycleNode, message_type: type, topic: str, *how: Any) -> None:
        """Prepare the subscriptions; see `InputStream`."""
        self.topic, self._node, self._type, self._how = topic, node, message_type, how
        self.meter: InputMeter = how[2]
        self._streams: dict[str, InputStream] = {}
        self._due = math.inf

    def open(self) -> None:
        """Begin to look for topics."""
        self._due = 0.0

    def close(self) -> None:
        """End all subscriptions."""
        self._due = math.inf
        for stream in self._streams.values():
            stream.close()
        self._streams = {}

    @property
    def reliability(self) -> str:
        """Reliabilities of the subscriptions."""
        return ", ".join(sorted({stream.reliability for stream in self._streams.values()}))

    @property
    def publishers(self) -> int:
        """Number of publishers that the subscriptions are matched with."""
        return sum(stream.publishers for stream in self._streams.values())

    def adapt(self) -> None:
        """Look for topics once a second; see also `InputStream.adapt`."""
        for stream in self._streams.values():
            stream.adapt()
        if time.monotonic() < self._due:
            return
        self._due = time.monotonic() + LOOK_PERIOD
        pattern = resolved(self._node, self.topic)
        kind = f"{self._type.__module__.split('.')[0]}/msg/{self._type.__name__}"
        topics = {
            name
            for name, types in self._node.get_topic_names_and_types()
            if kind in types and fnmatchcase(name, pattern) and self._node.count_publishers(name)
        }
        for name in self._streams.keys() - topics:
            self._streams.pop(name).close()
        for name in sorted(topics - self._streams.keys()):
            self._node.get_logger().info(f"listening to {name}")
            self._streams[name] = InputStream(self._node, self._type, name, *self._how)
            self._streams[name].has_overrides = False  # nobody knows the names before
            self._streams[name].open()


def message_class(source: Source, by: str) -> type:
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
        raise UsageError(f"parameter {by}: the ROS 2 package {package} has no message {name}") from None
    return found


def installed_types(source: Source, by: str) -> Typestore:
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
            raise UsageError(f"parameter {by}: {name} needs the ROS 2 package {package}, which is not installed")
        try:
            store.register(get_types_from_msg((share / "msg" / f"{message}.msg").read_text(encoding="utf-8"), name))
        except Exception as error:  # a definition by somebody else
            reason = " ".join(str(error).split())
            raise UsageError(f"parameter {by}: the definition of {name} cannot be read: {reason}") from None
        fields: Any = store.fielddefs[name][1]
        for _, (kind, detail) in fields:
            inner, of = detail[0] if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE) else (kind, detail)
            wanted += [of] if inner is Nodetype.NAME else []
    return store


Input = InputStream | MatchingStreams | HandedStream
Inputs = tuple[Input, Input]
"""Streams of angles and of forces"""


LATCHED = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""QoS of `/tf_static` as tf2 has it: late subscribers get all earlier messages"""


class StaticTransformTopic:
    """Publisher and subscription of `/tf_static`, if `frame.tibia` names a frame and tf2_msgs is installed."""

    def __init__(self, node: LifecycleNode, frame: ForceFrame) -> None:
        """Publish where the tibia frame lies, if its name says so; transforms of others are handed to `frame`."""
        self._node, self._frame = node, frame
        self._publisher: Any = None
        self._subscription: Any = None
        if not frame.wanted:
            return
        try:
            from tf2_msgs.msg import TFMessage
        except ImportError:
            node.get_logger().warning(
                f"the ROS 2 package tf2_msgs is not installed: forces in other frames than {frame.wanted} are "
                "refused, and the place of this frame is not published"
            )
            return
        own = isb_transform(frame.wanted)
        if own:
            self._publisher = node.create_publisher(TFMessage, TF_STATIC, LATCHED)
            self._publisher.publish(encode_transforms([own], node.get_clock().now().nanoseconds))
        self._subscription = node.create_subscription(TFMessage, TF_STATIC, self._on_transforms, LATCHED, raw=True)

    def close(self) -> None:
        """Close publisher and subscription."""
        if self._publisher is not None:
            self._node.destroy_publisher(self._publisher)
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
        self._publisher = self._subscription = None

    def _on_transforms(self, data: bytes) -> None:
        try:
            problems = self._frame.learn(decode_transforms(data))
        except ValueError as error:
            problems = [str(error)]
        if problems:
            more = f" (and {len(problems) - 1} more like that)" if len(problems) > 1 else ""
            text = f"{TF_STATIC}: {problems[0]}{more}"
            self._node.get_logger().warning(text, **at_most_every(LOG_PERIOD))
