"""One MCAP file as a ROS 2 recorder writes it: CDR messages, `ros2msg` schemas, QoS and type hashes.

The bytes are those of the message's content and nothing else (ROS's own serialiser leaves uninitialised padding), so
the same messages give the same file.
"""

from __future__ import annotations

import errno
import os
import struct
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from threading import Lock
from typing import Any

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import MessageIndex
from mcap.writer import CompressionType, Writer

from knee_contact_ros.bags.metadata import OFFERED_QOS, FileFacts, information, to_yaml
from knee_contact_ros.messages.answer import Record
from knee_contact_ros.messages.ros_types import definition, typestore
from knee_contact_ros.system.output_files import open_claimed, sync_folder, take_name

LIBRARY = "knee_contact_ros"
HEAD = struct.Struct("<BQHIQQ").pack
"""Of a message record: opcode, length behind it, channel, sequence number, log time and publish time [ns]"""
HEAD_LENGTH, RECORD_LENGTH = 22, 31
"""[B] of it that count as the record's, and all"""
ENTRY = struct.Struct("<QQ")
"""Of an index: log time [ns], and place in the chunk"""
CHUNK_SIZE = 64 * 1024
"""[B] Small chunks: closing one stalls the writer 2-4 ms at most, and little is lost in a crash."""


class Index(MessageIndex):
    """The library's, of which many entries are added and written at once: bytes may stand for them."""

    def write(self, stream: RecordBuilder) -> None:
        """Write the record."""
        entries = b"".join([entry if isinstance(entry, bytes) else ENTRY.pack(*entry) for entry in self.records])
        stream.start_record(Opcode.MESSAGE_INDEX)
        stream.write2(self.channel_id)
        stream.write4(len(entries))
        stream.write(entries)
        stream.finish_record()  # type: ignore[no-untyped-call]


def count_messages(told: Any, count: str, number: int, first: int, last: int) -> None:
    """Take messages into account where the library tells their number and their first and last stamp [ns]."""
    known = getattr(told, count)
    told.message_start_time = min(first, told.message_start_time) if known else first
    told.message_end_time = max(last, told.message_end_time)
    setattr(told, count, known + number)


@dataclass(slots=True)
class _Written:
    """Messages of a topic that are being written."""

    name: str
    channel: int
    next: int
    """Number of the next one"""
    places: list[tuple[int, int]] = field(default_factory=list)
    """Stamp [ns] of each, and where it begins in the chunk"""


