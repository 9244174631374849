"""Write an MCAP file whose messages come as bytes: one message or thousands, all go into its chunks the same way.

`cuts` tells where chunks end among message records, and `append` takes those that lie between two cuts. All other
records are written by the `mcap` library's classes. The file is, to the last byte, that of the library's `Writer`.
"""

from __future__ import annotations

import zlib
from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import IO

import lz4.frame
import zstandard
from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.writer import CompressionType

from knee_contact_ros.bags.mcap_layout import ENTRY, HEAD, INDEX, MAGIC

CHUNK_SIZE = 64 * 1024
"""[B] of records beyond which a chunk ends: to end a small one takes 2-4 ms at most, and little is lost in a crash"""
COMPRESSIONS: dict[CompressionType, tuple[str, Callable[[bytes], bytes]]] = {
    CompressionType.NONE: ("", bytes),
    CompressionType.LZ4: ("lz4", lz4.frame.compress),
    CompressionType.ZSTD: ("zstd", zstandard.compress),
}
"""The name by which a chunk tells of each, and what compresses"""
SUMMARY = (
    Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS,
    Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX,
)  # fmt: skip
"""What the end of a file repeats or tells, in this order"""


class OpenChunk:
    """The chunk that is being filled."""

    def __init__(self) -> None:
        """An empty one."""
        self.data: list[bytes | memoryview] = []
        """Pieces of one record or more"""
        self.size = 0
        """[B] of them"""
        self.entries: dict[int, list[bytes]] = {}
        """Of each channel's message index, by channel in the order of the first messages"""
        self.first = self.last = 0
        """Smallest and largest log time of the messages [ns]"""


