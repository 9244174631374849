"""The messages of a sqlite3 file of a rosbag2 recording, and its faults; the format has no checksums."""

import sqlite3
from collections import Counter
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ..streams.columns import Column
from ..streams.topics import NO_DEFINITION
from ..system.errors import UsageError
from .bag_file import BagFile, Batch, Channel, Chunk
from .mcap_file import definition_of

CHUNK_ROWS = 1024
"""Number of rows that are read together"""
LONGEST_REASON = 120
"""Largest number of characters of an error of sqlite3 that are shown"""
MESSAGE_ROWS = (
    "FROM messages WHERE typeof(topic_id) = 'integer' AND typeof(timestamp) = 'integer' "
    "AND typeof(data) = 'blob'"
)
"""Rows that are messages"""
SELECT_DEFINITIONS = (
    "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
)


class SqliteFile(BagFile):
    """Checked sqlite3 file."""

    def __init__(self, path: Path) -> None:
        """Open the file and check all of it.

        Raises:
            UsageError: The file is damaged, or not a bag.
        """
        super().__init__(path)
        log = path.with_name(f"{path.name}-wal")
        if log.exists() and log.stat().st_size:
            self.faults.append(
                f"{log.name} holds messages that were never merged: open the bag once with sqlite3"
            )
        address = f"{path.absolute().as_uri()}?mode=ro&immutable=1"
        self._database = sqlite3.connect(address, uri=True)
        self.close = self._database.close
        try:
            tables = self._checked_tables()
            self._find_chunks()
            self._find_channels("message_definitions" in tables)
        except (sqlite3.Error, ValueError, TypeError, OverflowError) as error:
            self.close()
            reason = " ".join(str(error).split())[:LONGEST_REASON]
            advice = "; ".join(self.faults) or (
                "try to get its messages into another one with sqlite3's own `.recover`"
            )
            raise UsageError(
                f"{path} is not a sqlite3 bag, or it is damaged ({reason}): {advice}"
            ) from None

    def read_chunk(self, chunk: Chunk, numbers: Mapping[int, int]) -> Batch:
        """Read the messages of a chunk; see `BagFile.read_chunk`."""
        query = (
            f"SELECT topic_id, timestamp, data {MESSAGE_ROWS} AND id BETWEEN ? AND ? ORDER BY id"
        )
        rows = self._database.execute(query, (chunk.offset, chunk.end))
        selected = [(numbers[topic], time, data) for topic, time, data in rows if topic in numbers]
        topics, times, messages = zip(*selected, strict=True) if selected else ((), (), ())
        log_times = np.array(times, np.int64 if min(times, default=0) < 0 else np.uint64)
        return Batch(np.array(topics, np.intp), log_times, Column.of(messages))

    def _value(self, query: str) -> Any:
        return self._database.execute(query).fetchone()[0]

    def _checked_tables(self) -> dict[str, str]:
        """Check the file; return the kinds of its tables and views by their names."""
        if (integrity := self._value("PRAGMA integrity_check(1)")) != "ok":
            raise ValueError(integrity)
        size = self._value("PRAGMA page_count") * self._value("PRAGMA page_size")
        if size > self.path.stat().st_size:
            # sqlite3 takes what is missing of the last page for zeros.
            raise ValueError("it is cut off")
        kinds = dict(self._database.execute("SELECT name, type FROM sqlite_master").fetchall())
        for name in ("topics", "messages", "message_definitions"):
            if kinds.get(name, "table") != "table":
                # A view may take forever to read.
                raise ValueError("its messages or topics cannot be read as a table")
        return kinds

    def _find_chunks(self) -> None:
        """Find the rows that are messages."""
        rows = self._database.execute(f"SELECT id, topic_id, timestamp {MESSAGE_ROWS} ORDER BY id")
        last = 0
        while part := rows.fetchmany(CHUNK_ROWS):
            ids, topics, times = zip(*part, strict=True)
            span = min(times), max(times)
            self.chunks.append(
                Chunk(ids[0], ids[-1], ids[0], 0, times=span, counts=Counter(topics))
            )
            self.goes_back |= any(later < earlier for earlier, later in pairwise((last, *times)))
            last = times[-1]

    def _find_channels(self, has_definitions: bool) -> None:
        """Find the topics, with their definitions if the file has any."""
        found = self._database.execute(SELECT_DEFINITIONS) if has_definitions else ()
        definitions = {
            str(name): definition_of(str(encoding), str(text).encode())
            for name, encoding, text in found
        }
        query = "SELECT id, name, type, serialization_format FROM topics"
        for number, *texts in self._database.execute(query):
            topic, kind, encoding = map(str, texts)
            definition = definitions.get(kind, NO_DEFINITION)
            self.channels[int(number)] = Channel(topic, kind, encoding, definition)
        every = self._value("SELECT count(*) FROM messages")
        usable = self.note_undeclared()
        if every > usable:
            self.faults.append(f"{every - usable} rows are no messages")
