"""Files of a bag, found and opened even where `metadata.yaml` is missing or wrong."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Collection, Sequence
from contextlib import ExitStack
from pathlib import Path
from resource import RLIMIT_NOFILE, getrlimit, setrlimit
from typing import NamedTuple

import zstandard

from knee_contact_ros.bags.mcap_file import McapFile
from knee_contact_ros.bags.mcap_inspection import ALLOWED_SIZE, MOST_GROWTH
from knee_contact_ros.bags.mcap_layout import MAGIC
from knee_contact_ros.bags.mcap_metadata import NUMBERED, as_one_recording, in_order, later_files
from knee_contact_ros.bags.metadata import METADATA, read_metadata
from knee_contact_ros.bags.sqlite_file import SqliteFile
from knee_contact_ros.system.errors import UsageError, printable
from knee_contact_ros.system.files import open_regular

File = McapFile | SqliteFile
"""Open file of a bag"""
SQLITE_MAGIC = b"SQLite format 3\x00"
"""Bytes at the beginning of a sqlite3 file"""
MOST_AT_ONCE = 2**28
"""Largest total size [B] of the chunks that are unpacked at one time"""
MOST_SHOWN = 3
"""Largest number of faults in a message"""
MOST_NAMED = 8
"""Largest number of file names in a message"""
BAG_FILES = (".mcap", ".db3")
"""Suffixes of the files of a bag"""
BLOCK = 2**20
"""Size [B] of the pieces in which a compressed file is unpacked"""


class BagFiles(NamedTuple):
    """Open files of a bag and their faults."""

    files: list[File]
    """Open files, in the order in which they were found"""
    faults: list[str]
    """Faults of the bag, as sentences; empty if it is whole"""
    packed: bool
    """Whether the messages are compressed one by one"""
    counts: dict[str, int]
    """Number of messages of each topic according to `metadata.yaml`; empty without a readable one"""


def find_files(path: Path, opened: ExitStack) -> BagFiles:
    """Open all files of a bag; `opened` closes them.

    Raises:
        UsageError: It is not clear which files belong to the bag, or one of them cannot be used.
        OSError: A file cannot be read.
    """
    if not path.is_dir():
        file = _bounded(open_file(path))
        opened.callback(file.close)
        return BagFiles([file], list(file.faults), False, {})
    _allow_many_files(path)
    metadata, faults = read_metadata(path)
    listed, folder = metadata.files if metadata else [], path
    if metadata and metadata.compressed == "file":
        folder = Path(opened.enter_context(tempfile.TemporaryDirectory(prefix="knee_contact_bag_")))
        names = _decompressed([path / name for name in listed], folder)
    else:
        names, name_faults = _names(path, listed)
        faults += name_faults
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
    return BagFiles(files, faults, packed, metadata.counts if metadata else {})


def open_file(path: Path, advance: Callable[[int, int], None] = lambda _done, _total: None) -> File:
    """Open a file, whose kind its first bytes tell, or else its name; `advance` is called with the progress in bytes.

    Raises:
        UsageError: It is neither an MCAP nor a sqlite3 file, or a damaged sqlite3 file.
        OSError: It cannot be read.
    """
    with open_regular(path) as file:
        magic = file.read(len(SQLITE_MAGIC))
    if magic.startswith(MAGIC):
        return McapFile(path, advance)
    if magic == SQLITE_MAGIC or ".db3" in path.suffixes:
        return SqliteFile(path)
    if ".mcap" in path.suffixes:
        return McapFile(path, advance)
    raise UsageError(f"cannot read bag {path}: it is neither an MCAP nor a sqlite3 file")


def _bounded(file: File) -> File:
    """Return the file unless its chunks would take more memory than those of any recording.

    Raises:
        UsageError: They would.
    """
    if isinstance(file, McapFile) and file.at_once > MOST_AT_ONCE:
        file.close()
        raise UsageError(
            f"bag {file.path}: its chunks lie over each other in time, so that {file.at_once} bytes would be unpacked "
            f"at once; at most {MOST_AT_ONCE} are"
        )
    return file


def _decompressed(paths: Sequence[Path], folder: Path) -> list[str]:
    """Unpack files that rosbag2 has compressed as a whole into `folder`, and return their names.

    The names of unpacked files come first, those of missing ones last.

    Raises:
        UsageError: A file grows too much, or cannot be unpacked.
    """
    names, present = [], [path for path in paths if is_there(path)]
    left = max(MOST_GROWTH * sum(path.stat().st_size for path in present), ALLOWED_SIZE)  # [B]
    for path in present:
        names.append(path.name.removesuffix(".zstd"))
        try:
            with open_regular(path) as file, (folder / names[-1]).open("wb") as unpacked:
                reader = zstandard.ZstdDecompressor().stream_reader(file, read_across_frames=True)
                while left >= 0 and (data := reader.read(BLOCK)):
                    left -= len(data)
                    unpacked.write(data)
        except (OSError, zstandard.ZstdError) as error:
            raise UsageError(f"cannot read bag file {path}: {error}") from None
        if left < 0:
            raise UsageError(f"{path} holds more than {MOST_GROWTH} times its size: no recording is compressed so well")
    return names + [path.name for path in paths if path not in present]


def _allow_many_files(path: Path) -> None:
    """Raise the limit of open files to what a folder with many files needs: the usual one is 1024."""
    soft, hard = getrlimit(RLIMIT_NOFILE)
    if 2 * sum(1 for _ in path.iterdir()) > soft // 2 and soft != hard:
        setrlimit(RLIMIT_NOFILE, (hard, hard))


def files_of(bag: Path) -> list[Path]:
    """Paths of the files of a bag: the bag itself if it is a file, or those in its folder that belong to it.

    Raises:
        UsageError: It is not clear which files belong to the bag.
    """
    if not bag.is_dir():
        return [bag]
    metadata, _ = read_metadata(bag)
    names, _ = _names(bag, metadata.files if metadata else [])
    return [bag / name for name in names]


def _names(folder: Path, listed: Sequence[str]) -> tuple[list[str], list[str]]:
    """Names of the files of a bag in a folder, and the faults of the names that are `listed` in `metadata.yaml`.

    Raises:
        UsageError: It is not clear which files belong to the bag.
    """
    if not any(is_there(folder / name) for name in listed):
        return _guessed(folder), [f"{name} is missing" for name in listed]
    unlisted = later_files(folder, listed[0], listed)
    fault = f"{METADATA} does not name all files that go on with {listed[0]}: {len(unlisted)} more are read"
    return [*listed, *unlisted], [fault] if unlisted else []


def others_beside(bag: Path) -> list[str]:
    """Sentence about other recordings in the folder of a bag, which are not read; an empty list if there are none."""
    if not bag.is_dir():
        return []
    read = {path.name.removesuffix(".zstd") for path in files_of(bag)}
    others = sorted(path.name for path in bag.iterdir() if path.suffix in BAG_FILES and path.name not in read)
    if not others:
        return []
    return [f"of {bag}, {_named(sorted(read))} is read; what else is there, give as a file: {_named(others)}"]


def _named(names: Sequence[str]) -> str:
    """First names of a list, separated by commas."""
    return ", ".join(names[:MOST_NAMED]) + " ..." * (len(names) > MOST_NAMED)


def _guessed(folder: Path) -> list[str]:
    """Names of the files of a folder without a usable `metadata.yaml`: the only file, or the numbered ones.

    Raises:
        UsageError: There are no files, or those of more than one bag.
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
    """Refuse an output that would replace the bag it is computed from, or one of its files.

    Raises:
        UsageError: It would.
    """
    if is_there(output) and any(is_there(path) and output.samefile(path) for path in files_of(bag)):
        raise UsageError(f"{output} is the input: it is never touched; choose another name")


def is_there(path: Path) -> bool:
    """Whether a path is a regular file; False for a name that is too long."""
    try:
        return path.is_file()
    except OSError:
        return False


def in_a_line(faults: Collection[str]) -> str:
    """First faults, and the number of the others, in one line of printable characters."""
    more = len(faults) - MOST_SHOWN
    return printable("; ".join(list(faults)[:MOST_SHOWN])) + (f"; and {more} more" if more > 0 else "")
