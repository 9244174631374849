"""Metadata records of an MCAP file, read without its other records, and the order of the files of a recording."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator
from contextlib import closing
from itertools import islice
from pathlib import Path
from typing import IO

from mcap.opcode import Opcode
from mcap.records import Metadata

from knee_contact_ros.bags.mcap_file import McapFile
from knee_contact_ros.bags.mcap_layout import HEAD
from knee_contact_ros.bags.mcap_records import head_at, magic_at, parsed, record_at
from knee_contact_ros.bags.writer import CONTINUED
from knee_contact_ros.system.files import open_regular
from knee_contact_ros.system.output_files import FIRST

NUMBERED = re.compile(r"(.+)_(\d+)(\.mcap|\.db3)")
"""Name of a numbered file in a rosbag2 folder: stem, number and suffix"""
FIRST_RECORDS = 4
"""Number of records at the beginning of a file among which the record `continued` is searched for"""
LARGEST = 2**24
"""Largest size [B] of a metadata record that is read; those of this package hold some curves"""


def metadata_records(path: Path) -> list[Metadata]:
    """Metadata records of a file in their order: the readable ones of a damaged file, none of a file that is no MCAP.

    Raises:
        OSError: The file cannot be read.
    """
    with open_regular(path) as file:
        size = path.stat().st_size
        is_mcap = magic_at(file, 0)
        heads = list(_heads(file, size))
        if not is_mcap or (heads and heads[-1][1] == Opcode.FOOTER):
            records = [_metadata_at(file, offset, size) for offset, opcode in heads if opcode == Opcode.METADATA]
            if None not in records:
                return [record for record in records if record]
    with closing(McapFile(path)) as damaged:
        return list(damaged.metadata())


def _heads(file: IO[bytes], size: int) -> Iterator[tuple[int, int]]:
    """Offset [B] and opcode of each record, found by the lengths of the records."""
    position = magic_at(file, 0)
    while position and (head := head_at(file, position)) and position + HEAD.size + head[1] <= size:
        yield position, head[0]
        if head[0] == Opcode.FOOTER:
            return
        position += HEAD.size + head[1]


def _metadata_at(file: IO[bytes], offset: int, size: int) -> Metadata | None:
    """Metadata record at an offset; None if it is damaged or too large."""
    head = head_at(file, offset)
    record = record_at(file, offset, size) if head and head[1] <= LARGEST else None
    content = parsed(record) if record else None
    return content if isinstance(content, Metadata) else None


def goes_on_with(path: Path) -> str:
    """Name of the first file of the recording that a file continues; empty if the file does not name one."""
    try:
        with open_regular(path) as file:
            size = path.stat().st_size
            for offset, opcode in islice(_heads(file, size), FIRST_RECORDS):
                content = _metadata_at(file, offset, size) if opcode == Opcode.METADATA else None
                if content and content.name == CONTINUED:
                    return content.metadata.get("first", "")
    except OSError:
        pass
    return ""


def later_files(folder: Path, first: str, listed: Collection[str] = ()) -> list[str]:
    """Names of the files in a folder that continue the recording of `first`, in their order, without those `listed`."""
    path = Path(first)
    return [
        name
        for name in in_order(path.name for path in folder.iterdir())
        if name not in listed and _is_later(name, path) and goes_on_with(folder / name) == first
    ]


def as_one_recording(folder: Path, names: Collection[str]) -> list[str]:
    """Names in the order of their recording if the files are one whole recording; else an empty list."""
    first = [name for name in names if not goes_on_with(folder / name)]
    recording = [*first, *later_files(folder, first[0])] if len(first) == 1 else []
    return recording if set(recording) == set(names) else []


def in_order(names: Iterable[str]) -> list[str]:
    """Names that are numbered, in the order of the numbers; the others are left out."""
    numbered = [match for match in map(NUMBERED.fullmatch, names) if match]
    return [match[0] for match in sorted(numbered, key=lambda match: int(match[2]))]


def _is_later(name: str, first: Path) -> bool:
    """Whether a later file of the recording with this first file may have this name."""
    match = NUMBERED.fullmatch(name)
    return bool(match and match[1] == first.stem.removesuffix(FIRST) and match[3] == first.suffix)
