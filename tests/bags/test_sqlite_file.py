"""sqlite3 files: what Python's library reads of them, and what it finds damaged."""

import sqlite3
from contextlib import closing

import pytest

from knee_contact_ros.bags.arrival import by_arrival
from knee_contact_ros.bags.sqlite_file import SqliteFile
from knee_contact_ros.system.errors import UsageError
from studies.fuzz_bags.bags import messages, sqlite

WRITTEN = list(messages())


@pytest.fixture
def database(tmp_path):
    sqlite(tmp_path / "bag")
    return tmp_path / "bag" / "bag.db3"


def rows(file):
    numbers = {number: number for number in file.channels}
    return [row for batch in by_arrival([file], [numbers]) for row in batch]


def read(path):
    with closing(SqliteFile(path)) as file:
        found = [(file.channels[topic].topic, time, data) for topic, time, data in rows(file)]
        assert file.message_counts.total() == len(found)
        return found, file.faults


def test_a_file_cut_off_anywhere_is_refused(database):
    content = database.read_bytes()
    for size in range(len(content) - 1, 0, -3001):
        database.write_bytes(content[:size])
        with pytest.raises(UsageError, match="is not a sqlite3 bag, or it is damaged"):
            read(database)


def test_messages_that_are_no_table_are_not_computed(database):
    with closing(sqlite3.connect(database)) as connection, connection:
        connection.execute("ALTER TABLE messages RENAME TO others")
        endless = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT i, 1, i, x'00' FROM n"
        connection.execute(f"CREATE VIEW messages (id, topic_id, timestamp, data) AS {endless}")
    with pytest.raises(UsageError, match="cannot be read as a table"):
        read(database)


def test_messages_in_a_log_beside_are_not_forgotten(database):
    database.with_name("bag.db3-wal").write_bytes(b"something")
    assert "bag.db3-wal holds messages that were never merged" in read(database)[1][0]


@pytest.mark.parametrize(
    ("statement", "missing", "fault"),
    [
        (
            "UPDATE messages SET topic_id = 7 WHERE id = 5",
            1,
            "1 messages are of topics that nothing declares",
        ),
        (
            "INSERT INTO messages (topic_id, timestamp, data) VALUES (1, 5, 'text'), (1, 'noon', x'00')",
            0,
            "2 rows are no messages",
        ),
    ],
)
def test_rows_that_give_no_message_are_counted(database, statement, missing, fault):
    with closing(sqlite3.connect(database)) as connection, connection:
        connection.execute(statement)
    found, faults = read(database)
    assert (len(found), set(found) <= set(WRITTEN), faults) == (
        len(WRITTEN) - missing,
        True,
        [fault],
    )
