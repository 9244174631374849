"""The records of an MCAP file one after another, and what lies between them where the file is damaged.

A record is taken only if its content fills it exactly. Behind anything else the next one is searched for.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Collection, Iterator
from io import BytesIO
from typing import IO, Any, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")
"""Opcode and length of the content [B]"""
CHUNK_HEAD = struct.Struct("<QQQII")
"""First and last time, size, checksum, length of the compression's name"""
LONGEST_NAME = 16
"""[B] of a compression's name"""
INDEX_HEAD = struct.Struct("<HI")
"""Of a message index: channel, length of the entries [B]"""
INDEX_ENTRY = struct.Struct("<QQ")
"""Log time [ns], offset in the chunk [B]"""
MESSAGE_HEAD = 22
"""[B] before the payload"""
LARGEST_RECORD = 2**30
"""[B] that is ever read at once"""
BLOCK = 2**20
"""[B] that are searched at once"""
MOST_READ = 4
"""Times the file's size that may be read of what looks like records, and is none"""
LONGEST_ALONE = 2**16
"""[B] of a record that is searched for and not followed by another one"""
PARSERS: dict[int, Any] = {
    Opcode.HEADER: Header,
    Opcode.FOOTER: Footer,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.CHUNK_INDEX: ChunkIndex,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex,
    Opcode.STATISTICS: Statistics,
    Opcode.METADATA: Metadata,
    Opcode.METADATA_INDEX: MetadataIndex,
    Opcode.SUMMARY_OFFSET: SummaryOffset,
    Opcode.ATTACHMENT: Attachment,
    Opcode.DATA_END: DataEnd,
}
IN_CHUNKS = (Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL)
PRIVATE = 0x80
"""Opcodes from here on are anybody's"""
KNOWN = {int(opcode) for opcode in Opcode}
CANDIDATE = re.compile(rb"(?s)(?=[\x01-\x0f].{4}\x00{4})")
"""The beginning of a record of less than 4 GiB"""


class Record(NamedTuple):
    """A whole record."""

    opcode: int
    offset: int
    """[B] of its beginning in the file, or in its chunk"""
    content: bytes

    @property
    def end(self) -> int:
        """Where [B] the next record begins."""
        return self.offset + HEAD.size + len(self.content)


class CutChunk(NamedTuple):
    """A chunk whose end the file does not hold."""

    offset: int
    content: bytes


class Hole(NamedTuple):
    """Bytes that are no records."""

    offset: int
    length: int
    cut: bool
    """The file ends in it"""


class _Exact(ReadDataStream):
    """Gives all the bytes asked for, or none."""

    def __init__(self, content: bytes) -> None:
        super().__init__(BytesIO(content))
        self._size = len(content)

    def read(self, length: int) -> bytes:
        if length > self._size - self.count:
            raise EndOfFile
        return bytes(super().read(length))


def parsed(record: Record) -> Any:
    """The record in the form that `mcap` gives it; None if its content is no such record.

    Not for messages and chunks.
    """
    if record.opcode == Opcode.MESSAGE_INDEX:
        return _message_index(record.content)
    stream = _Exact(record.content)
    try:
        found = PARSERS[record.opcode].read(stream)
    except (KeyError, EndOfFile, struct.error, UnicodeDecodeError):
        return None
    return found if stream.count == len(record.content) else None


def _message_index(content: bytes) -> MessageIndex | None:
    """A message index, an entry per message: `mcap` would take as long for it as for the messages."""
    if len(content) < INDEX_HEAD.size:
        return None
    channel, length = INDEX_HEAD.unpack_from(content)
    if length % INDEX_ENTRY.size or length != len(content) - INDEX_HEAD.size:
        return None
    return MessageIndex(channel, list(INDEX_ENTRY.iter_unpack(content[INDEX_HEAD.size :])))


def read_records(file: IO[bytes], size: int) -> Iterator[Record | CutChunk | Hole]:
    """All that a file of `size` [B] holds behind its magic, in order."""
    file.seek(0)
    position = len(MAGIC) if file.read(len(MAGIC)) == MAGIC else 0
    search = _Search(file, size)
    while position < size:
        found = record_at(file, position, size) or _cut_chunk_at(file, position, size)
        if found is None or search.finds_others_in(found):
            following = search.next_record(position + 1, size)
            yield Hole(position, following - position, following == size)
            position = following
            continue
        yield found
        position = found.end if isinstance(found, Record) else size
        if isinstance(found, Record) and found.opcode == Opcode.FOOTER:
            position += magic_at(file, position)


