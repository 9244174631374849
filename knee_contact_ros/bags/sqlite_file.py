"""Reading of a sqlite3 file of a rosbag2 recording with Python's own library; the format has no checksums."""

from __future__ import annotations

import os
import sqlite3
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote

import numpy as np

from knee_contact_ros.bags.batch import Batch
from knee_contact_ros.streams.columns import Column
from knee_contact_ros.system.errors import UsageError

TABLES = ("topics", "messages", "message_definitions")
"""Names of the tables that are read"""
KINDS = "typeof(topic_id) = 'integer' AND typeof(timestamp) = 'integer' AND typeof(data) = 'blob'"
"""Condition for a valid row of a message"""
COUNTS = f"SELECT topic_id, count(*) FROM messages WHERE {KINDS} GROUP BY topic_id"  # noqa: S608
OTHERS = f"SELECT count(*) FROM messages WHERE NOT ({KINDS})"  # noqa: S608
ROWS = f"SELECT topic_id, timestamp, data FROM messages WHERE {KINDS} ORDER BY timestamp, id"  # noqa: S608
DEFINITIONS = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
ROWS_AT_ONCE = 256
"""Number of rows that are fetched at once"""
TIMES = f"SELECT min(timestamp), max(timestamp) FROM messages WHERE {KINDS}"  # noqa: S608
FIELDS = ((16, 2), (24, 4), (28, 4), (92, 4))
"""Offset and length [B] in the header of page size, change counter, number of pages, and the counter valid for that"""


class Topic(NamedTuple):
    """Row of the table of topics."""

    name: str
    """Name of the topic"""
    type: str
    """Type of the messages"""
    encoding: str
    """Serialization format of the messages"""


class SqliteFile:
    """Messages of a sqlite3 file, and its faults."""

    def __init__(self, path: Path) -> None:
        """Open the file and check all of it.

        Raises:
            UsageError: The file is damaged, or no bag.
        """
        self.path, self.size = path, path.stat().st_size
        self.faults: list[str] = []
        """Faults of the file, as sentences"""
        log = path.with_name(f"{path.name}-wal")
        if log.exists() and log.stat().st_size:
            self.faults.append(f"{log.name} holds messages that were never merged: open the bag once with sqlite3")
        address = f"file:{quote(os.fsencode(path.absolute()))}?mode=ro&immutable=1"
        # a replay reads ahead in another thread
        self._database = sqlite3.connect(address, uri=True, check_same_thread=False)
        try:
            integrity = self._database.execute("PRAGMA integrity_check(1)").fetchone()[0]
            if integrity != "ok" or _is_cut_off(path):  # sqlite takes missing pages for zeros
                raise sqlite3.DatabaseError("it is cut off" if integrity == "ok" else integrity)
            kinds = dict(self._database.execute("SELECT name, type FROM sqlite_master").fetchall())
            if any(kinds.get(name, "table") != "table" for name in TABLES):  # a view may take forever to read
                raise sqlite3.DatabaseError("its messages or topics are no table")
            self._read()
        except (sqlite3.Error, ValueError, TypeError, OverflowError) as error:
            self._database.close()
            reason = " ".join(str(error).split())[:120]
            advice = "try to get its messages into another one with sqlite3's own `.recover`"
            raise UsageError(f"{path} is no sqlite3 bag, or a damaged one ({reason}): {advice}") from None

    @property
    def times(self) -> tuple[int, int] | None:
        """Smallest and largest log time [ns]; None without messages."""
        first, last = self._database.execute(TIMES).fetchone()
        return None if first is None else (first, last)

    def by_time(self, numbers: Mapping[int, int]) -> Iterator[Batch]:
        """Messages in the order of log time, at equal times in that of the rows.

        Args:
            numbers: Number in the batches of each topic that is read, by its number in the file.
        """
        cursor = self._database.execute(ROWS)
        while rows := cursor.fetchmany(ROWS_AT_ONCE):
            selected = [(numbers[topic], time, data) for topic, time, data in rows if topic in numbers]
            if selected:
                topics, times, messages = zip(*selected, strict=True)
                yield Batch(np.array(topics, np.intp), np.array(times, np.int64), Column.of(messages))

    def close(self) -> None:
        """Close the file."""
        self._database.close()

    def _read(self) -> None:
        """Read topics, definitions and numbers of messages."""
        rows = self._database.execute("SELECT id, name, type, serialization_format FROM topics")
        self.topics = {int(number): Topic(*map(str, texts)) for number, *texts in rows}
        """Topics by their numbers"""
        self.definitions: dict[str, tuple[str, str]] = {}
        """Encoding and text of the definition of each type; empty if the file has no definitions"""
        if self._database.execute("SELECT 1 FROM sqlite_master WHERE name = 'message_definitions'").fetchone():
            for type_name, encoding, text in self._database.execute(DEFINITIONS):
                self.definitions[str(type_name)] = str(encoding), str(text)
        self.counts = Counter(dict(self._database.execute(COUNTS).fetchall()))
        """Number of messages of each topic, by the number of the topic"""
        if others := self._database.execute(OTHERS).fetchone()[0]:
            self.faults.append(f"{others} rows are no messages")
        for number in [number for number in self.counts if number not in self.topics]:
            self.faults.append(f"{self.counts.pop(number)} messages are of topic {number}, which nothing declares")


def _is_cut_off(path: Path) -> bool:
    """Whether a file is shorter than its header says."""
    with path.open("rb") as file:
        head = file.read(100)
    page_size, changes, pages, valid_for = (int.from_bytes(head[at : at + n], "big") for at, n in FIELDS)
    return changes == valid_for and pages * (page_size if page_size > 1 else 65536) > path.stat().st_size
