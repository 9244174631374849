"""The content of an MCAP file, whole or damaged, in one pass over its records. Unusable bytes are reported."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from functools import lru_cache
from io import BytesIO
from itertools import groupby, islice
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple

import lz4.frame
import numpy as np
import zstandard
from mcap import records as mcap
from mcap.opcode import Opcode
from numpy.typing import NDArray
from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat

from ..streams.columns import Column
from ..streams.topics import NO_DEFINITION
from ..system.files import open_regular
from ..system.progress import OnProgress, no_progress
from .bag_file import BagFile, Batch, Channel, Chunk
from .mcap_records import (
    ALLOWED_SIZE,
    HOLE,
    LARGEST_CHUNK,
    FileRecord,
    RecordReader,
    parsed,
)
from .mcap_writer import MESSAGE_HEAD, MESSAGE_PREFIX, RECORD_HEAD

MESSAGE_HEADS = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log", "<u8"),
        ("publish", "<u8"),
    ]
)
"""Layout `MESSAGE_HEAD` as a NumPy type"""
MESSAGE_HEAD_BYTES = np.dtype(f"V{MESSAGE_HEAD.size}")
"""Head of a message as one item, for fast copies"""
RECORD_LENGTH = struct.Struct("<xQ")
"""Head of a record: length [B] of its content, after the opcode"""
MAX_RECORDS = 2**20
"""Largest number of records in a chunk"""
MAX_GROWTH = 200
"""Largest uncompressed size of all chunks, as a multiple of the file's size: recordings of motion reach ten"""
LOOSE_MESSAGES = 64
"""Number of messages outside chunks that are read at a time"""
DECOMPRESSORS: dict[str, Callable[[bytes], Any]] = {
    "": BytesIO,
    "zstd": lambda data: zstandard.ZstdDecompressor().stream_reader(data),
    "lz4": lambda data: lz4.frame.LZ4FrameFile(BytesIO(data)),
}
"""Streams of uncompressed data by the name of the compression"""
DECOMPRESSION_ERRORS = (zstandard.ZstdError, RuntimeError, EOFError, MemoryError)
"""Errors of these streams"""
NO_SCHEMA = mcap.Schema(id=0, data=b"", encoding="", name="")
"""Schema of a channel that has none"""
DEFINITION_FORMATS = {
    "ros2msg": MessageDefinitionFormat.MSG,
    "ros2idl": MessageDefinitionFormat.IDL,
}
"""Format of a definition by the encoding of its schema"""


class DamagedError(Exception):
    """A chunk cannot be used; the message says why, after "the chunk"."""


