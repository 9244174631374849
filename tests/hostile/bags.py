"""MCAP files and folders that are made to hang, fill memory or mislead; each is small."""

from __future__ import annotations

import struct
from collections.abc import Iterable

import lz4.frame

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, METADATA, DATA_END = 1, 2, 3, 4, 5, 6, 12, 15


def record(opcode: int, content: bytes) -> bytes:
    """A record."""
    return struct.pack("<BQ", opcode, len(content)) + content


def text(content: str | bytes) -> bytes:
    """A text with its length before it."""
    data = content.encode() if isinstance(content, str) else content
    return struct.pack("<I", len(data)) + data


def pairs(entries: Iterable[tuple[str, str]]) -> bytes:
    """Names and values, with their length before them."""
    return text(b"".join(text(name) + text(value) for name, value in entries))


def whole(*records: bytes) -> bytes:
    """A file without a summary."""
    head = record(HEADER, text("ros2") + text("somebody's"))
    return MAGIC + head + b"".join(records) + record(DATA_END, bytes(4)) + record(FOOTER, bytes(20)) + MAGIC


def chunk(data: bytes, size: int, compression: str = "zstd", first: int = 0, last: int = 0) -> bytes:
    """A chunk that claims to hold `size` bytes."""
    head = struct.pack("<QQQI", first, last, size, 0)
    return record(CHUNK, head + text(compression) + struct.pack("<Q", len(data)) + data)


def schema(number: int, name: str, definition: bytes) -> bytes:
    """A schema."""
    return record(SCHEMA, struct.pack("<H", number) + text(name) + text("ros2msg") + text(definition))


def channel(number: int, topic: str, qos: str = "", schema_number: int = 1) -> bytes:
    """A channel."""
    head = struct.pack("<HH", number, schema_number)
    return record(CHANNEL, head + text(topic) + text("cdr") + pairs([("offered_qos_profiles", qos)]))


def message(number: int, data: bytes, time: int = 0) -> bytes:
    """A message."""
    return record(MESSAGE, struct.pack("<HIQQ", number, 0, time, time) + data)


def zstd_of_zeros(megabytes: int) -> bytes:
    """So much in a thirty-thousandth of it: blocks that say "a zero, 131072 times"."""
    block, last = ((2**17 << 3 | 1 << 1 | end).to_bytes(3, "little") + b"\0" for end in (0, 1))
    return b"\x28\xb5\x2f\xfd\0\x50" + block * (8 * megabytes - 1) + last


def lz4_of_zeros(megabytes: int) -> bytes:
    """The same, a two-hundred-fiftieth of it long."""
    return lz4.frame.compress(bytes(megabytes * 2**20))
