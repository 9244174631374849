"""Static transforms: the node publishes where its tibia frame lies, and listens where the frames of the forces lie."""

from __future__ import annotations

from typing import Any

from rclpy.lifecycle import LifecycleNode
from rclpy.qos import DurabilityPolicy, QoSProfile

from knee_contact_ros.node.health import REFUSAL_LOG_PERIOD, at_most_every
from knee_contact_ros.streams.frames import TF_STATIC, ForceFrame, decode_transforms, encode_transforms, isb_transform

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
