"""The metadata records of an MCAP file: from head to head, past chunks; around the damage if there is any."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import IO

from mcap.opcode import Opcode
from mcap.records import Metadata

from knee_contact_ros.bags.recovery.inspection import open_file
from knee_contact_ros.bags.recovery.mcap_file import McapFile
from knee_contact_ros.bags.recovery.records import HEAD, MAGIC, magic_at, parsed, record_at
from knee_contact_ros.system.regular_file import open_regular

LARGEST = 2**24
"""[B] of a record that is read; ours hold some curves"""


def metadata_records(path: Path) -> list[Metadata]:
    """In the order of the file; of one that is damaged those that can be read, of one of another kind none.

    Raises:
        OSError: it cannot be read.
    """
    with open_regular(path) as file:
        found = _of_whole(file, path.stat().st_size)
    return _around_damage(path) if found is None else found


def _of_whole(file: IO[bytes], size: int) -> list[Metadata] | None:
    """None if the file is not one record after another up to its footer."""
    position, found = magic_at(file, 0), list[Metadata]()
    while position:
        file.seek(position)
        head = file.read(HEAD.size)
        if len(head) < HEAD.size:
            return None
        opcode, length = HEAD.unpack(head)
        end = position + HEAD.size + length
        if opcode == Opcode.FOOTER:
            return found if end + len(MAGIC) == size and magic_at(file, end) else None
        if opcode == Opcode.METADATA:
            record = record_at(file, position, size) if length <= LARGEST else None
            if record is None:
                return None
            found.append(parsed(record))
        position = end
    return None


def _around_damage(path: Path) -> list[Metadata]:
    file = open_file(path)
    if file is None:
        return []
    with closing(file):
        return list(file.metadata()) if isinstance(file, McapFile) else []
