"""What a chunk holds: decompressed, cut into records, without trust in its sizes or in its message indices."""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import lz4.frame
import numpy as np
import zstandard
from mcap.opcode import Opcode
from numpy.typing import NDArray

from knee_contact_ros.bags.mcap_layout import CHUNK_HEAD, ENTRY, HEAD, INDEX, MESSAGE, MESSAGE_HEAD
from knee_contact_ros.bags.mcap_records import Record

MESSAGE_HEADS = np.dtype(
    [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log", "<u8"), ("publish", "<u8")]
)
"""Layout `MESSAGE_HEAD` as a NumPy type"""
LARGEST_CHUNK = 2**28
"""Largest uncompressed size [B] of a chunk: recorders make chunks of a MB, or of one larger message"""
STEP = 4096
"""Size [B] of the pieces in which a truncated chunk is decompressed"""
DECLARATIONS = (Opcode.SCHEMA, Opcode.CHANNEL)
"""Opcodes of the records that declare types and topics"""


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
