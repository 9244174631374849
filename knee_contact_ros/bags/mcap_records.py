"""The records of an MCAP file, whole or damaged, one after the other.

Lengths in records are not trusted: a record counts if its content has exactly its length. If the summary fits its
checksum, its chunk indexes are a second source for a chunk with a wrong head. After any other damage, reading
continues at the record to which the length leads, or at the next chunk.
"""

import re
import struct
import zlib
from bisect import bisect_right
from collections.abc import Iterator
from contextlib import suppress
from io import BytesIO
from typing import IO, Any, NamedTuple

from mcap.data_stream import RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, ChunkIndex, Footer
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC

from ..system.portable import data_from
from .bag_file import Chunk
from .mcap_writer import RECORD_HEAD

HOLE = 0
"""Bytes that are not a record: in the place of an opcode, and never one"""
SKIPPED = Opcode.MESSAGE, Opcode.MESSAGE_INDEX
"""Opcodes of records that are not parsed here, like those beyond the last known one, `DATA_END`"""
CHUNK_HEAD = struct.Struct("<BQQQQII")
"""Beginning of a chunk: opcode, length, smallest and largest log time [ns], uncompressed size [B], CRC-32 of the
records, and length [B] of the name of the compression, which follows with the compressed size"""
CHECKSUM_OFFSET = 33
"""Offset [B] of the CRC-32 in a chunk"""
LONGEST_NAME = 16
"""Largest length [B] of the name of a compression; those of the specification have 4"""
CHUNK_OR_DATA_END = re.compile(rb"(?s)(?=\x06.{4}\x00{4}|\x0f.\x00{7})")
"""Head of a chunk of less than 4 GiB, or of the record that ends the data section"""
FOOTER_SIZE = 29
"""Size [B] of the footer record, by the specification"""
LARGEST_RECORD = 2**30
"""Largest size [B] of a record outside chunks"""
LARGEST_CHUNK = 2**28
"""Largest size [B] of the records in a chunk, compressed or not"""
ALLOWED_SIZE = 2**26
"""Size [B] of a summary, and of the uncompressed chunks of a file, that is always read"""
BYTES_AT_ONCE = 2**20
"""Number of bytes that are searched, summed or unpacked at a time"""
NOT_A_RECORD = (McapError, struct.error, UnicodeDecodeError, OverflowError)
"""Errors of `mcap` about bytes that are not records"""


class FileRecord(NamedTuple):
    """Whole record of a file, or bytes that are not a record."""

    opcode: int
    """Opcode, or `HOLE`"""
    offset: int
    """Offset [B] of the beginning in the file"""
    end: int
    """Offset [B] of the end"""
    content: Any = None
    """A chunk as `Chunk`; any other record as `mcap` parses it. None for messages, their index and unknown records"""


def parsed(data: bytes) -> Any:
    """Record as `mcap` parses it; None if that would not write the same bytes, before fields that are unknown to it."""
    builder = RecordBuilder()
    try:
        record: Any = next(StreamReader(BytesIO(data), skip_magic=True).records)
        record.write(builder)
    except NOT_A_RECORD:
        return None
    written: bytes = builder.end()[RECORD_HEAD.size :]  # type: ignore[no-untyped-call]
    content = data[RECORD_HEAD.size :]
    if isinstance(record, Attachment) and content[len(written) - 4 :].startswith(bytes(4)):
        written = written[:-4]  # it has no checksum
    return record if content.startswith(written) else None


