"""Damaged MCAP files: what is read is what was written, and what is missing is said."""

from contextlib import closing, nullcontext

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from knee_contact_ros.bags.arrival import by_arrival
from knee_contact_ros.bags.mcap_file import MAX_RECORDS, McapFile
from knee_contact_ros.system.errors import UsageError
from studies.fuzz_bags.bags import TICKS, mcap, messages
from tests.hostile.bags import channel, chunk, message, record, schema, whole, zstd_of_zeros

FORMS = {
    "plain": lambda path: mcap(path, CompressionType.NONE),
    "zstd": lambda path: mcap(path, CompressionType.ZSTD),
    "lz4": lambda path: mcap(path, CompressionType.LZ4),
    "no checksums": lambda path: mcap(path, CompressionType.NONE, checksums=False),
    "no chunks": lambda path: mcap(path, CompressionType.NONE, chunks=False),
}
WRITTEN, STATE = list(messages()), "sensor_msgs/msg/JointState"


def made(tmp_path, form):
    path = tmp_path / "bag.mcap"
    FORMS[form](path)
    return path


def read(path):
    """Messages by time, and faults."""
    with closing(McapFile(path)) as file:
        numbers = {number: number for number in file.declared}
        found = [row for batch in by_arrival([file], [numbers]) for row in batch]
        topics = {number: channel.topic for number, (channel, _) in file.declared.items()}
        assert file.message_counts.total() == len(found)
        return [(topics[number], time, data) for number, time, data in found], file.faults


def chunks(path):
    """Offsets and lengths of the chunks, by the file's own index."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    return sorted(
        (index.chunk_start_offset, index.chunk_length) for index in summary.chunk_indexes
    )


def change(path, offset, data):
    content = bytearray(path.read_bytes())
    content[offset : offset + len(data)] = data
    path.write_bytes(content)


@pytest.mark.parametrize("form", FORMS)
def test_of_a_file_cut_off_anywhere_the_beginning_is_read(tmp_path, form):
    path = made(tmp_path, form)
    whole, most = path.read_bytes(), 0
    for size in range(len(whole) - 1, 8, -211):
        path.write_bytes(whole[:size])
        found, faults = read(path)
        assert found == WRITTEN[: len(found)]
        assert faults[0] == "the end is missing: the recording was cut off"
        most = max(most, len(found))
    assert most == 2 * TICKS  # cut off in the summary


@pytest.mark.parametrize(
    "compression", [CompressionType.ZSTD, CompressionType.LZ4, CompressionType.NONE]
)
def test_the_beginning_of_a_chunk_that_is_cut_off_is_read(tmp_path, compression):
    path, random = tmp_path / "bag.mcap", np.random.default_rng(0)
    payloads = [random.bytes(1000) for _ in range(1000)]
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=10**7, compression=compression)
        writer.start()
        channel = writer.register_channel("/noise", "", 0)
        for time, payload in enumerate(payloads):
            writer.add_message(channel, time, payload, time)
        writer.finish()
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    found, faults = read(path)
    assert 300 < len(found) < 510  # the file has an index, too; zstd gives blocks of 128 KiB
    assert [data for _, _, data in found] == payloads[: len(found)]
    assert f"is cut off; {len(found)} of its messages are read" in faults[1]


def test_damage_without_checksums(tmp_path):
    path = made(tmp_path, "no checksums")
    payload = path.read_bytes().index(WRITTEN[50][2])
    change(path, payload - 10, b"\x01")  # of its log time
    assert any("has other times than its messages" in fault for fault in read(path)[1])
    path = made(tmp_path, "no checksums")
    change(path, path.read_bytes().index(b"sensor_msgs"), b"\xff")
    assert "a topic's or a type's declaration cannot be read" in read(path)[1]


def test_channels_come_from_a_damaged_chunk_if_nothing_else_has_them(tmp_path):
    path = made(tmp_path, "plain")
    (offset, length), (last, last_length) = chunks(path)[0], chunks(path)[-1]
    change(path, offset + length - 20, b"\xff\xff")  # in a payload
    path.write_bytes(path.read_bytes()[: last + last_length])
    found, faults = read(path)
    assert found == WRITTEN[-len(found) :]
    assert "only a damaged chunk declares /joint_reaction_force, /joint_states" in faults


@pytest.mark.parametrize("seed", range(5))
def test_overlapping_chunks_are_read_by_time(tmp_path, seed):
    dice, path, chunks = np.random.default_rng(seed), tmp_path / "bag.mcap", []
    times = [sorted(dice.integers(0, 200, dice.integers(1, 9)).tolist()) for _ in range(100)]
    times[seed] = list(range(300))
    for number, part in enumerate(
        times, start=1
    ):  # each of another publisher: time goes back for none of them
        data = b"".join(message(number, b"", time) for time in part)
        chunks.append(chunk(data, len(data), "", part[0], part[-1]))
    channels = (channel(number, "/a") for number in range(1, len(times) + 1))
    path.write_bytes(whole(schema(1, "a/msg/B", b""), *channels, *chunks))
    assert [time for _, time, _ in read(path)[0]] == sorted(
        time for part in times for time in part
    )


@pytest.mark.parametrize("pause", [25, 500])
def test_a_clock_that_is_set_back_between_bursts_leaves_the_order_of_arrival(tmp_path, pause):
    times = np.cumsum(
        np.where(np.arange(500) % 5 == 0, pause, 1)
    )  # five messages at a time, as over a radio
    times[300:] -= times[300] - times[150] + 10
    path, data = tmp_path / "bag.mcap", b"".join(message(1, b"", time) for time in times.tolist())
    path.write_bytes(
        whole(schema(1, "a/msg/B", b""), channel(1, "/a"), chunk(data, len(data), "", 0, 10**6))
    )
    assert [time for _, time, _ in read(path)[0]] == times.tolist()


def test_too_large_chunks_are_left_out(tmp_path):
    path = tmp_path / "bag.mcap"
    for content, words in (
        (whole(chunk(zstd_of_zeros(1024), 2**28)), "more than 200 times the file"),
        (
            whole(chunk(record(0x80, b"") * (MAX_RECORDS + 1), 9 * (MAX_RECORDS + 1), "")),
            f"{MAX_RECORDS} records",
        ),
    ):
        path.write_bytes(content)
        with closing(McapFile(path)) as file:
            assert any(words in fault for fault in file.faults)


def test_memory_of_overlapping_chunks_is_limited(tmp_path, monkeypatch):
    monkeypatch.setattr("knee_contact_ros.bags.arrival.MAX_BYTES_IN_MEMORY", 2**20)
    path, topics = tmp_path / "bag.mcap", schema(1, STATE, b"") + channel(1, "/joint_states")
    for last, refused in ((0, False), (300, True)):
        parts = []
        for number in range(300):
            data = message(1, bytes(2**12), number) + message(1, bytes(2**12), number + last)
            parts.append(chunk(data, len(data), "", number, number + last))
        path.write_bytes(whole(topics, *parts))
        with closing(McapFile(path)) as file:
            batches = by_arrival([file], [{1: 0}])
            with (
                pytest.raises(UsageError, match="its chunks overlap") if refused else nullcontext()
            ):
                assert sum(map(len, batches)) == 600
