"""Executor for ROS callbacks: the events executor if this rclpy has it."""

from __future__ import annotations

from contextlib import suppress

from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.node import Node

Quickest: type[Executor] = SingleThreadedExecutor
with suppress(ImportError):  # Jazzy before rclpy 7.1.4
    from rclpy.experimental import EventsExecutor

    Quickest = EventsExecutor

NO_EVENTS = (
    "this rclpy has no EventsExecutor (Jazzy has it from 7.1.4 on): the single-threaded executor is used, which takes "
    "more time per message"
)


def executor_of(*nodes: Node) -> Executor:
    """Make the fastest available executor with some nodes; the first node logs if it is not the events executor.

    To be used with `spin_once(timeout_sec=...)` in a loop: in `spin`, and without a time-out, the events executor of
    Jazzy's wheels keeps a processor busy and delivers nothing.
    """
    if Quickest is SingleThreadedExecutor:
        nodes[0].get_logger().warning(NO_EVENTS)
    executor = Quickest()
    for node in nodes:
        executor.add_node(node)
    return executor
