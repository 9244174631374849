"""Opens a bag: the ordinary way if it is whole, and else around what is damaged."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from resource import RLIMIT_NOFILE, getrlimit, setrlimit
from typing import NamedTuple, Protocol

from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinition, MessageDefinitionFormat

from knee_contact_ros.bags.mcap_reader import open_reader
from knee_contact_ros.bags.recovery.folder_metadata import Declared
from knee_contact_ros.bags.recovery.inspection import Inspection, declarations, inspect
from knee_contact_ros.bags.recovery.mcap_file import McapFile
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.printable import printable

MOST_AT_ONCE = 2**28
"""[B] of chunks that are unpacked at a time"""
MOST_SAID = 3
"""Faults that are told in a line"""


class Reader(Protocol):
    """What is asked of a bag's reader; that of `rosbags` is one."""

    connections: list[Connection]

    @property
    def end_time(self) -> int:
        """Log time [ns] behind the last message."""

    def messages(
        self, connections: Collection[Connection], start: int | None = None, stop: int | None = None
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """Messages in the order of log time [ns], from `start` to before `stop`."""

    def close(self) -> None:
        """Close the bag."""


class Opened(NamedTuple):
    """An open bag."""

    reader: Reader
    damage: list[str]
    """What is wrong with it, as sentences; empty if it is whole"""


class SalvageReader:
    """Reads what can be read of a bag."""

    def __init__(self, found: Inspection) -> None:
        self._found = found
        counts = found.counts()
        declared: dict[str, Declared] = {}
        for file in found.files:
            for number, topic in declarations(file).items():
                if file.counts[number] or topic.topic not in declared:
                    declared.setdefault(topic.topic, topic)
        self.connections = [
            self._connection(number, topic, counts[topic.topic])
            for number, topic in enumerate(declared.values(), start=1)
        ]

    @property
    def end_time(self) -> int:
        """See `Reader`; looks through all messages."""
        return 1 + max((log_time for _, log_time, _ in self.messages(self.connections)), default=0)

    def messages(
        self, connections: Collection[Connection], start: int | None = None, stop: int | None = None
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """See `Reader`; one file after another."""
        wanted = {(c.topic, c.msgtype): c for c in connections}
        for file in self._found.files:
            numbers = {
                number: wanted[topic.topic, topic.type]
                for number, topic in declarations(file).items()
                if (topic.topic, topic.type) in wanted
            }
            for message in file.by_time(numbers):
                time = message.log_time
                if (start is not None and time < start) or (stop is not None and time >= stop):
                    continue
                yield numbers[message.channel], message.log_time, message.data

    def close(self) -> None:
        """Close the bag."""
        self._found.close()

    def _connection(self, number: int, declared: Declared, count: int) -> Connection:
        kind = MessageDefinitionFormat.MSG if declared.definition else MessageDefinitionFormat.NONE
        definition = MessageDefinition(kind, declared.definition)
        extension = ConnectionExtRosbag2(declared.encoding, [])
        return Connection(number, declared.topic, declared.type, definition, "", count, extension, self)


def open_bag(path: Path) -> Opened:
    """Open a bag.

    Raises:
        UsageError: nothing of it can be read.
    """
    try:
        _allow_many_files(path)
        found = inspect(path)
    except OSError as error:
        raise UsageError(f"cannot read bag {path}: {error.strerror}") from None
    if found is None:
        return Opened(_ordinary(path), [])
    try:
        _bounded(path, found)
    except UsageError:
        found.close()
        raise
    if not found.faults:
        try:
            reader = _ordinary(path)
        except UsageError as refused:
            found.faults.append(str(refused))
        else:
            found.close()
            return Opened(reader, [])
    try:
        return _salvaged(path, found)
    except UsageError:
        found.close()
        raise


def _allow_many_files(path: Path) -> None:
    """Have as many files open as a folder's may be, twice; a shell's limit is 1024, and may be raised by anybody."""
    soft, hard = getrlimit(RLIMIT_NOFILE)
    if path.is_dir() and 2 * sum(1 for _ in path.iterdir()) > soft // 2 and soft != hard:
        setrlimit(RLIMIT_NOFILE, (hard, hard))


def _bounded(path: Path, found: Inspection) -> None:
    """Refuse what would take more memory than any recording."""
    most = max((file.at_once for file in found.files if isinstance(file, McapFile)), default=0)
    if most > MOST_AT_ONCE:
        raise UsageError(
            f"bag {path}: its chunks lie over each other in time, so that {most} bytes would be unpacked at once; "
            f"at most {MOST_AT_ONCE} are"
        )


def _salvaged(path: Path, found: Inspection) -> Opened:
    faults = in_a_line(found.faults)
    if found.compressed:
        raise UsageError(f"bag {path} is damaged ({faults}), and rosbag2 has compressed its messages one by one")
    if not found.counts().total():
        raise UsageError(f"cannot read bag {path}: no message can be read of it; {faults}")
    return Opened(SalvageReader(found), found.faults)


def in_a_line(faults: Sequence[str]) -> str:
    """The first faults, and how many more there are."""
    more = len(faults) - MOST_SAID
    return printable("; ".join(faults[:MOST_SAID])) + (f"; and {more} more" if more > 0 else "")


def _ordinary(path: Path) -> Reader:
    try:
        reader: Reader = open_reader(path)
    except Exception as error:  # whatever a broken file provokes in the reader
        raise UsageError(f"cannot read bag {path}: {' '.join(str(error).split()) or type(error).__name__}") from None
    return reader
