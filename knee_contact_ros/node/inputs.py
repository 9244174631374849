"""The node's inputs: subscriptions as reliable as their publishers allow, another node in the process, transforms."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection
from typing import Any, NamedTuple

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.lifecycle import LifecycleNode
from rclpy.qos import DurabilityPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions

from knee_contact_ros.node.diagnostics import REFUSAL_LOG_PERIOD, InputMeter, at_most_every
from knee_contact_ros.streams.frames import TF_STATIC, ForceFrame, decode_transforms, encode_transforms, isb_transform

DEPTH = 1000
"""Number of messages that may wait: one second at 1 kHz"""


class HandOver:
    """Hands messages from one node to another in the same process."""

    def __init__(self) -> None:
        self.taker: Callable[[bytes], object] | None = None
        """Function of the receiving node that takes a message; None if it does not listen"""

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

    reliability, publishers = "handed over", 1

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
    ) -> None:
        """Prepare a subscription: `on_data` gets the bytes of a message and returns its stamp, `meter` counts it.

        `qos_given` has the names of the QoS overrides that the user has given.
        """
        self.topic = topic
        self.meter = meter
        self.best_effort = False
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
            self._on_message,
            QoSProfile(depth=DEPTH, reliability=reliability),
            raw=True,
            event_callbacks=SubscriptionEventCallbacks(incompatible_qos=self._on_incompatible_qos),
            qos_overriding_options=QoSOverridingOptions(self._left_to_user()),
        )

    def _left_to_user(self) -> list[QoSPolicyKind]:
        """QoS policies that a user may override; once declared, the reliability would stay as it was at first."""
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
        self._node.get_logger().info(f"a publisher of {name} is best effort; listening likewise")

    def _on_message(self, data: bytes) -> None:
        stamp = self._on_data(data)
        self.meter.arrivals.append((time.monotonic(), time.time(), stamp))

    def _on_incompatible_qos(self, event: Any) -> None:
        self._unheard = event.last_policy_kind == QoSPolicyKind.RELIABILITY or self._decided_by_user


Inputs = tuple[InputStream | HandedStream, InputStream | HandedStream]
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
                f"the ROS 2 package tf2_msgs is not installed: forces in other frames than {frame.wanted} are refused, "
                "and nobody is told where that lies"
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
            self._node.get_logger().warning(text, **at_most_every(REFUSAL_LOG_PERIOD))
