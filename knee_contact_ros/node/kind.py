"""Description of a kind of node: its parameters, its topics, and its session."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import TYPE_CHECKING, Any, NamedTuple

from rclpy.lifecycle import LifecycleNode

from knee_contact_ros.parameters.schema import NodeSection

if TYPE_CHECKING:
    from knee_contact_ros.node.session import Session


class Topics(NamedTuple):
    """Topics whose QoS a user may override."""

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]


class NodeKind(NamedTuple):
    """Kind of node; what all kinds have in common is in `node.py` and `session.py`."""

    schema: type[NodeSection]
    """Name of the node, and its parameters"""
    live: frozenset[str]
    """Names of the parameters that may change while the node is configured: they take effect between two ticks"""
    topics: Topics
    session: Callable[[LifecycleNode, Any, Collection[str]], Session]
    """Makes the session of a node from its parameters and the names of the QoS overrides that the user has given"""
