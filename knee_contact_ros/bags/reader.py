"""Read a bag: an `.mcap` file or a rosbag2 folder (MCAP or sqlite3), as any ROS 2 recorder writes them."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

import zstandard
from rosbags.interfaces import MessageDefinition

from knee_contact_ros.bags.bag_files import in_a_line
from knee_contact_ros.bags.stored_bag import StoredBag
from knee_contact_ros.bags.topic_names import OWN_NAMES, Names, absolute
from knee_contact_ros.bags.topics_in_bag import find_topic
from knee_contact_ros.messages.ros_types import deserialize
from knee_contact_ros.messages.topics import INPUTS, MESSAGE_TYPES
from knee_contact_ros.system.errors import UsageError

INPUT_TYPES = {f"/{topic}": MESSAGE_TYPES[topic] for topic in INPUTS}
"""The topics that drive the model, by their absolute names, and their types."""
LARGEST_MESSAGE = 2**24
"""[B] of a message that was compressed by itself"""
ZSTD = b"\x28\xb5\x2f\xfd"
"""How compressed bytes begin; a message never does"""


class BagMessage(NamedTuple):
    """A message from a bag, in the order of log time."""

    topic: str
    """Absolute name, as the node has it"""
    log_time: int
    """[ns]"""
    message: Any
    """A plain message"""


class RawMessage(NamedTuple):
    """A message as it stands in a bag, not decoded."""

    topic: str
    log_time: int
    data: bytes
    """CDR"""


class BagReader:
    """A bag that is known to hold the topics asked for."""

    def __init__(self, path: Path, types: Mapping[str, str] = INPUT_TYPES, names: Names = OWN_NAMES) -> None:
        """Open the bag at `path` and look for topics (absolute names) of the given types; `names` they have in there.

        Raises:
            UsageError: no such bag, not a bag, a topic is missing or empty, or has another type.
        """
        self.path = path
        if not path.exists():
            raise UsageError(f"no bag at {path}: give an .mcap file or a rosbag2 folder")
        self._bag = StoredBag(path)
        self.damage = self._bag.damage
        """What is wrong with the bag, in sentences; what can be read of it is read all the same"""
        try:
            self._connections = {
                topic: find_topic(path, self._bag.connections, topic, type_name, names.get(topic, topic))
                for topic, type_name in types.items()
            }
        except UsageError as error:
            self.close()
            damage = f"; the bag is damaged: {in_a_line(self.damage)}" if self.damage else ""
            raise UsageError(f"{error}{damage}") from None
        self._topics = {names.get(topic, topic): topic for topic in types}
        self._refuse_compressed_messages()

    @property
    def count(self) -> int:
        """Number of messages on the topics asked for."""
        return sum(connection.messages for found in self._connections.values() for connection in found)

    @property
    def end(self) -> int:
        """Log time [ns] behind the last message of the bag, whatever its topic."""
        return self._bag.end_time

    def raw_messages(
        self, topics: Collection[str] = (), start: int | None = None, stop: int | None = None
    ) -> Iterator[RawMessage]:
        """Messages in the order of log time, as their bytes.

        Args:
            topics: only these of the topics asked for; none: all.
            start: log time [ns] of the first one.
            stop: log time [ns] behind the last one.

        Raises:
            UsageError: the bag breaks off.
        """
        for message, _ in self.described_messages(topics, start, stop):
            yield message

    def described_messages(
        self, topics: Collection[str] = (), start: int | None = None, stop: int | None = None
    ) -> Iterator[tuple[RawMessage, MessageDefinition]]:
        """Messages that are not decoded, each with the definition that the bag holds of its type."""
        asked = [connection for topic in topics or self._connections for connection in self._connections[topic]]
        try:
            for connection, log_time, data in self._bag.messages(asked, start, stop):
                message = unpacked(data) if self._bag.packed else data
                yield RawMessage(self._topics[absolute(connection.topic)], log_time, message), connection.definition
        except Exception as error:  # whatever a broken file provokes in the reader
            raise self._damaged(error) from None

    def messages(self) -> Iterator[BagMessage]:
        """Messages in the order of log time, decoded by the definitions that this package knows.

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
        self._bag.close()

    def __enter__(self) -> BagReader:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _refuse_compressed_messages(self) -> None:
        """A file of a bag whose messages are compressed one by one does not tell so; its folder does."""
        first = next(self.raw_messages(), None) if self.path.is_file() else None
        if first and first.data.startswith(ZSTD):
            self.close()
            raise UsageError(f"bag {self.path} has compressed messages: give its folder, whose metadata.yaml says so")


def unpacked(data: bytes) -> bytes:
    """A message that was compressed by itself.

    Raises:
        ValueError: it claims to be larger than any of our topics.
        zstandard.ZstdError: it cannot be unpacked.
    """
    size = zstandard.frame_content_size(data)
    if size > LARGEST_MESSAGE:
        raise ValueError(f"a message claims to have {size} bytes; at most {LARGEST_MESSAGE} are read")
    return zstandard.ZstdDecompressor().decompress(data, max_output_size=LARGEST_MESSAGE)


def read_bag(path: Path, types: Mapping[str, str]) -> list[BagMessage]:
    """All messages of some topics at once; for short bags."""
    with BagReader(path, types) as bag:
        return list(bag.messages())
