"""The metadata records of an MCAP file, from head to head past all else; and which files go on with a recording."""

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
from knee_contact_ros.system.output_files import FIRST
from knee_contact_ros.system.regular_file import open_regular

NUMBERED = re.compile(r"(.+)_(\d+)(\.mcap|\.db3)")
"""Name of a file in a rosbag2 folder"""
AMONG = 4
"""Records at the beginning of a file, one of which says with what it goes on"""
LARGEST = 2**24
"""[B] of a record that is read; ours hold some curves"""


def metadata_records(path: Path) -> list[Metadata]:
    """In the order of the file; of one that is damaged those that can be read, of one of another kind none.

    Raises:
        OSError: it cannot be read.
    """
    with open_regular(path) as file:
        size = path.stat().st_size
        begins = magic_at(file, 0)
        found = list(_heads(file, size))
        if not begins or (found and found[-1][1] == Opcode.FOOTER):
            records = [_metadata_at(file, offset, size) for offset, kind in found if kind == Opcode.METADATA]
            if None not in records:
                return [record for record in records if record]
    with closing(McapFile(path)) as damaged:
        return list(damaged.metadata())


def _heads(file: IO[bytes], size: int) -> Iterator[tuple[int, int]]:
    """Where each record begins [B] and its opcode, as far as their lengths lead."""
    position = magic_at(file, 0)
    while position and (head := head_at(file, position)) and position + HEAD.size + head[1] <= size:
        yield position, head[0]
        if head[0] == Opcode.FOOTER:
            return
        position += HEAD.size + head[1]


def _metadata_at(file: IO[bytes], offset: int, size: int) -> Metadata | None:
    head = head_at(file, offset)
    record = record_at(file, offset, size) if head and head[1] <= LARGEST else None
    found = parsed(record) if record else None
    return found if isinstance(found, Metadata) else None


def goes_on_with(path: Path) -> str:
    """Name of the first file of the recording that a file goes on with; empty if it does not say so."""
    try:
        with open_regular(path) as file:
            size = path.stat().st_size
            for offset, kind in islice(_heads(file, size), AMONG):
                content = _metadata_at(file, offset, size) if kind == Opcode.METADATA else None
                if content and content.name == CONTINUED:
                    return content.metadata.get("first", "")
    except OSError:
        pass
    return ""


def later_files(folder: Path, first: str, listed: Collection[str] = ()) -> list[str]:
    """Names of the files in a folder that say that they go on with `first`, in their order, but those listed."""
    path = Path(first)
    return [
        name
        for name in in_order(path.name for path in folder.iterdir())
        if name not in listed and _is_later(name, path) and goes_on_with(folder / name) == first
    ]


def as_one_recording(folder: Path, names: Collection[str]) -> list[str]:
    """Files in their order if they are a first one and all that go on with it; else none."""
    begins = [name for name in names if not goes_on_with(folder / name)]
    found = [*begins, *later_files(folder, begins[0])] if len(begins) == 1 else []
    return found if set(found) == set(names) else []


def in_order(names: Iterable[str]) -> list[str]:
    """The numbered ones of some names, by their numbers."""
    numbered = [match for match in map(NUMBERED.fullmatch, names) if match]
    return [match[0] for match in sorted(numbered, key=lambda match: int(match[2]))]


def _is_later(name: str, first: Path) -> bool:
    """Whether a name is one that a recording with this first file goes on to."""
    match = NUMBERED.fullmatch(name)
    return bool(match and match[1] == first.stem.removesuffix(FIRST) and match[3] == first.suffix)
