"""One MCAP file as a ROS 2 recorder writes it: CDR messages, `ros2msg` schemas, QoS and type hashes.

The bytes are those of the message's content and nothing else (ROS's own serialiser leaves uninitialised padding), so
the same messages give the same file.
"""

from __future__ import annotations

import errno
import os
import struct
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import cache
from itertools import accumulate, count, pairwise
from pathlib import Path
from threading import Lock

from mcap.opcode import Opcode
from mcap.writer import CompressionType

from knee_contact_ros.bags.chunked_mcap import ChunkedMcap
from knee_contact_ros.bags.mcap_layout import MESSAGE, MESSAGE_HEAD
from knee_contact_ros.bags.metadata import OFFERED_QOS, FileFacts, information, to_yaml
from knee_contact_ros.messages.answer import Record
from knee_contact_ros.messages.ros_types import definition, typestore
from knee_contact_ros.system.output_files import open_claimed, sync_folder, take_name

LIBRARY = "knee_contact_ros"


class BagFile:
    """An MCAP file that appears under its final name when it is complete; until then it is a locked `.partial`."""

    def __init__(
        self, path: Path, partial: Path, compression: CompressionType, overwrite: bool, earlier: Mapping[str, int]
    ) -> None:
        """Open the claimed file `partial`, which will be `path`; with `overwrite` whatever has that name then.

        `earlier` has how many messages of each topic are in files before: their sequence numbers go on.

        Raises:
            UsageError: see `open_claimed`.
        """
        self.path, self.partial, self._overwrite, self._earlier = path, partial, overwrite, earlier
        self._types: dict[str, str] = {}  # topic to message type
        self.channels: dict[str, int] = {}
        """Topic to channel number"""
        self._file = open_claimed(self.partial)
        self._closing = Lock()
        self._name_synced = False
        self.mcap = ChunkedMcap(self._file, "ros2", LIBRARY, compression)
        """Its bytes"""

    def add_topic(self, topic: str, type_name: str) -> None:
        """Declare a topic (absolute name) and its message type; the order of declaration is that in the file."""
        metadata = {"offered_qos_profiles": offered_qos(), "topic_type_hash": typestore().hash_rihs01(type_name)}
        schema = (type_name, "ros2msg", definition(type_name))
        self.channels[topic] = self.mcap.add_channel(topic, "cdr", metadata, schema)
        self._types[topic] = type_name

    def next_number(self, topic: str) -> int:
        """Sequence number of the next message of a topic: how many there are in this file and those before."""
        counts = self.mcap.statistics.channel_message_counts
        return self._earlier.get(topic, 0) + counts.get(self.channels[topic], 0)

    def write_all(self, records: Iterable[Record], names: Mapping[str, str]) -> None:
        """Write messages, whose log time and publish time are their stamps [ns], under the names of their topics."""
        records = list(records)
        ends = list(accumulate([MESSAGE_HEAD.size + len(data) for _, _, data in records]))
        for begin, end in pairwise(self.mcap.cuts(ends)):
            self._append(records[begin:end], names)

    def _append(self, records: Sequence[Record], names: Mapping[str, str]) -> None:
        """Write messages that go into one chunk."""
        found: dict[str, tuple[int, Iterator[int], list[int]]] = {}  # channel, sequence numbers, index entries
        pieces: list[bytes] = []
        place = self.mcap.place
        for topic, stamp, data in records:
            if topic not in found:
                found[topic] = self.channels[names[topic]], count(self.next_number(names[topic])), []
            channel, numbers, entries = found[topic]
            length = len(data)
            pieces += (
                MESSAGE_HEAD.pack(Opcode.MESSAGE, MESSAGE.size + length, channel, next(numbers), stamp, stamp),
                data,
            )
            entries += stamp, place
            place += MESSAGE_HEAD.size + length
        packed = {channel: struct.pack(f"<{len(entries)}Q", *entries) for channel, _, entries in found.values()}
        stamps = [stamp for _, stamp, _ in records]
        self.mcap.append(b"".join(pieces), packed, min(stamps), max(stamps))

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
        told = self.mcap.statistics
        counts = Counter({name: told.channel_message_counts.get(number, 0) for name, number in self.channels.items()})
        return FileFacts(self.path.name, told.message_start_time, told.message_end_time, counts)

    def complete(self) -> None:
        """Write what ends the file."""
        whole = information([self.facts()], self._types)
        self.mcap.add_metadata("rosbag2", {"serialized_metadata": to_yaml(whole)})
        self.mcap.finish()
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
