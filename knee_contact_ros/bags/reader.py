"""Reading of a bag: an `.mcap` file, or a rosbag2 folder with MCAP or sqlite3 files, from any ROS 2 recorder."""

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
from knee_contact_ros.streams.topics import INPUTS, MESSAGE_TYPES, deserialize
from knee_contact_ros.system.errors import UsageError

INPUT_TYPES = {f"/{topic}": MESSAGE_TYPES[topic] for topic in INPUTS}
"""Types of the topics that drive the model, by their absolute names"""
LARGEST_MESSAGE = 2**24
"""Largest size [B] of a message that was compressed by itself"""
ZSTD = b"\x28\xb5\x2f\xfd"
"""Magic at the beginning of compressed bytes; no CDR message begins like this"""


class BagMessage(NamedTuple):
    """Decoded message of a bag."""

    topic: str
    """Absolute name of the topic in the node"""
    log_time: int
    """Log time [ns]"""
    message: Any
    """Message as `rosbags` deserializes it"""


class RawMessage(NamedTuple):
    """Message of a bag that is not decoded."""

    topic: str
    """Absolute name of the topic in the node"""
    log_time: int
    """Log time [ns]"""
    data: bytes
    """CDR bytes"""


class BagReader:
    """Open bag that contains all requested topics."""

    def __init__(self, path: Path, types: Mapping[str, str] = INPUT_TYPES, names: Names = OWN_NAMES) -> None:
        """Open a bag and find the requested topics in it.

        Args:
            path: Bag.
            types: Type of each requested topic, by the absolute name in the node.
            names: Absolute names in the bag of topics that have another one there.

        Raises:
            UsageError: There is no such bag, it cannot be read, or a topic is missing, empty or of another type.
        """
        self.path = path
        if not path.exists():
            raise UsageError(f"no bag at {path}: give an .mcap file or a rosbag2 folder")
        self._bag = StoredBag(path)
        self.damage = self._bag.damage
        """Faults of the bag, as sentences; the readable part is read nevertheless"""
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
        """Number of messages on the requested topics."""
        return sum(connection.messages for topic in self._connections.values() for connection in topic)

    @property
    def end(self) -> int:
        """Log time [ns] after the last message of the bag, on any topic."""
        return self._bag.end_time

    def raw_messages(
        self, topics: Collection[str] = (), start: int | None = None, stop: int | None = None
    ) -> Iterator[RawMessage]:
        """Messages in the order of log time, not decoded.

        Args:
            topics: Topics to read, out of the requested ones; all of them if empty.
            start: Smallest log time [ns]; None means no limit.
            stop: Log time [ns] that messages do not reach; None means no limit.

        Raises:
            UsageError: The bag is damaged.
        """
        for message, _ in self.described_messages(topics, start, stop):
            yield message

    def described_messages(
        self, topics: Collection[str] = (), start: int | None = None, stop: int | None = None
    ) -> Iterator[tuple[RawMessage, MessageDefinition]]:
        """Messages as `raw_messages` gives them, each with the definition of its type in the bag."""
        for batch, connections in self._batches(topics, start, stop):
            described = [(self._topic_of(connection), connection.definition) for connection in connections]
            for number, log_time, data in batch:
                topic, definition = described[number]
                yield RawMessage(topic, log_time, data), definition

    def blocks(self, topics: Collection[str] = (), *, most: int) -> Iterator[Batch]:
        """Messages in the order of log time, in blocks of at most `most` messages.

        The number of a message in a block is the index of its topic among all requested ones.

        Args:
            topics: Topics to read, out of the requested ones; all of them if empty.
            most: Largest number of messages in a block.

        Raises:
            UsageError: The bag is damaged.
        """
        indices = {topic: index for index, topic in enumerate(self._connections)}
        for connections, pairs in groupby(self._batches(topics), key=itemgetter(1)):
            index_of = np.array([indices[self._topic_of(connection)] for connection in connections], np.intp)
            batches = (replace(batch, numbers=index_of[batch.numbers]) for batch, _ in pairs)
            yield from blocks(batches, most)

    def _batches(
        self, topics: Collection[str], start: int | None = None, stop: int | None = None
    ) -> Iterator[tuple[Batch, list[Connection]]]:
        """Decompressed messages in batches, whose numbers are indices of the connections."""
        requested = [connection for topic in topics or self._connections for connection in self._connections[topic]]
        try:
            for batch, connections in self._bag.batches(requested, start, stop):
                all_of_them = np.ones(len(batch), dtype=bool)
                yield batch.changed(unpacked, all_of_them) if self._bag.packed else batch, connections
        except Exception as error:  # whatever a broken file provokes in the reader
            raise self._damaged(error) from None

    def _topic_of(self, connection: Connection) -> str:
        """Absolute name in the node of the topic of a connection."""
        return self._topics[absolute(connection.topic)]

    def messages(self) -> Iterator[BagMessage]:
        """Messages in the order of log time, decoded by the definitions in this package.

        Raises:
            UsageError: The bag is damaged, or a message cannot be decoded.
        """
        for topic, log_time, data in self.raw_messages():
            try:
                message = deserialize(data, topic.removeprefix("/"))
            except Exception as error:  # whatever broken bytes provoke in the decoder
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
        """Refuse a file whose messages are compressed one by one: only `metadata.yaml` in its folder says so.

        Raises:
            UsageError: The first message is compressed.
        """
        first = next(self.raw_messages(), None) if self.path.is_file() else None
        if first and first.data.startswith(ZSTD):
            self.close()
            raise UsageError(f"bag {self.path} has compressed messages: give its folder, whose metadata.yaml says so")


def unpacked(data: bytes) -> bytes:
    """Message that was compressed by itself, decompressed.

    Raises:
        ValueError: It is too large by what its frame says.
        zstandard.ZstdError: It cannot be decompressed.
    """
    size = zstandard.frame_content_size(data)
    if size > LARGEST_MESSAGE:
        raise ValueError(f"a message claims to have {size} bytes; at most {LARGEST_MESSAGE} are read")
    return zstandard.ZstdDecompressor().decompress(data, max_output_size=LARGEST_MESSAGE)


def read_bag(path: Path, types: Mapping[str, str]) -> list[BagMessage]:
    """All messages of the topics with these types, as a list; for short bags."""
    with BagReader(path, types) as bag:
        return list(bag.messages())
