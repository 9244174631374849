"""Goes through an MCAP file once, and finds where its messages lie and what is wrong with it."""

from __future__ import annotations

import zlib
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import IO, NamedTuple

from mcap.opcode import Opcode
from mcap.records import ChunkIndex, Footer, MessageIndex, Statistics

from knee_contact_ros.salvage.catalogue import Catalogue
from knee_contact_ros.salvage.chunks import MESSAGE, is_message, read_chunk, records_in, unpack
from knee_contact_ros.salvage.records import HEAD, CutChunk, Hole, Record, parsed, read_records

LONGEST_RUN = 2**20
"""[B] of messages outside chunks that are read at once"""
Advance = Callable[[int, int], None]
"""Told how many bytes are done, and how many there are"""


class Segment(NamedTuple):
    """A piece of the file that is read at once: a chunk, or messages outside chunks."""

    first: int
    """Smallest log time [ns]"""
    last: int
    """Largest one"""
    offset: int
    end: int
    """[B]"""
    counts: Counter[int]
    """Messages by channel"""
    left_out: frozenset[int]
    """Where in the chunk messages begin that are not trusted"""
    cut: bool = False
    loose: bool = False
    """Outside chunks"""
    behind_hole: bool = False
    """Nobody knows whether a loose one is not part of a broken chunk"""


@dataclass
class ChunkFacts:
    """What the index of chunks should say of one."""

    offset: int
    length: int
    compression: str
    compressed_size: int
    size: int
    indexes: dict[int, int] = field(default_factory=dict)
    """Where the index of each channel's messages begins"""
    indexes_length: int = 0


class _Pending:
    """A segment in the making: its messages by offset, with channel and log time."""

    def __init__(self, offset: int, end: int, *, checked: bool, cut: bool = False) -> None:
        self.offset, self.end, self.checked, self.cut = offset, end, checked, cut
        self.messages: dict[int, tuple[int, int]] = {}
        self.indexed: set[int] = set()  # channels that the index names
        self.listed: set[int] = set()  # offsets that the index gives as they are
        self.wrong = 0  # entries that are not as the index says

    def compare(self, index: MessageIndex) -> None:
        """Take a message index of the chunk."""
        self.indexed.add(index.channel_id)
        for log_time, offset in index.records:
            if self.messages.get(offset) == (index.channel_id, log_time):
                self.listed.add(offset)
            else:
                self.wrong += 1

    def not_as_listed(self) -> frozenset[int]:
        """Offsets of the messages that an index should give, and does not."""
        return frozenset(
            offset
            for offset, (channel, _) in self.messages.items()
            if channel in self.indexed and offset not in self.listed
        )

    def segment(self, left_out: frozenset[int], **kind: bool) -> Segment | None:
        """The segment, without some messages; None if there are no others."""
        kept = [message for offset, message in self.messages.items() if offset not in left_out]
        if not kept:
            return None
        times = [log_time for _, log_time in kept]
        counts = Counter(channel for channel, _ in kept)
        return Segment(min(times), max(times), self.offset, self.end, counts, left_out, self.cut, **kind)


