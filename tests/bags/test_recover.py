"""`recover`: all that can be read, in a file that every reader takes."""

import errno
import io
import os
import subprocess
import sys
from collections.abc import Callable
from contextlib import closing, suppress
from types import SimpleNamespace
from typing import Any

import pytest
from mcap.reader import NonSeekingReader, make_reader
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer
from rosbags.highlevel import AnyReader

from knee_contact_ros.bags.bag import Bag
from knee_contact_ros.bags.mcap_file import DECOMPRESSORS, McapFile
from knee_contact_ros.bags.recover import RECOVERED, recover
from knee_contact_ros.system.errors import UsageError
from studies.fuzz_bags.bags import TICKS, mcap, messages
from tests.bags.test_mcap_file import chunks
from tests.helpers.bags import raw_messages
from tests.helpers.commands import run

Row = tuple[str, int, bytes]
"""Topic, log time [ns] and bytes of a message"""


@pytest.fixture
def cut(tmp_path):
    """A recording that was cut off."""
    path = tmp_path / "bag.mcap.partial"
    mcap(path, CompressionType.ZSTD)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    return path


def content(path):
    """All that a file holds, by the name of the record; strictly read."""
    found: dict[str, list[Any]] = {}
    with path.open("rb") as file:
        for record in StreamReader(file, validate_crcs=True).records:
            found.setdefault(type(record).__name__, []).append(record)
    return found


