"""Writing of one MCAP file as a ROS 2 recorder does: CDR messages, `ros2msg` schemas, QoS profiles and type hashes.

Equal messages give equal files, because padding bytes are zero (the serialiser of ROS leaves them uninitialised).
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
from knee_contact_ros.streams.topics import Record, definition, typestore
from knee_contact_ros.system.output_files import open_claimed, sync_folder, take_name

LIBRARY = "knee_contact_ros"
"""Name of the writing library in the header of a file"""


class BagFile:
    """MCAP file that gets its final name when it is complete; until then it is a locked `.partial` file."""

    def __init__(
        self, path: Path, partial: Path, compression: CompressionType, overwrite: bool, earlier: Mapping[str, int]
    ) -> None:
        """Open a file for writing.

        Args:
            path: Final name.
            partial: Name until the file is complete, already claimed.
            compression: Compression of the chunks.
            overwrite: Whether the complete file replaces one that has the final name.
            earlier: Number of messages of each topic in earlier files of the recording: sequence numbers continue.

        Raises:
            UsageError: The file cannot be opened; see `open_claimed`.
        """
        self.path, self.partial, self._overwrite, self._earlier = path, partial, overwrite, earlier
        self._types: dict[str, str] = {}  # message type of each topic
        self.channels: dict[str, int] = {}
        """Channel number of each topic"""
        self._file = open_claimed(self.partial)
        self._closing = Lock()
        self._name_synced = False
        self.mcap = ChunkedMcap(self._file, "ros2", LIBRARY, compression)
        """Writer of the MCAP records"""

    def add_topic(self, topic: str, type_name: str) -> None:
        """Declare a topic by its absolute name and message type; channels have the order of the declarations."""
        metadata = {"offered_qos_profiles": offered_qos(), "topic_type_hash": typestore().hash_rihs01(type_name)}
        schema = (type_name, "ros2msg", definition(type_name))
        self.channels[topic] = self.mcap.add_channel(topic, "cdr", metadata, schema)
        self._types[topic] = type_name

    def next_number(self, topic: str) -> int:
        """Sequence number of the next message of a topic: its number of messages in this file and earlier ones."""
        counts = self.mcap.statistics.channel_message_counts
        return self._earlier.get(topic, 0) + counts.get(self.channels[topic], 0)

    def write_all(self, records: Iterable[Record], names: Mapping[str, str]) -> None:
        """Write messages under the absolute names of their topics; log time and publish time are their stamps [ns]."""
        records = list(records)
        ends = list(accumulate([MESSAGE_HEAD.size + len(data) for _, _, data in records]))
        for begin, end in pairwise(self.mcap.cuts(ends)):
            self._append(records[begin:end], names)

    def _append(self, records: Sequence[Record], names: Mapping[str, str]) -> None:
        """Write messages that belong to one chunk."""
        topics: dict[str, tuple[int, Iterator[int], list[int]]] = {}  # channel, sequence numbers, index entries
        pieces: list[bytes] = []
        place = self.mcap.place
        for topic, stamp, data in records:
            if topic not in topics:
                topics[topic] = self.channels[names[topic]], count(self.next_number(names[topic])), []
            channel, numbers, entries = topics[topic]
            length = len(data)
            pieces += (
                MESSAGE_HEAD.pack(Opcode.MESSAGE, MESSAGE.size + length, channel, next(numbers), stamp, stamp),
                data,
            )
            entries += stamp, place
            place += MESSAGE_HEAD.size + length
        packed = {channel: struct.pack(f"<{len(entries)}Q", *entries) for channel, _, entries in topics.values()}
        stamps = [stamp for _, stamp, _ in records]
        self.mcap.append(b"".join(pieces), packed, min(stamps), max(stamps))

    def sync(self) -> None:
        """Sync all flushed data, and the name of the file, to the disk; may be called by another thread.

        Raises:
            OSError: The sync has failed.
        """
        with self._closing:
            if self._file.closed:
                return
            os.fdatasync(self._file.fileno())
            if not self._name_synced:
                sync_folder(self.path.parent)
                self._name_synced = True

    def free_space(self) -> int:
        """Free space [B] on the disk of the file.

        Raises:
            OSError: The file has been removed.
        """
        self._check_presence()
        disk = os.fstatvfs(self._file.fileno())
        return disk.f_bavail * disk.f_frsize

    def facts(self) -> FileFacts:
        """Name, log times and numbers of messages of the file so far."""
        statistics = self.mcap.statistics
        by_channel = statistics.channel_message_counts
        counts = Counter({topic: by_channel.get(channel, 0) for topic, channel in self.channels.items()})
        return FileFacts(self.path.name, statistics.message_start_time, statistics.message_end_time, counts)

    def complete(self) -> None:
        """Write the metadata of rosbag2 and the end of the file, and sync it to the disk."""
        content = information([self.facts()], self._types)
        self.mcap.add_metadata("rosbag2", {"serialized_metadata": to_yaml(content)})
        self.mcap.finish()
        self._file.flush()
        os.fsync(self._file.fileno())

    def take_name(self) -> None:
        """Give the complete file its final name, or the next free one if it was taken meanwhile.

        Raises:
            OSError: The file cannot be renamed, or has been removed.
        """
        self._check_presence()
        self.path = take_name(self.partial, self.path, self._overwrite)
        sync_folder(self.path.parent)
        with self._closing:
            self._file.close()

    def discard(self) -> None:
        """Close the file and remove it."""
        with self._closing, suppress(OSError):  # a full disk also refuses what is still in the file's buffer
            self._file.close()
        self.partial.unlink(missing_ok=True)

    def _check_presence(self) -> None:
        """Check that the open file still has its name.

        Raises:
            OSError: The file has been removed or replaced.
        """
        with suppress(FileNotFoundError, NotADirectoryError):
            if os.path.samestat(self.partial.lstat(), os.fstat(self._file.fileno())):
                return
        raise OSError(errno.ENOENT, "its file or folder was removed while it was written")


@cache
def offered_qos() -> str:
    """Offered QoS profiles as YAML text, for the metadata of channels."""
    return to_yaml(OFFERED_QOS)
