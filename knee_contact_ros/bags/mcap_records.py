"""Reading of MCAP records without trust in their lengths or in the heads of chunks.

A record is accepted only if its content has exactly its length. After anything else, reading continues at the record to
which the length leads, or else at the next chunk, which is searched for.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterable, Iterator
from io import BytesIO
from typing import IO, Any, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from knee_contact_ros.bags.mcap_layout import CHUNK_HEAD, HEAD, MAGIC, MESSAGE

LONGEST_NAME = 16
"""Largest length [B] of the name of a compression"""
LONGEST_INDEX = 2**24
"""Largest size [B] of the message indices after a chunk that are used"""
LARGEST_RECORD = 2**30
"""Largest size [B] of a record that is read"""
BLOCK = 2**20
"""Size [B] of the pieces in which a file is searched"""
PARSERS: dict[int, Any] = {
    Opcode.HEADER: Header,
    Opcode.FOOTER: Footer,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.CHUNK_INDEX: ChunkIndex,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex,
    Opcode.STATISTICS: Statistics,
    Opcode.METADATA: Metadata,
    Opcode.METADATA_INDEX: MetadataIndex,
    Opcode.SUMMARY_OFFSET: SummaryOffset,
    Opcode.ATTACHMENT: Attachment,
    Opcode.DATA_END: DataEnd,
}
"""Class of the `mcap` library that parses the records of each opcode"""
PRIVATE = 0x80
"""First opcode for private records of applications"""
CHUNK_OR_DATA_END = re.compile(rb"(?s)(?=\x06.{4}\x00{4}|\x0f\x04\x00{7})")
"""Head of a chunk of less than 4 GiB, or of the record that ends the data section"""


class Record(NamedTuple):
    """Whole record."""

    opcode: int
    """Opcode"""
    offset: int
    """Offset [B] of the beginning in the file, or in its chunk"""
    content: bytes
    """Content, without the head"""

    @property
    def end(self) -> int:
        """Offset [B] of the next record."""
        return self.offset + HEAD.size + len(self.content)


class Hole(NamedTuple):
    """Bytes of a file that are no records."""

    offset: int
    """Offset [B] of the first one"""
    length: int
    """Number of bytes"""
    alone: bool = False
    """Whether they are one record of an unknown kind or form, whose length leads to the next record"""


class CutChunk(NamedTuple):
    """Truncated chunk at the end of a file."""

    offset: int
    """Offset [B] of the chunk record"""
    content: bytes
    """Content of the record, as far as the file goes"""


Piece = Record | CutChunk | Hole
"""Piece of a file"""


class _Exact(ReadDataStream):
    """Stream whose reads return all of the requested bytes or raise `EndOfFile`."""

    def __init__(self, content: bytes) -> None:
        super().__init__(BytesIO(content))
        self._size = len(content)

    def read(self, length: int) -> bytes:
        if length > self._size - self.count:
            raise EndOfFile
        return bytes(super().read(length))


def parsed(record: Record) -> Any:
    """Record as the `mcap` library parses it; None if it is damaged, or `PARSERS` does not have its opcode."""
    stream = _Exact(record.content)
    try:
        content = PARSERS[record.opcode].read(stream)
    except (KeyError, EndOfFile, struct.error, UnicodeDecodeError):
        return None
    return content if stream.count == len(record.content) else None


def read_records(file: IO[bytes], size: int) -> Iterator[Piece]:
    """Pieces of a file of `size` [B] after its magic, in order; only heads are read twice."""
    position = magic_at(file, 0)
    while position < size:
        record = record_at(file, position, size)
        if record is None:
            head = head_at(file, position)
            end = position + HEAD.size + head[1] if head else size
            if head and _is_cut_chunk(file, position, head, size):
                yield CutChunk(position, read_at(file, position + HEAD.size, size))
                return
            alone = end < size and _is_followed(file, end, size)
            following = end if alone else _next_record(file, position + 1, size)
            yield Hole(position, following - position, alone)
            position = following
            continue
        yield record
        position = record.end
        if record.opcode == Opcode.FOOTER:
            position += magic_at(file, position)


def record_at(file: IO[bytes], offset: int, size: int) -> Record | None:
    """Record that begins at `offset`; None if there is no whole and valid one."""
    head = head_at(file, offset)
    if head is None or not _may_be(file, *head, offset, size):
        return None
    record = Record(head[0], offset, read_at(file, offset + HEAD.size, head[1]))
    return record if record.opcode not in PARSERS or parsed(record) is not None else None


def head_at(file: IO[bytes], offset: int) -> tuple[int, int] | None:
    """Opcode and content length [B] of the record at `offset`; None if the file ends within its head."""
    data = read_at(file, offset, HEAD.size)
    if len(data) < HEAD.size:
        return None
    opcode, length = HEAD.unpack(data)
    return opcode, length


def _may_be(file: IO[bytes], opcode: int, length: int, offset: int, size: int) -> bool:
    """Whether a record with this head is possible, checked before a long one is read."""
    if length > LARGEST_RECORD or offset + HEAD.size + length > size:
        return False
    if opcode == Opcode.CHUNK:
        return _is_chunk(file, offset, length)
    if opcode == Opcode.MESSAGE:
        return length >= MESSAGE.size
    return opcode in PARSERS or opcode == Opcode.MESSAGE_INDEX or opcode >= PRIVATE


def _is_chunk(file: IO[bytes], offset: int, length: int) -> bool:
    """Whether the beginning of a chunk record's content fits its length."""
    beginning = read_at(file, offset + HEAD.size, CHUNK_HEAD.size + LONGEST_NAME + 8)
    if len(beginning) < CHUNK_HEAD.size + 8:
        return False
    name_end: int = CHUNK_HEAD.size + CHUNK_HEAD.unpack_from(beginning)[-1]
    if name_end + 8 > len(beginning):
        return False
    compressed_size = int.from_bytes(beginning[name_end : name_end + 8], "little")
    return compressed_size == length - name_end - 8


