"""Which files go on with a recording: a kill may leave more of them than `metadata.yaml` names, or none of that."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import Metadata

from knee_contact_ros.bags.recovery.records import HEAD, magic_at, parsed, record_at
from knee_contact_ros.bags.writer import CONTINUED
from knee_contact_ros.system.output_files import FIRST
from knee_contact_ros.system.regular_file import open_regular

NUMBERED = re.compile(r"(.+)_(\d+)(\.mcap|\.db3)")
"""Name of a file in a rosbag2 folder"""
AMONG = 4
"""Records at the beginning of a file, one of which says with what it goes on"""
LARGEST = 2**16
"""[B] of such a record"""


def goes_on_with(path: Path) -> str:
    """Name of the first file of the recording that a file goes on with; empty if it does not say so."""
    try:
        with open_regular(path) as file:
            size = path.stat().st_size
            position = magic_at(file, 0)
            for _ in range(AMONG):
                if position + HEAD.size > size:  # a length may be anything, also more than a file can have
                    return ""
                file.seek(position)
                head = file.read(HEAD.size)
                opcode, length = HEAD.unpack(head)
                if opcode == Opcode.METADATA and length <= LARGEST:
                    record = record_at(file, position, size)
                    content = parsed(record) if record else None
                    if isinstance(content, Metadata) and content.name == CONTINUED:
                        return content.metadata.get("first", "")
                position += HEAD.size + length
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