class McapFile(BagFile):
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
        self.unread_bytes = 0
        """Number of bytes that could not be used"""
        self.declared: dict[int, tuple[mcap.Channel, mcap.Schema]] = {}
        """Channels by their ids as the file declares them, each with its schema, or `NO_SCHEMA`"""
        self.statistics: mcap.Statistics | None = None
        """Statistics according to the summary"""
        self._others: list[int] = []  # offsets [B] of metadata and attachments
        self._declarations: dict[tuple[type, int], Any] = {}  # schemas and channels by their ids
        self._doubtful: dict[tuple[type, int], Any] = {}  # those of damaged chunks
        self._lost: list[tuple[int, int, str]] = []  # bytes from and to, and why they are lost
        self._latest: dict[int, int] = {}  # log time [ns] of the last message of each channel
        self._bytes_left = max(MAX_GROWTH * self.size, ALLOWED_SIZE)
        self._has_header = False
        self._has_end = False
        self._records = RecordReader(open_regular(path), self.size)
        self.close = self._records.file.close
        try:
            for opcode, run in groupby(self._records.records(), key=attrgetter("opcode")):
                together = LOOSE_MESSAGES if opcode == Opcode.MESSAGE else 1
                while part := list(islice(run, together)):
                    first = part[0]
                    advance(first.offset, self.size)
                    if opcode == Opcode.MESSAGE:
                        begin, end = first.offset, part[-1].end
                        self._add_chunk(Chunk(begin, end, begin, end - begin))
                    elif opcode == Opcode.CHUNK:
                        self._add_chunk(first.content)
                    else:
                        self._add_record(first)
            self._match_channels()
            self._sum_faults()
        except BaseException:
            self.close()
            raise

    def read_chunk(self, chunk: Chunk, numbers: Mapping[int, int]) -> Batch:
        """Read the messages of a chunk; see `BagFile.read_chunk`."""
        own = numbers.keys() & chunk.counts.keys()
        number_of = np.full(max(chunk.counts) + 1, -1, np.intp)
        number_of[list(own)] = [numbers[channel] for channel in own]
        content = self._content_of(chunk)
        number = number_of[content.heads["channel"]]
        batch = Batch(number, content.heads["log"], content.messages)
        return batch.select(np.flatnonzero(number >= 0))

    def in_file_order(
        self,
    ) -> Iterator[tuple[int, mcap.Message | mcap.Metadata | mcap.Attachment]]:
        """Yield messages, metadata and attachments in the order of the file, with the offset [B] of their record."""
        chunks = {chunk.offset: chunk for chunk in self.chunks}
        for offset in sorted([*chunks, *self._others]):
            if offset not in chunks:
                if record := self._records.record_at(offset):
                    yield offset, record.content
                continue
            heads, messages, *_ = self._content_of(chunks[offset])
            rows = heads[["channel", "sequence", "log", "publish"]].tolist()
            for row, data in zip(rows, messages, strict=True):
                channel, sequence, log_time, publish_time = row
                if channel in self.declared:
                    yield offset, mcap.Message(channel, log_time, data, publish_time, sequence)

    def _add_chunk(self, chunk: Chunk) -> None:
        """Add the records of a chunk, or note why it is left out."""
        if chunk.uncompressed_size > self._bytes_left:
            reason = f"the chunk is one too many: they hold more than {MAX_GROWTH} times the file"
            self._lost.append((chunk.offset, chunk.end, reason))
            return
        self._bytes_left -= chunk.uncompressed_size
        try:
            content = self._content_of(chunk)
        except DamagedError as fault:
            self._lost.append((chunk.offset, chunk.end, f"the chunk {fault}"))
            with suppress(DamagedError):
                data = self._uncompressed(chunk._replace(is_cut=True))
                for record in filter(None, chunk_content(data, is_cut=True).declarations):
                    self._doubtful.setdefault((type(record), record.id), record)
            return
        for record in content.declarations:
            self._declare(record)
        heads = content.heads
        where = f"the chunk at byte {chunk.offset}"
        if chunk.is_cut:
            self._note(f"{where} is cut off; {len(heads)} of its messages are read")
        if not len(heads):
            return
        order = np.argsort(heads["channel"], kind="stable")
        channels = heads["channel"][order]
        times = heads["log"][order]
        begins = np.flatnonzero(np.diff(channels, prepend=-1))
        counts = dict[int, int]()
        for channel, own in zip(
            channels[begins].tolist(), np.split(times, begins[1:]), strict=True
        ):
            first = int(own[0])
            self.goes_back |= first < self._latest.get(channel, 0)
            self.goes_back |= bool((own[1:] < own[:-1]).any())
            self._latest[channel] = int(own[-1])
            counts[channel] = len(own)
        span = int(times.min()), int(times.max())
        is_unchecked = chunk.compression is not None and not (chunk.checksum or chunk.is_cut)
        if is_unchecked and span != chunk.times:
            self._note(f"{where}, which has no checksum, has other times than its messages")
        starts = content.message_starts
        self.chunks.append(chunk._replace(times=span, counts=counts, message_starts=starts))

    def _content_of(self, chunk: Chunk) -> ChunkContent:
        """Return the records of a chunk.

        Raises:
            DamagedError: They cannot be decompressed, do not fit size or checksum, or are too many or not records.
        """
        return chunk_content(self._uncompressed(chunk), chunk.is_cut, chunk.message_starts)

    def _uncompressed(self, chunk: Chunk) -> bytes:
        """Return the uncompressed records of a chunk; if it is cut off, the beginning that can be decompressed.

        Raises:
            DamagedError: They cannot be decompressed, or do not fit their size or checksum.
        """
        if (compression := chunk.compression or "") not in DECOMPRESSORS:
            raise DamagedError(f"has the unknown compression {compression!r}")
        if max(chunk.uncompressed_size, chunk.end - chunk.records_begin) > LARGEST_CHUNK:
            raise DamagedError(
                f"holds more than {LARGEST_CHUNK} bytes; another tool may write it again in smaller chunks"
            )
        compressed = self._records.bytes_between(chunk.records_begin, chunk.end)
        stream = DECOMPRESSORS[compression](compressed)
        parts = list[bytes]()
        left = chunk.uncompressed_size
        try:
            # Without any bytes, `read1` of zstandard would never return.
            while compressed and left >= 0 and (part := stream.read1(left or 1)):
                parts.append(part)
                left -= len(part)
        except DECOMPRESSION_ERRORS as error:
            if not chunk.is_cut:
                reason = " ".join(str(error).split())
                raise DamagedError(f"does not decompress ({reason})") from None
        data = b"".join(parts)
        if not chunk.is_cut:
            if left:
                raise DamagedError(f"does not hold {chunk.uncompressed_size} bytes")
            if chunk.checksum and zlib.crc32(data) != chunk.checksum:
                raise DamagedError("does not fit its checksum")
        return data

    def _declare(self, record: mcap.Schema | mcap.Channel | None) -> None:
        """Add a schema or channel."""
        if record is None:
            self._note("a topic's or a type's declaration cannot be read")
        elif self._declarations.setdefault((type(record), record.id), record) != record:
            self._note("topics are declared in contradictory ways; the first one counts")

    def _add_record(self, record: FileRecord) -> None:
        """Add a record that is not in a chunk."""
        match content := record.content:
            case mcap.Schema() | mcap.Channel():
                self._declare(content)
            case mcap.Metadata():
                self._others.append(record.offset)
                self.metadata.append(content)
            case mcap.Attachment():
                self._others.append(record.offset)
            case mcap.Statistics():
                self.statistics = content
            case mcap.Header():
                self.profile = content.profile
                self._has_header = True
                self.library = content.library
            case mcap.DataEnd() | mcap.Footer():
                self._check_section(record)
            case None if record.opcode == HOLE:
                self._lost.append((record.offset, record.end, "they are no valid records"))

    def _check_section(self, end: FileRecord) -> None:
        """Check the data section or the summary section by the checksum in the record that ends it."""
        if isinstance(end.content, mcap.Footer):
            self._has_end = bool(self._records.magic_length_at(end.end))
            if not self._records.fits_summary(end):
                self._note("the summary does not fit its checksum or its place")
            return
        checksum = end.content.data_section_crc
        if checksum and checksum != self._records.checksum_between(0, end.offset):
            self._note("the data do not fit their checksum")

    def _match_channels(self) -> None:
        """Match channels with their schemas."""
        found = self._doubtful | self._declarations | {(mcap.Schema, 0): NO_SCHEMA}
        for (kind, channel_id), record in found.items():
            if kind is mcap.Channel and (schema := found.get((mcap.Schema, record.schema_id))):
                self.declared[channel_id] = record, schema
                self.channels[channel_id] = Channel(
                    record.topic,
                    schema.name,
                    record.message_encoding,
                    definition_of(schema.encoding, schema.data),
                )

    def _sum_faults(self) -> None:
        """Add the faults of the whole file."""
        self.unread_bytes = sum(end - begin for begin, end, _ in self._lost)
        lost = [
            f"bytes {begin} to {end} cannot be read: {reason}"
            for begin, end, reason in sorted(self._lost)
        ]
        self.faults = [*lost, *self.faults]
        if doubtful := sorted(
            channel.topic
            for channel_id, (channel, _) in self.declared.items()
            if (mcap.Channel, channel_id) not in self._declarations
        ):
            self._note(f"only a damaged chunk declares {', '.join(doubtful)}")
        total = self.note_undeclared()
        if self.statistics:
            expected = self.statistics.message_count
            if total < expected:
                self._note(f"{expected - total} of {expected} messages are missing")
            elif total > expected:
                self._note("the statistics do not fit")
        if not self._has_end and (self._has_header or self.declared):
            self.faults.insert(0, "the end is missing: the recording was cut off")
        if not self._has_header:
            self.faults.insert(0, "the beginning is damaged, or this is no MCAP file")
            encodings = {channel.message_encoding for channel, _ in self.declared.values()}
            self.profile = "ros2" if encodings == {"cdr"} else ""

    def _note(self, fault: str) -> None:
        """Add a fault unless it is known already."""
        if fault not in self.faults:
            self.faults.append(fault)


