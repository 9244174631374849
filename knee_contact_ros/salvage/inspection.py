"""What the files of a bag hold, and whether they are whole: without trust in an index or in `metadata.yaml`."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from knee_contact_ros.errors import UsageError
from knee_contact_ros.salvage.folder_metadata import METADATA, Declared, contradictions, read_metadata
from knee_contact_ros.salvage.mcap_file import McapFile
from knee_contact_ros.salvage.records import MAGIC
from knee_contact_ros.salvage.scan import Advance
from knee_contact_ros.salvage.sqlite_file import SqliteFile

SQLITE_MAGIC = b"SQLite format 3\x00"
NUMBERED = re.compile(r"(.+)_(\d+)(\.mcap|\.db3)")
"""Name of a file in a rosbag2 folder"""


class Inspection(NamedTuple):
    """The files of a bag."""

    files: Sequence[McapFile | SqliteFile]
    faults: list[str]
    """What is wrong, as sentences; empty if the bag is whole"""
    compressed: str
    """How rosbag2 has compressed the whole: `file`, `message` or not at all"""

    def counts(self) -> Counter[str]:
        """Messages by topic."""
        counts = Counter[str]()
        for file in self.files:
            for number, declared in declarations(file).items():
                counts[declared.topic] += file.counts[number]
        return counts

    def close(self) -> None:
        """Close the files."""
        for file in self.files:
            file.close()


def declarations(file: McapFile | SqliteFile) -> dict[int, Declared]:
    """A file's topics by number."""
    if isinstance(file, SqliteFile):
        return {number: Declared(*topic) for number, topic in file.topics.items()}
    declared = {}
    for number, (channel, schema) in file.streams.items():
        qos = channel.metadata.get("offered_qos_profiles", "")
        text = schema.data.decode("utf-8", "replace") if schema and schema.encoding == "ros2msg" else ""
        type_name = schema.name if schema else ""
        declared[number] = Declared(channel.topic, type_name, channel.message_encoding, qos, definition=text)
    return declared


def inspect(path: Path) -> Inspection | None:
    """Look into all files of a bag; None if it is of a kind that this package leaves to others.

    Raises:
        UsageError: it is not clear which files are the bag's.
        OSError: a file cannot be read.
    """
    if not path.is_dir():
        file = open_file(path)
        return None if file is None else Inspection([file], list(file.faults), "")
    metadata, faults = read_metadata(path)
    if metadata and metadata.compressed == "file":
        return None
    names = metadata.files if metadata else []
    if not any((path / name).is_file() for name in names):
        faults += [f"{name} is missing" for name in names]
        names = guessed(path)
    files = []
    for name in names:
        file = open_file(path / name) if (path / name).is_file() else None
        if file is None:
            faults.append(f"{name} is missing" if not (path / name).exists() else f"{name} is no file of a bag")
            continue
        files.append(file)
        faults += [f"{name}: {fault}" for fault in file.faults]
    found = Inspection(files, faults, metadata.compressed if metadata else "")
    if metadata:
        faults += contradictions(metadata.topics, [(declarations(file), file.counts) for file in files])
    return found


def files_of(bag: Path) -> list[Path]:
    """A bag's files: itself, or those of its folder, in which other bags may lie as well.

    Raises:
        UsageError: it is not clear which files are the bag's.
    """
    if not bag.is_dir():
        return [bag]
    metadata, _ = read_metadata(bag)
    return [bag / name for name in (metadata.files if metadata else guessed(bag))]


def open_file(path: Path, advance: Advance = lambda _done, _total: None) -> McapFile | SqliteFile | None:
    """A file by its beginning, or else by its name; None if it is of another kind."""
    with path.open("rb") as file:
        beginning = file.read(len(SQLITE_MAGIC))
    if beginning.startswith(MAGIC):
        return McapFile(path, advance)
    if beginning == SQLITE_MAGIC or ".db3" in path.suffixes:
        return SqliteFile(path)
    return McapFile(path, advance) if ".mcap" in path.suffixes else None


def guessed(folder: Path) -> list[str]:
    """Names of the files, without `metadata.yaml`: the only one, or those that are numbered.

    Raises:
        UsageError: there are none, or of more than one bag.
    """
    names = sorted(path.name for path in folder.iterdir() if path.suffix in {".mcap", ".db3"})
    if not names:
        raise UsageError(f"{folder} is no rosbag2 folder: it has no {METADATA} of use, and no files")
    if len(names) == 1:
        return names
    numbered = [match for match in map(NUMBERED.fullmatch, names) if match]
    bags = {(match[1], match[3]) for match in numbered}
    if len(bags) != 1 or len(numbered) != len(names):
        raise UsageError(
            f"{folder / METADATA} is of no use, and there is not one bag beside it: give the .mcap or .db3 file instead"
        )
    return [match[0] for match in sorted(numbered, key=lambda match: int(match[2]))]
