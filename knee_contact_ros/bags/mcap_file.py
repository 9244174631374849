"""Reading of an MCAP file without trust in its summary: all records are checked once, and faults are reported."""

from __future__ import annotations

import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from heapq import heappop, heappush
from itertools import accumulate, zip_longest
from operator import attrgetter, itemgetter
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, DataEnd, Header, Metadata, Schema, Statistics

from knee_contact_ros.bags.batch import Batch
from knee_contact_ros.bags.mcap_chunks import (
    DECLARATIONS,
    Chunk,
    Contents,
    DamagedError,
    beginning_of,
    contents_of,
    read_chunk,
    records_in,
    unpack,
)
from knee_contact_ros.bags.mcap_layout import HEAD, MESSAGE
from knee_contact_ros.bags.mcap_records import (
    BLOCK,
    CutChunk,
    Hole,
    Piece,
    Record,
    magic_at,
    parsed,
    read_at,
    read_records,
    record_at,
    with_indices,
)
from knee_contact_ros.messages.column import Column
from knee_contact_ros.system.regular_file import open_regular

CHUNK, CUT_CHUNK, LOOSE = "chunk", "cut chunk", "loose"
"""Kinds of segments: a chunk, the beginning of a truncated chunk, messages outside chunks"""
MOST_GROWTH = 200
"""Largest uncompressed size of all chunks as a multiple of the file's size; recordings of motion reach ten"""
ALLOWED_SIZE = 2**26
"""Uncompressed size [B] of all chunks that is allowed in a file of any size"""
MOST_RECORDS = 2**20
"""Largest number of records in a chunk"""
ALLOWED_RECORDS = 2**21
"""Number of records in chunks that is allowed in a file of any size; each further one takes a byte of the file"""
LARGEST_LOOSE = 2**20
"""Size [B] of messages outside chunks at which the next of them begins another segment"""
CHANNELS = 2**16
"""Number of possible channels in a file"""
Advance = Callable[[int, int], None]
"""Function that is called with the progress: bytes done, and bytes in all"""


class Stream(NamedTuple):
    """Channel with its schema."""

    channel: Channel
    """Channel record"""
    schema: Schema | None
    """Schema record; None if the channel has no schema"""


class Message(NamedTuple):
    """Content of a message record."""

    channel: int
    """Number of the channel"""
    log_time: int
    """Log time [ns]"""
    data: bytes
    """Encoded message"""
    publish_time: int
    """Publish time [ns]"""
    sequence: int
    """Sequence number"""


class Segment(NamedTuple):
    """Piece of the file that is read at once: a chunk, or messages outside chunks."""

    offset: int
    """Offset [B] of the beginning in the file"""
    end: int
    """Offset [B] of the end in the file, without message indices"""
    size: int
    """Uncompressed size [B] of the records"""
    kind: str
    """One of `CHUNK`, `CUT_CHUNK` and `LOOSE`"""
    first: int
    """Smallest log time [ns] of the messages"""
    last: int
    """Largest log time [ns] of the messages"""
    counts: Counter[int]
    """Number of messages of each channel"""
    indices_end: int = 0
    """Offset [B] of the end of the message indices that follow a chunk; 0 if there are none"""


