"""The records of an MCAP file, read without trust in their lengths or in what a chunk says of itself.

A record is taken only if its content fills it exactly. Behind anything else the record goes on that its length leads
to, or else the next chunk is searched for.
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
"""[B] of a compression's name"""
MESSAGE_HEADS = np.dtype(
    [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log", "<u8"), ("publish", "<u8")]
)
"""`MESSAGE_HEAD` in columns"""
LONGEST_INDEX = 2**24
"""[B] of the indices behind a chunk that are looked at"""
LARGEST_RECORD = 2**30
"""[B] that is ever read at once"""
LARGEST_CHUNK = 2**28
"""[B] uncompressed: recorders make chunks of a MB, or of a message that is larger"""
STEP = 4096
"""[B] of a chunk that is cut off that are decompressed at once"""
BLOCK = 2**20
"""[B] that are searched at once"""
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
DECLARATIONS = (Opcode.SCHEMA, Opcode.CHANNEL)
UNPARSED = (Opcode.MESSAGE, Opcode.CHUNK, Opcode.MESSAGE_INDEX)
PRIVATE = 0x80
"""Opcodes from here on are anybody's"""
GOES_ON = re.compile(rb"(?s)(?=\x06.{4}\x00{4}|\x0f\x04\x00{7})")
"""The beginning of a chunk of less than 4 GiB, or of the end of the data"""


class Record(NamedTuple):
    """A whole record."""

    opcode: int
    offset: int
    """[B] of its beginning in the file, or in its chunk"""
    content: bytes

    @property
    def end(self) -> int:
        """Where [B] the next record begins."""
        return self.offset + HEAD.size + len(self.content)


class Hole(NamedTuple):
    """Bytes that are no records."""

    offset: int
    length: int
    alone: bool = False
    """Whether they are a record of an unknown kind or form, whose length leads to the next one"""


class CutChunk(NamedTuple):
    """A chunk whose end the file does not hold."""

    offset: int
    content: bytes


Piece = Record | CutChunk | Hole
"""Of a file"""


class Chunk(NamedTuple):
    """A chunk as its record tells of it."""

    first: int
    last: int
    """Smallest and largest log time [ns]"""
    size: int
    """[B] uncompressed"""
    checksum: int
    """0: none"""
    compression: str
    data: bytes


class Contents(NamedTuple):
    """The records of a chunk, or of a piece of the file; arrays have shape (n,)."""

    heads: NDArray[Any]
    """Of its messages, as `MESSAGE_HEADS`"""
    begins: NDArray[np.int64]
    """[B] of what they hold"""
    ends: NDArray[np.int64]
    others: list[Record]
    """Schemas and channels"""
    number: int
    """Of all records"""
    end: int
    """[B] of the last one"""


class DamagedError(Exception):
    """A chunk that cannot be used; says why as the end of a sentence that begins with it."""


class _Exact(ReadDataStream):
    """Gives all the bytes asked for, or none."""

    def __init__(self, content: bytes) -> None:
        super().__init__(BytesIO(content))
        self._size = len(content)

    def read(self, length: int) -> bytes:
        if length > self._size - self.count:
            raise EndOfFile
        return bytes(super().read(length))


def parsed(record: Record) -> Any:
    """The record in the form that `mcap` gives it; None if its content is no such record, or one of `UNPARSED`."""
    stream = _Exact(record.content)
    try:
        found = PARSERS[record.opcode].read(stream)
    except (KeyError, EndOfFile, struct.error, UnicodeDecodeError):
        return None
    return found if stream.count == len(record.content) else None


def read_records(file: IO[bytes], size: int) -> Iterator[Piece]:
    """All that a file of `size` [B] holds behind its magic, in order; no byte is read twice but for heads."""
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
    """The record that begins at `offset`, if there is a whole one that holds what its kind must hold."""
    head = head_at(file, offset)
    if head is None or not _may_be(file, *head, offset, size):
        return None
    record = Record(head[0], offset, read_at(file, offset + HEAD.size, head[1]))
    return record if record.opcode not in PARSERS or parsed(record) is not None else None


def head_at(file: IO[bytes], offset: int) -> tuple[int, int] | None:
    """Opcode and length [B] of the record at `offset`; None if the file ends before."""
    data = read_at(file, offset, HEAD.size)
    if len(data) < HEAD.size:
        return None
    opcode, length = HEAD.unpack(data)
    return opcode, length


def _may_be(file: IO[bytes], opcode: int, length: int, offset: int, size: int) -> bool:
    """Whether there can be such a record; before a long one is read."""
    if length > LARGEST_RECORD or offset + HEAD.size + length > size:
        return False
    if opcode == Opcode.CHUNK:
        return _is_chunk(file, offset, length)
    if opcode == Opcode.MESSAGE:
        return length >= MESSAGE.size
    return opcode in PARSERS or opcode in UNPARSED or opcode >= PRIVATE


def _is_chunk(file: IO[bytes], offset: int, length: int) -> bool:
    """Whether a chunk's beginning fits its length."""
    beginning = read_at(file, offset + HEAD.size, CHUNK_HEAD.size + LONGEST_NAME + 8)
    if len(beginning) < CHUNK_HEAD.size + 8:
        return False
    name_end: int = CHUNK_HEAD.size + CHUNK_HEAD.unpack_from(beginning)[-1]
    if name_end + 8 > len(beginning):
        return False
    told = int.from_bytes(beginning[name_end : name_end + 8], "little")
    return told == length - name_end - 8


def _next_record(file: IO[bytes], offset: int, size: int) -> int:
    """Where the next chunk, or the end of the data, is that a record follows, or nothing; `size` if there is none."""
    while offset < size:
        block = read_at(file, offset, BLOCK + HEAD.size)
        for candidate in GOES_ON.finditer(block, 0, min(BLOCK, size - offset) + HEAD.size):
            begin = offset + candidate.start()
            head = head_at(file, begin)
            if head and _may_be(file, *head, begin, size) and _is_followed(file, begin + HEAD.size + head[1], size):
                return begin
        offset += BLOCK
    return size


def _is_followed(file: IO[bytes], end: int, size: int) -> bool:
    head = head_at(file, end)
    return end == size or (head is not None and _may_be(file, *head, end, size))


def _is_cut_chunk(file: IO[bytes], offset: int, head: tuple[int, int], size: int) -> bool:
    """Whether a chunk begins whose end the file does not hold, in a file that does not end as a whole one does."""
    opcode, length = head
    too_long = opcode == Opcode.CHUNK and 0 < offset + HEAD.size + length - size <= LARGEST_RECORD
    return too_long and not _is_ended(file, size) and _is_chunk(file, offset, length)


def _is_ended(file: IO[bytes], size: int) -> bool:
    """Whether a file ends as a whole one does."""
    return size >= len(MAGIC) and bool(magic_at(file, size - len(MAGIC)))


def magic_at(file: IO[bytes], offset: int) -> int:
    """Length [B] of the magic at `offset`; 0 if there is none."""
    return len(MAGIC) if read_at(file, offset, len(MAGIC)) == MAGIC else 0


def read_at(file: IO[bytes], offset: int, length: int) -> bytes:
    """So many bytes, or what there is of them."""
    file.seek(offset)
    return file.read(length)


def read_chunk(content: bytes) -> Chunk:
    """A chunk from its record's content, whose head is known to fit."""
    first, last, size, checksum, name_length = CHUNK_HEAD.unpack_from(content)
    name_end = CHUNK_HEAD.size + name_length
    compression = content[CHUNK_HEAD.size : name_end].decode("ascii", "replace")
    return Chunk(first, last, size, checksum, compression, content[name_end + 8 :])


def unpack(chunk: Chunk) -> bytes:
    """The records of a chunk, still in one piece.

    Raises:
        DamagedError: they cannot be had, or do not fit their size or checksum.
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
    """What a chunk's data become, no more than it claims to hold: a frame by itself may claim anything."""
    if chunk.compression == "":
        return chunk.data
    if chunk.compression == "zstd":
        told = zstandard.frame_content_size(chunk.data)
        if told > chunk.size:
            raise DamagedError(f"holds {told} bytes and not {chunk.size}")
        unzip = zstandard.ZstdDecompressor()
        return unzip.decompress(chunk.data, max_output_size=chunk.size + 1, allow_extra_data=False)
    if chunk.compression == "lz4":
        decompressor = lz4.frame.LZ4FrameDecompressor()
        data = bytes(decompressor.decompress(chunk.data, max_length=chunk.size + 1))
        if not decompressor.eof or decompressor.unused_data:
            raise DamagedError("has another end than its data")
        return data
    raise DamagedError(f"has the unknown compression {chunk.compression!r}")


def beginning_of(chunk: Chunk) -> bytes:
    """The whole records at the beginning of a chunk that is cut off; nothing checks them."""
    makers: dict[str, Any] = {
        "zstd": lambda: zstandard.ZstdDecompressor().decompressobj().decompress,
        "lz4": lambda: lz4.frame.LZ4FrameDecompressor().decompress,
        "": lambda: bytes,
    }
    data, decompress = bytearray(), makers.get(chunk.compression, lambda: lambda _: b"")()
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
    """Opcode, and where the content begins and ends, of a chunk's records, up to the first that is not whole.

    One more than `most` at most.
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
    """What there is up to the first record that is not whole, one more record than `most` at most.

    Raises:
        DamagedError: a message is too short.
    """
    if found := indexed(data, indices):
        return found
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
    """What a chunk holds, as the `indices` behind it tell, if these are right beyond doubt.

    They are if there is a message wherever they say, which goes on to the next one, and nothing else.
    """
    if not indices or any(len(index) % ENTRY.size != INDEX.size for index in indices):
        return None
    places = np.concatenate([np.frombuffer(index, "<u8", offset=INDEX.size)[1::2] for index in indices])
    if not len(places) or int(places.max()) > len(data) - MESSAGE_HEAD.size:
        return None
    begins = np.sort(places.astype(np.int64), kind="stable")  # runs that are in order: quickly done
    heads, ends = _heads(data, begins), np.append(begins[1:], len(data))
    lengths = ends - begins - HEAD.size
    right = begins[0] == 0 and int(lengths.min()) >= MESSAGE.size and (heads["length"] == lengths).all()
    if not (right and (heads["opcode"] == Opcode.MESSAGE).all()):
        return None
    return Contents(heads, begins + MESSAGE_HEAD.size, ends, [], len(begins), len(data))


def _heads(data: bytes, begins: NDArray[np.int64]) -> NDArray[Any]:
    """The heads of the messages that begin there, as `MESSAGE_HEADS`."""
    heads = np.dtype(f"V{MESSAGE_HEAD.size}")  # as one thing each, which is copied at once
    windows = np.ndarray(max(len(data) - heads.itemsize + 1, 0), heads, data, strides=(1,))
    return windows[begins].view(MESSAGE_HEADS)


def with_indices(pieces: Iterable[Piece]) -> Iterator[tuple[Piece, list[Record]]]:
    """Each piece of a file with what a chunk's indices are that follow it, instead of these."""
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
