"""The content of an MCAP file, whole or damaged, in one pass over its records.

Lengths in records are not trusted: a record counts if its content has exactly its length. If the summary fits its
checksum, its index of chunks is a second source for a chunk with a wrong head. After any other damage, reading
continues at the record to which the length leads, or at the next chunk. Unusable bytes are reported.
"""

from __future__ import annotations

import re
import struct
import zlib
from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from functools import lru_cache
from io import BytesIO
from itertools import groupby, islice
from operator import attrgetter
from pathlib import Path
from typing import IO, Any, NamedTuple

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Message,
    Metadata,
    Schema,
    Statistics,
)
from mcap.stream_reader import StreamReader
from numpy.typing import NDArray
from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat

from knee_contact_ros.bags.columns import MESSAGE_HEADS, Batch, Connection, File, Segment
from knee_contact_ros.bags.recorder import HEAD, MAGIC, MESSAGE, MESSAGE_HEAD
from knee_contact_ros.streams.columns import Column
from knee_contact_ros.streams.output import LOAD_PROVENANCE, PROVENANCE
from knee_contact_ros.streams.topics import NO_DEFINITION
from knee_contact_ros.system.files import open_regular
from knee_contact_ros.system.progress import OnProgress, no_progress

MESSAGE_OPCODE, SCHEMA, CHANNEL = int(Opcode.MESSAGE), int(Opcode.SCHEMA), int(Opcode.CHANNEL)
HOLE, PRIVATE = 0, 0x80
"""Instead of an opcode: bytes that are not records; and the first opcode of applications' private records"""
CHUNK_HEAD = struct.Struct("<BQQQQII")
"""Beginning of a chunk: opcode, length, smallest and largest log time [ns], uncompressed size [B], CRC-32 of the
records, and length [B] of the name of the compression, which follows with the compressed size"""
CHUNK_OR_DATA_END = re.compile(rb"(?s)(?=\x06.{4}\x00{4}|\x0f\x04\x00{7})")
"""Head of a chunk of less than 4 GiB, or of the record that ends the data section"""
FOOTER_SIZE, LONGEST_NAME = 29, 16
"""Sizes [B] of the footer record, and of the longest name of a compression"""
LARGEST, MOST_RECORDS = 2**30, 2**20
"""Largest size [B] of a record, and of the records in a chunk; largest number of these"""
MOST_GROWTH, ALLOWED_SIZE = 200, 2**26
"""Largest uncompressed size of all chunks: a multiple of the file's size (recordings of motion reach ten), and a size
[B] that is always allowed"""
BLOCK, LOOSE = 2**20, 64
"""Bytes searched or summed at a time; messages outside chunks read at a time"""
NOT_A_RECORD = (McapError, struct.error, UnicodeDecodeError, OverflowError)
"""Errors of `mcap` about bytes that are not records"""
UNPACKERS: dict[str, Callable[[bytes], Any]] = {
    "": BytesIO,
    "zstd": lambda data: zstandard.ZstdDecompressor().stream_reader(data),
    "lz4": lambda data: lz4.frame.LZ4FrameFile(BytesIO(data)),
}
"""Streams of uncompressed data by the name of the compression"""
BAD_DATA = (zstandard.ZstdError, RuntimeError, EOFError, MemoryError)
"""Errors of these streams"""
NO_SCHEMA = Schema(id=0, data=b"", encoding="", name="")
"""Schema of a channel that has none"""
FORMATS = {"ros2msg": MessageDefinitionFormat.MSG, "ros2idl": MessageDefinitionFormat.IDL}
"""Format of a definition by the encoding of its schema"""
"""Function that is called with the progress: work done, and work in all"""


class DamagedError(Exception):
    """A chunk cannot be used; the message says why, after "the chunk"."""


class Piece(NamedTuple):
    """Whole record of a file, or bytes that are not a record."""

    opcode: int
    """Opcode, or `HOLE`"""
    offset: int
    """Offset [B] of the beginning in the file"""
    end: int
    """Offset [B] of the end"""
    content: Any = None
    """Segment of a chunk; else the record as `mcap` parses it, but for messages, their index and private records"""


