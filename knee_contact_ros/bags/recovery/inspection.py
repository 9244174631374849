"""What the files of a bag hold, and whether they are whole: without trust in an index or in `metadata.yaml`."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from knee_contact_ros.bags.recovery.compressed_files import check_compressed
from knee_contact_ros.bags.recovery.continuing import NUMBERED, as_one_recording, in_order, later_files
from knee_contact_ros.bags.recovery.folder_metadata import METADATA, Declared, contradictions, read_metadata
from knee_contact_ros.bags.recovery.mcap_file import McapFile
from knee_contact_ros.bags.recovery.records import MAGIC
from knee_contact_ros.bags.recovery.scan import Advance
from knee_contact_ros.bags.recovery.sqlite_file import SqliteFile
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.regular_file import open_regular
from knee_contact_ros.system.yaml_file import BadYamlError, parse_yaml

MOST_TOPICS, LARGEST_QOS = 2000, 2**15
"""Of a file, and characters of a topic's quality of service: each takes its time"""
SQLITE_MAGIC = b"SQLite format 3\x00"


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
    declared, texts = {}, {0: ""}  # of many channels with one schema, the definition is decoded once
    for number, (channel, schema) in file.streams.items():
        qos = channel.metadata.get("offered_qos_profiles", "")
        if schema and schema.id not in texts:
            texts[schema.id] = schema.data.decode("utf-8", "replace") if schema.encoding == "ros2msg" else ""
        text = texts[schema.id if schema else 0]
        type_name = schema.name if schema else ""
        declared[number] = Declared(channel.topic, type_name, channel.message_encoding, qos, definition=text)
    return declared


def inspect(path: Path) -> Inspection | None:
    """Look into all files of a bag; None if it is of a kind that this package leaves to others.

    Raises:
        UsageError: it is not clear which files are the bag's, or they hold too much.
        OSError: a file cannot be read.
    """
    if not path.is_dir():
        file = open_file(path)
        return None if file is None else Inspection([file], [*file.faults, *strange_topics(file)], "")
    metadata, faults = read_metadata(path)
    if metadata and metadata.compressed == "file":
        check_compressed([path / name for name in metadata.files])
        return None
    names = metadata.files if metadata else []
    if not any(is_there(path / name) for name in names):
        faults += [f"{name} is missing" for name in names]
        names = guessed(path)
    elif unlisted := later_files(path, names[0], names):
        faults.append(f"{METADATA} does not name all files that go on with {names[0]}: {len(unlisted)} more are read")
        names = [*names, *unlisted]
    files = []
    for name in names:
        file = open_file(path / name) if is_there(path / name) else None
        if file is None:
            faults.append(f"{name} is no file of a bag" if os.path.lexists(path / name) else f"{name} is missing")
            continue
        files.append(file)
        faults += [f"{name}: {fault}" for fault in (*file.faults, *strange_topics(file))]
    found = Inspection(files, faults, metadata.compressed if metadata else "")
    if metadata:
        faults += contradictions(metadata.topics, [(declarations(file), file.counts) for file in files])
    return found


def strange_topics(file: McapFile | SqliteFile) -> list[str]:
    """What rosbags, which takes a file as it is, would read too long in its topics."""
    topics = declarations(file).values()
    if len(topics) > MOST_TOPICS:
        return [f"it declares {len(topics)} topics; at most {MOST_TOPICS} are read in the ordinary way"]
    strange = sorted({topic.topic for topic in topics if isinstance(topic.qos, str) and not _is_qos(topic.qos)})
    return [f"the quality of service of {strange[0]} cannot be read"] if strange else []


@lru_cache(maxsize=256)
def _is_qos(text: str) -> bool:
    if len(text) > LARGEST_QOS:
        return False
    try:
        parse_yaml(text)
    except BadYamlError:
        return False
    return True


def files_of(bag: Path) -> list[Path]:
    """A bag's files: itself, or those of its folder, in which other bags may lie as well.

    Raises:
        UsageError: it is not clear which files are the bag's.
    """
    if not bag.is_dir():
        return [bag]
    metadata, _ = read_metadata(bag)
    listed = metadata.files if metadata else []
    if not any(is_there(bag / name) for name in listed):
        return [bag / name for name in guessed(bag)]
    return [bag / name for name in (*listed, *later_files(bag, listed[0], listed))]


def refuse_input(bag: Path, output: Path) -> None:
    """Refuse an output that is the bag, or one of its files: there is no way back from replacing that.

    Raises:
        UsageError: it is.
    """
    if is_there(output) and any(is_there(path) and output.samefile(path) for path in files_of(bag)):
        raise UsageError(f"{output} is the input: it is never touched; choose another name")


def is_there(path: Path) -> bool:
    """Whether there is one; of a name that is too long there is none."""
    try:
        return path.is_file()
    except OSError:
        return False


def open_file(path: Path, advance: Advance = lambda _done, _total: None) -> McapFile | SqliteFile | None:
    """A file by its beginning, or else by its name; None if it is of another kind."""
    with open_regular(path) as file:
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
    if len(bags) == 1 and len(numbered) == len(names):
        return in_order(names)
    if recording := as_one_recording(folder, names):
        return recording
    raise UsageError(
        f"{folder / METADATA} is of no use, and there is not one bag beside it: give the .mcap or .db3 file instead"
    )
