"""MCAP files and folders that are made to hang, fill memory or mislead; each is small."""

import struct

import lz4.frame
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Chunk, DataEnd, Footer, Header, Message, Schema

MAGIC = b"\x89MCAP0\r\n"


def written(*records):
    """Records of the library of the MCAP project."""
    builder = RecordBuilder()
    for each in records:
        each.write(builder)
    return bytes(builder.end())


def record(opcode, content):
    """A record of any kind."""
    return struct.pack("<BQ", opcode, len(content)) + content


def whole(*records):
    """A file without a summary."""
    head, end = written(Header("ros2", "somebody's")), written(DataEnd(0), Footer(0, 0, 0))
    return MAGIC + head + b"".join(records) + end + MAGIC


def chunk(data, size, compression="zstd", first=0, last=0):
    """A chunk that claims to hold `size` bytes."""
    return written(Chunk(compression, data, last, first, 0, size))


def schema(number, name, definition):
    """A schema."""
    return written(Schema(number, definition, "ros2msg", name))


def channel(number, topic, qos="", schema_number=1):
    """A channel."""
    return written(Channel(number, topic, "cdr", {"offered_qos_profiles": qos}, schema_number))


def message(number, data, time=0):
    """A message."""
    return written(Message(number, time, data, time, 0))


def zstd_of_zeros(megabytes):
    """So much in a thirty-thousandth of it: blocks that say "a zero, 131072 times"."""
    block, last = ((2**17 << 3 | 1 << 1 | end).to_bytes(3, "little") + b"\0" for end in (0, 1))
    return b"\x28\xb5\x2f\xfd\0\x50" + block * (8 * megabytes - 1) + last


def lz4_of_zeros(megabytes):
    """The same, a two-hundred-fiftieth of it long."""
    return lz4.frame.compress(bytes(megabytes * 2**20))