def _next_record(file: IO[bytes], offset: int, size: int) -> int:
    """Offset [B] of the next chunk or data end that a possible record or the end of the file follows, else `size`."""
    while offset < size:
        block = read_at(file, offset, BLOCK + HEAD.size)
        for candidate in CHUNK_OR_DATA_END.finditer(block, 0, min(BLOCK, size - offset) + HEAD.size):
            begin = offset + candidate.start()
            head = head_at(file, begin)
            if head and _may_be(file, *head, begin, size) and _is_followed(file, begin + HEAD.size + head[1], size):
                return begin
        offset += BLOCK
    return size


def _is_followed(file: IO[bytes], end: int, size: int) -> bool:
    """Whether a possible record begins at `end`, or the file ends there."""
    head = head_at(file, end)
    return end == size or (head is not None and _may_be(file, *head, end, size))


def _is_cut_chunk(file: IO[bytes], offset: int, head: tuple[int, int], size: int) -> bool:
    """Whether a truncated chunk begins at `offset`, in a file without the magic at its end."""
    opcode, length = head
    too_long = opcode == Opcode.CHUNK and 0 < offset + HEAD.size + length - size <= LARGEST_RECORD
    return too_long and not magic_at(file, max(size - len(MAGIC), 0)) and _is_chunk(file, offset, length)


def magic_at(file: IO[bytes], offset: int) -> int:
    """Length [B] of the magic at `offset`; 0 if there is none."""
    return len(MAGIC) if read_at(file, offset, len(MAGIC)) == MAGIC else 0


def read_at(file: IO[bytes], offset: int, length: int) -> bytes:
    """Bytes at an offset; fewer than `length` only at the end of the file."""
    file.seek(offset)
    return file.read(length)


def with_indices(pieces: Iterable[Piece]) -> Iterator[tuple[Piece, list[Record]]]:
    """Pieces of a file without message indices, each chunk with the list of those that follow it."""
    last, indices, size = None, list[Record](), 0
    for piece in pieces:
        if isinstance(piece, Record) and piece.opcode == Opcode.MESSAGE_INDEX and isinstance(last, Record):
            size += len(piece.content)
            if last.opcode == Opcode.CHUNK and size <= LONGEST_INDEX:
                indices.append(piece)
            continue
        if last:
            yield last, indices
        last, indices, size = piece, [], 0
    if last:
        yield last, indices