class McapFile:
    """Readable content of an MCAP file, and its faults."""

    def __init__(self, path: Path, advance: Advance = lambda _done, _total: None) -> None:
        """Check all records of the file once; `advance` is called with the progress.

        Raises:
            OSError: The file cannot be read.
        """
        self.path, self.size = path, path.stat().st_size
        self.faults: list[str] = []
        """Faults of the file, as sentences"""
        self.profile = ""
        """Profile according to the header; `ros2` if the header is damaged and all messages are CDR"""
        self.compression: str | None = None
        """Name of the first chunk's compression; None if there are no chunks"""
        self.unread = 0
        """Number of bytes that could not be used"""
        self.counts: Counter[int] = Counter()
        """Number of messages of each channel"""
        self.streams: dict[int, Stream] = {}
        """Channels by their numbers"""
        self._declared: dict[tuple[type, int], Any] = {}  # schemas and channels by type and number
        self._doubtful: dict[tuple[type, int], Any] = {}  # those of damaged chunks
        self._segments: list[Segment] = []
        self._others: list[int] = []  # offsets of metadata and attachments
        self._statistics: Statistics | None = None
        self._header = self._ended = False
        self._last_loose: Record | None = None
        self._before_last: Segment | None = None  # the segment before that message
        # what chunks may still hold: bytes and records
        self._bytes_left, self._records_left = max(MOST_GROWTH * self.size, ALLOWED_SIZE), self.size + ALLOWED_RECORDS
        self._file = open_regular(path)
        try:
            for piece, indices in with_indices(read_records(self._file, self.size)):
                self._take(piece, indices)
                advance(piece.offset, self.size)
        except BaseException:
            self._file.close()
            raise
        self._conclude()

    @property
    def promised(self) -> dict[int, int] | None:
        """Number of messages of each channel according to the statistics record; None if there is none."""
        return self._statistics.channel_message_counts if self._statistics else None

    @property
    def times(self) -> tuple[int, int] | None:
        """Smallest and largest log time [ns] of the messages; None if there are none."""
        segments = self._segments
        return (min(s.first for s in segments), max(s.last for s in segments)) if segments else None

    @property
    def at_once(self) -> int:
        """Largest number of bytes that are unpacked at one time when messages are read in the order of log time."""
        ends = [end for s in self._segments for end in ((s.first, s.size), (s.last + 1, -s.size))]
        return max(accumulate(size for _, size in sorted(ends)), default=0)

    def by_time(self, numbers: Mapping[int, int]) -> Iterator[Batch]:
        """Messages in the order of log time, at equal times in that of the file.

        Args:
            numbers: Number in the batches of each channel that is read.
        """
        number_of = np.full(CHANNELS, -1, np.intp)
        for channel, number in numbers.items():
            number_of[channel] = number
        segments = [segment for segment in self._segments if not numbers.keys().isdisjoint(segment.counts)]
        segments.sort(key=attrgetter("first", "offset"))
        waiting = list[tuple[int, int, Batch]]()  # rests of segments by time and offset
        for segment, following in zip_longest(segments, segments[1:]):
            data, contents = self._read(segment)
            messages = Column(data, contents.begins, contents.ends)
            batch = Batch(number_of[contents.heads["channel"]], contents.heads["log"], messages)
            batch = batch.part(np.flatnonzero(batch.numbers >= 0)).by_time()
            if waiting or (following and following.first <= segment.last):
                heappush(waiting, (int(batch.times[0]), segment.offset, batch))
                yield from _until(following, waiting)
            else:
                yield batch

    def in_file_order(self) -> Iterator[tuple[int, Message | Metadata | Attachment]]:
        """Messages, metadata and attachments in the order of the file, with the offset [B] of the segment or record."""
        entries: list[tuple[int, Segment | None]] = [(segment.offset, segment) for segment in self._segments]
        entries += [(offset, None) for offset in self._others]
        for offset, segment in sorted(entries, key=itemgetter(0)):
            if segment is None:
                yield offset, self._record(offset)
                continue
            data, contents = self._read(segment)
            heads = contents.heads[["channel", "sequence", "log", "publish"]].tolist()
            messages = Column(data, contents.begins, contents.ends)
            for (channel, sequence, log_time, publish_time), message in zip(heads, messages, strict=True):
                if channel in self.streams:
                    yield offset, Message(channel, log_time, message, publish_time, sequence)

    def metadata(self) -> Iterator[Metadata]:
        """Readable metadata records in the order of the file."""
        yield from (record for record in map(self._record, self._others) if isinstance(record, Metadata))

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _record(self, offset: int) -> Any:
        """Record at an offset, as the `mcap` library parses it; None if there is none."""
        record = record_at(self._file, offset, self.size)
        return parsed(record) if record else None

    def _read(self, segment: Segment) -> tuple[bytes, Contents]:
        """Uncompressed records of a segment, and where its messages are."""
        if segment.kind == LOOSE:
            data = read_at(self._file, segment.offset, segment.end - segment.offset)
            return data, contents_of(data, (), len(data))
        begin, end = segment.offset + HEAD.size, max(segment.indices_end, segment.end)
        content = read_at(self._file, begin, end - begin)
        record, rest = content[: segment.end - begin], content[segment.end - begin :]
        data = (unpack if segment.kind == CHUNK else beginning_of)(read_chunk(record))
        indices = [rest[first:last] for _, first, last in records_in(rest, len(rest))]
        return data, contents_of(data, indices, len(data))

    def _take(self, piece: Piece, indices: list[Record]) -> None:
        """Take in a piece of the file, for a chunk with the message indices that follow it."""
        if isinstance(piece, Hole):
            self._hole(piece)
        elif isinstance(piece, CutChunk):
            self._cut_chunk(piece)
        elif piece.opcode == Opcode.CHUNK:
            self._chunk(piece, indices)
        elif piece.opcode == Opcode.MESSAGE:
            self._loose(piece)
        elif piece.opcode == Opcode.FOOTER:
            self._ended = bool(magic_at(self._file, piece.end))
            self._check_summary(piece)
        else:
            self._declare(piece, self._declared)

    def _hole(self, hole: Hole) -> None:
        """Count and report bytes that are no records."""
        last = self._last_loose
        if last and last.end == hole.offset and not hole.alone:  # its length may be what is wrong
            self._drop_last_loose(last)
        self.unread += hole.length
        self.faults.append(f"{hole.length} bytes from byte {hole.offset} on are no records")

    def _chunk(self, record: Record, indices: list[Record]) -> None:
        """Take in a chunk, or report why it is left out."""
        chunk = read_chunk(record.content)
        self.compression = chunk.compression if self.compression is None else self.compression
        try:
            if chunk.size > self._bytes_left:
                raise DamagedError(f"is one too many: they hold more than {MOST_GROWTH} times the file")
            self._bytes_left -= chunk.size
            data = unpack(chunk)
            self._add_chunk(record, chunk, data, CHUNK, indices)
        except DamagedError as fault:
            self.unread += len(record.content)
            where = f"the chunk at byte {record.offset}"
            self.faults.append(f"{where} {fault}; its {len(record.content)} bytes are left out")
            self._declare_doubtful(chunk)

    def _cut_chunk(self, piece: CutChunk) -> None:
        """Take in the whole records at the beginning of a truncated chunk."""
        chunk, before = read_chunk(piece.content), len(self._segments)
        self.compression = chunk.compression if self.compression is None else self.compression
        data = beginning_of(chunk) if chunk.size <= self._bytes_left else b""
        try:
            self._add_chunk(Record(Opcode.CHUNK, piece.offset, piece.content), chunk, data, CUT_CHUNK, [])
        except DamagedError:
            self.unread += len(piece.content)
        count = sum(segment.counts.total() for segment in self._segments[before:])
        self.faults.append(f"the chunk at byte {piece.offset} is cut off; {count} messages could be read")

    def _declare_doubtful(self, chunk: Chunk) -> None:
        """Take in the declarations in a damaged chunk, for channels that are declared nowhere else."""
        data = chunk.data if not chunk.compression else b""
        for opcode, begin, end in records_in(data, MOST_RECORDS):
            if opcode in DECLARATIONS:
                self._declare(Record(opcode, begin, data[begin:end]), self._doubtful)

    def _loose(self, record: Record) -> None:
        """Add a message outside chunks to the last segment if that ends at the message, else to a new one."""
        last, self._last_loose = self._segments[-1] if self._segments else None, record
        channel, _, log_time, _ = MESSAGE.unpack_from(record.content)
        if last and last.kind == LOOSE and last.end == record.offset and last.end - last.offset < LARGEST_LOOSE:
            last.counts[channel] += 1
            self._before_last = last
            self._segments[-1] = last._replace(
                end=record.end, size=record.end - last.offset, first=min(last.first, log_time),
                last=max(last.last, log_time),
            )  # fmt: skip
            return
        size, self._before_last = record.end - record.offset, None
        self._segments.append(Segment(record.offset, record.end, size, LOOSE, log_time, log_time, Counter([channel])))

    def _drop_last_loose(self, record: Record) -> None:
        """Leave out the last message of the last segment, which is outside chunks."""
        segment, (channel, *_) = self._segments.pop(), MESSAGE.unpack_from(record.content)
        segment.counts[channel] -= 1
        if self._before_last:
            self._segments.append(self._before_last)
        self.unread += record.end - record.offset
        self.faults.append(f"the message at byte {record.offset} may not be as long as it says; it is left out")

    def _add_chunk(self, record: Record, chunk: Chunk, data: bytes, kind: str, indices: list[Record]) -> None:
        """Take in the records of a chunk.

        Raises:
            DamagedError: There are too many records, or the data do not end with a whole one.
        """
        most = min(MOST_RECORDS, self._records_left)
        contents = contents_of(data, [index.content for index in indices], most)
        self._records_left -= contents.number
        if contents.number > most:
            raise DamagedError(f"holds more than {most} records")
        if contents.end != len(data):
            raise DamagedError(f"ends in {len(data) - contents.end} bytes that are no records")
        for declaration in contents.others:
            self._declare(declaration, self._declared)
        if not len(contents.heads):
            return
        first, last = int(contents.heads["log"].min()), int(contents.heads["log"].max())
        counts, indices_end = Counter[int](contents.heads["channel"].tolist()), indices[-1].end if indices else 0
        self._segments.append(Segment(record.offset, record.end, len(data), kind, first, last, counts, indices_end))
        if kind == CHUNK and not chunk.checksum and (first, last) != (chunk.first, chunk.last):
            self._add_fault(
                f"the chunk at byte {record.offset}, which has no checksum, tells other times than its messages"
            )

    def _declare(self, record: Record, declared: dict[tuple[type, int], Any]) -> None:
        """Take in a record that is neither a chunk nor a message; schemas and channels go into `declared`."""
        content = parsed(record)
        match content:
            case Schema() | Channel():
                known = declared.setdefault((type(content), content.id), content)
                if known != content and declared is self._declared:
                    self._add_fault("topics are declared in contradictory ways; the first one counts")
            case Metadata():
                self._others.append(record.offset)
            case Attachment():
                self._attachment(record)
            case Statistics():
                self._statistics = content
            case Header() if not self._header:
                self._header, self.profile = True, content.profile
            case DataEnd():
                if content.data_section_crc not in (0, _checksum(self._file, 0, record.offset)):
                    self._add_fault("the data do not fit their checksum")
            case None if record.opcode in DECLARATIONS:
                self._add_fault("a topic's or a type's declaration cannot be read")
            case _:
                pass

    def _check_summary(self, record: Record) -> None:
        """Check the summary section that the footer in `record` points to."""
        footer = parsed(record)
        if footer.summary_start and footer.summary_crc:
            covered = record.offset + HEAD.size + len(record.content) - 4  # all but the checksum itself
            within = footer.summary_start <= record.offset
            if not within or _checksum(self._file, footer.summary_start, covered) != footer.summary_crc:
                self._add_fault("the summary does not fit its checksum or its place")

    def _attachment(self, record: Record) -> None:
        """Take in an attachment if its checksum is right."""
        checksum = int.from_bytes(record.content[-4:], "little")
        if checksum and zlib.crc32(record.content[:-4]) != checksum:
            self.unread += len(record.content)
            self.faults.append(f"the attachment at byte {record.offset} does not fit its checksum; it is left out")
        else:
            self._others.append(record.offset)

    def _conclude(self) -> None:
        """Match channels with their schemas, count messages, and add the faults of the whole file."""
        declared = self._doubtful | self._declared
        for (kind, number), channel in declared.items():
            if kind is Channel and (channel.schema_id == 0 or (Schema, channel.schema_id) in declared):
                self.streams[number] = Stream(channel, declared.get((Schema, channel.schema_id)))
        for segment in self._segments:
            self.counts.update(segment.counts)
        doubtful = {number for kind, number in self._doubtful.keys() - self._declared.keys() if kind is Channel}
        if topics := sorted(self.streams[number].channel.topic for number in doubtful & self.streams.keys()):
            self._add_fault(f"only a damaged chunk declares {', '.join(topics)}")
        if self._statistics and self._statistics.message_count != self.counts.total():
            count = self._statistics.message_count
            missing = count - self.counts.total()
            fault = f"{missing} of {count} messages are missing" if missing > 0 else "the statistics do not fit"
            self._add_fault(fault)
        for number in [number for number in self.counts if number not in self.streams]:
            self._add_fault(f"{self.counts.pop(number)} messages are of channel {number}, which nothing declares")
        if not self._ended:
            self.faults.insert(0, "the end is missing: the recording was cut off")
        if not self._header:
            self.faults.insert(0, "the beginning is damaged")
            encodings = {stream.channel.message_encoding for stream in self.streams.values()}
            self.profile = "ros2" if encodings == {"cdr"} else ""

    def _add_fault(self, fault: str) -> None:
        """Add a fault unless it is known already."""
        if fault not in self.faults:
            self.faults.append(fault)


def _until(following: Segment | None, waiting: list[tuple[int, int, Batch]]) -> Iterator[Batch]:
    """Remove and yield the waiting messages before the following segment, all if it is None, in at most one batch."""
    parts = []
    while waiting and (following is None or waiting[0][0] < following.first):
        _, offset, batch = heappop(waiting)
        count = int(np.searchsorted(batch.times, np.uint64(following.first))) if following else len(batch)
        parts.append((offset, batch.part(slice(count))))
        if count < len(batch):
            heappush(waiting, (int(batch.times[count]), offset, batch.part(slice(count, None))))
    if parts:
        yield Batch.together([batch for _, batch in sorted(parts, key=itemgetter(0))]).by_time()


def _checksum(file: IO[bytes], begin: int, end: int) -> int:
    """CRC-32 of the bytes between two offsets [B]."""
    file.seek(begin)
    checksum = 0
    for position in range(begin, end, BLOCK):
        checksum = zlib.crc32(file.read(min(BLOCK, end - position)), checksum)
    return checksum
