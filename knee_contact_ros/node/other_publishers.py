"""Finds other publishers of the topics that a node publishes, whose messages subscribers would get mixed with ours."""

import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rclpy.lifecycle import LifecycleNode

from ..system.ros import resolve_topic

EACH_NODE = "/parameter_events"
"""Topic that every node publishes"""
GONE_AFTER = 25.0
"""Time [s] for which a publisher whose process seems to have ended is left out; the middleware forgets it after 20 s"""
HOST, PROCESS = slice(0, 4), slice(4, 6)
"""Bytes of an endpoint's identifier in Fast DDS: vendor and host, and the low half of the number of its process"""
HALF, LAST_PROCESS = 2**16, 2**22
"""Number of values of that half, and largest number of a process in Linux"""


class OtherPublishers:
    """Watches the topics of a node by questions to the graph, which cost a tick nothing."""

    def __init__(self, node: LifecycleNode, topics: Sequence[str]) -> None:
        """Watch these topics."""
        self._node, self._topics = node, topics
        self._ended: dict[bytes, float] = {}  # monotonic times [s] at which they were first seen

    def mixed_sentence(self) -> str:
        """Sentence about other publishers of our topics; empty without one."""
        topics: dict[str, list[str]] = {}
        for topic in self._topics:
            for name in self._others(topic):
                topics.setdefault(name, []).append(resolve_topic(self._node, topic))
        if not topics:
            return ""
        found = "; ".join(
            f"another node ({name}) publishes {' and '.join(dict.fromkeys(each))}"
            for name, each in topics.items()
        )
        return f"{found}: subscribers get its messages among ours, and no answer is usable; stop or remap one"

    def name_sentence(self) -> str:
        """Sentence that another node has our name; empty without one."""
        own = self._node.get_fully_qualified_name()
        if own not in self._others(EACH_NODE):
            return ""
        return f"another node is called {own}: rename one of the two (-r __node:=NAME)"

    def _others(self, topic: str) -> list[str]:
        """Full names of the nodes, besides this one, that publish a topic; a name for each publisher."""
        found = self._node.get_publishers_info_by_topic(topic)
        if len(found) < 2:
            return []
        names = [
            "/".join((each.node_namespace.rstrip("/"), each.node_name))
            for each in found
            if not self._has_ended(bytes(each.endpoint_gid), found)
        ]
        own = self._node.get_fully_qualified_name()
        if own in names:
            names.remove(own)
        return names

    def _has_ended(self, endpoint: bytes, found: Sequence[Any]) -> bool:
        """Whether an endpoint seems to be one of a process that was killed, as those are known for a while."""
        own = (os.getpid() % HALF).to_bytes(2, "little")
        hosts = {
            bytes(each.endpoint_gid)[HOST]
            for each in found
            if bytes(each.endpoint_gid)[PROCESS] == own
        }
        number = int.from_bytes(endpoint[PROCESS], "little")
        if endpoint[HOST] not in hosts or any(
            Path(f"/proc/{each}").exists() for each in range(number, LAST_PROCESS, HALF)
        ):
            return False
        # In another container its process may have a number that we do not see.
        return time.monotonic() < self._ended.setdefault(endpoint, time.monotonic()) + GONE_AFTER