class ChunkContent(NamedTuple):
    """Records of a chunk with n messages; arrays have shape (n,)."""

    heads: NDArray[Any]
    """Heads of the messages, as `MESSAGE_HEADS`"""
    messages: Column
    """Encoded messages"""
    declarations: list[Any]
    """Schemas and channels; None for one that cannot be read"""
    message_starts: NDArray[np.uint32]
    """Offsets [B] of the message records"""


def chunk_content(
    data: bytes, is_cut: bool = False, message_starts: NDArray[np.uint32] | None = None
) -> ChunkContent:
    """Return the messages, schemas and channels in `data`; if it is cut off, the whole ones at its beginning.

    If the offsets of the messages are known (`message_starts`), nothing else is searched.

    Raises:
        DamagedError: There are too many records, or bytes that are not records.
    """
    declarations = list[Any]()
    if message_starts is None:
        starts, end = _record_starts(data)
        if end != len(data) and not is_cut:
            raise DamagedError(f"ends in {len(data) - end} bytes that are not records")
        opcodes = np.frombuffer(data, np.uint8)[starts]
        ends = np.append(starts[1:], end)
        declared = np.flatnonzero((opcodes == Opcode.SCHEMA) | (opcodes == Opcode.CHANNEL))
        declarations = [parsed(data[starts[i] : ends[i]]) for i in declared.tolist()]
        message_starts = starts[opcodes == Opcode.MESSAGE].astype(np.uint32)
    begins = message_starts.astype(np.int64)
    count = max(len(data) - MESSAGE_HEAD.size + 1, 0)
    windows = np.ndarray(count, MESSAGE_HEAD_BYTES, data, strides=(1,))
    heads = windows[begins].view(MESSAGE_HEADS)
    ends = begins + heads["length"].astype(np.int64) + RECORD_HEAD.size
    messages = Column(data, begins + MESSAGE_HEAD.size, ends)
    return ChunkContent(heads, messages, declarations, message_starts)