def parsed(data: bytes) -> Any:
    """Record as the `mcap` library parses it; None if that does not know it, or would not write the same bytes."""
    builder = RecordBuilder()
    try:
        record: Any = next(StreamReader(BytesIO(data), skip_magic=True).records)
        record.write(builder)
    except NOT_A_RECORD:
        return None
    written: bytes = builder.end()  # type: ignore[no-untyped-call]
    if isinstance(record, Attachment) and data.endswith(bytes(4)):  # it has no checksum
        written = written[:-4] + bytes(4)
    return record if written == data else None


class Records:
    """Records of an open MCAP file of `size` [B]."""

    def __init__(self, file: IO[bytes], size: int) -> None:
        self.file, self.size = file, size
        self._index: dict[int, ChunkIndex] = {}  # by the offsets of the chunks
        self._starts = [size]
        footer = self.record_at(max(size - len(MAGIC) - FOOTER_SIZE, 0))
        if (
            footer
            and isinstance(footer.content, Footer)
            and footer.content.summary_crc
            and self.fits_summary(footer)
        ):
            file.seek(footer.content.summary_start)
            with suppress(*NOT_A_RECORD):
                for record in StreamReader(
                    file, skip_magic=True, record_size_limit=ALLOWED_SIZE
                ).records:
                    if isinstance(record, ChunkIndex):
                        self._index[record.chunk_start_offset] = record
        self._starts = [*sorted(self._index), size]

    def read(self, offset: int, end: int) -> bytes:
        """Bytes between two offsets; fewer at the end of the file."""
        self.file.seek(offset)
        return self.file.read(max(end - offset, 0))

    def magic_at(self, offset: int) -> int:
        """Length [B] of the magic at `offset`; 0 if there is none."""
        return len(MAGIC) if self.read(offset, offset + len(MAGIC)) == MAGIC else 0

    def pieces(self) -> Iterator[Piece]:
        """Pieces of the file after its magic, in order, up to its end."""
        position = self.magic_at(0)
        while position < self.size:
            piece = self.record_at(position) or self._hole(position)
            yield piece
            position = piece.end
            if piece.opcode == Opcode.FOOTER:
                position += self.magic_at(position)

    def record_at(self, offset: int) -> Piece | None:
        """Record that begins at `offset`; None if there is no whole and valid one."""
        opcode, end = self._head(offset)
        if chunk := self._by_index(offset) or (
            self._chunk(offset) if opcode == Opcode.CHUNK else None
        ):
            return Piece(Opcode.CHUNK, offset, chunk.end, chunk)
        if not offset < end <= min(self._limit(offset), offset + LARGEST):
            return None
        if opcode in (Opcode.MESSAGE, Opcode.MESSAGE_INDEX) or opcode >= PRIVATE:
            follows = end > self.size - HEAD.size or self._may_begin(end)  # so its length is right
            return Piece(opcode, offset, end) if follows else None
        record = parsed(self.read(offset, end)) if opcode != Opcode.CHUNK else None
        return Piece(opcode, offset, end, record) if record else None

    def checksum(self, begin: int, end: int) -> int:
        """CRC-32 of the bytes between two offsets [B]."""
        checksum = 0
        for position in range(begin, end, BLOCK):
            checksum = zlib.crc32(self.read(position, min(position + BLOCK, end)), checksum)
        return checksum

    def fits_summary(self, footer: Piece) -> bool:
        """Whether the summary section fits the checksum in the footer, if that has one."""
        begin, checksum = footer.content.summary_start, footer.content.summary_crc
        return not (begin and checksum) or (
            begin <= footer.offset and self.checksum(begin, footer.end - 4) == checksum
        )

    def _by_index(self, offset: int) -> Segment | None:
        """Chunk at an offset according to the index; None if the index has none, or no checksum verifies it."""
        if not (index := self._index.get(offset)):
            return None
        end, place = offset + index.chunk_length, offset + CHUNK_HEAD.size - 8
        begin, checksum = (
            end - index.compressed_size,
            int.from_bytes(self.read(place, place + 4), "little"),
        )
        if not checksum or begin < place + 4 or end > self._limit(offset):
            return None
        return Segment(offset, end, begin, index.uncompressed_size, index.compression, checksum)

    def _chunk(self, offset: int) -> Segment | None:
        """Chunk at an offset according to its head; None without one.

        If its two lengths differ, that of its data counts if another record follows and a checksum confirms it.
        """
        head = self.read(offset, offset + CHUNK_HEAD.size + LONGEST_NAME + 8)
        if len(head) < CHUNK_HEAD.size + 8:
            return None
        _, length, *times, size, checksum, name = CHUNK_HEAD.unpack_from(head)
        begin, end = CHUNK_HEAD.size + name + 8, offset + HEAD.size + length
        data_end = offset + begin + int.from_bytes(head[begin - 8 : begin], "little")
        if begin > len(head):
            return None
        if end != data_end and not (
            checksum and data_end <= self._limit(offset) and self._may_begin(data_end)
        ):
            return None
        end = data_end
        compression = head[CHUNK_HEAD.size : begin - 8].decode("ascii", "replace")
        cut = end > self.size and not self.magic_at(max(self.size - len(MAGIC), 0))
        if end > self._limit(offset) and not cut:
            return None
        end = min(end, self.size)
        return Segment(
            offset, end, offset + begin, size, compression, checksum, cut, (times[0], times[1])
        )

    def _head(self, offset: int) -> tuple[int, int]:
        """Opcode at an offset, and the offset of the record's end by its length; 0 and `offset` without one."""
        head = self.read(offset, offset + HEAD.size)
        opcode, length = HEAD.unpack(head) if len(head) == HEAD.size else (0, -HEAD.size)
        return opcode, offset + HEAD.size + length

    def _may_begin(self, offset: int) -> bool:
        """Whether there is a plausible head of a record."""
        opcode, end = self._head(offset)
        return (0 < opcode <= Opcode.DATA_END or opcode >= PRIVATE) and end <= self._limit(offset)

    def _limit(self, offset: int) -> int:
        """Offset of the next chunk after `offset` that the index knows, or the size of the file."""
        return self._starts[min(bisect_right(self._starts, offset), len(self._starts) - 1)]

    def _hole(self, offset: int) -> Piece:
        """Bytes from `offset` that are not a record: up to where their length leads, or up to the next chunk."""
        _, end = self._head(offset)
        limit = self._limit(offset)
        if offset < end < limit and self._may_begin(end):
            return Piece(HOLE, offset, end)
        for begin in range(offset + 1, limit, BLOCK):
            block = self.read(begin, begin + BLOCK + HEAD.size)
            for candidate in CHUNK_OR_DATA_END.finditer(block, 0, BLOCK + HEAD.size):
                place = begin + candidate.start()
                record = self.record_at(place) if place < limit else None
                if record and (record.end == self.size or self._may_begin(record.end)):
                    return Piece(HOLE, offset, place)
        return Piece(HOLE, offset, limit)


