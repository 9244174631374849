"""Which files a bag consists of, whatever `metadata.yaml` says, each opened."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Collection, Sequence
from contextlib import ExitStack
from pathlib import Path
from resource import RLIMIT_NOFILE, getrlimit, setrlimit
from typing import NamedTuple

import zstandard

from knee_contact_ros.bags.folder_metadata import METADATA, read_metadata
from knee_contact_ros.bags.mcap_file import LITTLE, MOST_GROWTH, McapFile
from knee_contact_ros.bags.mcap_layout import MAGIC
from knee_contact_ros.bags.mcap_metadata import NUMBERED, as_one_recording, in_order, later_files
from knee_contact_ros.bags.sqlite_file import SqliteFile
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.printable import printable
from knee_contact_ros.system.regular_file import open_regular

File = McapFile | SqliteFile
SQLITE_MAGIC = b"SQLite format 3\x00"
MOST_AT_ONCE = 2**28
"""[B] of chunks that are unpacked at a time"""
MOST_SAID = 3
"""Faults that are told in a line"""
MOST_NAMED = 8
"""Files, likewise"""
BAG_FILES = (".mcap", ".db3")
"""How their names end"""
BLOCK = 2**20
"""[B] of a compressed file that are unpacked at a time"""


class Found(NamedTuple):
    """A bag's files."""

    files: list[File]
    faults: list[str]
    """What is wrong, as sentences; empty if the bag is whole"""
    packed: bool
    """Whether its messages are compressed one by one"""
    counts: dict[str, int]
    """Messages by topic, as `metadata.yaml` tells; empty if it does not"""


def find_files(path: Path, opened: ExitStack) -> Found:
    """Open all files of a bag, to be closed with `opened`.

    Raises:
        UsageError: it is not clear which files are the bag's, or one cannot be used.
        OSError: a file cannot be read.
    """
    if not path.is_dir():
        file = _bounded(open_file(path))
        opened.callback(file.close)
        return Found([file], list(file.faults), False, {})
    _allow_many_files(path)
    metadata, faults = read_metadata(path)
    names, folder = metadata.files if metadata else [], path
    if metadata and metadata.compressed == "file":
        folder = Path(opened.enter_context(tempfile.TemporaryDirectory(prefix="knee_contact_bag_")))
        names = _decompressed([path / name for name in names], folder)
    elif not any(is_there(path / name) for name in names):
        faults += [f"{name} is missing" for name in names]
        names = guessed(path)
    elif unlisted := later_files(path, names[0], names):
        faults.append(f"{METADATA} does not name all files that go on with {names[0]}: {len(unlisted)} more are read")
        names = [*names, *unlisted]
    files: list[File] = []
    for name in names:
        if not is_there(folder / name):
            faults.append(f"{name} is {'no file of a bag' if os.path.lexists(folder / name) else 'missing'}")
            continue
        try:
            file = open_file(folder / name)
        except UsageError as error:
            faults.append(f"{name}: {error}")
            continue
        files.append(_bounded(file))
        opened.callback(file.close)
        faults += [f"{name}: {fault}" for fault in file.faults]
    packed = metadata is not None and metadata.compressed == "message"
    return Found(files, faults, packed, metadata.counts if metadata else {})


def open_file(path: Path, advance: Callable[[int, int], None] = lambda _done, _total: None) -> File:
    """A file by its beginning, or else by its name; `advance` hears of it.

    Raises:
        UsageError: it is of another kind, or a damaged sqlite3 one.
        OSError: it cannot be read.
    """
    with open_regular(path) as file:
        beginning = file.read(len(SQLITE_MAGIC))
    if beginning.startswith(MAGIC):
        return McapFile(path, advance)
    if beginning == SQLITE_MAGIC or ".db3" in path.suffixes:
        return SqliteFile(path)
    if ".mcap" in path.suffixes:
        return McapFile(path, advance)
    raise UsageError(f"cannot read bag {path}: it is neither an MCAP nor a sqlite3 file")


def _bounded(file: File) -> File:
    """Refuse what would take more memory than any recording.

    Raises:
        UsageError: that is so.
    """
    if isinstance(file, McapFile) and file.at_once > MOST_AT_ONCE:
        file.close()
        raise UsageError(
            f"bag {file.path}: its chunks lie over each other in time, so that {file.at_once} bytes would be unpacked "
            f"at once; at most {MOST_AT_ONCE} are"
        )
    return file


def _decompressed(paths: Sequence[Path], folder: Path) -> list[str]:
    """Unpack files that rosbag2 has compressed as a whole; their new names, of those that are there.

    Raises:
        UsageError: they hold too much for their size, or cannot be unpacked.
    """
    names, there = [], [path for path in paths if is_there(path)]
    most = max(MOST_GROWTH * sum(path.stat().st_size for path in there), LITTLE)
    for path in there:
        names.append(path.name.removesuffix(".zstd"))
        try:
            with open_regular(path) as file, (folder / names[-1]).open("wb") as unpacked:
                reader = zstandard.ZstdDecompressor().stream_reader(file, read_across_frames=True)
                while most >= 0 and (data := reader.read(BLOCK)):
                    most -= len(data)
                    unpacked.write(data)
        except (OSError, zstandard.ZstdError) as error:
            raise UsageError(f"cannot read bag file {path}: {error}") from None
        if most < 0:
            raise UsageError(f"{path} holds more than {MOST_GROWTH} times its size: no recording is compressed so well")
    return names + [path.name for path in paths if path not in there]


def _allow_many_files(path: Path) -> None:
    """Have as many files open as a folder's may be, twice; a shell's limit is 1024, and may be raised by anybody."""
    soft, hard = getrlimit(RLIMIT_NOFILE)
    if 2 * sum(1 for _ in path.iterdir()) > soft // 2 and soft != hard:
        setrlimit(RLIMIT_NOFILE, (hard, hard))


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


def others_beside(bag: Path) -> list[str]:
    """A sentence about other recordings in a bag's folder, which are not read; none if there are none."""
    if not bag.is_dir():
        return []
    read = {path.name.removesuffix(".zstd") for path in files_of(bag)}
    others = sorted(path.name for path in bag.iterdir() if path.suffix in BAG_FILES and path.name not in read)
    if not others:
        return []
    return [f"of {bag}, {_named(sorted(read))} is read; what else is there, give as a file: {_named(others)}"]


def _named(names: Sequence[str]) -> str:
    return ", ".join(names[:MOST_NAMED]) + " ..." * (len(names) > MOST_NAMED)


def guessed(folder: Path) -> list[str]:
    """Names of the files, without `metadata.yaml`: the only one, or those that are numbered.

    Raises:
        UsageError: there are none, or of more than one bag.
    """
    names = sorted(path.name for path in folder.iterdir() if path.suffix in BAG_FILES)
    if not names:
        raise UsageError(f"{folder} is no rosbag2 folder: it has no {METADATA} of use, and no files")
    numbered = [match for match in map(NUMBERED.fullmatch, names) if match]
    if len(names) == 1 or (len(numbered) == len(names) and len({(m[1], m[3]) for m in numbered}) == 1):
        return in_order(names) if len(names) > 1 else names
    if recording := as_one_recording(folder, names):
        return recording
    raise UsageError(
        f"{folder} has more than one recording, and no {METADATA} of use that names one; "
        f"give one of these files: {_named(names)}"
    )


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


def in_a_line(faults: Sequence[str] | Collection[str]) -> str:
    """The first faults, and how many more there are."""
    more = len(faults) - MOST_SAID
    return printable("; ".join(list(faults)[:MOST_SAID])) + (f"; and {more} more" if more > 0 else "")
