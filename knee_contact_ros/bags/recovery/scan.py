"""Goes through an MCAP file once, and finds where its messages lie and what is wrong with it."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from typing import IO

from mcap.opcode import Opcode
from mcap.records import ChunkIndex, Footer, Statistics

from knee_contact_ros.bags.recovery.catalogue import Catalogue
from knee_contact_ros.bags.recovery.chunks import (
    MESSAGE,
    MOST_RECORDS,
    Chunk,
    Unpacked,
    contents_of,
    read_chunk,
    unpack,
)
from knee_contact_ros.bags.recovery.records import HEAD, CutChunk, Hole, Record, magic_at, parsed, read_records
from knee_contact_ros.bags.recovery.segments import ChunkFacts, Pending, Segment

FOOTER_SIZE = 29
"""[B]"""
MOST_GROWTH = 200
"""Times the file's size that its chunks may hold altogether; recordings of motion take a tenth at best"""
LITTLE = 2**26
"""[B] that they may hold whatever the file's size"""
LITTLE_RECORDS = 2**21
"""Records that the chunks of a file may hold whatever its size; of more, each takes a byte of the file"""
LONGEST_RUN = 2**20
"""[B] of messages outside chunks that are read at once"""
Advance = Callable[[int, int], None]
"""Told how many bytes are done, and how many there are"""


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
        self._pending: Pending | None = None
        self._run: Pending | None = None
        self._behind_hole = False
        self._index_fits = False  # a message index may come here
        self._unpacking = max(MOST_GROWTH * size, LITTLE)  # [B] that chunks may still hold
        self._records = size + LITTLE_RECORDS  # that chunks may still hold
        for piece in read_records(file, size):
            self._take(piece)
            advance(piece.offset, size)
        self._close()
        self._drop_debris()
        if not self.footer or not magic_at(file, self.footer[0] + FOOTER_SIZE):
            self.faults.insert(0, "the end is missing: the recording was cut off")

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
        data, fault, made = self._unpacked(chunk, cut)
        self._unpacking -= made
        if not cut:
            length = HEAD.size + len(content)
            self.chunks.append(ChunkFacts(offset, length, chunk.compression, len(chunk.data), chunk.size))
        pending = Pending(offset, offset + HEAD.size + len(content), checked=bool(chunk.checksum), cut=cut)
        most = min(MOST_RECORDS, self._records)
        contents = contents_of(data, most)
        self._records -= contents.records
        pending.messages = contents.messages
        if contents.records > most:
            fault, cut = f"holds more than {most} records", False
        usable = cut or not fault
        for record in contents.others:
            self.catalogue.add(record, doubtful=not usable)
        if not usable:
            self.unread += len(content)
            self.faults.append(f"the chunk at byte {offset} {fault}; its {len(content)} bytes are left out")
            return
        if cut:
            self.faults.append(f"the chunk at byte {offset} is cut off; {len(pending.messages)} messages could be read")
        elif contents.end != len(data):
            self.faults.append(
                f"the chunk at byte {offset} ends in {len(data) - contents.end} bytes that are no records"
            )
        self._pending = pending

    def _unpacked(self, chunk: Chunk, cut: bool) -> Unpacked:
        if chunk.size > self._unpacking:
            return Unpacked(b"", f"is one too many: they hold more than {MOST_GROWTH} times the file")
        return unpack(chunk, cut=cut)

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
            self._run = Pending(record.offset, record.end, checked=False)
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

    def _left_out(self, pending: Pending) -> frozenset[int]:
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
