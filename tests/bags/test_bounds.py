"""What a file may claim: it is read in proportion to its size, and holds no more than makes sense."""

from __future__ import annotations

import struct
from contextlib import closing
from io import BytesIO
from pathlib import Path

import pytest
import zstandard

from knee_contact_ros.bags.bag_files import MOST_AT_ONCE
from knee_contact_ros.bags.mcap_chunks import LARGEST_CHUNK, Chunk, DamagedError, unpack
from knee_contact_ros.bags.mcap_file import McapFile
from knee_contact_ros.bags.mcap_inspection import MOST_RECORDS
from knee_contact_ros.bags.mcap_layout import HEAD, MAGIC
from knee_contact_ros.bags.mcap_records import BLOCK, read_records
from knee_contact_ros.bags.stored_bag import StoredBag
from knee_contact_ros.system.errors import UsageError
from tests.hostile.bags import channel, chunk, message, record, schema, whole, zstd_of_zeros


class Counting(BytesIO):
    """Counts the bytes that are read of it."""

    total = 0

    def read(self, size: int | None = -1, /) -> bytes:
        data = super().read(size)
        self.total += len(data)
        return data


@pytest.mark.parametrize("opcode", [5, 6, 7, 9, 12, 15])
def test_what_only_looks_like_records_is_not_read(opcode: int) -> None:
    """Each of them claims all that follows."""
    count = 60_000
    heads = b"".join(struct.pack("<BQ", opcode, HEAD.size * (left - 1)) for left in range(count, 0, -1))
    content = MAGIC + b"\xff" + heads + b"\xff" * 9
    file = Counting(content)
    assert sum(1 for _ in read_records(file, len(content))) < 10
    assert file.total < 10 * len(content) + 2 * BLOCK


def test_a_chunk_holds_so_much_at_most(tmp_path: Path) -> None:
    with pytest.raises(DamagedError, match="claims to hold"):
        unpack(Chunk(0, 0, LARGEST_CHUNK + 1, 0, "zstd", b""))
    path = tmp_path / "bag.mcap"
    for content, words in (
        (whole(chunk(zstd_of_zeros(1024), 2**28)), "more than 200 times the file"),
        (whole(chunk(record(0x80, b"") * (MOST_RECORDS + 1), 9 * (MOST_RECORDS + 1), "")), f"{MOST_RECORDS} records"),
    ):
        path.write_bytes(content)
        with closing(McapFile(path)) as file:
            assert any(words in fault for fault in file.faults)


def test_nothing_is_hidden_behind_the_end_of_a_chunk() -> None:
    """Others would unpack it."""
    data = zstandard.compress(b"good")
    assert unpack(Chunk(0, 0, 4, 0, "zstd", data)) == b"good"
    with pytest.raises(DamagedError, match="does not decompress"):
        unpack(Chunk(0, 0, 4, 0, "zstd", data + zstd_of_zeros(1)))


def test_chunks_over_each_other_are_not_unpacked_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With a sixteenth of what is allowed, and in chunks of a sixteenth of the size that is usual."""
    most = MOST_AT_ONCE // 16
    monkeypatch.setattr("knee_contact_ros.bags.bag_files.MOST_AT_ONCE", most)
    padding = record(0x80, bytes(2**16))
    path, topics = tmp_path / "bag.mcap", schema(1, "sensor_msgs/msg/JointState", b"") + channel(1, "/joint_states")
    names = {}
    for last in (0, 300):
        chunks = []
        for number in range(300):
            data = message(1, b"", number) + padding + message(1, b"", number + last)
            chunks.append(chunk(data, len(data), "", number, number + last))
        path.write_bytes(whole(topics, *chunks))
        with closing(McapFile(path)) as file:
            names[last] = file.at_once
    assert names[0] < 2**17 < most < names[300]
    with pytest.raises(UsageError, match="its chunks lie over each other in time"):
        StoredBag(path)