class ChunkedMcap:
    """An MCAP file that is being written."""

    def __init__(self, file: IO[bytes], profile: str, library: str, compression: CompressionType) -> None:
        """Begin it in an empty binary file, which is never closed; its header tells `profile` and `library`."""
        self.statistics = records.Statistics(0, 0, Counter(), 0, 0, 0, 0, 0, 0)
        """Of what was added: messages, also by channel, their smallest and largest log time [ns] (0: no messages)"""
        self.size = 0
        """[B] written, without the chunk that is being filled"""
        self._file, self._checksum = file, 0  # of all that was written
        self._compression, self._compress = COMPRESSIONS[compression]
        self._chunk = OpenChunk()
        self._schemas: dict[str, int] = {}  # numbers by name
        self._summary = {opcode: bytearray() for opcode in SUMMARY}
        self._write(MAGIC + packed(records.Header(profile, library)))

    def add_channel(self, topic: str, encoding: str, metadata: dict[str, str], schema: tuple[str, str, bytes]) -> int:
        """Declare a topic, and the type of its messages if none of that name was declared before.

        Args:
            topic: Its name.
            encoding: Of its messages.
            metadata: What else is to be told of the channel.
            schema: Name, encoding and text of the type's definition.

        Returns:
            The channel's number, by which its messages name it.
        """
        told, (name, schema_encoding, text) = self.statistics, schema
        if name not in self._schemas:
            told.schema_count += 1
            self._schemas[name] = told.schema_count
            self._declare(Opcode.SCHEMA, records.Schema(told.schema_count, text, schema_encoding, name))
        told.channel_count += 1
        channel = records.Channel(told.channel_count, topic, encoding, metadata, self._schemas[name])
        self._declare(Opcode.CHANNEL, channel)
        return told.channel_count

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Write a metadata record at once: before the messages of the chunk that is being filled."""
        data = packed(records.Metadata(name, values))
        self.statistics.metadata_count += 1
        self._summary[Opcode.METADATA_INDEX] += packed(records.MetadataIndex(self.size, len(data), name))
        self._write(data)

    @property
    def place(self) -> int:
        """Where in its chunk [B] the next record begins."""
        return self._chunk.size

    def cuts(self, ends: Sequence[int]) -> list[int]:
        """Cut message records that are to be appended where chunks end among them.

        Args:
            ends: Where each record ends [B], counted from where the first one begins; growing.

        Returns:
            How many records lie before each cut: from 0 to all of them; only 0 if there are none. The first part begins
            at `place`, and each other one with a chunk.
        """
        cuts, begin = [0], -self.place
        while cuts[-1] < len(ends):
            cuts.append(min(bisect_right(ends, begin + CHUNK_SIZE, cuts[-1]) + 1, len(ends)))
            begin = ends[cuts[-1] - 1]
        return cuts

    def append(self, data: bytes | memoryview, entries: Mapping[int, bytes], first: int, last: int) -> None:
        """Add message records to the chunk that is being filled, which ends behind them if it is full then.

        Args:
            data: Whole records, one behind the other: those between two of the `cuts`. They are not copied.
            entries: The packed entries (`ENTRY`) of each channel's message index, by channel in the order of the first
                messages; only of channels that have any.
            first: Smallest log time of the messages [ns].
            last: Largest one [ns].
        """
        chunk, told = self._chunk, self.statistics
        chunk.first = min(first, chunk.first) if chunk.entries else first
        chunk.last = max(last, chunk.last)
        told.message_start_time = min(first, told.message_start_time) if told.message_count else first
        told.message_end_time = max(last, told.message_end_time)
        for channel, some in entries.items():
            told.message_count += len(some) // ENTRY.size
            told.channel_message_counts[channel] += len(some) // ENTRY.size
            chunk.entries.setdefault(channel, []).append(some)
        self._add(data)

    def flush(self) -> None:
        """End the chunk that is being filled, and hand all that was written to the operating system."""
        self._end_chunk()
        self._file.flush()

    def finish(self) -> None:
        """Write what ends the file: the last chunk, and the summary."""
        self._end_chunk()
        self._write(packed(records.DataEnd(self._checksum)))
        self._summary[Opcode.STATISTICS] += packed(self.statistics)
        begin, summary, offsets = self.size, b"", []
        for opcode, group in self._summary.items():
            offsets.append(records.SummaryOffset(opcode, begin + len(summary), len(group)))
            summary += group
        places = begin, begin + len(summary)
        summary += packed(*offsets)
        checksum = zlib.crc32(summary + packed(records.Footer(*places, 0))[:-4])  # of all that is before it
        self._write(summary + packed(records.Footer(*places, checksum)) + MAGIC)

    def _declare(self, opcode: Opcode, record: records.McapRecord) -> None:
        """Add a record to the chunk that is being filled, and to the summary."""
        data = packed(record)
        self._summary[opcode] += data
        self._add(data)

    def _add(self, data: bytes | memoryview) -> None:
        """Add records to the chunk that is being filled, which ends behind them if it is full then."""
        self._chunk.data.append(data)
        self._chunk.size += len(data)
        if self._chunk.size > CHUNK_SIZE:
            self._end_chunk()

    def _end_chunk(self) -> None:
        """Write the chunk that is being filled and its message indices, unless there is no message in it."""
        chunk, begin, name = self._chunk, self.size, self._compression
        if not chunk.entries:
            return
        self._chunk, content = OpenChunk(), b"".join(chunk.data)
        data, checksum = self._compress(content), zlib.crc32(content)
        self._write(packed(records.Chunk(name, data, chunk.last, chunk.first, checksum, chunk.size)))
        end, indices, places = self.size, bytearray(), {}
        for channel, pieces in chunk.entries.items():
            places[channel], entries = end + len(indices), b"".join(pieces)
            indices += HEAD.pack(Opcode.MESSAGE_INDEX, INDEX.size + len(entries)) + INDEX.pack(channel, len(entries))
            indices += entries
        self._write(indices)
        self.statistics.chunk_count += 1
        self._summary[Opcode.CHUNK_INDEX] += packed(
            records.ChunkIndex(
                chunk_start_offset=begin, chunk_length=end - begin, message_index_offsets=places,
                message_index_length=len(indices), compression=name, compressed_size=len(data),
                uncompressed_size=chunk.size, message_start_time=chunk.first, message_end_time=chunk.last,
            )
        )  # fmt: skip

    def _write(self, data: bytes | bytearray) -> None:
        self._checksum = zlib.crc32(data, self._checksum)
        self.size += len(data)
        self._file.write(data)


def packed(*some: records.McapRecord) -> bytes:
    """Records as they lie in a file, one behind the other."""
    builder = RecordBuilder()
    for record in some:
        record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]
