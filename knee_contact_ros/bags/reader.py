"""Read a bag: an `.mcap` file or a rosbag2 folder (MCAP or sqlite3), as any ROS 2 recorder writes them."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

import numpy as np
import zstandard
from rosbags.interfaces import MessageDefinition

from knee_contact_ros.bags.bag_files import in_a_line
from knee_contact_ros.bags.batch import Batch, blocks
from knee_contact_ros.bags.stored_bag import Connection, StoredBag
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
        for batch, connections in self._batches(topics, start, stop):
            described = [(self._topic_of(connection), connection.definition) for connection in connections]
            for number, log_time, data in batch:
                topic, definition = described[number]
                yield RawMessage(topic, log_time, data), definition

    def blocks(self, topics: Collection[str] = (), *, most: int) -> Iterator[Batch]:
        """All messages, of these topics if there are any, by so many; numbers are those of topics asked for at first.

        Raises:
            UsageError: the bag breaks off.
        """
        places = {topic: place for place, topic in enumerate(self._connections)}
        for connections, found in groupby(self._batches(topics), key=itemgetter(1)):
            place_of = np.array([places[self._topic_of(connection)] for connection in connections], np.intp)
            batches = (replace(batch, numbers=place_of[batch.numbers]) for batch, _ in found)
            yield from blocks(batches, most)

    def _batches(
        self, topics: Collection[str], start: int | None = None, stop: int | None = None
    ) -> Iterator[tuple[Batch, list[Connection]]]:
        asked = [connection for topic in topics or self._connections for connection in self._connections[topic]]
        try:
            for batch, connections in self._bag.batches(asked, start, stop):
                every = np.ones(len(batch), dtype=bool)
                yield batch.changed(unpacked, every) if self._bag.packed else batch, connections
        except Exception as error:  # whatever a broken file provokes in the reader
            raise self._damaged(error) from None

    def _topic_of(self, connection: Connection) -> str:
        return self._topics[absolute(connection.topic)]

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
