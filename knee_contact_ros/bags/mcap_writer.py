"""Writing of one MCAP file as a ROS 2 recorder does, with CDR messages: one message or thousands at a time."""

from __future__ import annotations

import errno
import os
from array import array
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from shutil import disk_usage
from struct import Struct
from threading import Lock
from typing import IO, Any, NamedTuple

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Statistics
from mcap.writer import CompressionType, Writer

from ..streams.topics import Record, definition, typestore
from ..system import output_files
from ..system.portable import CAN_RENAME_OPEN_FILES, sync_data
from .metadata_file import information, offered_qos, qos_of, to_yaml

RECORD_HEAD = Struct("<BQ")
"""Head of a record: opcode, and length [B] of the content, which follows"""
MESSAGE_PREFIX = Struct("<HIQQ")
"""Beginning of a message record's content, before the data: channel, sequence number, log time and publish time [ns]"""
MESSAGE_HEAD = Struct("<BQHIQQ")
"""`RECORD_HEAD` and `MESSAGE_PREFIX` together"""
INDEX_FIELDS = Struct("<HI")
"""Beginning of a message index record's content: channel, and length [B] of the entries, which follow"""
INDEX_ENTRY = Struct("<QQ")
"""Entry of a message index: log time [ns] of a message, and offset [B] of its record in the uncompressed chunk"""
MESSAGE_OPCODE = int(Opcode.MESSAGE)
CHUNK_SIZE = 64 * 1024
"""Size [B] of the records beyond which a chunk ends: a small chunk ends in 2-4 ms, and a crash loses little"""
LIBRARY = "knee_contact_ros"
"""Name of the writing library in the header of a file"""
ROSBAG2 = "rosbag2"
"""Name of the metadata record with the `metadata.yaml` of the file, which `rosbag2` writes too"""


class PackedMessageIndex(NamedTuple):
    """Message index of a channel in a chunk with packed entries, as `mcap.records.MessageIndex` is slow."""

    channel: int
    """Id of the channel"""
    entries: array[int]
    """Log time [ns] and offset [B] in the chunk of each message, one after the other"""

    def write(self, stream: RecordBuilder) -> None:
        """Write the record, as `mcap.records.MessageIndex` does."""
        size = self.entries.itemsize * len(self.entries)
        stream.write(RECORD_HEAD.pack(Opcode.MESSAGE_INDEX, INDEX_FIELDS.size + size))
        stream.write(INDEX_FIELDS.pack(self.channel, size))
        stream.write(self.entries.tobytes())