class McapFile(File):
    """Checked MCAP file: its readable content, and its faults."""

    def __init__(self, path: Path, advance: OnProgress = no_progress) -> None:
        """Check the file; `advance` is called with the progress in bytes.

        Raises:
            OSError: The file cannot be read.
        """
        super().__init__(path)
        self.size = path.stat().st_size
        self.profile = ""
        """Profile according to the header; `ros2` if the header is damaged and all messages are CDR"""
        self.unread = 0
        """Number of bytes that could not be used"""
        self.streams: dict[int, tuple[Channel, Schema]] = {}
        """Channels by their numbers, each with its schema, or `NO_SCHEMA`"""
        self.promised: dict[int, int] | None = None
        """Number of messages of each channel according to the statistics record; None if there is none"""
        self._others: list[int] = []  # offsets [B] of metadata and attachments
        self._declared: dict[tuple[type, int], Any] = {}  # schemas and channels by type and number
        self._doubtful: dict[tuple[type, int], Any] = {}  # those of damaged chunks
        self._lost: list[
            tuple[int, int, str]
        ] = []  # bytes from and to that cannot be read, and why
        self._latest: dict[int, int] = {}  # log time [ns] of the last message of each channel
        self._bytes_left = max(MOST_GROWTH * self.size, ALLOWED_SIZE)
        self._begun = self._ended = False
        self._records = Records(open_regular(path), self.size)
        self.close = self._records.file.close
        try:
            for opcode, run in groupby(self._records.pieces(), key=attrgetter("opcode")):
                while part := list(islice(run, LOOSE if opcode == Opcode.MESSAGE else 1)):
                    first, *_, last = *part, part[-1]
                    advance(first.offset, self.size)
                    if opcode == Opcode.MESSAGE:
                        self._take(
                            Segment(first.offset, last.end, first.offset, last.end - first.offset)
                        )
                    elif opcode == Opcode.CHUNK:
                        self._take(first.content)
                    else:
                        self._take_other(first)
            self._conclude()
        except BaseException:
            self.close()
            raise

    def read(self, segment: Segment, numbers: Mapping[int, int]) -> Batch:
        """Messages of a segment; see `File.read`."""
        own = numbers.keys() & segment.counts.keys()
        number_of = np.full(max(segment.counts) + 1, -1, np.intp)
        number_of[list(own)] = [numbers[channel] for channel in own]
        heads, messages, *_ = self._contents(segment)
        batch = Batch(number_of[heads["channel"]], heads["log"], messages)
        return batch.part(np.flatnonzero(batch.numbers >= 0))

    def in_file_order(self) -> Iterator[tuple[int, Message | Metadata | Attachment]]:
        """Messages, metadata and attachments in the order of the file, with the offset [B] of the segment or record."""
        places = [(segment.offset, segment) for segment in self.segments] + [
            (offset, None) for offset in self._others
        ]
        for offset, segment in sorted(places, key=lambda place: place[0]):
            if segment is None:
                if record := self._records.record_at(offset):
                    yield offset, record.content
                continue
            heads, messages, *_ = self._contents(segment)
            rows = heads[["channel", "sequence", "log", "publish"]].tolist()
            for (channel, sequence, log_time, publish_time), data in zip(
                rows, messages, strict=True
            ):
                if channel in self.streams:
                    yield offset, Message(channel, log_time, data, publish_time, sequence)

    def _take(self, segment: Segment) -> None:
        """Add the records of a segment, or note why it is left out."""
        if segment.size > self._bytes_left:
            words = f"the chunk is one too many: they hold more than {MOST_GROWTH} times the file"
            self._lost.append((segment.offset, segment.end, words))
            return
        self._bytes_left -= segment.size
        try:
            heads, _, declarations, starts = self._contents(segment)
        except DamagedError as fault:
            self._lost.append((segment.offset, segment.end, f"the chunk {fault}"))
            with suppress(DamagedError):
                data = self._unpacked(segment._replace(cut=True))
                for record in filter(None, contents_of(data, cut=True).declarations):
                    self._doubtful.setdefault((type(record), record.id), record)
            return
        for record in declarations:
            self._declare(record)
        if segment.cut:
            self._note(
                f"the chunk at byte {segment.offset} is cut off; {len(heads)} of its messages are read"
            )
        if not len(heads):
            return
        order, counts = np.argsort(heads["channel"], kind="stable"), dict[int, int]()
        channels, times = heads["channel"][order], heads["log"][order]
        begins = np.flatnonzero(np.diff(channels, prepend=-1))
        for channel, own in zip(
            channels[begins].tolist(), np.split(times, begins[1:]), strict=True
        ):
            self.goes_back |= int(own[0]) < self._latest.get(channel, 0) or bool(
                (own[1:] < own[:-1]).any()
            )
            self._latest[channel], counts[channel] = int(own[-1]), len(own)
        span = int(times.min()), int(times.max())
        if (
            segment.compression is not None
            and not (segment.checksum or segment.cut)
            and span != segment.times
        ):
            self._note(
                f"the chunk at byte {segment.offset}, which has no checksum, has other times than its messages"
            )
        self.segments.append(segment._replace(times=span, counts=counts, starts=starts))

    def _contents(self, segment: Segment) -> Contents:
        """Records of a segment.

        Raises:
            DamagedError: They cannot be decompressed, do not fit size or checksum, or are too many or not records.
        """
        return contents_of(self._unpacked(segment), segment.cut, segment.starts)

    def _unpacked(self, segment: Segment) -> bytes:
        """Uncompressed records of a segment; if it is `cut` off, the beginning that can be unpacked.

        Raises:
            DamagedError: They cannot be decompressed, or do not fit their size or checksum.
        """
        if (compression := segment.compression or "") not in UNPACKERS:
            raise DamagedError(f"has the unknown compression {compression!r}")
        if segment.size > LARGEST:
            raise DamagedError(
                f"holds more than {LARGEST} bytes; another tool may write it again in smaller chunks"
            )
        stream = UNPACKERS[compression](self._records.read(segment.begin, segment.end))
        parts, left = list[bytes](), segment.size
        try:
            while part := stream.read1(left or 1):
                parts.append(part)
                left -= len(part)
                if left < 0:
                    break
        except BAD_DATA as error:
            if not segment.cut:
                raise DamagedError(
                    f"does not decompress ({' '.join(str(error).split())})"
                ) from None
        data = b"".join(parts)
        if left and not segment.cut:
            raise DamagedError(f"does not hold {segment.size} bytes")
        if segment.checksum and not segment.cut and zlib.crc32(data) != segment.checksum:
            raise DamagedError("does not fit its checksum")
        return data

    def _declare(self, record: Schema | Channel | None) -> None:
        """Add a schema or channel."""
        if record is None:
            self._note("a topic's or a type's declaration cannot be read")
        elif self._declared.setdefault((type(record), record.id), record) != record:
            self._note("topics are declared in contradictory ways; the first one counts")

    def _take_other(self, piece: Piece) -> None:
        """Add a record that belongs to no segment."""
        match piece.content:
            case Schema() | Channel():
                self._declare(piece.content)
            case Metadata() | Attachment():
                self._others.append(piece.offset)
                self.is_recording |= piece.content.name in (PROVENANCE, LOAD_PROVENANCE)
            case Statistics():
                self.promised = piece.content.channel_message_counts
            case Header():
                self.profile, self._begun = piece.content.profile, True
            case DataEnd():
                if piece.content.data_section_crc not in (
                    0,
                    self._records.checksum(0, piece.offset),
                ):
                    self._note("the data do not fit their checksum")
            case Footer():
                self._ended = bool(self._records.magic_at(piece.end))
                if not self._records.fits_summary(piece):
                    self._note("the summary does not fit its checksum or its place")
            case None if piece.opcode == HOLE:
                self._lost.append((piece.offset, piece.end, "they are no valid records"))

    def _conclude(self) -> None:
        """Match channels with their schemas, and add the faults of the whole file."""
        declared: dict[tuple[type, int], Any] = (
            {(Schema, 0): NO_SCHEMA} | self._doubtful | self._declared
        )
        for (kind, number), channel in declared.items():
            if kind is Channel and (schema := declared.get((Schema, channel.schema_id))):
                self.streams[number] = channel, schema
                definition = definition_of(schema.encoding, schema.data)
                self.connections[number] = Connection(
                    channel.topic, schema.name, channel.message_encoding, definition
                )
        self.unread = sum(end - begin for begin, end, _ in self._lost)
        lost = [
            f"bytes {begin} to {end} cannot be read: {reason}"
            for begin, end, reason in sorted(self._lost)
        ]
        self.faults = [*lost, *self.faults]
        if doubtful := sorted(
            stream.topic
            for number, (stream, _) in self.streams.items()
            if (Channel, number) not in self._declared
        ):
            self._note(f"only a damaged chunk declares {', '.join(doubtful)}")
        total = self.note_undeclared()
        if self.promised is not None and (promised := sum(self.promised.values())) != total:
            missing = f"{promised - total} of {promised} messages are missing"
            self._note(missing if promised > total else "the statistics do not fit")
        if not self._ended:
            self.faults.insert(0, "the end is missing: the recording was cut off")
        if not self._begun:
            self.faults.insert(0, "the beginning is damaged")
            encodings = {channel.message_encoding for channel, _ in self.streams.values()}
            self.profile = "ros2" if encodings == {"cdr"} else ""

    def _note(self, fault: str) -> None:
        """Add a fault unless it is known already."""
        if fault not in self.faults:
            self.faults.append(fault)


