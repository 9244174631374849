"""Read a bag: an `.mcap` file or a rosbag2 folder (MCAP or sqlite3), as any ROS 2 recorder writes them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

from rosbags.interfaces import Connection

from knee_contact_ros.errors import UsageError
from knee_contact_ros.messages import deserialize
from knee_contact_ros.salvage.source import in_a_line, open_bag
from knee_contact_ros.topics import INPUTS, MESSAGE_TYPES

INPUT_TYPES = {f"/{topic}": MESSAGE_TYPES[topic] for topic in INPUTS}
"""The topics that drive the model, under their names in a bag, and their types."""


class BagMessage(NamedTuple):
    """A message from a bag, in the order of log time."""

    topic: str
    """Absolute name"""
    log_time: int
    """[ns]"""
    message: Any
    """A plain message"""


class RawMessage(NamedTuple):
    """The same, not decoded."""

    topic: str
    log_time: int
    data: bytes
    """CDR"""


class BagReader:
    """A bag that is known to hold the topics asked for."""

    def __init__(self, path: Path, types: Mapping[str, str] = INPUT_TYPES) -> None:
        """Open the bag at `path` and look for topics (absolute names) of the given types.

        Raises:
            UsageError: no such bag, not a bag, a topic is missing or empty, or has another type.
        """
        self.path = path
        if not path.exists():
            raise UsageError(f"no bag at {path}: give an .mcap file or a rosbag2 folder")
        self._reader, self.damage = open_bag(path)
        """`damage` says what is wrong with the bag, in sentences; what can be read of it is read all the same"""
        try:
            self._connections = [self._connection(topic, type_name) for topic, type_name in types.items()]
        except UsageError as error:
            self.close()
            damage = f"; the bag is damaged: {in_a_line(self.damage)}" if self.damage else ""
            raise UsageError(f"{error}{damage}") from None

    @property
    def count(self) -> int:
        """Number of messages on the topics asked for."""
        return sum(connection.msgcount for connection in self._connections)

    def raw_messages(self) -> Iterator[RawMessage]:
        """Messages in the order of log time, as their bytes.

        Raises:
            UsageError: the bag breaks off.
        """
        try:
            for connection, log_time, data in self._reader.messages(connections=self._connections):
                yield RawMessage(connection.topic, log_time, bytes(data))
        except Exception as error:  # whatever a broken file provokes in the reader
            raise self._damaged(error) from None

    def messages(self) -> Iterator[BagMessage]:
        """Decoded messages in the order of log time.

        Raises:
            UsageError: the bag breaks off or a message cannot be decoded.
        """
        for topic, log_time, data in self.raw_messages():
            try:
                message = deserialize(data, topic.removeprefix("/"))
            except Exception as error:  # likewise
                raise self._damaged(error) from None
            yield BagMessage(topic, log_time, message)

    def _damaged(self, error: Exception) -> UsageError:
        return UsageError(f"bag {self.path} is damaged: {' '.join(str(error).split())}")

    def close(self) -> None:
        """Close the bag."""
        self._reader.close()

    def __enter__(self) -> BagReader:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _connection(self, topic: str, type_name: str) -> Connection:
        on_topic = [connection for connection in self._reader.connections if connection.topic == topic]
        if not on_topic:
            found = ", ".join(sorted({connection.topic for connection in self._reader.connections})) or "none"
            raise UsageError(f"bag {self.path} has no topic {topic} ({type_name}); its topics: {found}")
        if on_topic[0].msgtype != type_name:
            raise UsageError(f"bag {self.path}: topic {topic} is a {on_topic[0].msgtype}; it must be a {type_name}")
        if not on_topic[0].msgcount:
            raise UsageError(f"bag {self.path}: topic {topic} has no messages")
        return on_topic[0]


def read_bag(path: Path, types: Mapping[str, str]) -> list[BagMessage]:
    """All messages of some topics at once; for short bags."""
    with BagReader(path, types) as bag:
        return list(bag.messages())
