"""Writing of an MCAP file whose message records come as bytes, one or thousands at a time.

`ChunkedMcap.cuts` tells where chunks end among message records, and `ChunkedMcap.append` takes those between two cuts.
All other records are written by the classes of the `mcap` library. The file has the same bytes as that of its `Writer`.
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
"""Size [B] of the records beyond which a chunk ends: a small chunk ends in 2-4 ms, and a crash loses little"""
COMPRESSIONS: dict[CompressionType, tuple[str, Callable[[bytes], bytes]]] = {
    CompressionType.NONE: ("", bytes),
    CompressionType.LZ4: ("lz4", lz4.frame.compress),
    CompressionType.ZSTD: ("zstd", zstandard.compress),
}
"""Name of each compression in a chunk record, and the function that compresses"""
SUMMARY = (
    Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS,
    Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX,
)  # fmt: skip
"""Opcodes of the records of the summary section, in their order"""


class OpenChunk:
    """Chunk that is being filled."""

    def __init__(self) -> None:
        """Begin an empty chunk."""
        self.data: list[bytes | memoryview] = []
        """Pieces of the content, each of one record or more"""
        self.size = 0
        """Size [B] of the content"""
        self.entries: dict[int, list[bytes]] = {}
        """Packed message index entries of each channel, in the order of their first messages"""
        self.first = self.last = 0
        """Smallest and largest log time [ns] of the messages"""


class ChunkedMcap:
    """MCAP file that is being written."""

    def __init__(self, file: IO[bytes], profile: str, library: str, compression: CompressionType) -> None:
        """Write magic and header, with `profile` and `library`, to an empty binary file, which is never closed."""
        self.statistics = records.Statistics(0, 0, Counter(), 0, 0, 0, 0, 0, 0)
        """Statistics of the records so far; log times [ns] are 0 without messages"""
        self.size = 0
        """Number of bytes written, without the chunk that is being filled"""
        self._file, self._checksum = file, 0  # CRC-32 of all written bytes
        self._compression, self._compress = COMPRESSIONS[compression]
        self._chunk = OpenChunk()
        self._schemas: dict[str, int] = {}  # number of each schema by its name
        self._summary = {opcode: bytearray() for opcode in SUMMARY}
        self._write(MAGIC + packed(records.Header(profile, library)))

    def add_channel(self, topic: str, encoding: str, metadata: dict[str, str], schema: tuple[str, str, bytes]) -> int:
        """Declare a channel, and its schema if none of that name was declared before.

        Args:
            topic: Name of the topic.
            encoding: Encoding of the messages.
            metadata: Metadata of the channel.
            schema: Name, encoding and text of the schema.

        Returns:
            Number of the channel.
        """
        statistics, (name, schema_encoding, text) = self.statistics, schema
        if name not in self._schemas:
            statistics.schema_count += 1
            self._schemas[name] = statistics.schema_count
            self._declare(Opcode.SCHEMA, records.Schema(statistics.schema_count, text, schema_encoding, name))
        statistics.channel_count += 1
        channel = records.Channel(statistics.channel_count, topic, encoding, metadata, self._schemas[name])
        self._declare(Opcode.CHANNEL, channel)
        return statistics.channel_count

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Write a metadata record at once, that is, before the messages of the chunk that is being filled."""
        data = packed(records.Metadata(name, values))
        self.statistics.metadata_count += 1
        self._summary[Opcode.METADATA_INDEX] += packed(records.MetadataIndex(self.size, len(data), name))
        self._write(data)

    @property
    def place(self) -> int:
        """Offset [B] in its chunk at which the next record begins."""
        return self._chunk.size

    def cuts(self, ends: Sequence[int]) -> list[int]:
        """Find where chunks end among message records that are to be appended.

        Args:
            ends: Ascending offsets [B] of the ends of the records, from the beginning of the first one.

        Returns:
            Number of records before each cut, from 0 to all of them; only 0 if there are none. The first part begins
            at `place`, and each other part begins a chunk.
        """
        cuts, begin = [0], -self.place
        while cuts[-1] < len(ends):
            cuts.append(min(bisect_right(ends, begin + CHUNK_SIZE, cuts[-1]) + 1, len(ends)))
            begin = ends[cuts[-1] - 1]
        return cuts

    def append(self, data: bytes | memoryview, entries: Mapping[int, bytes], first: int, last: int) -> None:
        """Add message records to the chunk that is being filled, and end it if it is full then.

        Args:
            data: Concatenated records between two of the `cuts`. They are not copied.
            entries: Packed message index entries (`ENTRY`) of each channel that has any, in the order of their first
                messages.
            first: Smallest log time [ns] of the messages.
            last: Largest log time [ns] of the messages.
        """
        chunk, statistics = self._chunk, self.statistics
        chunk.first = min(first, chunk.first) if chunk.entries else first
        chunk.last = max(last, chunk.last)
        statistics.message_start_time = min(first, statistics.message_start_time) if statistics.message_count else first
        statistics.message_end_time = max(last, statistics.message_end_time)
        for channel, piece in entries.items():
            statistics.message_count += len(piece) // ENTRY.size
            statistics.channel_message_counts[channel] += len(piece) // ENTRY.size
            chunk.entries.setdefault(channel, []).append(piece)
        self._add(data)

    def flush(self) -> None:
        """End the chunk that is being filled, and hand all written data to the operating system."""
        self._end_chunk()
        self._file.flush()

    def finish(self) -> None:
        """Write the last chunk, the summary section and the end of the file."""
        self._end_chunk()
        self._write(packed(records.DataEnd(self._checksum)))
        self._summary[Opcode.STATISTICS] += packed(self.statistics)
        begin, summary, offsets = self.size, b"", []
        for opcode, group in self._summary.items():
            offsets.append(records.SummaryOffset(opcode, begin + len(summary), len(group)))
            summary += group
        places = begin, begin + len(summary)
        summary += packed(*offsets)
        checksum = zlib.crc32(summary + packed(records.Footer(*places, 0))[:-4])  # of all bytes before it
        self._write(summary + packed(records.Footer(*places, checksum)) + MAGIC)

    def _declare(self, opcode: Opcode, record: records.McapRecord) -> None:
        """Add a record to the chunk that is being filled, and to the summary."""
        data = packed(record)
        self._summary[opcode] += data
        self._add(data)

    def _add(self, data: bytes | memoryview) -> None:
        """Add records to the chunk that is being filled, and end it if it is full then."""
        self._chunk.data.append(data)
        self._chunk.size += len(data)
        if self._chunk.size > CHUNK_SIZE:
            self._end_chunk()

    def _end_chunk(self) -> None:
        """Write the chunk that is being filled, and its message indices, unless it has no messages."""
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


def packed(*mcap_records: records.McapRecord) -> bytes:
    """Concatenated bytes of records as they stand in a file."""
    builder = RecordBuilder()
    for record in mcap_records:
        record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]
