"""What a chunk of an MCAP file holds: decompressed as far as it goes, and its records."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from typing import NamedTuple

import lz4.frame
import zstandard
from mcap.opcode import Opcode

from knee_contact_ros.bags.recovery.records import CHUNK_HEAD, HEAD, MESSAGE_HEAD, Record

MESSAGE = struct.Struct("<HIQQ")
"""Channel, sequence, log time and publish time [ns]"""
CHANNEL_AND_TIME = struct.Struct("<H4xQ")
"""Of a message: channel and log time [ns]"""
STEP = 4096
"""[B] given to a decompressor at once: what it makes of them counts if all of them are right"""


LARGEST_CHUNK = 2**28
"""[B] uncompressed: recorders make chunks of a MB, or of a message that is larger"""
MOST_RECORDS = 2**20
"""In a chunk"""
DECLARATIONS = (Opcode.SCHEMA, Opcode.CHANNEL)


class Chunk(NamedTuple):
    """A chunk as its record tells of it."""

    size: int
    """[B] uncompressed"""
    checksum: int
    """0: none"""
    compression: str
    data: bytes


class Unpacked(NamedTuple):
    """A chunk's records, still in one piece."""

    data: bytes
    fault: str
    """What is wrong, as the end of a sentence that begins with the chunk; empty if nothing is"""
    made: int = 0
    """[B] that came out, also those that are left out"""


class Message(NamedTuple):
    """A message in a chunk, or between them."""

    channel: int
    sequence: int
    log_time: int
    """[ns]"""
    publish_time: int
    """[ns]"""
    data: bytes


def read_chunk(content: bytes) -> Chunk:
    """A chunk from its record's content, whose head is known to fit; its data may be cut off."""
    _, _, size, checksum, name_length = CHUNK_HEAD.unpack_from(content)
    name_end = CHUNK_HEAD.size + name_length
    compression = content[CHUNK_HEAD.size : name_end].decode("ascii", "replace")
    return Chunk(size, checksum, compression, content[name_end + 8 :])


def unpack(chunk: Chunk, *, cut: bool = False) -> Unpacked:
    """Decompress a chunk; of one that is cut off, as far as it goes.

    What is wrong with a whole one is said: the data are then those that came out before, or those that the checksum
    does not fit.
    """
    if chunk.size > LARGEST_CHUNK:
        return Unpacked(b"", f"claims to hold {chunk.size} bytes")
    try:
        decompressor = _decompressor(chunk.compression)
    except KeyError:
        return Unpacked(b"", f"has the unknown compression {chunk.compression!r}")
    data, fault, made = _decompressed(decompressor, chunk)
    if cut:
        return Unpacked(data, "is cut off", made)
    if not fault and len(data) != chunk.size:
        fault = f"holds {len(data)} bytes and not {chunk.size}"
    if not fault and chunk.checksum and zlib.crc32(data) != chunk.checksum:
        fault = "does not fit its checksum"
    return Unpacked(data, fault, made)


class _Plain:
    """Leaves everything as it is."""

    def decompress(self, data: bytes) -> bytes:
        return data


def _decompressor(compression: str) -> _Plain | zstandard.ZstdDecompressionObj | lz4.frame.LZ4FrameDecompressor:
    makers = {
        "": _Plain,
        "zstd": lambda: zstandard.ZstdDecompressor().decompressobj(),
        "lz4": lz4.frame.LZ4FrameDecompressor,
    }
    return makers[compression]()


def _decompressed(
    decompressor: _Plain | zstandard.ZstdDecompressionObj | lz4.frame.LZ4FrameDecompressor, chunk: Chunk
) -> Unpacked:
    """What comes out of a decompressor, no more than the chunk claims to hold, and what went wrong."""
    parts: list[bytes] = []
    size = 0
    try:
        for begin in range(0, len(chunk.data), STEP):
            part = decompressor.decompress(chunk.data[begin : begin + STEP])
            size += len(part)
            if size > chunk.size:
                return Unpacked(b"".join(parts), f"holds more than {chunk.size} bytes", size)
            parts.append(part)
    except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError) as error:
        return Unpacked(b"".join(parts), f"does not decompress ({' '.join(str(error).split())})", size)
    if getattr(decompressor, "unused_data", b""):  # others would go on with it
        return Unpacked(b"".join(parts), "goes on behind its end", size)
    return Unpacked(b"".join(parts), "", size)


class Contents(NamedTuple):
    """Where the messages of a chunk are, and its schemas and channels."""

    messages: dict[int, tuple[int, int]]
    """Channel and log time [ns] by offset"""
    others: list[Record]
    records: int
    """How many, of all kinds"""
    end: int
    """[B] up to which the data are records"""


def contents_of(data: bytes, most: int) -> Contents:
    """What a chunk's data hold, without a copy of every message; one record more than `most` at most."""
    messages: dict[int, tuple[int, int]] = {}
    others: list[Record] = []
    position, end, head_size, kind, count = 0, len(data), HEAD.size, int(Opcode.MESSAGE), 0
    head, channel_and_time = (
        HEAD.unpack_from,
        CHANNEL_AND_TIME.unpack_from,
    )  # by names: every message of a bag comes here
    while position + head_size <= end and count <= most:
        opcode, length = head(data, position)
        following = position + head_size + length
        if following > end or not opcode:
            break
        count += 1
        if opcode == kind and length >= MESSAGE_HEAD:
            messages[position] = channel_and_time(data, position + head_size)
        elif opcode in DECLARATIONS:
            others.append(Record(opcode, position, data[position + HEAD.size : following]))
        position = following
    return Contents(messages, others, count, position)


def records_in(data: bytes) -> Iterator[Record]:
    """The records in a chunk's data, up to the first that is not whole."""
    position, end = 0, len(data)
    while position + HEAD.size <= end:
        opcode, length = HEAD.unpack_from(data, position)
        begin = position + HEAD.size
        if begin + length > end:
            return
        yield Record(opcode, position, data[begin : begin + length])
        position = begin + length


def read_message(content: bytes) -> Message | None:
    """A message from its record's content; None if it is too short for one."""
    if len(content) < MESSAGE_HEAD:
        return None
    channel, sequence, log_time, publish_time = MESSAGE.unpack_from(content)
    return Message(channel, sequence, log_time, publish_time, content[MESSAGE_HEAD:])


def is_message(record: Record) -> bool:
    """Whether a record is one that can be a message."""
    return record.opcode == Opcode.MESSAGE and len(record.content) >= MESSAGE_HEAD
