"""A sqlite3 file of a rosbag2 recording, read row by row around the pages that are damaged or missing."""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote

import apsw
import numpy as np

from knee_contact_ros.bags.recovery.chunks import Message
from knee_contact_ros.bags.recovery.whole_pages import NAME

READ_ONLY = apsw.SQLITE_OPEN_READONLY | apsw.SQLITE_OPEN_URI
FIELDS = ((16, 2), (24, 4), (28, 4), (92, 4))
"""Where in the header, and how long: size of a page, number of the last change, pages, change for which they count"""
UNREADABLE = (apsw.Error, UnicodeDecodeError)
"""What damaged pages, and damaged texts on them, provoke"""
LONGEST_FAULT = 120
"""Characters of what sqlite says"""


class Topic(NamedTuple):
    """A row of the table of topics."""

    name: str
    type: str
    encoding: str
    qos: str
    digest: str


class SqliteFile:
    """What can be read of a sqlite3 file, and what is wrong with it."""

    def __init__(self, path: Path) -> None:
        """Check the whole file, and read it if it does not pass.

        Raises:
            OSError: it cannot be read.
        """
        self.path = path
        self.size = path.stat().st_size
        self.topics: dict[int, Topic] = {}
        self.counts: Counter[int] = Counter()
        """Messages by topic"""
        self.faults: list[str] = []
        self._rows: _Rows | None = None
        log = path.with_name(path.name + "-wal")
        if log.exists() and log.stat().st_size:
            self.faults.append(f"{log.name} holds messages that were never merged: open the bag once with sqlite3")
        self._database: apsw.Connection | None = None
        try:
            self._database = _opened(path)
        except UNREADABLE as error:
            self.faults.append(f"no database: {_said(error)}")
            return
        self._read(self._database)

    def by_time(self, topics: Collection[int]) -> Iterator[Message]:
        """The messages of some topics in the order of their times; equal ones in the order of rows."""
        if self._database is None:
            return
        for number in self._walked(self._database).by_time():
            try:
                row = self._database.execute(ONE_ROW, (number,)).fetchone()
            except UNREADABLE:
                continue  # it could be read before: somebody is at the file
            if row and row[0] in topics:
                yield Message(row[0], 0, row[1], row[1], bytes(row[2]))

    def close(self) -> None:
        """Close the file."""
        if self._database is not None:
            self._database.close()

    def _read(self, database: apsw.Connection) -> None:
        fault = _integrity(database)
        if missing := _missing_bytes(self.path):
            self.faults.append(f"it is cut off: its last {missing} bytes are missing")
        if fault:
            self.faults.append(f"sqlite finds it damaged: {fault}")
        try:
            self.topics, strange = _topics(database)
            self.faults += [f"topic {number} has a name or type that is no text" for number in strange]
            if not fault and (others := _strange_rows(database)):
                self.faults.append(fault := f"{others} rows are no messages")
            self.counts.update(self._walked(database).topics if fault else _counts(database))
        except UNREADABLE as error:
            self.faults.append(f"the tables are not those of rosbag2, or cannot be read: {_said(error)}")
        for number in [number for number in self.counts if number not in self.topics]:
            self.faults.append(f"{self.counts.pop(number)} messages are of topic {number}, which nothing declares")

    def _walked(self, database: apsw.Connection) -> _Rows:
        """All rows that can be read."""
        if self._rows is None:
            self._rows = _Rows()
            for topic, time, number in _walk(database, self.size):
                self._rows.add(topic, time, number)
        return self._rows


KINDS = "typeof(topic_id) = 'integer' AND typeof(timestamp) = 'integer' AND typeof(data) = 'blob'"
"""Of what a row of a message has"""
STRANGE_ROWS = f"SELECT count(*) FROM messages WHERE NOT ({KINDS})"  # noqa: S608
ROWS = (
    f"SELECT topic_id, timestamp, id FROM messages NOT INDEXED WHERE id >= ? AND {KINDS} "  # noqa: S608
    "AND substr(data, length(data), 1) IS NOT NULL ORDER BY id"  # reads a long message to its end
)
ONE_ROW = "SELECT topic_id, timestamp, data FROM messages NOT INDEXED WHERE id = ?"