def test_a_hole_in_the_file_takes_no_time(tmp_path):
    """Of 1 TiB that the disk has not stored; other commands name `recover`."""
    path = tmp_path / "bag.mcap"
    mcap(path, CompressionType.ZSTD)
    whole = path.read_bytes()
    with path.open("r+b") as file:
        file.truncate(len(whole) // 2)
        file.seek(2**40)
        file.write(whole[len(whole) // 2 :])
    assert recover(path, tmp_path / "out.mcap").unread_bytes > 2**39
    assert len(list(raw_messages(tmp_path / "out.mcap"))) > 20
    with pytest.raises(UsageError, match="takes the rest"):
        Bag(path)


def test_a_cut_off_recording_is_whole_again(cut, tmp_path):
    before, output = cut.read_bytes(), tmp_path / "bag.mcap"
    recovery = recover(cut, output)
    assert cut.read_bytes() == before
    with closing(McapFile(output)) as file:
        assert file.faults == []
    found = [tuple(message) for message in raw_messages(output)]
    assert found == list(messages())[: len(found)]
    assert 20 < len(found) < 2 * TICKS
    assert [topic.messages for topic in recovery.topics] == [
        (len(found) + 1) // 2,
        len(found) // 2,
    ]
    assert {topic.missing for topic in recovery.topics} == {None}  # the statistics are gone
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bag.mcap", "bag.mcap.partial"]
    with AnyReader([output]) as reader:
        assert reader.message_count == len(found)
    with output.open("rb") as file:
        notes = {record.name: record.metadata for record in make_reader(file).iter_metadata()}
    assert notes[RECOVERED]["source"] == "bag.mcap.partial"
    assert notes[RECOVERED]["messages"] == str(len(found))
    assert notes[RECOVERED]["faults"] == "\n".join(recovery.faults)


def test_a_file_that_ends_behind_the_head_of_a_chunk_is_read(tmp_path, monkeypatch):
    """`read1` of zstandard never returns without any bytes."""
    path, whole = tmp_path / "bag.mcap", DECOMPRESSORS["zstd"]
    mcap(path, CompressionType.ZSTD)
    with closing(McapFile(path)) as file:
        *_, last = file.chunks
    os.truncate(path, last.records_begin)
    never = SimpleNamespace(read1=lambda _: pytest.fail("it would never return"))
    monkeypatch.setitem(DECOMPRESSORS, "zstd", lambda data: whole(data) if data else never)
    with closing(McapFile(path)) as file:
        assert f"the chunk at byte {last.offset} is cut off; 0 of" in str(file.faults)


def test_a_file_that_is_cut_off_while_it_is_read_costs_a_line(tmp_path):
    path = tmp_path / "bag.mcap"
    mcap(path, CompressionType.ZSTD)
    with closing(McapFile(path)) as file:
        *_, last = file.chunks

    def advance(done, total):
        if 2 * done > total:
            os.truncate(path, last.records_begin)

    with pytest.raises(UsageError, match="was changed while it was read: a chunk does not hold"):
        recover(path, tmp_path / "out.mcap", advance)
    assert [*tmp_path.iterdir()] == [path]


def test_everything_else_stays_as_it_is(tmp_path):
    path, output = tmp_path / "in.mcap", tmp_path / "o" / "out.mcap"
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.LZ4)
        writer.start(profile="mine", library="me")
        schema = writer.register_schema("Thing", "jsonschema", b"{}")
        first = writer.register_channel("/things", "json", schema, {"a": "b"})
        second = writer.register_channel("/bare", "", 0)
        for time in (30, 10, 20):
            writer.add_message(first, time, b"{%d}" % time, time - 5, time + 1)
            writer.add_message(second, time, b"", 0)
        writer.add_metadata("note", {"c": "d"})
        writer.add_attachment(1, 2, "page.txt", "text/plain", b"some text")
        writer.finish()
    recovery = recover(path, output)
    old, new = content(path), content(output)
    for name in ("Schema", "Channel", "Message", "Attachment"):
        assert new[name] == old[name], name
    assert new["Header"][0].profile == "mine"
    assert [record.name for record in new["Metadata"]] == ["note", RECOVERED]
    assert new["Metadata"][0] == old["Metadata"][0]
    assert {record.compression for record in new["ChunkIndex"]} == {"lz4"}
    assert (
        recovery.faults,
        recovery.unread_bytes,
        [topic.missing for topic in recovery.topics],
    ) == (
        [],
        0,
        [0, 0],
    )


def test_the_missing_are_counted_where_the_statistics_are_left(tmp_path, capsys):
    path = tmp_path / "in.mcap"
    mcap(path, CompressionType.ZSTD)
    data, (offset, length) = bytearray(path.read_bytes()), chunks(path)[1]
    data[offset + length // 2] ^= 1
    path.write_bytes(data)
    assert run(f"recover {path} {tmp_path}/out.mcap") == 0
    said = capsys.readouterr().out
    left = len(raw_messages(tmp_path / "out.mcap"))
    missing = [int(line.split()[-1]) for line in said.splitlines() if line.startswith(" /joint")]
    assert sum(missing) == 2 * TICKS - left > 0
    assert f"bytes {offset} to " in said
    assert "from 0.005 s to 0.500 s" in said
    assert f"Recovered: {tmp_path / 'out.mcap'}" in said


def test_an_output_is_replaced_only_when_asked(cut, tmp_path):
    output = tmp_path / "bag.mcap"
    output.write_text("precious")
    with pytest.raises(UsageError, match="exists already"):
        recover(cut, output)
    assert output.read_text() == "precious"
    recover(cut, output, overwrite=True)
    with pytest.raises(UsageError, match="is the input"):
        recover(output, output, overwrite=True)
    assert raw_messages(output)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (None, "is not there"),
        (b"text", "is no MCAP file"),
        (
            b"\x89PNG\r\n\x1a\n" + bytes(99),
            r"or this is no MCAP file; bytes 0 to 107 cannot be read",
        ),
        (b"", "is no MCAP file"),
        (b"SQLite format 3\0", "sqlite3"),
    ],
)
def test_a_file_without_messages_is_refused(tmp_path, data, words):
    path = tmp_path / "in.mcap"
    if data is not None:
        path.write_bytes(data)
    with pytest.raises(UsageError, match=words):
        recover(path, tmp_path / "o" / "out.mcap")
    with pytest.raises(UsageError, match="is a folder"):
        recover(tmp_path, tmp_path / "o" / "out.mcap")
    assert not (tmp_path / "o").exists()


# From Python 3.14 on a buffer takes the whole bag, and there is no second write.
LATER = ["write:2"] if io.DEFAULT_BUFFER_SIZE < 2**16 else []


@pytest.mark.parametrize("fault", ["open:1", "write:1", *LATER, "fsync:1"])
def test_a_full_disk_leaves_nothing_behind(cut, watching, tmp_path, fault):
    """The output that is to be replaced and what lies beside stay as they were."""
    folder = tmp_path / "full"
    folder.mkdir()
    output = folder / "bag.mcap"
    output.write_text("precious")
    environment = {
        "LD_PRELOAD": str(watching),
        "WATCHED_FOLDER": str(folder),
        "WATCHED_LOG": str(tmp_path / "log"),
    }
    environment["WATCHED_FAULT"] = f"{fault}:{errno.ENOSPC}"
    command = [
        sys.executable,
        "-m",
        "knee_contact_ros.commands.main",
        "recover",
        str(cut),
        str(output),
        "--overwrite",
    ]
    done = subprocess.run(
        command, env=os.environ | environment, capture_output=True, text=True, check=False
    )
    refused = fault.startswith("open")  # there is no place for it
    assert (done.returncode, done.stdout) == (2 if refused else 1, ""), done.stderr
    assert done.stderr.startswith("knee-contact: ")
    assert done.stderr.count("\n") == 1
    assert {path.name for path in folder.iterdir()} == {"bag.mcap"}
    assert output.read_text() == "precious"


def test_an_output_that_appears_meanwhile_is_kept(cut, tmp_path):
    output = tmp_path / "bag.mcap"
    with pytest.raises(UsageError, match="appeared in the meantime and was not changed"):
        recover(cut, output, advance=lambda _done, _total: output.write_text("precious") and None)
    assert output.read_text() == "precious"
    recover(
        cut,
        output,
        advance=lambda _done, _total: output.write_text("old") and None,
        overwrite=True,
    )
    assert raw_messages(output)


Damage = Callable[[bytearray, list[int], int], object]
"""Change of a file whose chunks, and whose summary, begin at these offsets; the data of a chunk begin behind byte 48"""


def put(begin, data, chunk=None):
    """Write over bytes of a chunk, or, from the end on if `begin` is negative, of the file."""

    def damage(content, chunks, _summary):
        first = begin + (chunks[chunk] if chunk is not None else len(content) if begin < 0 else 0)
        content[first : first + len(data)] = data[: len(content) - first]

    return damage


def deleted(chunk, begin, length):
    return lambda content, chunks, _: content.__delitem__(
        slice(chunks[chunk] + begin, chunks[chunk] + begin + length)
    )


def inserted(data):
    return lambda content, chunks, _: content.__setitem__(
        slice(chunks[2], chunks[2]), data(content, chunks)
    )


def of_length(length):
    """Have the second chunk claim another length."""
    return lambda content, chunks, summary: put(1, length(chunks).to_bytes(8, "little"), 1)(
        content, chunks, summary
    )


def without_index(damage):
    return lambda content, chunks, summary: (
        damage(content, chunks, summary),
        content.__delitem__(slice(summary, None)),
    )


def every_opcode(content, chunks, _summary):
    for offset in chunks:
        content[offset] = 5


def wrong_index(content, chunks, summary):
    """Have the index of the chunks lie about the place of one."""
    begin = content.index(chunks[2].to_bytes(8, "little"), summary)
    content[begin : begin + 8] = b"\x55" * 8


U = b"\x55"
HEAD_LIES = "the data do not fit their checksum"
NO_RECORDS, SUMMARY = (
    "they are no valid records",
    "the summary does not fit its checksum or its place",
)
DAMAGES: dict[str, tuple[Damage, bool, str]] = {
    "opcode of the first chunk": (put(0, b"\x21", 0), True, HEAD_LIES),
    "opcode of every chunk": (every_opcode, True, HEAD_LIES),
    "length beyond all memory": (of_length(lambda _: 2**64 - 1), True, HEAD_LIES),
    "length without an index": (
        without_index(of_length(lambda _: 10**4)),
        True,
        "the end is missing",
    ),
    "size of the data without an index": (
        without_index(
            lambda data, chunks, _: put(41 + data[chunks[1] + 37], b"\xff" * 8, 1)(data, chunks, 0)
        ),
        False,
        NO_RECORDS,
    ),
    "times of a chunk": (put(9, U * 16, 2), True, "the data do not fit their checksum"),
    "size of a chunk": (put(25, U * 2, 2), True, HEAD_LIES),
    "opcode and data": (
        lambda *file: (put(0, b"\0", 2)(*file), put(200, U * 4, 2)(*file)),
        False,
        "the chunk does not ",
    ),
    "checksum": (put(33, U * 4, 2), False, "the chunk does not fit its checksum"),
    "data": (put(200, U * 4, 2), False, "the chunk does not "),
    "message index": (put(-60, U * 40, 3), True, "the data do not fit their checksum"),
    "zeros over two chunks' border": (put(-300, bytes(400), 2), False, "messages are missing"),
    "place in the index": (wrong_index, True, SUMMARY),
    "summary": (
        lambda content, _, summary: put(summary, U * 60)(content, [], 0),
        True,
        NO_RECORDS,
    ),
    "footer": (put(-30, U * 10), True, NO_RECORDS),
    "place of the summary": (put(-28, b"\xff" * 8), True, SUMMARY),
    "magic at the end": (put(-8, U * 8), True, "the end is missing"),
    "magic at the beginning": (put(0, U * 8), True, "the data do not fit their checksum"),
    "header": (put(8, U * 9), True, "the beginning is damaged, or this is no MCAP file"),
    "cut in a chunk": (deleted(3, 300, 10**6), False, "is cut off; "),
    "cut in the summary": (
        lambda content, _, summary: content.__delitem__(slice(summary + 30, None)),
        True,
        "the end",
    ),
    "zeros at the end": (put(300, bytes(10**6), 3), False, "the end is missing"),
    "bytes deleted": (deleted(1, -30, 80), False, NO_RECORDS),
    "bytes inserted": (inserted(lambda *_: b"\x11" * 77), True, NO_RECORDS),
    "attachment": (
        lambda data, *_: put(data.index(b"some text"), U)(data, [], 0),
        True,
        NO_RECORDS,
    ),
    "length of an attachment's data": (
        lambda data, *_: put(data.index(b"some text") - 8, b"\xff" * 8)(data, [], 0),
        True,
        NO_RECORDS,
    ),
    "a chunk twice": (
        inserted(lambda content, chunks: content[chunks[2] : chunks[3]]),
        True,
        "statistics do not fit",
    ),
}
"""For each damage, whether all messages can be got back, and what is said"""


def read_by_mcap(path, kind):
    with path.open("rb") as file:
        for _, channel, message in kind(file, validate_crcs=True).iter_messages(
            log_time_order=False
        ):
            yield channel.topic, message.log_time, message.data


def read_by_rosbags(path):
    with AnyReader([path]) as reader:
        for connection, time, data in reader.messages():
            yield connection.topic, time, bytes(data)


def as_far_as_it_goes(found):
    rows = set()
    with suppress(Exception):  # whatever the damage provokes
        for row in found:
            rows.add(row)
    return rows


@pytest.mark.parametrize("compression", CompressionType)
@pytest.mark.parametrize("name", DAMAGES)
def test_no_other_reader_reads_more_of_a_damaged_file(tmp_path, name, compression):
    """And nothing that was not written: checksums cover all messages here."""
    path, written = tmp_path / "in.mcap", set(messages())
    mcap(path, compression)
    content, (damage, whole, words) = bytearray(path.read_bytes()), DAMAGES[name]
    damage(
        content, [offset for offset, _ in chunks(path)], int.from_bytes(content[-28:-20], "little")
    )
    path.write_bytes(content)
    recovery = recover(path, tmp_path / "o" / "out.mcap")
    found = {tuple(message) for message in raw_messages(tmp_path / "o" / "out.mcap")}
    ways = (
        read_by_mcap(path, NonSeekingReader),
        read_by_mcap(path, make_reader),
        read_by_rosbags(path),
    )
    for theirs in map(as_far_as_it_goes, ways):
        assert found >= theirs & written
    assert found == written if whole else found < written
    assert any(words in fault for fault in recovery.faults), recovery.faults
