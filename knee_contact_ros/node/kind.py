"""What tells one kind of node from another: its parameters, its topics, and what it does while configured."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import TYPE_CHECKING, Any, NamedTuple

from rclpy.lifecycle import LifecycleNode

from knee_contact_ros.parameters.declared import NodeReading

if TYPE_CHECKING:
    from knee_contact_ros.node.session import Session


class Topics(NamedTuple):
    """Those that a user may override the QoS of."""

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]


class NodeKind(NamedTuple):
    """A kind of node; what all have in common is in `node.py` and `session.py`."""

    reading: NodeReading[Any]
    """Of its parameters, with its name"""
    live: frozenset[str]
    """Parameters that may change while it is configured: they take effect between two ticks"""
    topics: Topics
    session: Callable[[LifecycleNode, Any, Collection[str]], Session]
    """Its configured life; see `Session`"""