class _Search:
    """For records behind what is none; no byte is searched twice, and what only looks like records is read to a limit.

    Behind that limit nothing is found any more, so that no file takes longer than in proportion to its size.
    """

    def __init__(self, file: IO[bytes], size: int) -> None:
        self._file, self._size = file, size
        self._left = MOST_READ * size + BLOCK  # [B] of what may be read in vain
        self._searched: dict[Collection[int], tuple[int, int]] = {}  # from where to where, by the kinds left out

    def finds_others_in(self, found: Record | CutChunk) -> bool:
        """Whether a message or a chunk is not as long as it says: others begin in it, and none behind it."""
        if not isinstance(found, Record) or _continues(self._file, found, self._size):
            return False
        others = self.next_record(found.offset + 1, found.end, IN_CHUNKS if found.opcode == Opcode.CHUNK else ())
        self._left -= len(found.content) if others < found.end else 0
        return others < found.end

    def next_record(self, offset: int, end: int, but: Collection[int] = ()) -> int:
        """Where the next record begins that is followed by another one, but for some kinds; `end` if there is none."""
        begin, until = self._searched.get(but, (offset, offset))
        if not begin <= offset <= until:
            begin = until = offset
        found = self._look(max(offset, until), end, but) if until < end else until
        self._searched[but] = begin, max(found, until)
        return min(found, end)

    def _look(self, offset: int, end: int, but: Collection[int]) -> int:
        while offset < end and self._left > 0:
            block = _read(self._file, offset, min(BLOCK + HEAD.size, self._size - offset))
            for candidate in CANDIDATE.finditer(block, 0, min(BLOCK, end - offset) + HEAD.size):
                begin = offset + candidate.start()
                if self._is_record(begin, but):
                    return begin
                if self._left <= 0:
                    break
            offset += BLOCK
        return end

    def _is_record(self, offset: int, but: Collection[int]) -> bool:
        head = _head_at(self._file, offset)
        if head is None:
            return False
        opcode, length = head
        if offset + HEAD.size + length > self._size:
            return _cut_chunk_at(self._file, offset, self._size) is not None
        if length > LONGEST_ALONE and not _is_followed(self._file, offset + HEAD.size + length, self._size):
            return False
        record = record_at(self._file, offset, self._size)
        if record is not None and opcode not in but and _continues(self._file, record, self._size):
            return True
        if record is not None or opcode != Opcode.CHUNK:  # of a chunk that is none, only the head was read
            self._left -= length
        return False


def record_at(file: IO[bytes], offset: int, size: int) -> Record | None:
    """The record that begins at `offset`, if there is a whole one that holds what its kind must hold."""
    head = _head_at(file, offset)
    if head is None or offset + HEAD.size + head[1] > size or not _may_be_read(file, *head):
        return None
    record = Record(head[0], offset, _read(file, offset + HEAD.size, head[1]))
    if record.opcode in PARSERS or record.opcode == Opcode.MESSAGE_INDEX:
        return record if parsed(record) is not None else None
    return record


def _continues(file: IO[bytes], record: Record, size: int) -> bool:
    """Whether a message or a chunk is followed by a record; the others tell by themselves that they are records."""
    return record.opcode not in {Opcode.MESSAGE, Opcode.CHUNK} or _is_followed(file, record.end, size)


def _is_followed(file: IO[bytes], end: int, size: int) -> bool:
    """Whether what ends at `end` is followed by the head of a record, or by nothing."""
    if end == size:
        return True
    head = _head_at(file, end)
    return head is not None and (head[0] in KNOWN or head[0] >= PRIVATE) and end + HEAD.size + head[1] <= size


def _cut_chunk_at(file: IO[bytes], offset: int, size: int) -> CutChunk | None:
    if magic_at(file, size - len(MAGIC)):  # this is how a whole file ends
        return None
    head = _head_at(file, offset)
    if head is None or head[0] != Opcode.CHUNK or offset + HEAD.size + head[1] <= size:
        return None
    if head[1] > LARGEST_RECORD or not _may_be_read(file, *head):
        return None
    return CutChunk(offset, _read(file, offset + HEAD.size, size - offset - HEAD.size))


def _head_at(file: IO[bytes], offset: int) -> tuple[int, int] | None:
    """Opcode and length [B]."""
    data = _read(file, offset, HEAD.size)
    if len(data) < HEAD.size:
        return None
    opcode, length = HEAD.unpack(data)
    return opcode, length


def _may_be_read(file: IO[bytes], opcode: int, length: int) -> bool:
    """Whether a record's beginning, behind which the file stands, fits its length; before a long one is read."""
    if length > LARGEST_RECORD:
        return False
    if opcode == Opcode.MESSAGE:
        return length >= MESSAGE_HEAD
    if opcode != Opcode.CHUNK:
        return opcode in KNOWN or opcode >= PRIVATE
    head = file.read(CHUNK_HEAD.size)
    if len(head) < CHUNK_HEAD.size:
        return False
    name_length = CHUNK_HEAD.unpack(head)[-1]
    if name_length > LONGEST_NAME:
        return False
    rest = file.read(name_length + 8)[name_length:]
    return len(rest) == 8 and int.from_bytes(rest, "little") == length - CHUNK_HEAD.size - name_length - 8


def magic_at(file: IO[bytes], offset: int) -> int:
    """Length [B] of the magic at `offset`; 0 if there is none."""
    return len(MAGIC) if offset >= 0 and _read(file, offset, len(MAGIC)) == MAGIC else 0


def _read(file: IO[bytes], offset: int, length: int) -> bytes:
    file.seek(offset)
    return file.read(length)
