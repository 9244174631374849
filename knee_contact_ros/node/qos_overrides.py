"""QoS overrides: which ones there are, what they may be, and which the user has given; rclpy ignores others."""

from __future__ import annotations

from collections.abc import Iterable

from rclpy.node import Node
from rclpy.qos import HistoryPolicy, ReliabilityPolicy

from knee_contact_ros.node.kind import Topics
from knee_contact_ros.system.errors import UsageError

PREFIX = "qos_overrides."
OTHERS = ("/clock.", "/parameter_events.", "/rosout.")
"""Topics of every node, with overrides of their own"""
MOST = 2**31 - 1
"""Depth beyond which the middleware has no number for it"""
POLICIES = {
    policy: tuple(member.name.lower() for member in members if member.name != "UNKNOWN")
    for policy, members in (("history", HistoryPolicy), ("reliability", ReliabilityPolicy))
}


def given_by_user(node: Node) -> frozenset[str]:
    """Names of the overrides that the user has given; rclpy declares the others itself, and read-only."""
    names = [PREFIX + name for name in node.get_parameters_by_prefix(PREFIX.rstrip("."))]
    return frozenset(name for name in names if not node.describe_parameter(name).read_only)


def check_qos_overrides(node: Node, topics: Topics, given: Iterable[tuple[str, object]]) -> None:
    """Check overrides for a node's topics, of names and values; other parameters may be among them.

    Raises:
        UsageError: one names none of the node's topics or no policy of one, or has a value that is not allowed.
    """
    ours = [
        f"{PREFIX}{node.resolve_topic_name(topic)}.{side}."
        for side, of_side in (("subscription", topics.inputs), ("publisher", topics.outputs))
        for topic in of_side
    ]
    for name, value in given:
        if not name.startswith(PREFIX) or name.removeprefix(PREFIX).startswith(OTHERS):
            continue
        beginning, _, policy = name.rpartition(".")
        if f"{beginning}." not in ours or policy not in (*POLICIES, "depth"):
            known = ", ".join(f"{topic}*" for topic in ours)
            raise UsageError(f"unknown parameter {name}; allowed: {known} with depth, {', '.join(POLICIES)}")
        _check_value(name, policy, value)


def _check_value(name: str, policy: str, value: object) -> None:
    if policy == "depth":
        allowed, words = type(value) is int and 0 <= value <= MOST, f"an integer from 0 to {MOST}"
    else:
        allowed = isinstance(value, str) and value.lower() in POLICIES[policy]
        words = ", ".join(POLICIES[policy])
    if not allowed:
        raise UsageError(f"parameter {name}: {value!r} is not allowed; allowed: {words}")
