"""What a file says of the recording that it goes on with."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest

from knee_contact_ros.bags.mcap_metadata import LARGEST, goes_on_with
from knee_contact_ros.bags.writer import CONTINUED
from tests.hostile.bags import HEADER, MAGIC, METADATA, pairs, record, text


def continued(first: str, name: str = CONTINUED) -> bytes:
    return record(METADATA, text(name) + pairs([("first", first)]))


@pytest.mark.parametrize(
    ("content", "first"),
    [
        (MAGIC + record(HEADER, text("ros2") * 2) + continued("knee.mcap"), "knee.mcap"),
        (MAGIC + record(HEADER, text("ros2") * 2) + continued("knee.mcap", "note"), ""),
        (MAGIC + continued("x" * LARGEST), ""),
        (MAGIC + continued("knee.mcap")[:-1], ""),
        (MAGIC + struct.pack("<BQ", HEADER, 2**64 - 1), ""),
        (MAGIC, ""),
        (b"", ""),
    ],
)
def test_only_a_whole_record_at_the_beginning_counts(tmp_path: Path, content: bytes, first: str) -> None:
    path = tmp_path / "knee_1.mcap"
    path.write_bytes(content)
    assert goes_on_with(path) == first
    assert not goes_on_with(tmp_path)