class Scan:
    """What was found; all offsets and lengths are in bytes, all times in ns."""

    def __init__(self, file: IO[bytes], size: int, advance: Advance) -> None:
        """Go through the file."""
        self.profile: str | None = None
        self.catalogue = Catalogue()
        self.segments: list[Segment] = []
        self.compression: str | None = None
        """Of the first chunk"""
        self.metadata: list[int] = []
        self.attachments: list[int] = []
        self.faults: list[str] = []
        self.unread = 0
        """Bytes that are of no use"""
        self.chunks: list[ChunkFacts] = []
        """Of all chunks, damaged or not"""
        self.data_end: tuple[int, int] | None = None
        """Offset and checksum of the data section"""
        self.footer: tuple[int, Footer] | None = None
        self.statistics: Statistics | None = None
        self.chunk_indexes: list[ChunkIndex] = []
        self._pending: _Pending | None = None
        self._run: _Pending | None = None
        self._behind_hole = False
        self._index_fits = False  # a message index may come here
        for piece in read_records(file, size):
            self._take(piece)
            advance(piece.offset, size)
        self._close()
        self._drop_debris()
        if not self.footer:
            self.faults.append("the end is missing: the recording was cut off")

    def _take(self, piece: Record | CutChunk | Hole) -> None:
        if isinstance(piece, Record) and piece.opcode == Opcode.MESSAGE_INDEX:
            self._index(piece)
            return
        if isinstance(piece, Record) and piece.opcode == Opcode.MESSAGE:
            self._loose(piece)
            return
        self._close()
        self._index_fits = not isinstance(piece, Record) or piece.opcode == Opcode.CHUNK
        if isinstance(piece, Hole):
            self._hole(piece)
        elif isinstance(piece, CutChunk):
            self._chunk(piece.offset, piece.content, cut=True)
        elif piece.opcode == Opcode.CHUNK:
            self._chunk(piece.offset, piece.content, cut=False)
        else:
            self._other(piece)

    def _other(self, record: Record) -> None:
        """Take a record that holds no messages."""
        if record.opcode == Opcode.METADATA:
            self.metadata.append(record.offset)
            return
        if record.opcode == Opcode.ATTACHMENT:
            self._attachment(record)
            return
        self.catalogue.add(record, in_summary=self.data_end is not None)
        match record.opcode, parsed(record):
            case Opcode.HEADER, header if self.profile is None:
                self.profile = header.profile
            case Opcode.DATA_END, end:
                self.data_end = record.offset, end.data_section_crc
            case Opcode.FOOTER, footer:
                self.footer = record.offset, footer
            case Opcode.STATISTICS, statistics:
                self.statistics = statistics
            case Opcode.CHUNK_INDEX, index:
                self.chunk_indexes.append(index)
            case _:
                pass

    def _attachment(self, record: Record) -> None:
        checksum = int.from_bytes(record.content[-4:], "little")
        if checksum and zlib.crc32(record.content[:-4]) != checksum:
            self.unread += len(record.content)
            self.faults.append(f"the attachment at byte {record.offset} does not fit its checksum; it is left out")
        else:
            self.attachments.append(record.offset)

    def _hole(self, hole: Hole) -> None:
        self._behind_hole = True
        self.unread += hole.length
        what = "an unfinished record" if hole.cut else "no records"
        self.faults.append(f"{hole.length} bytes from byte {hole.offset} on are {what}")

    def _chunk(self, offset: int, content: bytes, *, cut: bool) -> None:
        chunk = read_chunk(content)
        self.compression = chunk.compression if self.compression is None else self.compression
        data, fault = unpack(chunk, cut=cut)
        if not cut:
            length = HEAD.size + len(content)
            self.chunks.append(ChunkFacts(offset, length, chunk.compression, len(chunk.data), chunk.size))
        pending = _Pending(offset, offset + HEAD.size + len(content), checked=bool(chunk.checksum), cut=cut)
        usable, end = cut or not fault, 0
        for record in records_in(data):
            end = record.end
            if is_message(record):
                channel, _, log_time, _ = MESSAGE.unpack_from(record.content)
                pending.messages[record.offset] = channel, log_time
            else:
                self.catalogue.add(record, doubtful=not usable)
        if not usable:
            self.unread += len(content)
            self.faults.append(f"the chunk at byte {offset} {fault}; its {len(content)} bytes are left out")
            return
        if cut:
            self.faults.append(f"the chunk at byte {offset} is cut off; {len(pending.messages)} messages could be read")
        elif end != len(data):
            self.faults.append(f"the chunk at byte {offset} ends in {len(data) - end} bytes that are no records")
        self._pending = pending

    def _index(self, record: Record) -> None:
        if not self._index_fits:
            self.faults.append(f"the index at byte {record.offset} belongs to no chunk")
            return
        index = parsed(record)
        if self.chunks:
            self.chunks[-1].indexes[index.channel_id] = record.offset
            self.chunks[-1].indexes_length += record.end - record.offset
        if self._pending:
            self._pending.compare(index)

    def _loose(self, record: Record) -> None:
        """Take a message outside chunks."""
        if self._run is None or record.offset - self._run.offset > LONGEST_RUN:
            self._close()
            self._run = _Pending(record.offset, record.end, checked=False)
        channel, _, log_time, _ = MESSAGE.unpack_from(record.content)
        self._run.messages[record.offset] = channel, log_time
        self._run.end = record.end

    def _close(self) -> None:
        """Finish the segment in the making."""
        pending, run, segment = self._pending, self._run, None
        self._pending = self._run = None
        if run:
            segment = run.segment(frozenset(), loose=True, behind_hole=self._behind_hole)
        elif pending:
            segment = pending.segment(self._left_out(pending))
        if segment:
            self.segments.append(segment)

    def _left_out(self, pending: _Pending) -> frozenset[int]:
        """The messages that are not trusted: no checksum covers them, and the index has them otherwise."""
        missing = pending.not_as_listed()
        if not missing and not pending.wrong:
            return frozenset()
        where = f"the index of the chunk at byte {pending.offset} does not fit it"
        if pending.checked:
            self.faults.append(where)
            return frozenset()
        self.faults.append(f"{where}, which has no checksum; {len(missing)} messages are left out")
        return missing

    def _drop_debris(self) -> None:
        """In a file of chunks, messages behind a hole are what is left of a broken chunk: no checksum covers them."""
        if all(segment.loose for segment in self.segments):
            return
        debris = [segment for segment in self.segments if segment.behind_hole]
        if debris:
            count = sum(segment.counts.total() for segment in debris)
            self.unread += sum(segment.end - segment.offset for segment in debris)
            self.faults.append(f"{count} messages of broken chunks are left out: no checksum covers them")
            self.segments = [segment for segment in self.segments if not segment.behind_hole]