def _record_starts(data: bytes) -> tuple[NDArray[np.int64], int]:
    """Return the offsets [B] of the whole records at the beginning of `data`, shape (n,), and the end of the last one.

    Raises:
        DamagedError: There are too many.
    """
    starts = list[int]()
    position = 0
    last = len(data) - RECORD_HEAD.size
    length_at = RECORD_LENGTH.unpack_from
    while position <= last:
        starts.append(position)
        position += RECORD_HEAD.size + length_at(data, position)[0]
        if len(starts) > MAX_RECORDS:
            raise DamagedError(
                f"holds more than {MAX_RECORDS} records; another tool may write it again in smaller chunks"
            )
    if position > len(data):
        position = starts.pop()
    places = np.fromiter([*starts, position], np.int64, len(starts) + 1)
    opcodes = np.frombuffer(data, np.uint8)[places[:-1]]
    lengths = np.diff(places) - RECORD_HEAD.size
    bad = (opcodes == HOLE) | ((opcodes == Opcode.MESSAGE) & (lengths < MESSAGE_PREFIX.size))
    count = int(bad.argmax()) if bad.any() else len(starts)
    return places[:count], int(places[count])


@lru_cache(maxsize=64)  # thousands of channels may share a schema of a megabyte
def definition_of(encoding: str, text: bytes) -> MessageDefinition:
    """Return the definition of a type from the encoding and the text of its schema."""
    if encoding not in DEFINITION_FORMATS:
        return NO_DEFINITION
    return MessageDefinition(DEFINITION_FORMATS[encoding], text.decode("utf-8", "replace"))
