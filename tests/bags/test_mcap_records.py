"""Records and holes of an MCAP file."""

from __future__ import annotations

from io import BytesIO

import pytest
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, DataEnd, Footer, Header, Metadata, Schema

from knee_contact_ros.bags.mcap_records import MAGIC, Hole, Record, parsed, read_records
from tests.hostile.bags import chunk


def bytes_of(*records: Header | Schema | Channel | Metadata | Attachment | DataEnd | Footer) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())


def pieces(content: bytes) -> list[object]:
    """Opcodes of records, lengths of holes."""
    found = read_records(BytesIO(content), len(content))
    return [piece.opcode if isinstance(piece, Record) else piece for piece in found]


HEADER = Header("ros2", "me")
SCHEMA = Schema(id=1, name="Thing", encoding="ros2msg", data=b"float64 a")
NOTE = Metadata("note", {"a": "b"})


def test_records_are_read_as_they_were_written() -> None:
    content = MAGIC + bytes_of(HEADER, SCHEMA, NOTE)
    found = [parsed(piece) for piece in read_records(BytesIO(content), len(content)) if isinstance(piece, Record)]
    assert found == [HEADER, SCHEMA, NOTE]


@pytest.mark.parametrize("length", [8, 10])
def test_a_record_must_fill_its_length_exactly(length: int) -> None:
    schema = bytearray(bytes_of(SCHEMA))
    schema[-13:-9] = length.to_bytes(4, "little")  # of the text, which has 9 bytes
    assert parsed(Record(Opcode.SCHEMA, 0, bytes(schema[9:]))) is None
    assert pieces(MAGIC + bytes_of(HEADER) + schema + bytes_of(NOTE)) == [
        Opcode.HEADER,
        Hole(len(MAGIC) + len(bytes_of(HEADER)), len(schema), alone=True),
        Opcode.METADATA,
    ]


@pytest.mark.parametrize("length", [10, 2**40, 2**64 - 1])
def test_a_length_beyond_all_memory_is_no_record(length: int) -> None:
    attachment = bytearray(bytes_of(Attachment(1, 1, "page.txt", "text/plain", b"some text")))
    attachment[-21:-13] = length.to_bytes(8, "little")
    assert parsed(Record(Opcode.ATTACHMENT, 0, bytes(attachment[9:]))) is None


def test_a_hole_may_be_the_end() -> None:
    beginning = MAGIC + bytes_of(HEADER)
    assert pieces(beginning + bytes_of(NOTE)[:-1]) == [
        Opcode.HEADER,
        Hole(len(beginning), len(bytes_of(NOTE)) - 1),
    ]


def test_behind_a_hole_the_next_chunk_is_found_or_the_end_of_the_data() -> None:
    end = bytes_of(DataEnd(0), Footer(0, 0, 0)) + MAGIC
    assert pieces(b"\xff" * 8 + end) == [Hole(0, 8), Opcode.DATA_END, Opcode.FOOTER]
    whole = chunk(b"", 0, "")
    assert pieces(MAGIC + b"\xff" * 8 + whole + b"\xff" * 9 + whole + end) == [
        Hole(8, 8 + len(whole) + 9),  # a chunk that no record follows may be anything
        Opcode.CHUNK,
        Opcode.DATA_END,
        Opcode.FOOTER,
    ]