class RecordReader:
    """Reader of the records of an open MCAP file."""

    def __init__(self, file: IO[bytes], size: int) -> None:
        """Read the chunk indexes of a file of `size` [B], if its summary is whole."""
        self.file = file
        self.size = size
        self._indexes: dict[int, ChunkIndex] = {}  # by the offsets of the chunks
        self._chunk_starts = [size]
        footer = self.record_at(max(size - len(MCAP0_MAGIC) - FOOTER_SIZE, 0))
        if (
            footer
            and isinstance(footer.content, Footer)
            and footer.content.summary_crc
            and self.fits_summary(footer)
        ):
            file.seek(footer.content.summary_start)
            with suppress(*NOT_A_RECORD):
                summary = StreamReader(file, skip_magic=True, record_size_limit=ALLOWED_SIZE)
                for record in summary.records:
                    if isinstance(record, ChunkIndex):
                        self._indexes[record.chunk_start_offset] = record
        self._chunk_starts = [*sorted(self._indexes), size]

    def bytes_between(self, begin: int, end: int) -> bytes:
        """Return the bytes between two offsets; fewer at the end of the file."""
        self.file.seek(begin)
        return self.file.read(max(end - begin, 0))

    def magic_length_at(self, offset: int) -> int:
        """Return the length [B] of the magic at `offset`; 0 if there is none."""
        found = self.bytes_between(offset, offset + len(MCAP0_MAGIC))
        return len(MCAP0_MAGIC) if found == MCAP0_MAGIC else 0

    def records(self) -> Iterator[FileRecord]:
        """Yield records and holes after the magic, in order, up to the end of the file."""
        position = self.magic_length_at(0)
        while position < self.size:
            record = self.record_at(position) or self._hole_at(position)
            yield record
            position = record.end
            if record.opcode == Opcode.FOOTER:
                position += self.magic_length_at(position)

    def record_at(self, offset: int) -> FileRecord | None:
        """Record that begins at `offset`; None if there is no whole and valid one."""
        if chunk := self._indexed_chunk_at(offset):
            return chunk
        opcode, end = self._head_at(offset)
        if opcode == Opcode.CHUNK:
            return self._chunk_at(offset, end)
        limit = min(self._next_chunk_after(offset), offset + LARGEST_RECORD)
        if not offset < end <= limit:
            return None
        if opcode in SKIPPED or opcode > Opcode.DATA_END:
            # Its length is right if another record follows.
            follows = end > self.size - RECORD_HEAD.size or self._may_begin_at(end)
            return FileRecord(opcode, offset, end) if follows else None
        content = parsed(self.bytes_between(offset, end))
        return FileRecord(opcode, offset, end, content) if content else None

    def checksum_between(self, begin: int, end: int) -> int:
        """Return the CRC-32 of the bytes between two offsets; -1 if more are not stored than a record can have."""
        checksum = 0
        for position in range(begin, end, BYTES_AT_ONCE):
            if data_from(self.file, position, end) - position > LARGEST_RECORD:
                return -1
            data = self.bytes_between(position, min(position + BYTES_AT_ONCE, end))
            checksum = zlib.crc32(data, checksum)
        return checksum

    def fits_summary(self, footer: FileRecord) -> bool:
        """Return whether the summary section fits the checksum in the footer, if that has one."""
        begin = footer.content.summary_start
        checksum = footer.content.summary_crc
        if not (begin and checksum):
            return True
        if begin > footer.offset:
            return False
        return self.checksum_between(begin, footer.end - 4) == int(checksum)

    def _indexed_chunk_at(self, offset: int) -> FileRecord | None:
        """Return the chunk at an offset by its index; None if it has no index, or no checksum verifies it."""
        if not (index := self._indexes.get(offset)):
            return None
        end = offset + index.chunk_length
        begin = offset + CHUNK_HEAD.size + len(index.compression.encode()) + 8
        records_end = begin + index.compressed_size
        checksum_end = offset + CHECKSUM_OFFSET + 4
        checksum = int.from_bytes(self.bytes_between(checksum_end - 4, checksum_end), "little")
        if not checksum or not records_end <= end <= self._next_chunk_after(offset):
            return None
        size = index.uncompressed_size
        chunk = Chunk(offset, records_end, begin, size, index.compression, checksum)
        return FileRecord(Opcode.CHUNK, offset, end, chunk)

    def _chunk_at(self, offset: int, end: int) -> FileRecord | None:
        """Return the chunk at an offset by its head, with the end by its length; None without one.

        Unknown fields may follow its data. If its length is wrong, that of its data counts if another record follows
        and a checksum confirms it.
        """
        head = self.bytes_between(offset, offset + CHUNK_HEAD.size + LONGEST_NAME + 8)
        if len(head) < CHUNK_HEAD.size + 8:
            return None
        _, _, first, last, size, checksum, name_length = CHUNK_HEAD.unpack_from(head)
        begin = CHUNK_HEAD.size + name_length + 8
        if begin > len(head):
            return None
        records_end = offset + begin + int.from_bytes(head[begin - 8 : begin], "little")
        limit = self._next_chunk_after(offset)
        is_cut = end > self.size and not self.magic_length_at(max(self.size - len(MCAP0_MAGIC), 0))
        if records_end > end or (records_end < end and not self._may_begin_at(end)):
            if checksum and records_end <= limit and self._may_begin_at(records_end):
                end = records_end
            elif records_end > end or not is_cut:
                return None
        if end > limit and not is_cut:
            return None
        chunk = Chunk(
            offset,
            min(records_end, self.size),
            offset + begin,
            size,
            head[CHUNK_HEAD.size : begin - 8].decode("ascii", "replace"),
            checksum,
            records_end > self.size,
            (first, last),
        )
        return FileRecord(Opcode.CHUNK, offset, min(end, self.size), chunk)

    def _head_at(self, offset: int) -> tuple[int, int]:
        """Return the opcode at an offset, and where the record ends by its length; `HOLE` and `offset` without one."""
        head = self.bytes_between(offset, offset + RECORD_HEAD.size)
        if len(head) < RECORD_HEAD.size:
            return HOLE, offset
        opcode, length = RECORD_HEAD.unpack(head)
        return opcode, offset + RECORD_HEAD.size + length

    def _may_begin_at(self, offset: int) -> bool:
        """Return whether there is a plausible head of a record."""
        opcode, end = self._head_at(offset)
        return opcode != HOLE and end <= self._next_chunk_after(offset)

    def _next_chunk_after(self, offset: int) -> int:
        """Return the offset of the next chunk after `offset` that has an index, or the size of the file."""
        following = bisect_right(self._chunk_starts, offset)
        return self._chunk_starts[min(following, len(self._chunk_starts) - 1)]

    def _hole_at(self, offset: int) -> FileRecord:
        """Return the bytes from `offset` that are no record: up to where their length leads, or to the next chunk."""
        _, end = self._head_at(offset)
        limit = self._next_chunk_after(offset)
        if offset < end < limit and self._may_begin_at(end):
            return FileRecord(HOLE, offset, end)
        begin = offset + 1 - BYTES_AT_ONCE
        while (begin := data_from(self.file, begin + BYTES_AT_ONCE, limit)) < limit:
            data = self.bytes_between(begin, begin + BYTES_AT_ONCE + RECORD_HEAD.size)
            for candidate in CHUNK_OR_DATA_END.finditer(data):
                place = begin + candidate.start()
                record = self.record_at(place) if place < limit else None
                if record and (record.end == self.size or self._may_begin_at(record.end)):
                    return FileRecord(HOLE, offset, place)
        return FileRecord(HOLE, offset, limit)