class BagFile:
    """An MCAP file that appears under its final name when it is complete; until then it is a locked `.partial`."""

    def __init__(self, path: Path, partial: Path, compression: CompressionType, overwrite: bool) -> None:
        """Open the claimed file `partial`, which will be `path`; with `overwrite` whatever has that name then.

        Raises:
            UsageError: see `open_claimed`.
        """
        self.path, self.partial, self._overwrite = path, partial, overwrite
        self.first = self.last = 0
        """Smallest and largest stamp [ns]"""
        self.counts: Counter[str] = Counter()
        self._types: dict[str, str] = {}  # topic to message type
        self._schemas: dict[str, int] = {}  # message type to schema id
        self.channels: dict[str, int] = {}
        """Topic to channel id"""
        self._file = open_claimed(self.partial)
        self._closing = Lock()
        self._name_synced = False
        self.writer = Writer(self._file, chunk_size=CHUNK_SIZE, compression=compression, enable_data_crcs=True)
        self.writer.start(profile="ros2", library=LIBRARY)

    def add_topic(self, topic: str, type_name: str) -> None:
        """Declare a topic (absolute name) and its message type; the order of declaration is that in the file."""
        if type_name not in self._schemas:
            text = definition(type_name)
            self._schemas[type_name] = self.writer.register_schema(name=type_name, encoding="ros2msg", data=text)
        self.channels[topic] = self.writer.register_channel(
            topic=topic,
            message_encoding="cdr",
            schema_id=self._schemas[type_name],
            metadata={"offered_qos_profiles": offered_qos(), "topic_type_hash": typestore().hash_rihs01(type_name)},
        )
        self._types[topic] = type_name
        self.counts[topic] = 0

    def write(self, topic: str, stamp: int, data: bytes, number: int) -> None:
        """Write a message's CDR bytes under its stamp [ns] and its number among those of its topic."""
        self.writer.add_message(self.channels[topic], stamp, data, stamp, number)
        self.count(topic, 1, stamp, stamp)

    def write_all(self, records: Iterable[Record], names: Mapping[str, str], numbers: Counter[str]) -> None:
        """Write messages under the names of their topics: the same bytes as by `write`, in a third of the time.

        `numbers` has how many of each name there are in the recording, and goes on.

        The library makes some thirty calls for a message. Its chunk builder takes bytes as well, and is handed the
        messages as they would lie in the chunk, with their index; the library compresses and writes the chunk.
        """
        builder: Any = self.writer._Writer__chunk_builder  # type: ignore[attr-defined]
        files: dict[str, _Written] = {}
        pieces: list[bytes] = []
        offset = builder.count
        for topic, stamp, data in records:
            written = files.get(topic)
            if written is None:
                name = names[topic]
                files[topic] = written = _Written(name, self.channels[name], numbers[name])
            length = len(data)
            pieces += HEAD(Opcode.MESSAGE, HEAD_LENGTH + length, written.channel, written.next, stamp, stamp), data
            written.next += 1
            written.places.append((stamp, offset))
            offset += RECORD_LENGTH + length
            if offset > CHUNK_SIZE:
                self._hand_over(builder, pieces, files.values(), numbers)
                self.writer._Writer__finalize_chunk()  # type: ignore[attr-defined]
                files, pieces, offset = {}, [], 0
        self._hand_over(builder, pieces, files.values(), numbers)

    def _hand_over(
        self, builder: Any, pieces: Sequence[bytes], files: Iterable[_Written], numbers: Counter[str]
    ) -> None:
        """Give message records to the library's chunk, and count them as it would."""
        statistics: Any = self.writer._Writer__statistics  # type: ignore[attr-defined]
        for written in files:
            first, last, number = min(written.places)[0], max(written.places)[0], len(written.places)
            builder.message_indices.setdefault(written.channel, Index(written.channel, [])).records += written.places
            count_messages(builder, "num_messages", number, first, last)
            count_messages(statistics, "message_count", number, first, last)
            statistics.channel_message_counts[written.channel] += number
            self.count(written.name, number, first, last)
            numbers[written.name] = written.next
        builder.record_writer.write(b"".join(pieces))

    def count(self, topic: str, number: int, first: int, last: int) -> None:
        """Take messages into account that were written, with their first and last stamp [ns]."""
        if not self.counts.total():
            self.first, self.last = first, last
        self.first, self.last = min(self.first, first), max(self.last, last)
        self.counts[topic] += number

    def flush(self) -> None:
        """Hand all that was written to the operating system."""
        self.writer.flush()  # type: ignore[no-untyped-call]

    def sync(self) -> None:
        """Have all that was flushed, and its name, on the disk; may be called by another thread.

        Raises:
            OSError: it cannot be.
        """
        with self._closing:
            if self._file.closed:
                return
            os.fdatasync(self._file.fileno())
            if not self._name_synced:
                sync_folder(self.path.parent)
                self._name_synced = True

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Write a metadata record."""
        self.writer.add_metadata(name, values)

    def size(self) -> int:
        """[B] written so far, without the chunk in progress."""
        return self._file.tell()

    def free_space(self) -> int:
        """[B] that are free on its disk.

        Raises:
            OSError: the file is not there any more.
        """
        self._check_presence()
        disk = os.fstatvfs(self._file.fileno())
        return disk.f_bavail * disk.f_frsize

    def facts(self) -> FileFacts:
        """What there is to know of it so far."""
        return FileFacts(self.path.name, self.first, self.last, Counter(self.counts))

    def complete(self) -> None:
        """Write what ends the file."""
        whole = information([self.facts()], self._types)
        self.writer.add_metadata("rosbag2", {"serialized_metadata": to_yaml(whole)})
        self.writer.finish()  # type: ignore[no-untyped-call]
        self._file.flush()
        os.fsync(self._file.fileno())

    def take_name(self) -> None:
        """Give the complete file its final name, or the next free one if it was taken meanwhile.

        Raises:
            OSError: it cannot have one, or is not there any more.
        """
        self._check_presence()
        self.path = take_name(self.partial, self.path, self._overwrite)
        sync_folder(self.path.parent)
        with self._closing:
            self._file.close()

    def discard(self) -> None:
        """Give up: leave nothing behind."""
        with self._closing, suppress(OSError):  # a full disk also refuses what is still in the file's buffer
            self._file.close()
        self.partial.unlink(missing_ok=True)

    def _check_presence(self) -> None:
        """Tell if the file is not there any more, or is another one.

        Raises:
            OSError: that is so.
        """
        with suppress(FileNotFoundError, NotADirectoryError):
            if os.path.samestat(self.partial.lstat(), os.fstat(self._file.fileno())):
                return
        raise OSError(errno.ENOENT, "its file or folder was removed while it was written")


@cache
def offered_qos() -> str:
    """As YAML text."""
    return to_yaml(OFFERED_QOS)