HEAD_BYTES = np.dtype(f"V{MESSAGE_HEAD.size}")
"""Head of a message as one item, for fast copies"""


class Contents(NamedTuple):
    """Messages, n of them, and declarations; arrays have shape (n,)."""

    heads: NDArray[Any]
    """Heads of the messages, as `MESSAGE_HEADS`"""
    messages: Column
    """Encoded messages"""
    declarations: list[Any]
    """Schemas and channels; None for one that cannot be read"""
    starts: NDArray[np.uint32]
    """Offsets [B] of the messages' records"""


def contents_of(
    data: bytes, cut: bool = False, starts: NDArray[np.uint32] | None = None
) -> Contents:
    """Messages, schemas and channels in `data`; if it is `cut` off, the whole ones at its beginning.

    `starts` are those of the messages (`starts_of`) if known; then nothing else is searched.

    Raises:
        DamagedError: There are too many records, or bytes that are not records.
    """
    declarations = list[Any]()
    if starts is None:
        places, end = starts_of(data)
        if end != len(data) and not cut:
            raise DamagedError(f"ends in {len(data) - end} bytes that are not records")
        opcodes, ends = np.frombuffer(data, np.uint8)[places], np.append(places[1:], end)
        declared = np.flatnonzero((opcodes == SCHEMA) | (opcodes == CHANNEL)).tolist()
        declarations = [parsed(data[places[i] : ends[i]]) for i in declared]
        starts = places[opcodes == MESSAGE_OPCODE].astype(np.uint32)
    begins = starts.astype(np.int64)
    windows = np.ndarray(max(len(data) - MESSAGE_HEAD.size + 1, 0), HEAD_BYTES, data, strides=(1,))
    heads = windows[begins].view(MESSAGE_HEADS)
    ends = begins + heads["length"].astype(np.int64) + HEAD.size
    return Contents(heads, Column(data, begins + MESSAGE_HEAD.size, ends), declarations, starts)


