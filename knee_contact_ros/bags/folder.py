"""The files of a bag: which ones belong to it, and of which kind they are.

Files of a rosbag2 folder are found even if its `metadata.yaml` is missing or wrong.
"""

import hashlib
import re
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import zstandard
from mcap.writer import MCAP0_MAGIC

from ..system.errors import UsageError, list_names
from ..system.files import (
    MAX_METADATA_SIZE,
    BadYamlError,
    is_file,
    open_regular,
    read_yaml,
    sha256_of,
)
from .mcap_file import MAX_GROWTH
from .mcap_records import ALLOWED_SIZE, BYTES_AT_ONCE
from .metadata_file import METADATA

MCAP = ".mcap"
"""Suffix of an MCAP file"""
SQLITE = ".db3"
"""Suffix of a sqlite3 file"""
MAGICS = {MCAP: MCAP0_MAGIC, SQLITE: b"SQLite format 3\x00"}
"""First bytes of the files of a bag, by their suffix"""
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
"""First bytes of zstd data, which no CDR message begins with"""
COMPRESSED = (ZSTD_MAGIC, b"\x1f\x8b", b"BZh", b"\xfd7zXZ", b"PK\x03\x04", b"\x04\x22\x4d\x18")
"""First bytes of files that are compressed as a whole: zstd, gzip, bzip2, xz, zip and lz4"""
FOREIGN = {
    b"#ROSBAG V": "is a bag of ROS 1: convert it, for example with `rosbags-convert --src FILE --dst FOLDER`",
    b"version https://git-lfs": "is a pointer of Git LFS and not the file itself: fetch it with `git lfs pull`",
    **dict.fromkeys(
        COMPRESSED, "is compressed: give the folder of the bag, or unpack the file first"
    ),
}
"""Kinds of files that are not bags, by their first bytes"""
NUMBERED = re.compile(r"(.+)_(\d+)(\.mcap|\.db3)")
"""Name of a numbered file in a rosbag2 folder: stem, number and suffix"""


class FolderContent(NamedTuple):
    """Files of a bag in a folder, by its `metadata.yaml` or else by their names."""

    names: list[str]
    """Names of the files"""
    faults: list[str]
    """Faults of the folder, as sentences"""
    compression: str = ""
    """Compression mode: `file`, `message` or empty"""
    message_count: int = 0
    """Number of messages"""


def folder_content(folder: Path) -> FolderContent:
    """Return the files of the bag in a folder.

    Without a usable `metadata.yaml` these are the only file, or the numbered ones of one name.

    Raises:
        UsageError: It is unclear which files belong to the bag, or there are none.
    """
    content = _content_by_metadata(folder)
    if any(is_file(folder / name) for name in content.names):
        return content
    names = sorted(path.name for path in folder.iterdir() if path.suffix in MAGICS)
    if not names:
        raise UsageError(
            f"{folder} is not a rosbag2 folder: it has no usable {METADATA}, and no files"
        )
    numbered = [match for match in map(NUMBERED.fullmatch, names) if match]
    is_one = len(numbered) == len(names) and len({match[1] + match[3] for match in numbered}) == 1
    if len(names) > 1 and not is_one:
        raise UsageError(
            f"{folder} has more than one recording, and no usable {METADATA} that names one; "
            f"give one of these files: {list_names(names)}"
        )
    return content._replace(
        names=sorted(names, key=file_number),
        faults=[*content.faults, *(f"{name} is missing" for name in content.names)],
        compression=content.compression.replace("file", ""),  # somebody has unpacked these
    )


def _content_by_metadata(folder: Path) -> FolderContent:
    """Return the files of the bag in a folder by its `metadata.yaml`; none, and a fault, if this cannot be used."""
    try:
        content = read_yaml(folder / METADATA, MAX_METADATA_SIZE)["rosbag2_bagfile_information"]
        names = list(dict.fromkeys(Path(name).name for name in content["relative_file_paths"]))
        mode = str(content.get("compression_mode") or "").lower().replace("none", "")
        return FolderContent(names, [], mode, int(content.get("message_count") or 0))
    except FileNotFoundError:
        return FolderContent([], [f"{METADATA} is missing"])
    except (
        OSError,
        BadYamlError,
        LookupError,
        TypeError,
        ValueError,
        AttributeError,
        OverflowError,
    ):
        return FolderContent([], [f"{METADATA} cannot be read"])


def file_number(name: str) -> int:
    """Return the number of a numbered name; 0 for another name."""
    match = NUMBERED.fullmatch(name)
    return int(match[2]) if match else 0


def files_of(bag: Path) -> list[Path]:
    """Return the paths of the files of a bag: the bag itself if it is a file, or those in its folder that belong to it.

    Raises:
        UsageError: It is not clear which files belong to the bag.
    """
    return [bag / name for name in folder_content(bag).names] if bag.is_dir() else [bag]


def others_beside(bag: Path) -> list[str]:
    """Return a sentence that the folder of a bag has other recordings, which are not read; else an empty list."""
    if not bag.is_dir():
        return []
    read = {path.name.removesuffix(".zstd") for path in files_of(bag)}
    others = sorted(
        path.name for path in bag.iterdir() if path.suffix in MAGICS and path.name not in read
    )
    if not others:
        return []
    return [
        f"{bag}: only {list_names(sorted(read))} is read; to read {list_names(others)}, give it as a file"
    ]


def kind_of(path: Path) -> str:
    """Return the kind of a file of a bag, `MCAP` or `SQLITE`, by its first bytes or else its name.

    Raises:
        UsageError: It is neither of the two.
        OSError: It cannot be read.
    """
    with open_regular(path) as file:
        begin = file.read(max(map(len, FOREIGN)))
    for magic, words in FOREIGN.items():
        if begin.startswith(magic):
            raise UsageError(f"cannot read bag {path}: it {words}")
    kinds = [suffix for suffix in path.suffixes if suffix in MAGICS]
    kinds += [kind for kind, magic in MAGICS.items() if begin.startswith(magic)]
    if not kinds:
        raise UsageError(f"cannot read bag {path}: it is neither an MCAP nor a sqlite3 file")
    return kinds[-1]


def decompressed(packed: Path, folder: Path) -> Path:
    """Decompress a file that rosbag2 has compressed as a whole into `folder`; return the path of the new file.

    Raises:
        OSError: The file is missing, or grows too much.
        zstandard.ZstdError: It cannot be decompressed.
    """
    path = folder / packed.name.removesuffix(".zstd")
    limit = max(MAX_GROWTH * packed.stat().st_size, ALLOWED_SIZE)
    with open_regular(packed) as file, path.open("wb") as unpacked:
        reader = zstandard.ZstdDecompressor().stream_reader(file, read_across_frames=True)
        while data := reader.read(BYTES_AT_ONCE):
            unpacked.write(data)
            if unpacked.tell() > limit:
                raise OSError(f"it holds more than {MAX_GROWTH} times its size")
    return path


def files_digest(paths: Iterable[Path]) -> str:
    """Return the SHA-256 of the names and contents of files, in the order of their paths."""
    digest = hashlib.sha256()
    for path in sorted(paths):
        with open_regular(path) as file:
            digest.update(f"{path.name} {sha256_of(file)}\n".encode())
    return digest.hexdigest()


def bag_digest(bag: Path, files: Iterable[Path] | None = None) -> str:
    """Return the SHA-256 of a bag: of the file, or of the `files` in its folder that belong to it (`files_of`)."""
    if bag.is_dir():
        return files_digest(path for path in files or files_of(bag) if is_file(path))
    with open_regular(bag) as file:
        return sha256_of(file)
