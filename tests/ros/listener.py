"""A process that listens to the answers, for tests in which it stops reading."""

from __future__ import annotations

import rclpy
from knee_contact_ros.msg import KneeContact
from rclpy.node import Node
from rclpy.qos import QoSProfile


def listen() -> None:
    """Subscribe reliably, say so, and read on and on."""
    rclpy.init()
    node = Node("listener")
    node.create_subscription(KneeContact, "knee_contact", lambda _message: None, QoSProfile(depth=10))
    while not node.count_publishers("knee_contact"):
        rclpy.spin_once(node, timeout_sec=0.1)
    print("listening", flush=True)  # noqa: T201 - the test waits for it
    rclpy.spin(node)
