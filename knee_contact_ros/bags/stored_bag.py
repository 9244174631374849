"""Topics of a bag, and the messages in its files in the order of log time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat

from knee_contact_ros.bags.bag_files import File, find_files, in_a_line
from knee_contact_ros.bags.batch import Batch
from knee_contact_ros.bags.metadata import METADATA
from knee_contact_ros.bags.sqlite_file import SqliteFile
from knee_contact_ros.system.errors import UsageError

NO_DEFINITION = MessageDefinition(MessageDefinitionFormat.NONE, "")
"""Definition of a type that the bag does not define"""
FORMATS = {"ros2msg": MessageDefinitionFormat.MSG, "ros2idl": MessageDefinitionFormat.IDL}
"""Format of a definition by the encoding of its schema"""


class Connection(NamedTuple):
    """Topic of a bag with its type and encoding; recorders with several publishers, and merged files, repeat names."""

    topic: str
    """Name of the topic in the bag"""
    type: str
    """Type of the messages; empty if it is unknown"""
    encoding: str
    """Encoding of the messages"""
    definition: MessageDefinition
    """Definition of the type in the bag"""
    messages: int
    """Number of messages"""


class StoredBag:
    """Open bag: `damage` has its faults as sentences, `packed` is whether messages are compressed one by one."""

    def __init__(self, path: Path) -> None:
        """Open a bag, as far as it can be read.

        Raises:
            UsageError: No message of the bag can be read.
        """
        self._opened = ExitStack()
        try:
            with ExitStack() as opened:
                self._files, self.damage, self.packed, stated = find_files(path, opened)
                self._opened = opened.pop_all()
        except OSError as error:
            raise UsageError(f"cannot read bag {path}: {error.strerror}") from None
        self._files.sort(key=lambda file: file.times or (0, 0))
        self._topics = [_connections(file) for file in self._files]
        merged: dict[tuple[object, ...], Connection] = {}
        for topics in self._topics:
            for connection in topics.values():
                key = connection[:3]
                before = merged.setdefault(key, connection._replace(messages=0))
                merged[key] = before._replace(messages=before.messages + connection.messages)
        self.connections = list(merged.values())
        """Connections of all files, with one for each topic, type and encoding"""
        self.damage += self._contradictions(stated)
        if self.damage and not any(connection.messages for connection in self.connections):
            self.close()
            raise UsageError(f"cannot read bag {path}: no message can be read of it; {in_a_line(self.damage)}")

    @property
    def end_time(self) -> int:
        """Log time [ns] after the last message; 0 without messages."""
        return 1 + max((file.times[1] for file in self._files if file.times), default=-1)

    def batches(
        self, topics: Collection[Connection], start: int | None = None, stop: int | None = None
    ) -> Iterator[tuple[Batch, list[Connection]]]:
        """Messages in the order of log time, one file after another.

        Each batch comes with connections of its file; the numbers of the messages are indices of that list.

        Args:
            topics: Connections to read.
            start: Smallest log time [ns]; None means no limit.
            stop: Log time [ns] that messages do not reach; None means no limit.
        """
        wanted = {connection[:3] for connection in topics}
        for file, declared in zip(self._files, self._topics, strict=True):
            chosen = {channel: connection for channel, connection in declared.items() if connection[:3] in wanted}
            connections = list(chosen.values())
            for batch in file.by_time({channel: number for number, channel in enumerate(chosen)}):
                yield batch.between(start, stop), connections

    def close(self) -> None:
        """Close the bag."""
        self._opened.close()

    def _contradictions(self, stated: dict[str, int]) -> list[str]:
        """Sentences on topics whose number of messages in `metadata.yaml` is not that of the files."""
        if not stated:
            return []
        present, faults = Counter[str](), []
        for connection in self.connections:
            present[connection.topic] += connection.messages
        for topic in sorted(stated.keys() | (+present).keys()):
            expected, count = stated.get(topic, 0), present[topic]
            if count < expected:
                faults.append(f"{expected - count} of {expected} messages are missing on {topic}")
            elif count > expected:
                faults.append(f"{METADATA} knows of {expected} messages on {topic} and not of {count}")
        return faults


def _connections(file: File) -> dict[int, Connection]:
    """Connections of a file by the numbers of its channels or topics."""
    if isinstance(file, SqliteFile):
        return {
            number: Connection(*topic, _definition(*file.definitions.get(topic.type, ("", ""))), file.counts[number])
            for number, topic in file.topics.items()
        }
    connections, definitions = {}, {0: NO_DEFINITION}  # the schema of many channels is decoded once
    for number, (channel, schema) in file.streams.items():
        if schema and schema.id not in definitions and schema.encoding in FORMATS:
            text = schema.data.decode("utf-8", "replace")
            definitions[schema.id] = _definition(schema.encoding, text)
        definition = definitions.get(schema.id if schema else 0, NO_DEFINITION)
        type_name, encoding = schema.name if schema else "", channel.message_encoding
        connections[number] = Connection(channel.topic, type_name, encoding, definition, file.counts[number])
    return connections


def _definition(encoding: str, text: str) -> MessageDefinition:
    """Definition of a type from the encoding and the text of its schema."""
    return MessageDefinition(FORMATS[encoding], text) if encoding in FORMATS else NO_DEFINITION
