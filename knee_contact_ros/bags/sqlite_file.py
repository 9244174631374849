"""A sqlite3 file of a rosbag2 recording, as Python's own library reads it: no checksum covers it."""

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
from knee_contact_ros.messages.column import Column
from knee_contact_ros.system.errors import UsageError

TABLES = ("topics", "messages", "message_definitions")
KINDS = "typeof(topic_id) = 'integer' AND typeof(timestamp) = 'integer' AND typeof(data) = 'blob'"
"""Of what a row of a message has"""
COUNTS = f"SELECT topic_id, count(*) FROM messages WHERE {KINDS} GROUP BY topic_id"  # noqa: S608
OTHERS = f"SELECT count(*) FROM messages WHERE NOT ({KINDS})"  # noqa: S608
ROWS = f"SELECT topic_id, timestamp, data FROM messages WHERE {KINDS} ORDER BY timestamp, id"  # noqa: S608
DEFINITIONS = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
ROWS_AT_ONCE = 256
TIMES = f"SELECT min(timestamp), max(timestamp) FROM messages WHERE {KINDS}"  # noqa: S608


FIELDS = ((16, 2), (24, 4), (28, 4), (92, 4))
"""Where in the header, and how long: size of a page, number of the last change, pages, and at which change"""


class Topic(NamedTuple):
    """A row of the table of topics."""

    name: str
    type: str
    encoding: str


class SqliteFile:
    """The messages of a file, and what is odd about it."""

    def __init__(self, path: Path) -> None:
        """Check the whole file.

        Raises:
            UsageError: it is damaged.
        """
        self.path, self.size = path, path.stat().st_size
        self.faults: list[str] = []
        log = path.with_name(f"{path.name}-wal")
        if log.exists() and log.stat().st_size:
            self.faults.append(f"{log.name} holds messages that were never merged: open the bag once with sqlite3")
        address = f"file:{quote(os.fsencode(path.absolute()))}?mode=ro&immutable=1"
        self._database = sqlite3.connect(
            address, uri=True, check_same_thread=False
        )  # a replay reads ahead in another one
        try:
            found = self._database.execute("PRAGMA integrity_check(1)").fetchone()[0]
            if found != "ok" or _is_cut_off(path):  # which sqlite takes for zeros
                raise sqlite3.DatabaseError("it is cut off" if found == "ok" else found)
            kinds = dict(self._database.execute("SELECT name, type FROM sqlite_master").fetchall())
            if any(kinds.get(name, "table") != "table" for name in TABLES):  # a view may take for ever
                raise sqlite3.DatabaseError("its messages or topics are no table")
            self._read()
        except (sqlite3.Error, ValueError, TypeError, OverflowError) as error:
            self._database.close()
            said = " ".join(str(error).split())[:120]
            words = "try to get its messages into another one with sqlite3's own `.recover`"
            raise UsageError(f"{path} is no sqlite3 bag, or a damaged one ({said}): {words}") from None

    @property
    def times(self) -> tuple[int, int] | None:
        """Smallest and largest time [ns]."""
        first, last = self._database.execute(TIMES).fetchone()
        return None if first is None else (first, last)

    def by_time(self, numbers: Mapping[int, int]) -> Iterator[Batch]:
        """The messages of topics that have a number, under it, by time; equal times in the order of rows."""
        cursor = self._database.execute(ROWS)
        while rows := cursor.fetchmany(ROWS_AT_ONCE):
            found = [(numbers[topic], time, data) for topic, time, data in rows if topic in numbers]
            if found:
                numbers_of, times, messages = zip(*found, strict=True)
                yield Batch(np.array(numbers_of, np.intp), np.array(times, np.int64), Column.of(messages))

    def close(self) -> None:
        """Close the file."""
        self._database.close()

    def _read(self) -> None:
        rows = self._database.execute("SELECT id, name, type, serialization_format FROM topics")
        self.topics = {int(number): Topic(*map(str, texts)) for number, *texts in rows}
        """By number"""
        self.definitions: dict[str, tuple[str, str]] = {}
        """Encoding and text of the definition of a type, in files that hold them"""
        if self._database.execute("SELECT 1 FROM sqlite_master WHERE name = 'message_definitions'").fetchone():
            for type_name, encoding, text in self._database.execute(DEFINITIONS):
                self.definitions[str(type_name)] = str(encoding), str(text)
        self.counts = Counter(dict(self._database.execute(COUNTS).fetchall()))
        """Messages by topic"""
        if others := self._database.execute(OTHERS).fetchone()[0]:
            self.faults.append(f"{others} rows are no messages")
        for number in [number for number in self.counts if number not in self.topics]:
            self.faults.append(f"{self.counts.pop(number)} messages are of topic {number}, which nothing declares")


def _is_cut_off(path: Path) -> bool:
    """Whether a file is shorter than its header says."""
    with path.open("rb") as file:
        head = file.read(100)
    page, changes, pages, counted_at = (int.from_bytes(head[at : at + n], "big") for at, n in FIELDS)
    return changes == counted_at and pages * (page if page > 1 else 65536) > path.stat().st_size