class _Rows:
    """Times and numbers of rows, 16 bytes each."""

    def __init__(self) -> None:
        self.topics: Counter[int] = Counter()
        self._times, self._numbers = array("q"), array("q")

    def add(self, topic: int, time: int, number: int) -> None:
        self.topics[topic] += 1
        self._times.append(time)
        self._numbers.append(number)

    def by_time(self) -> Iterator[int]:
        """Numbers in the order of times."""
        if self._times:
            yield from np.array(self._numbers)[np.argsort(np.array(self._times), kind="stable")].tolist()


def _opened(path: Path) -> apsw.Connection:
    address = f"file:{quote(str(path))}?immutable=1"
    database = apsw.Connection(address, flags=READ_ONLY, vfs=NAME if _missing_bytes(path) else None)
    database.execute("PRAGMA writable_schema = ON")  # else sqlite refuses a file that is shorter than it says
    database.execute("SELECT count(*) FROM sqlite_master").fetchall()
    return database


def _missing_bytes(path: Path) -> int:
    """How much shorter the file is than its header says: sqlite reads zeros there."""
    with path.open("rb") as file:
        head = file.read(100)
    page, changes, pages, valid_for = (int.from_bytes(head[at : at + n], "big") for at, n in FIELDS)
    return max(pages * (page if page > 1 else 65536) - path.stat().st_size, 0) if changes == valid_for else 0


def _integrity(database: apsw.Connection) -> str:
    try:
        found = database.execute("PRAGMA integrity_check(1)").fetchone()
    except UNREADABLE as error:
        return _said(error)
    return "" if found and found[0] == "ok" else " ".join(str(found and found[0]).split())[:LONGEST_FAULT]


def _topics(database: apsw.Connection) -> tuple[dict[int, Topic], list[int]]:
    """By number; and the numbers of those that are left out, for they are not made of texts."""
    columns = {row[1] for row in database.execute("PRAGMA table_info(topics)")}
    qos = "offered_qos_profiles" if "offered_qos_profiles" in columns else "''"
    digest = "type_description_hash" if "type_description_hash" in columns else "''"
    rows = database.execute(f"SELECT id, name, type, serialization_format, {qos}, {digest} FROM topics")  # noqa: S608
    found = {int(number): rest for number, *rest in rows}
    strange = [number for number, rest in found.items() if not all(isinstance(value, str) for value in rest[:3])]
    return {number: Topic(*map(str, rest)) for number, rest in found.items() if number not in strange}, strange


def _strange_rows(database: apsw.Connection) -> int:
    """How many rows are no messages."""
    row = database.execute(STRANGE_ROWS).fetchone()
    return int(row[0]) if row else 0


def _counts(database: apsw.Connection) -> dict[int, int]:
    rows = database.execute("SELECT topic_id, count(*) FROM messages GROUP BY topic_id").fetchall()
    return {topic: count for topic, count in rows if isinstance(topic, int) and isinstance(count, int)}


def _walk(database: apsw.Connection, most: int) -> Iterator[tuple[int, int, int]]:
    """Topic, time [ns] and number of every row that can be read; numbers go up to `most`."""
    number = 0
    while number <= most:
        try:
            for topic, time, row in database.execute(ROWS, (number,)):
                if row >= number:  # a damaged tree may lead to the same rows twice
                    yield topic, time, row
                    number = row + 1
        except UNREADABLE:
            number = _next_readable(database, number + 1, most)
            continue
        return


def _next_readable(database: apsw.Connection, begin: int, most: int) -> int:
    """The first row from `begin` on that can be read behind rows that cannot; beyond `most` if there is none."""
    bad, step = begin - 1, 1
    while not _readable(database, bad + step):
        bad, step = bad + step, 2 * step
        if bad > most:
            return most + 1
    good = bad + step
    while good - bad > 1:
        middle = (good + bad) // 2
        if _readable(database, middle):
            good = middle
        else:
            bad = middle
    return good


def _readable(database: apsw.Connection, number: int) -> bool:
    """Whether reading can go on from a row on."""
    try:
        database.execute(f"{ROWS} LIMIT 1", (number,)).fetchone()
    except UNREADABLE:
        return False
    return True


def _said(error: Exception) -> str:
    return " ".join(str(error).split())[:LONGEST_FAULT]
