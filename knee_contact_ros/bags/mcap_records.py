"""Reading of MCAP records without trust in their lengths or in the heads of chunks.

A record is accepted only if its content has exactly its length. After anything else, reading continues at the record to
which the length leads, or else at the next chunk, which is searched for.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterable, Iterator, Sequence
from io import BytesIO
from typing import IO, Any, NamedTuple

import lz4.frame
import numpy as np
import zstandard
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
from numpy.typing import NDArray

from knee_contact_ros.bags.mcap_layout import CHUNK_HEAD, ENTRY, HEAD, INDEX, MAGIC, MESSAGE, MESSAGE_HEAD

LONGEST_NAME = 16
"""Largest length [B] of the name of a compression"""
MESSAGE_HEADS = np.dtype(
    [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log", "<u8"), ("publish", "<u8")]
)
"""Layout `MESSAGE_HEAD` as a NumPy type"""
LONGEST_INDEX = 2**24
"""Largest size [B] of the message indices after a chunk that are used"""
LARGEST_RECORD = 2**30
"""Largest size [B] of a record that is read"""
LARGEST_CHUNK = 2**28
"""Largest uncompressed size [B] of a chunk: recorders make chunks of a MB, or of one larger message"""
STEP = 4096
"""Size [B] of the pieces in which a truncated chunk is decompressed"""
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
DECLARATIONS = (Opcode.SCHEMA, Opcode.CHANNEL)
"""Opcodes of the records that declare types and topics"""
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


class Chunk(NamedTuple):
    """Content of a chunk record."""

    first: int
    """Smallest log time [ns]"""
    last: int
    """Largest log time [ns]"""
    size: int
    """Uncompressed size [B] of the records"""
    checksum: int
    """CRC-32 of the uncompressed records; 0 if there is none"""
    compression: str
    """Name of the compression; empty if there is none"""
    data: bytes
    """Compressed records"""


class Contents(NamedTuple):
    """Records of a chunk, or of messages outside chunks; arrays have shape (n,) for n messages."""

    heads: NDArray[Any]
    """Heads of the messages, as `MESSAGE_HEADS`"""
    begins: NDArray[np.int64]
    """Offsets [B] of the beginnings of the encoded messages"""
    ends: NDArray[np.int64]
    """Offsets [B] of the ends of the encoded messages"""
    others: list[Record]
    """Schema and channel records"""
    number: int
    """Number of all records"""
    end: int
    """Offset [B] of the end of the last record"""


class DamagedError(Exception):
    """A chunk cannot be used; the message is the end of a sentence whose subject is the chunk."""


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


def read_chunk(content: bytes) -> Chunk:
    """Chunk from the content of its record, whose beginning must have been checked."""
    first, last, size, checksum, name_length = CHUNK_HEAD.unpack_from(content)
    name_end = CHUNK_HEAD.size + name_length
    compression = content[CHUNK_HEAD.size : name_end].decode("ascii", "replace")
    return Chunk(first, last, size, checksum, compression, content[name_end + 8 :])


def unpack(chunk: Chunk) -> bytes:
    """Uncompressed records of a chunk.

    Raises:
        DamagedError: They cannot be decompressed, or do not fit their size or checksum.
    """
    if chunk.size > LARGEST_CHUNK:
        raise DamagedError(f"claims to hold {chunk.size} bytes")
    try:
        data = _decompressed(chunk)
    except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError) as error:
        raise DamagedError(f"does not decompress ({' '.join(str(error).split())})") from None
    if len(data) != chunk.size:
        raise DamagedError(f"holds {len(data)} bytes and not {chunk.size}")
    if chunk.checksum and zlib.crc32(data) != chunk.checksum:
        raise DamagedError("does not fit its checksum")
    return data


def _decompressed(chunk: Chunk) -> bytes:
    """Decompressed data of a chunk, limited to its size, because a compressed frame may claim any."""
    if chunk.compression == "":
        return chunk.data
    if chunk.compression == "zstd":
        size = zstandard.frame_content_size(chunk.data)
        if size > chunk.size:
            raise DamagedError(f"holds {size} bytes and not {chunk.size}")
        zstd = zstandard.ZstdDecompressor()
        return zstd.decompress(chunk.data, max_output_size=chunk.size + 1, allow_extra_data=False)
    if chunk.compression == "lz4":
        decompressor = lz4.frame.LZ4FrameDecompressor()
        data = bytes(decompressor.decompress(chunk.data, max_length=chunk.size + 1))
        if not decompressor.eof or decompressor.unused_data:
            raise DamagedError("has another end than its data")
        return data
    raise DamagedError(f"has the unknown compression {chunk.compression!r}")


def beginning_of(chunk: Chunk) -> bytes:
    """Whole records at the beginning of a truncated chunk, without a check of their content."""
    decompressors: dict[str, Any] = {
        "zstd": lambda: zstandard.ZstdDecompressor().decompressobj().decompress,
        "lz4": lambda: lz4.frame.LZ4FrameDecompressor().decompress,
        "": lambda: bytes,
    }
    data, decompress = bytearray(), decompressors.get(chunk.compression, lambda: lambda _: b"")()
    try:
        for begin in range(0, len(chunk.data), STEP):
            data += decompress(chunk.data[begin : begin + STEP])
            if len(data) > min(chunk.size, LARGEST_CHUNK):
                return b""
    except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError):
        pass
    end = 0
    for _, _, end in records_in(bytes(data), len(data)):  # noqa: B007  (the last one counts)
        pass
    return bytes(data[:end])


def records_in(data: bytes, most: int) -> Iterator[tuple[int, int, int]]:
    """Opcode and offsets [B] of the content's beginning and end of each record, up to the first that is not whole.

    At most `most` + 1 records are returned.
    """
    position, end, head, size, count = 0, len(data), HEAD.unpack_from, HEAD.size, 0  # every message of a bag comes here
    while position + size <= end and count <= most:
        opcode, length = head(data, position)
        begin, position = position + size, position + size + length
        if position > end or not opcode:
            return
        count += 1
        yield opcode, begin, position


def contents_of(data: bytes, indices: Sequence[bytes], most: int) -> Contents:
    """Records in `data` up to the first that is not whole, but at most `most` + 1, or as the `indices` of a chunk tell.

    Raises:
        DamagedError: A message is too short.
    """
    if contents := indexed(data, indices):
        return contents
    places, others, number, end = list[int](), list[Record](), 0, 0
    for opcode, begin, end in records_in(data, most):
        number += 1
        if opcode == Opcode.MESSAGE:
            if end - begin < MESSAGE.size:
                raise DamagedError("has a message that is too short")
            places.append(begin - HEAD.size)
        elif opcode in DECLARATIONS:
            others.append(Record(opcode, begin, data[begin:end]))
    begins = np.array(places, np.int64)
    heads = _heads(data, begins)
    ends = begins + HEAD.size + heads["length"].astype(np.int64)
    return Contents(heads, begins + MESSAGE_HEAD.size, ends, others, number, end)


def indexed(data: bytes, indices: Sequence[bytes]) -> Contents | None:
    """Records of a chunk according to the message `indices` that follow it; None unless these are certainly right.

    They are if the chunk consists of messages only, which begin exactly at the offsets in the indices.
    """
    if not indices or any(len(index) % ENTRY.size != INDEX.size for index in indices):
        return None
    places = np.concatenate([np.frombuffer(index, "<u8", offset=INDEX.size)[1::2] for index in indices])
    if not len(places) or int(places.max()) > len(data) - MESSAGE_HEAD.size:
        return None
    begins = np.sort(places.astype(np.int64), kind="stable")  # fast, because it consists of sorted runs
    heads, ends = _heads(data, begins), np.append(begins[1:], len(data))
    lengths = ends - begins - HEAD.size
    right = begins[0] == 0 and int(lengths.min()) >= MESSAGE.size and (heads["length"] == lengths).all()
    if not (right and (heads["opcode"] == Opcode.MESSAGE).all()):
        return None
    return Contents(heads, begins + MESSAGE_HEAD.size, ends, [], len(begins), len(data))


def _heads(data: bytes, begins: NDArray[np.int64]) -> NDArray[Any]:
    """Heads of the message records at the given offsets, as `MESSAGE_HEADS`."""
    heads = np.dtype(f"V{MESSAGE_HEAD.size}")  # one item each, which is copied at once
    windows = np.ndarray(max(len(data) - heads.itemsize + 1, 0), heads, data, strides=(1,))
    return windows[begins].view(MESSAGE_HEADS)


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
