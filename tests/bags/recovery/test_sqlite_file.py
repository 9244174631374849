"""Damaged sqlite3 files: rows around damaged pages are read."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from knee_contact_ros.bags.recovery.sqlite_file import SqliteFile
from studies.fuzz_bags.bags import Message, messages, sqlite

WRITTEN = list(messages())
PAGE = 4096


@pytest.fixture
def database(tmp_path: Path) -> Path:
    sqlite(tmp_path / "bag")
    return tmp_path / "bag" / "bag.db3"


def read(path: Path) -> tuple[list[Message], list[str]]:
    with closing(SqliteFile(path)) as file:
        found = [(file.topics[m.channel].name, m.log_time, m.data) for m in file.by_time(file.topics)]
        assert file.counts.total() == len(found)
        return found, file.faults


def leaves(path: Path) -> list[int]:
    """Pages that hold messages, by a look for their frame."""
    content = path.read_bytes()
    return [page for page in range(len(content) // PAGE) if content[page * PAGE :][:PAGE].count(b"tibia_r") > 5]


def test_a_whole_file_has_no_faults(database: Path) -> None:
    assert read(database) == (WRITTEN, [])


def test_rows_around_a_lost_page_are_read(database: Path) -> None:
    content, page = bytearray(database.read_bytes()), leaves(database)[2]
    content[page * PAGE : (page + 1) * PAGE] = bytes(PAGE)
    database.write_bytes(content)
    found, faults = read(database)
    assert len(WRITTEN) - 60 < len(found) < len(WRITTEN)  # a page holds some fifty rows
    assert found == [message for message in WRITTEN if message in found]
    assert {WRITTEN[0], WRITTEN[-1]} <= set(found)
    assert faults[0].startswith("sqlite finds it damaged: ")


def test_of_a_file_cut_off_anywhere_the_rest_is_read(database: Path) -> None:
    content = database.read_bytes()
    most = 0
    for size in range(len(content) - 1, 512, -3001):
        database.write_bytes(content[:size])
        found, faults = read(database)
        assert found == [message for message in WRITTEN if message in found]
        assert faults
        most = max(most, len(found))
    assert most > len(WRITTEN) // 2


def test_messages_in_a_log_beside_are_not_forgotten(database: Path) -> None:
    database.with_name("bag.db3-wal").write_bytes(b"something")
    assert "bag.db3-wal holds messages that were never merged" in read(database)[1][0]


def test_messages_of_unknown_topics_are_counted(database: Path) -> None:
    with closing(sqlite3.connect(database)) as connection, connection:
        connection.execute("UPDATE messages SET topic_id = 7 WHERE id = 5")
    found, faults = read(database)
    assert len(found) == len(WRITTEN) - 1
    assert faults == ["1 messages are of topic 7, which nothing declares"]


def test_texts_that_are_none_are_a_fault(database: Path) -> None:
    with closing(sqlite3.connect(database)) as connection, connection:
        connection.execute("UPDATE topics SET name = CAST(x'ff' AS TEXT) WHERE id = 1")
    found, faults = read(database)
    assert found == []
    assert faults[0].startswith("the tables are not those of rosbag2, or cannot be read: ")


def test_rows_that_are_no_messages_are_left_out(database: Path) -> None:
    with closing(sqlite3.connect(database)) as connection:
        connection.execute("INSERT INTO messages (topic_id, timestamp, data) VALUES (1, 5, 'text'), (1, 'noon', x'00')")
        connection.commit()
    assert read(database) == (WRITTEN, ["2 rows are no messages"])


def test_a_topic_that_is_no_text_is_left_out(database: Path) -> None:
    with closing(sqlite3.connect(database)) as connection:
        connection.execute("UPDATE topics SET name = x'ff00' WHERE id = 1")
        connection.commit()
    found, faults = read(database)
    assert 0 < len(found) < len(WRITTEN)
    assert faults[0] == "topic 1 has a name or type that is no text"
