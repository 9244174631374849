"""Inspection of an MCAP file without trust in its summary: all records are checked once, and faults are reported."""

from __future__ import annotations

import zlib
from collections import Counter
from collections.abc import Callable
from typing import IO, Any, NamedTuple

from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, DataEnd, Header, Metadata, Schema, Statistics

from knee_contact_ros.bags.mcap_chunks import (
    DECLARATIONS,
    Chunk,
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
    read_records,
    with_indices,
)

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
Advance = Callable[[int, int], None]
"""Function that is called with the progress: bytes done, and bytes in all"""


class Stream(NamedTuple):
    """Channel with its schema."""

    channel: Channel
    """Channel record"""
    schema: Schema | None
    """Schema record; None if the channel has no schema"""


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


class Inspection:
    """What an MCAP file holds and where, and its faults: all of its records are looked at once."""

    def __init__(self, file: IO[bytes], size: int, advance: Advance) -> None:
        """Look through a file of `size` [B]; `advance` is called with the progress.

        Raises:
            OSError: The file cannot be read.
        """
        self.size = size
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
        self.segments: list[Segment] = []
        """Pieces of the file with messages, in its order"""
        self.others: list[int] = []
        """Offsets [B] of metadata and attachments"""
        self._statistics: Statistics | None = None
        self._header = self._ended = False
        self._last_loose: Record | None = None
        self._before_last: Segment | None = None  # the segment before that message
        # what chunks may still hold: bytes and records
        self._bytes_left, self._records_left = max(MOST_GROWTH * size, ALLOWED_SIZE), size + ALLOWED_RECORDS
        self._file = file
        for piece, indices in with_indices(read_records(file, size)):
            self._take(piece, indices)
            advance(piece.offset, size)
        self._conclude()

    @property
    def promised(self) -> dict[int, int] | None:
        """Number of messages of each channel according to the statistics record; None if there is none."""
        return self._statistics.channel_message_counts if self._statistics else None

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
        chunk, before = read_chunk(piece.content), len(self.segments)
        self.compression = chunk.compression if self.compression is None else self.compression
        data = beginning_of(chunk) if chunk.size <= self._bytes_left else b""
        try:
            self._add_chunk(Record(Opcode.CHUNK, piece.offset, piece.content), chunk, data, CUT_CHUNK, [])
        except DamagedError:
            self.unread += len(piece.content)
        count = sum(segment.counts.total() for segment in self.segments[before:])
        self.faults.append(f"the chunk at byte {piece.offset} is cut off; {count} messages could be read")

    def _declare_doubtful(self, chunk: Chunk) -> None:
        """Take in the declarations in a damaged chunk, for channels that are declared nowhere else."""
        data = chunk.data if not chunk.compression else b""
        for opcode, begin, end in records_in(data, MOST_RECORDS):
            if opcode in DECLARATIONS:
                self._declare(Record(opcode, begin, data[begin:end]), self._doubtful)

    def _loose(self, record: Record) -> None:
        """Add a message outside chunks to the last segment if that ends at the message, else to a new one."""
        last, self._last_loose = self.segments[-1] if self.segments else None, record
        channel, _, log_time, _ = MESSAGE.unpack_from(record.content)
        if last and last.kind == LOOSE and last.end == record.offset and last.end - last.offset < LARGEST_LOOSE:
            last.counts[channel] += 1
            self._before_last = last
            self.segments[-1] = last._replace(
                end=record.end, size=record.end - last.offset, first=min(last.first, log_time),
                last=max(last.last, log_time),
            )  # fmt: skip
            return
        size, self._before_last = record.end - record.offset, None
        self.segments.append(Segment(record.offset, record.end, size, LOOSE, log_time, log_time, Counter([channel])))

    def _drop_last_loose(self, record: Record) -> None:
        """Leave out the last message of the last segment, which is outside chunks."""
        segment, (channel, *_) = self.segments.pop(), MESSAGE.unpack_from(record.content)
        segment.counts[channel] -= 1
        if self._before_last:
            self.segments.append(self._before_last)
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
        self.segments.append(Segment(record.offset, record.end, len(data), kind, first, last, counts, indices_end))
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
                self.others.append(record.offset)
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
            self.others.append(record.offset)

    def _conclude(self) -> None:
        """Match channels with their schemas, count messages, and add the faults of the whole file."""
        declared = self._doubtful | self._declared
        for (kind, number), channel in declared.items():
            if kind is Channel and (channel.schema_id == 0 or (Schema, channel.schema_id) in declared):
                self.streams[number] = Stream(channel, declared.get((Schema, channel.schema_id)))
        for segment in self.segments:
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


def _checksum(file: IO[bytes], begin: int, end: int) -> int:
    """CRC-32 of the bytes between two offsets [B]."""
    file.seek(begin)
    checksum = 0
    for position in range(begin, end, BLOCK):
        checksum = zlib.crc32(file.read(min(BLOCK, end - position)), checksum)
    return checksum
