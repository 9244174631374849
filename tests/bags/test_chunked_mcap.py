"""A file written chunk by chunk is, to the last byte, the one that the `mcap` library's writer makes."""

from __future__ import annotations

import struct
from io import BytesIO
from itertools import accumulate, pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.data_stream import RecordBuilder
from mcap.records import Message
from mcap.writer import CompressionType, Writer

from knee_contact_ros.bags.chunked_mcap import CHUNK_SIZE, ChunkedMcap
from knee_contact_ros.bags.mcap_chunks import MESSAGE_HEADS
from knee_contact_ros.bags.mcap_layout import MESSAGE_HEAD

CHANNELS = 3
Said = tuple[int, int, int]
"""Channel, log time [ns] and length of the data [B]"""
FULL = CHUNK_SIZE - MESSAGE_HEAD.size
"""[B] of a message's data that fill a chunk to the limit, which is not beyond it"""
NOTE = {"reason": "ü", "": ""}


def messages_of(said: list[Said], before: int = 0) -> list[Message]:
    return [
        Message(channel, time, bytes([number % 251]) * length, time, before + number)
        for number, (channel, time, length) in enumerate(said)
    ]


def append(mcap: ChunkedMcap, messages: list[Message]) -> None:
    """In parts, as whoever writes records is to."""
    records = [record_of(message) for message in messages]
    for begin, end in pairwise(mcap.cuts(list(accumulate(map(len, records))))):
        entries: dict[int, bytes] = {}
        place = mcap.place
        for message, record in zip(messages[begin:end], records[begin:end], strict=True):
            entry = struct.pack("<QQ", message.log_time, place)
            entries[message.channel_id] = entries.get(message.channel_id, b"") + entry
            place += len(record)
        times = [message.log_time for message in messages[begin:end]]
        mcap.append(memoryview(b"".join(records[begin:end])), entries, min(times), max(times))


def record_of(message: Message) -> bytes:
    builder = RecordBuilder()
    message.write(builder)
    return bytes(builder.end())


def both(
    parts: list[list[Said] | str], compression: CompressionType = CompressionType.NONE, text: bytes = b"float64 x"
) -> tuple[bytes, bytes]:
    """The file in our way and by the library; a part is messages, `flush` or `note`."""
    ours, theirs, before = BytesIO(), BytesIO(), 0
    mcap = ChunkedMcap(ours, "ros2", "tests", compression)
    writer = Writer(theirs, chunk_size=CHUNK_SIZE, compression=compression, enable_data_crcs=True)
    writer.start("ros2", "tests")
    for number in range(1, CHANNELS + 1):
        type_name = f"type {number % 2}"
        schema = number if number < 3 else 1
        if number < 3:
            assert writer.register_schema(type_name, "ros2msg", text) == schema
        assert writer.register_channel(f"/{number}", "cdr", schema, {"a": "b"}) == number
        assert mcap.add_channel(f"/{number}", "cdr", {"a": "b"}, (type_name, "ros2msg", text)) == number
    for part in parts:
        if part == "flush":
            mcap.flush()
            writer.flush()
        elif isinstance(part, str):
            mcap.add_metadata(part, NOTE)
            writer.add_metadata(part, NOTE)
        else:
            messages = messages_of(part, before)
            append(mcap, messages)
            for message in messages:
                kind = message.channel_id, message.log_time
                writer.add_message(*kind, message.data, message.publish_time, message.sequence)
            before += len(messages)
        assert mcap.size == len(ours.getvalue())
    assert mcap.statistics.message_count == before
    mcap.finish()
    writer.finish()
    return ours.getvalue(), theirs.getvalue()


messages_said = st.lists(
    st.tuples(st.integers(1, CHANNELS), st.integers(0, 2**64 - 1), st.sampled_from([0, 1, 40, 900, 30_000, FULL])),
    max_size=12,
)


@settings(max_examples=60, deadline=None)
@given(
    parts=st.lists(messages_said | st.sampled_from(["flush", "note"]), max_size=6),
    compression=st.sampled_from(CompressionType),
)
def test_the_file_is_that_of_the_library(parts: list[list[Said] | str], compression: CompressionType) -> None:
    ours, theirs = both(parts, compression)
    assert ours == theirs


@pytest.mark.parametrize("length", [FULL - 1, FULL, FULL + 1, 3 * CHUNK_SIZE])
@pytest.mark.parametrize("declared", [b"", bytes(2 * CHUNK_SIZE)])
def test_chunks_end_where_those_of_the_library_do(length: int, declared: bytes) -> None:
    """Behind the message that goes beyond the limit; also if what is declared does so alone."""
    ours, theirs = both([[(1, 7, 0)], "flush", [(1, 5, length), (2, 6, 0), (1, 5, length)]], text=declared)
    assert ours == theirs


@pytest.mark.parametrize("parts", [[], ["note"], ["flush", "note", "flush"]])
def test_files_without_messages_are_those_of_the_library(parts: list[list[Said] | str]) -> None:
    ours, theirs = both(parts)
    assert ours == theirs


def test_cuts_count_the_records_before_them() -> None:
    mcap = ChunkedMcap(BytesIO(), "", "", CompressionType.NONE)
    assert mcap.cuts([]) == [0]
    assert mcap.cuts([CHUNK_SIZE - 1, CHUNK_SIZE, CHUNK_SIZE + 1, CHUNK_SIZE + 2]) == [0, 3, 4]
    mcap.append(bytes(CHUNK_SIZE), {1: bytes(16)}, 0, 0)
    assert mcap.place == CHUNK_SIZE
    assert mcap.cuts([1, CHUNK_SIZE + 1, CHUNK_SIZE + 2]) == [0, 1, 3]


def test_a_message_has_the_same_head_everywhere() -> None:
    assert MESSAGE_HEADS.itemsize == MESSAGE_HEAD.size
    packed = MESSAGE_HEAD.pack(5, 22, 1, 2, 3, 4)
    assert record_of(Message(channel_id=1, log_time=3, data=b"", publish_time=4, sequence=2)) == packed
