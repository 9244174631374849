"""An MCAP file, read without trust in its index: gone through once, and what is wrong with it is said."""

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
from knee_contact_ros.bags.mcap_layout import HEAD, MESSAGE
from knee_contact_ros.bags.mcap_records import (
    BLOCK,
    DECLARATIONS,
    Chunk,
    Contents,
    CutChunk,
    DamagedError,
    Hole,
    Piece,
    Record,
    beginning_of,
    contents_of,
    magic_at,
    parsed,
    read_at,
    read_chunk,
    read_records,
    record_at,
    records_in,
    unpack,
    with_indices,
)
from knee_contact_ros.messages.column import Column
from knee_contact_ros.system.regular_file import open_regular

CHUNK, CUT_CHUNK, LOOSE = "chunk", "cut chunk", "loose"
MOST_GROWTH = 200
"""Times the file's size that its chunks may hold altogether; recordings of motion take a tenth at best"""
LITTLE = 2**26
"""[B] that they may hold whatever the file's size"""
MOST_RECORDS = 2**20
"""In a chunk"""
LITTLE_RECORDS = 2**21
"""Records that the chunks of a file may hold whatever its size; of more, each takes a byte of the file"""
LONGEST_RUN = 2**20
"""[B] of messages outside chunks that are read at once"""
CHANNELS = 2**16
"""That a file can have"""
Advance = Callable[[int, int], None]
"""Told how many bytes are done, and how many there are"""


class Stream(NamedTuple):
    """A channel with its schema."""

    channel: Channel
    schema: Schema | None


class Message(NamedTuple):
    """A message with all that its record tells."""

    channel: int
    log_time: int
    """[ns]"""
    data: bytes
    publish_time: int
    """[ns]"""
    sequence: int


class Segment(NamedTuple):
    """A piece of the file that is read at once: a chunk, or messages outside chunks."""

    offset: int
    end: int
    """[B]"""
    size: int
    """[B] of its records"""
    kind: str
    """`CHUNK`, `CUT_CHUNK`, or `LOOSE`: outside chunks"""
    first: int
    """Smallest log time [ns]"""
    last: int
    """Largest one"""
    counts: Counter[int]
    """Messages by channel"""
    indices_end: int = 0
    """[B] of the indices that follow a chunk; 0: there are none"""