class McapWriter(Writer):
    """MCAP file that takes one message or thousands at a time.

    It gets its final name when it is complete; until then it is a locked `.partial` file. `mcap` writes all of it
    except message records and their index, for which its `add_message` would take three times as long. For these this
    class uses the current chunk and the statistics inside `mcap` 1.6.
    """

    _Writer__statistics: Statistics
    _Writer__chunk_builder: Any

    def __init__(
        self,
        path: Path,
        file: IO[bytes],
        compressed: bool,
        overwrite: bool,
        earlier: Mapping[str, int],
    ) -> None:
        """Open a file for writing.

        Args:
            path: Final name.
            file: File that `output_files.claim` has opened for this name.
            compressed: Whether chunks are compressed (zstd).
            overwrite: Whether the complete file replaces one that has the final name.
            earlier: Number of messages of each topic in earlier files of the recording: sequence numbers continue.
        """
        self.path = path
        self.partial = output_files.partial_name(path)
        self.channels: dict[str, int] = {}
        """Id of the channel of each topic"""
        self.topics: list[dict[str, Any]] = []
        """Entries of the topics in `metadata.yaml`"""
        self._overwrite = overwrite
        self._earlier = earlier
        self._schemas: dict[str, int] = {}  # id of each schema by its name
        self._closing = Lock()
        self._file = file
        compression = CompressionType.ZSTD if compressed else CompressionType.NONE
        super().__init__(
            file, chunk_size=CHUNK_SIZE, compression=compression, enable_data_crcs=True
        )
        self.start("ros2", LIBRARY)
        self._chunk = self._Writer__chunk_builder
        self.statistics = self._Writer__statistics
        """Statistics of the records so far; log times [ns] are 0 without messages"""

    @property
    def written_bytes(self) -> int:
        """Number of bytes written, without the chunk that is being filled."""
        return self._file.tell()

    @property
    def chunk_bytes(self) -> int:
        """Number of bytes in the chunk that is being filled."""
        return int(self._chunk.count)

    def add_topic(self, topic: str, type_name: str) -> None:
        """Declare a topic by its absolute name and message type; channels have the order of the declarations."""
        type_hash = typestore().hash_rihs01(type_name)
        self.topics.append(
            {
                "name": topic,
                "type": type_name,
                "serialization_format": "cdr",
                "offered_qos_profiles": qos_of(type_name),
                "type_description_hash": type_hash,
            }
        )
        if type_name not in self._schemas:
            text = definition(type_name)
            self._schemas[type_name] = self.register_schema(type_name, "ros2msg", text)
        metadata = {"offered_qos_profiles": offered_qos(type_name), "topic_type_hash": type_hash}
        schema = self._schemas[type_name]
        self.channels[topic] = self.register_channel(topic, "cdr", schema, metadata)

    def next_sequence(self, topic: str) -> int:
        """Return the next sequence number of a topic: its number of messages in this file and earlier ones."""
        counts = self.statistics.channel_message_counts
        return self._earlier.get(topic, 0) + counts.get(self.channels[topic], 0)

    def write_records(self, records: Iterable[Record], names: Mapping[str, str]) -> None:
        """Write messages under the absolute names of their topics; log time and publish time are their stamps [ns]."""
        write = self._chunk.record_writer.write
        counts = self.statistics.channel_message_counts
        offset = self.chunk_bytes
        for topic, stamp, data in records:
            name = names[topic]
            channel = self.channels[name]
            sequence = self._earlier.get(name, 0) + counts[channel]
            entries = self._count_messages(channel, 1, stamp, stamp)
            entries.append(stamp)
            entries.append(offset)
            length = MESSAGE_PREFIX.size + len(data)
            write(
                MESSAGE_HEAD.pack(MESSAGE_OPCODE, length, channel, sequence, stamp, stamp) + data
            )
            offset += MESSAGE_HEAD.size + len(data)
            if offset > CHUNK_SIZE:
                self.flush()
                offset = 0

    def append_encoded(
        self, data: memoryview, entries: Mapping[int, bytes], first: int, last: int
    ) -> None:
        """Add message records to the chunk that is being filled, and end it if it is full then.

        Args:
            data: Concatenated records, of which none but the last one goes beyond `CHUNK_SIZE`.
            entries: Packed message index entries (`INDEX_ENTRY`) of each channel that has any, in the order of their
                first messages.
            first: Smallest log time [ns] of the messages.
            last: Largest log time [ns] of the messages.
        """
        for channel, own in entries.items():
            count = len(own) // INDEX_ENTRY.size
            self._count_messages(channel, count, first, last).frombytes(own)
        self._chunk.record_writer.write(data)
        if self.chunk_bytes > CHUNK_SIZE:
            self.flush()

    def flush(self) -> None:
        """End the chunk that is being filled, and hand all written data to the operating system.

        Raises:
            OSError: Writing has failed, or another process has changed the size of the file.
        """
        self._check_size()
        super().flush()  # type: ignore[no-untyped-call]

    def _count_messages(self, channel: int, count: int, first: int, last: int) -> array[int]:
        """Count messages between two log times [ns]; return the index entries of their channel in the chunk."""
        statistics = self.statistics
        chunk = self._chunk
        # `max` takes three times as long as these comparisons.
        if first < statistics.message_start_time or not statistics.message_count:
            statistics.message_start_time = first
        if last > statistics.message_end_time:  # noqa: PLR1730
            statistics.message_end_time = last
        if first < chunk.message_start_time or not chunk.num_messages:
            chunk.message_start_time = first
        if last > chunk.message_end_time:  # noqa: PLR1730
            chunk.message_end_time = last
        statistics.message_count += count
        statistics.channel_message_counts[channel] += count
        chunk.num_messages += count
        index = chunk.message_indices.get(channel)
        if not index:
            index = chunk.message_indices[channel] = PackedMessageIndex(channel, array("Q"))
        entries: array[int] = index.entries
        return entries

    def sync(self) -> None:
        """Sync all flushed data, and the name of the file, to the disk; may be called by another thread.

        Raises:
            OSError: The sync has failed.
        """
        with self._closing:
            if not self._file.closed:
                sync_data(self._file.fileno())
                output_files.sync_folder(self.path.parent)

    def free_space(self) -> int:
        """Return the free space [B] on the disk of the file.

        Raises:
            OSError: The file has been removed.
        """
        self._check_presence()
        return disk_usage(self.path.parent).free

    def complete(self) -> None:
        """Write the metadata of rosbag2 and the end of the file, and sync it to the disk; raises as `flush`."""
        self._check_size()
        content = information([(self.path.name, self.statistics)], self.topics)
        self.add_metadata(ROSBAG2, {"serialized_metadata": to_yaml(content)})
        self.finish()  # type: ignore[no-untyped-call]
        self._file.flush()
        os.fsync(self._file.fileno())

    def take_final_name(self) -> None:
        """Give the complete file its final name, or the next free one if it was taken meanwhile.

        Raises:
            OSError: The file cannot be renamed, or has been removed.
        """
        self._check_presence()
        if not CAN_RENAME_OPEN_FILES:
            self._close()
        self.path = output_files.take_name(self.partial, self.path, self._overwrite)
        output_files.sync_folder(self.path.parent)
        self._close()

    def discard(self) -> None:
        """Close the file and remove it."""
        # A full disk also refuses what is still in the file's buffer.
        with suppress(OSError):
            self._close()
        self.partial.unlink(missing_ok=True)

    def _close(self) -> None:
        with self._closing:
            self._file.close()

    def _check_size(self) -> None:
        """Check that the file ends where the writing goes on; raises OSError if not."""
        descriptor = self._file.fileno()
        if os.fstat(descriptor).st_size != os.lseek(descriptor, 0, os.SEEK_CUR):
            raise OSError(errno.EIO, "another process has changed its size while it was written")

    def _check_presence(self) -> None:
        """Check that the open file still has its name.

        Raises:
            OSError: The file has been removed or replaced.
        """
        with suppress(FileNotFoundError, NotADirectoryError):
            if os.path.samestat(self.partial.lstat(), os.fstat(self._file.fileno())):
                return
        raise OSError(errno.ENOENT, "its file or folder was removed while it was written")
