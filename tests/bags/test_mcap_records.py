"""Records and holes of an MCAP file."""

from __future__ import annotations

import struct
from io import BytesIO

import pytest
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, DataEnd, Footer, Header, Metadata, Schema

from knee_contact_ros.bags import mcap_records
from knee_contact_ros.bags.mcap_chunks import contents_of, indexed, records_in
from knee_contact_ros.bags.mcap_layout import HEAD, MAGIC, MESSAGE_HEAD
from knee_contact_ros.bags.mcap_records import Hole, Record, parsed, read_records, with_indices
from tests.hostile.bags import channel, chunk, message, record


def bytes_of(*records: Header | Schema | Channel | Metadata | Attachment | DataEnd | Footer) -> bytes:
    builder = RecordBuilder()
    for each in records:
        each.write(builder)
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


DATA = b"".join(message(number % 2 + 1, b"m" * (number % 5), 100 + number) for number in range(40))
PLACES = [begin - HEAD.size for _, begin, _ in records_in(DATA, 100)]


def index(*places: int, channel: int = 1) -> bytes:
    """What a chunk's index of a channel holds."""
    return struct.pack("<HI", channel, 16 * len(places)) + b"".join(struct.pack("<QQ", 7, place) for place in places)


def test_an_index_that_is_right_tells_where_messages_begin() -> None:
    found = indexed(DATA, [index(*PLACES[1::2]), index(*PLACES[::2])])
    assert found is not None
    assert [begin - MESSAGE_HEAD.size for begin in found.begins] == PLACES
    assert found.heads["log"].tolist() == list(range(100, 140))


WRONG = {
    "none": [],
    "empty": [index()],
    "one missing": [index(*PLACES[:7], *PLACES[8:])],
    "the last one missing": [index(*PLACES[:-1])],
    "one twice": [index(*PLACES, PLACES[3])],
    "one beside": [index(*PLACES[:7], PLACES[7] + 1, *PLACES[8:])],
    "one beyond the end": [index(*PLACES, len(DATA))],
    "one beyond all memory": [index(*PLACES, 2**64 - 1)],
    "half an entry": [index(*PLACES)[:-8]],
    "half a head": [b"\1"],
}


@pytest.mark.parametrize("indices", WRONG.values(), ids=WRONG)
@pytest.mark.parametrize("others", [b"", channel(1, "/a"), record(0x80, b"anybody's")])
def test_an_index_that_is_wrong_is_not_believed(indices: list[bytes], others: bytes) -> None:
    for data in (DATA + others, others + DATA):
        assert indexed(data, indices) is None
        found = contents_of(data, indices, 100)
        assert (len(found.heads), found.number, found.end) == (40, 40 + bool(others), len(data))
        assert [data[begin:end] for begin, end in zip(found.begins, found.ends, strict=True)] == [
            b"m" * (number % 5) for number in range(40)
        ]
        assert len(found.others) == (others[:1] == b"\4")


@pytest.mark.parametrize("length", [0, 21, 2**63, 2**64 - 9])
def test_a_length_that_leads_back_is_not_believed(length: int) -> None:
    """Whatever an index says."""
    data = bytearray(DATA)
    data[PLACES[4] + 1 : PLACES[4] + 9] = struct.pack("<Q", length)
    assert indexed(bytes(data), [index(*PLACES)]) is None
    assert indexed(bytes(data), [index(*PLACES, PLACES[4])]) is None


def test_a_chunk_comes_with_the_indices_behind_it() -> None:
    about = record(Opcode.MESSAGE_INDEX, index(3))
    content = MAGIC + about + chunk(b"", 0) + about * 2 + bytes_of(NOTE) + about + chunk(b"", 0)
    found = list(with_indices(read_records(BytesIO(content), len(content))))
    assert [(piece.opcode, len(indices)) for piece, indices in found if isinstance(piece, Record)] == [
        (Opcode.MESSAGE_INDEX, 0), (Opcode.CHUNK, 2), (Opcode.METADATA, 0), (Opcode.CHUNK, 0),
    ]  # fmt: skip


def test_indices_beyond_all_chunks_are_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    about = record(Opcode.MESSAGE_INDEX, index(3))
    monkeypatch.setattr(mcap_records, "LONGEST_INDEX", 3 * (len(about) - HEAD.size))
    content = MAGIC + chunk(b"", 0) + about * 10
    ((_, indices),) = with_indices(read_records(BytesIO(content), len(content)))
    assert len(indices) == 3