def starts_of(data: bytes) -> tuple[NDArray[np.int64], int]:
    """Offsets [B] of the whole records at the beginning of `data`, shape (n,), and the end of the last one.

    Raises:
        DamagedError: There are too many.
    """
    starts, position, last, length_at = list[int](), 0, len(data) - HEAD.size, LENGTH.unpack_from
    while position <= last:
        starts.append(position)
        position += HEAD.size + length_at(data, position)[0]
        if len(starts) > MOST_RECORDS:
            words = f"holds more than {MOST_RECORDS} records; another tool may write it again in smaller chunks"
            raise DamagedError(words)
    if position > len(data):
        position = starts.pop()
    places = np.fromiter([*starts, position], np.int64, len(starts) + 1)
    opcodes, lengths = (
        np.frombuffer(data, np.uint8)[places[:-1]],
        places[1:] - places[:-1] - HEAD.size,
    )
    bad = (opcodes == 0) | ((opcodes == MESSAGE_OPCODE) & (lengths < MESSAGE.size))
    count = int(bad.argmax()) if bad.any() else len(starts)
    return places[:count], int(places[count])


LENGTH = struct.Struct("<xQ")
"""Head of a record: length [B] of its content, after the opcode"""


@lru_cache(maxsize=64)  # thousands of channels may share a schema of a megabyte
def definition_of(encoding: str, text: bytes) -> MessageDefinition:
    """Definition of a type from the encoding and the text of its schema."""
    data = text.decode("utf-8", "replace")
    return MessageDefinition(FORMATS[encoding], data) if encoding in FORMATS else NO_DEFINITION
