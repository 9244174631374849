"""The messages in a bag's files by time, and its topics."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat

from knee_contact_ros.bags.bag_files import File, find_files, in_a_line
from knee_contact_ros.bags.batch import Batch
from knee_contact_ros.bags.folder_metadata import METADATA
from knee_contact_ros.bags.sqlite_file import SqliteFile
from knee_contact_ros.system.errors import UsageError

NO_DEFINITION = MessageDefinition(MessageDefinitionFormat.NONE, "")
FORMATS = {"ros2msg": MessageDefinitionFormat.MSG, "ros2idl": MessageDefinitionFormat.IDL}
"""By the encoding of a schema"""


class Connection(NamedTuple):
    """A topic as a bag has it; recorders that met several publishers, and merged files, may have several of a name."""

    topic: str
    type: str
    encoding: str
    definition: MessageDefinition
    """Of the type, as the bag holds it"""
    messages: int
    """How many it has"""


class StoredBag:
    """An open bag: `damage` says what is wrong with it, as sentences; its messages may each be `packed`."""

    def __init__(self, path: Path) -> None:
        """Open a bag; around what is damaged.

        Raises:
            UsageError: nothing of it can be read.
        """
        self._opened = ExitStack()
        try:
            with ExitStack() as opened:
                self._files, self.damage, self.packed, told = find_files(path, opened)
                self._opened = opened.pop_all()
        except OSError as error:
            raise UsageError(f"cannot read bag {path}: {error.strerror}") from None
        self._files.sort(key=lambda file: file.times or (0, 0))
        self._topics = [_connections(file) for file in self._files]
        alike: dict[tuple[object, ...], Connection] = {}
        for topics in self._topics:
            for connection in topics.values():
                key = (connection.topic, connection.type, connection.encoding)
                before = alike.setdefault(key, connection._replace(messages=0))
                alike[key] = before._replace(messages=before.messages + connection.messages)
        self.connections = list(alike.values())
        self.damage += self._contradictions(told)
        if self.damage and not any(connection.messages for connection in self.connections):
            self.close()
            raise UsageError(f"cannot read bag {path}: no message can be read of it; {in_a_line(self.damage)}")

    @property
    def end_time(self) -> int:
        """Log time [ns] behind the last message."""
        return 1 + max((file.times[1] for file in self._files if file.times), default=-1)

    def batches(
        self, topics: Collection[Connection], start: int | None = None, stop: int | None = None
    ) -> Iterator[tuple[Batch, list[Connection]]]:
        """Messages in the order of log time [ns], from `start` to before `stop`; one file after another.

        Each batch comes with the connections, as the file has them, that its numbers count.
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

    def _contradictions(self, told: dict[str, int]) -> list[str]:
        """Where `metadata.yaml` does not fit the numbers of messages in the files."""
        if not told:
            return []
        found, faults = Counter[str](), []
        for connection in self.connections:
            found[connection.topic] += connection.messages
        for topic in sorted({*told, *(topic for topic, count in found.items() if count)}):
            promised, count = told.get(topic, 0), found[topic]
            if count < promised:
                faults.append(f"{promised - count} of {promised} messages are missing on {topic}")
            elif count > promised:
                faults.append(f"{METADATA} knows of {promised} messages on {topic} and not of {count}")
        return faults


def _connections(file: File) -> dict[int, Connection]:
    """A file's topics by number."""
    if isinstance(file, SqliteFile):
        return {
            number: Connection(*topic, _definition(*file.definitions.get(topic.type, ("", ""))), file.counts[number])
            for number, topic in file.topics.items()
        }
    found, definitions = {}, {0: NO_DEFINITION}  # of many channels with one schema, the definition is decoded once
    for number, (channel, schema) in file.streams.items():
        if schema and schema.id not in definitions and schema.encoding in FORMATS:
            text = schema.data.decode("utf-8", "replace")
            definitions[schema.id] = _definition(schema.encoding, text)
        definition = definitions.get(schema.id if schema else 0, NO_DEFINITION)
        type_name = schema.name if schema else ""
        found[number] = Connection(channel.topic, type_name, channel.message_encoding, definition, file.counts[number])
    return found


def _definition(encoding: str, text: str) -> MessageDefinition:
    return MessageDefinition(FORMATS[encoding], text) if encoding in FORMATS else NO_DEFINITION