class McapFile:
    """What can be read of an MCAP file, and what is wrong with it."""

    def __init__(self, path: Path, advance: Advance = lambda _done, _total: None) -> None:
        """Go through the file once; `advance` hears of it.

        Raises:
            OSError: it cannot be read.
        """
        self.path, self.size = path, path.stat().st_size
        self.faults: list[str] = []
        self.profile = ""
        """As the header tells; `ros2` if there is none, and the messages are ROS 2's"""
        self.compression: str | None = None
        """Of the first chunk; None if there are no chunks"""
        self.unread = 0
        """Bytes that are of no use"""
        self.counts: Counter[int] = Counter()
        """Messages by channel"""
        self.streams: dict[int, Stream] = {}
        """Channels by number"""
        self._declared: dict[tuple[type, int], Any] = {}  # schemas and channels by their numbers
        self._doubtful: dict[tuple[type, int], Any] = {}  # likewise, of damaged chunks
        self._segments: list[Segment] = []
        self._others: list[int] = []  # where metadata and attachments are
        self._statistics: Statistics | None = None
        self._header = self._ended = False
        self._last_loose: Record | None = None
        self._before_last: Segment | None = None  # the run before that message
        self._unpacking, self._records = max(MOST_GROWTH * self.size, LITTLE), self.size + LITTLE_RECORDS
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
        """Messages by channel, as the file's statistics tell; None if it has none."""
        return self._statistics.channel_message_counts if self._statistics else None

    @property
    def times(self) -> tuple[int, int] | None:
        """Smallest and largest log time [ns] of the messages found."""
        segments = self._segments
        return (min(s.first for s in segments), max(s.last for s in segments)) if segments else None

    @property
    def at_once(self) -> int:
        """Bytes that are unpacked at a time at most, when messages are read in the order of time."""
        ends = [end for s in self._segments for end in ((s.first, s.size), (s.last + 1, -s.size))]
        return max(accumulate(size for _, size in sorted(ends)), default=0)

    def by_time(self, numbers: Mapping[int, int]) -> Iterator[Batch]:
        """The messages of channels that have a number, under it, by log time; equal times as in the file."""
        number_of = np.full(CHANNELS, -1, np.intp)
        for channel, number in numbers.items():
            number_of[channel] = number
        segments = [segment for segment in self._segments if not numbers.keys().isdisjoint(segment.counts)]
        segments.sort(key=attrgetter("first", "offset"))
        waiting = list[tuple[int, int, Batch]]()  # what is left of segments: by time, and equal times as in the file
        for segment, following in zip_longest(segments, segments[1:]):
            data, found = self._read(segment)
            messages = Column(data, found.begins, found.ends)
            batch = Batch(number_of[found.heads["channel"]], found.heads["log"], messages)
            batch = batch.part(np.flatnonzero(batch.numbers >= 0)).by_time()
            if waiting or (following and following.first <= segment.last):
                heappush(waiting, (int(batch.times[0]), segment.offset, batch))
                yield from _until(following, waiting)
            else:
                yield batch

    def in_file_order(self) -> Iterator[tuple[int, Message | Metadata | Attachment]]:
        """Everything but schemas and channels as the file has it, each with where [B] it was."""
        places: list[tuple[int, Segment | None]] = [(segment.offset, segment) for segment in self._segments]
        places += [(offset, None) for offset in self._others]
        for offset, segment in sorted(places, key=lambda place: place[0]):
            if segment is None:
                yield offset, self._record(offset)
                continue
            data, found = self._read(segment)
            told = found.heads[["channel", "sequence", "log", "publish"]].tolist()
            contents = Column(data, found.begins, found.ends)
            for (channel, sequence, log_time, publish_time), content in zip(told, contents, strict=True):
                if channel in self.streams:
                    yield offset, Message(channel, log_time, content, publish_time, sequence)

    def metadata(self) -> Iterator[Metadata]:
        """The metadata records that can be read."""
        yield from (entry for entry in map(self._record, self._others) if isinstance(entry, Metadata))

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _record(self, offset: int) -> Any:
        record = record_at(self._file, offset, self.size)
        return parsed(record) if record else None

    def _read(self, segment: Segment) -> tuple[bytes, Contents]:
        """The records of a segment, and what they are."""
        if segment.kind == LOOSE:
            data = read_at(self._file, segment.offset, segment.end - segment.offset)
            return data, contents_of(data, (), len(data))
        begin, behind = segment.offset + HEAD.size, max(segment.indices_end, segment.end)
        read = read_at(self._file, begin, behind - begin)
        record, indices = read[: segment.end - begin], read[segment.end - begin :]
        data = (unpack if segment.kind == CHUNK else beginning_of)(read_chunk(record))
        told = [indices[first:last] for _, first, last in records_in(indices, len(indices))]
        return data, contents_of(data, told, len(data))

    def _take(self, piece: Piece, indices: list[Record]) -> None:
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
        last = self._last_loose
        if last and last.end == hole.offset and not hole.alone:  # it may be what is not as long as it says
            self._take_back(last)
        self.unread += hole.length
        self.faults.append(f"{hole.length} bytes from byte {hole.offset} on are no records")

    def _chunk(self, record: Record, indices: list[Record]) -> None:
        chunk = read_chunk(record.content)
        self.compression = chunk.compression if self.compression is None else self.compression
        try:
            if chunk.size > self._unpacking:
                raise DamagedError(f"is one too many: they hold more than {MOST_GROWTH} times the file")
            self._unpacking -= chunk.size
            data = unpack(chunk)
            self._keep(record, chunk, data, CHUNK, indices)
        except DamagedError as fault:
            self.unread += len(record.content)
            where = f"the chunk at byte {record.offset}"
            self.faults.append(f"{where} {fault}; its {len(record.content)} bytes are left out")
            self._declare_doubtful(chunk)

    def _cut_chunk(self, piece: CutChunk) -> None:
        chunk, before = read_chunk(piece.content), self.messages
        self.compression = chunk.compression if self.compression is None else self.compression
        data = beginning_of(chunk) if chunk.size <= self._unpacking else b""
        try:
            self._keep(Record(Opcode.CHUNK, piece.offset, piece.content), chunk, data, CUT_CHUNK, [])
        except DamagedError:
            self.unread += len(piece.content)
        told = f"{self.messages - before} messages could be read"
        self.faults.append(f"the chunk at byte {piece.offset} is cut off; {told}")

    @property
    def messages(self) -> int:
        """How many were found."""
        return sum(segment.counts.total() for segment in self._segments)

    def _declare_doubtful(self, chunk: Chunk) -> None:
        """Take what a damaged chunk declares, for channels that nothing else declares."""
        data = chunk.data if not chunk.compression else b""
        for opcode, begin, end in records_in(data, MOST_RECORDS):
            if opcode in DECLARATIONS:
                self._declare(Record(opcode, begin, data[begin:end]), self._doubtful)

    def _loose(self, record: Record) -> None:
        """Take a message outside chunks: as a part of the run that it goes on with, if there is one."""
        last, self._last_loose = self._segments[-1] if self._segments else None, record
        channel, _, log_time, _ = MESSAGE.unpack_from(record.content)
        if last and last.kind == LOOSE and last.end == record.offset and last.end - last.offset < LONGEST_RUN:
            last.counts[channel] += 1
            self._before_last = last
            self._segments[-1] = last._replace(
                end=record.end, size=record.end - last.offset, first=min(last.first, log_time),
                last=max(last.last, log_time),
            )  # fmt: skip
            return
        size, self._before_last = record.end - record.offset, None
        self._segments.append(Segment(record.offset, record.end, size, LOOSE, log_time, log_time, Counter([channel])))

    def _take_back(self, record: Record) -> None:
        """Leave out the last message of a run."""
        run, (channel, *_) = self._segments.pop(), MESSAGE.unpack_from(record.content)
        run.counts[channel] -= 1
        if self._before_last:
            self._segments.append(self._before_last)
        self.unread += record.end - record.offset
        self.faults.append(f"the message at byte {record.offset} may not be as long as it says; it is left out")

    def _keep(self, record: Record, chunk: Chunk, data: bytes, kind: str, indices: list[Record]) -> None:
        """Take the records of a chunk.

        Raises:
            DamagedError: they are too many, or not all of the data are records.
        """
        most = min(MOST_RECORDS, self._records)
        found = contents_of(data, [index.content for index in indices], most)
        self._records -= found.number
        if found.number > most:
            raise DamagedError(f"holds more than {most} records")
        if found.end != len(data):
            raise DamagedError(f"ends in {len(data) - found.end} bytes that are no records")
        for each in found.others:
            self._declare(each, self._declared)
        if not len(found.heads):
            return
        first, last = int(found.heads["log"].min()), int(found.heads["log"].max())
        counts, behind = Counter[int](found.heads["channel"].tolist()), indices[-1].end if indices else 0
        self._segments.append(Segment(record.offset, record.end, len(data), kind, first, last, counts, behind))
        if kind == CHUNK and not chunk.checksum and (first, last) != (chunk.first, chunk.last):
            self._say(f"the chunk at byte {record.offset}, which has no checksum, tells other times than its messages")

    def _declare(self, record: Record, declared: dict[tuple[type, int], Any]) -> None:
        """Take any other record."""
        found = parsed(record)
        match found:
            case Schema() | Channel():
                if declared.setdefault((type(found), found.id), found) != found and declared is self._declared:
                    self._say("topics are declared in contradictory ways; the first one counts")
            case Metadata():
                self._others.append(record.offset)
            case Attachment():
                self._attachment(record)
            case Statistics():
                self._statistics = found
            case Header() if not self._header:
                self._header, self.profile = True, found.profile
            case DataEnd():
                if found.data_section_crc not in (0, _checksum(self._file, 0, record.offset)):
                    self._say("the data do not fit their checksum")
            case None if record.opcode in DECLARATIONS:
                self._say("a topic's or a type's declaration cannot be read")
            case _:
                pass

    def _check_summary(self, record: Record) -> None:
        footer = parsed(record)
        if footer.summary_start and footer.summary_crc:
            covered = record.offset + HEAD.size + len(record.content) - 4  # all but the checksum itself
            within = footer.summary_start <= record.offset
            if not within or _checksum(self._file, footer.summary_start, covered) != footer.summary_crc:
                self._say("the summary does not fit its checksum or its place")

    def _attachment(self, record: Record) -> None:
        checksum = int.from_bytes(record.content[-4:], "little")
        if checksum and zlib.crc32(record.content[:-4]) != checksum:
            self.unread += len(record.content)
            self.faults.append(f"the attachment at byte {record.offset} does not fit its checksum; it is left out")
        else:
            self._others.append(record.offset)

    def _conclude(self) -> None:
        declared = self._doubtful | self._declared
        for (kind, number), channel in declared.items():
            if kind is Channel and (channel.schema_id == 0 or (Schema, channel.schema_id) in declared):
                self.streams[number] = Stream(channel, declared.get((Schema, channel.schema_id)))
        for segment in self._segments:
            self.counts.update(segment.counts)
        doubtful = {key[1] for key in self._doubtful.keys() - self._declared.keys() if key[0] is Channel}
        if topics := sorted(self.streams[number].channel.topic for number in doubtful & self.streams.keys()):
            self._say(f"only a damaged chunk declares {', '.join(topics)}")
        if self._statistics and self._statistics.message_count != self.counts.total():
            missing, of = self._statistics.message_count - self.counts.total(), self._statistics.message_count
            self._say(f"{missing} of {of} messages are missing" if missing > 0 else "the statistics do not fit")
        for number in [number for number in self.counts if number not in self.streams]:
            self._say(f"{self.counts.pop(number)} messages are of channel {number}, which nothing declares")
        if not self._ended:
            self.faults.insert(0, "the end is missing: the recording was cut off")
        if not self._header:
            self.faults.insert(0, "the beginning is damaged")
            encodings = {stream.channel.message_encoding for stream in self.streams.values()}
            self.profile = "ros2" if encodings == {"cdr"} else ""

    def _say(self, fault: str) -> None:
        if fault not in self.faults:
            self.faults.append(fault)


def _until(following: Segment | None, waiting: list[tuple[int, int, Batch]]) -> Iterator[Batch]:
    """Take away what comes before a segment, all if there is none; in one batch, if there is any."""
    parts = []
    while waiting and (following is None or waiting[0][0] < following.first):
        _, offset, batch = heappop(waiting)
        number = int(np.searchsorted(batch.times, np.uint64(following.first))) if following else len(batch)
        parts.append((offset, batch.part(slice(number))))
        if number < len(batch):
            heappush(waiting, (int(batch.times[number]), offset, batch.part(slice(number, None))))
    if parts:
        yield Batch.together([batch for _, batch in sorted(parts, key=itemgetter(0))]).by_time()


def _checksum(file: IO[bytes], begin: int, end: int) -> int:
    """Of all that is between two places [B]."""
    file.seek(begin)
    checksum = 0
    for position in range(begin, end, BLOCK):
        checksum = zlib.crc32(file.read(min(BLOCK, end - position)), checksum)
    return checksum
