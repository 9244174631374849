"""QoS overrides: which ones the user has given, and whether they are any; rclpy has many ways to say so, one empty."""

from __future__ import annotations

from rclpy.node import Node
from rclpy.qos import HistoryPolicy, ReliabilityPolicy

from knee_contact_ros.errors import UsageError

PREFIX = "qos_overrides"
MOST = 2**31 - 1
"""Depth beyond which the middleware has no number for it"""
POLICIES = {
    policy: tuple(member.name.lower() for member in members if member.name != "UNKNOWN")
    for policy, members in (("history", HistoryPolicy), ("reliability", ReliabilityPolicy))
}


def given_by_user(node: Node) -> frozenset[str]:
    """Names of the overrides that the user has given; rclpy declares the others itself, and read-only."""
    names = [f"{PREFIX}.{name}" for name in node.get_parameters_by_prefix(PREFIX)]
    return frozenset(name for name in names if not node.describe_parameter(name).read_only)


def check_qos_overrides(node: Node, topic: str, side: str) -> None:
    """Check the overrides of a topic's `side`: `publisher` or `subscription`.

    Raises:
        UsageError: one cannot be used; by its name, with its value.
    """
    prefix = f"{PREFIX}.{node.resolve_topic_name(topic)}.{side}"
    for policy, parameter in node.get_parameters_by_prefix(prefix).items():
        value = parameter.value
        if policy == "depth":
            allowed, words = type(value) is int and 0 <= value <= MOST, f"an integer from 0 to {MOST}"
        elif policy in POLICIES:
            allowed = isinstance(value, str) and value.lower() in POLICIES[policy]
            words = ", ".join(POLICIES[policy])
        else:
            continue
        if not allowed:
            raise UsageError(f"parameter {prefix}.{policy}: {value!r} is not allowed; allowed: {words}")
