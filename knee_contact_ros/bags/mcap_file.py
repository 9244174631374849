"""What an MCAP file holds, whole or damaged, and its messages in the order of time or of the file.

The lengths that records claim are not trusted: a record is accepted only if its content has exactly its length. After
anything else reading continues at the record to which the length leads, or else at the next chunk. All chunks are
looked at before the first message is read. The index, if it fits its checksum, tells where chunks are whose heads are
wrong. A chunk that is too large for the memory is unpacked into a temporary file.
"""

from __future__ import annotations

import mmap
import re
import struct
import tempfile
import zlib
from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from io import BytesIO
from itertools import accumulate
from operator import itemgetter
from pathlib import Path
from typing import IO, Any, NamedTuple

import lz4.frame
import numpy as np
import zstandard
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, ChunkIndex, DataEnd, Footer, Header, Message, Metadata, Schema, Statistics
from numpy.typing import NDArray
from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat

from knee_contact_ros.bags.columns import DECLARATIONS, Batch, Contents, contents_of, records_in
from knee_contact_ros.bags.recorder import HEAD, MAGIC, MESSAGE
from knee_contact_ros.system.files import open_regular

CHUNK_HEAD = struct.Struct("<QQQII")
"""Beginning of a chunk record's content: smallest and largest log time [ns], uncompressed size [B], CRC-32 of the
records, and length [B] of the name of the compression, which follows"""
PARSERS: dict[int, Any] = {
    opcode: getattr(records, opcode.name.title().replace("_", ""))
    for opcode in Opcode
    if opcode not in (Opcode.MESSAGE, Opcode.CHUNK, Opcode.MESSAGE_INDEX)
}
"""Class of the `mcap` library that parses the records of each opcode"""
LARGE, MOST_OF_LARGE = (Opcode.CHUNK, Opcode.MESSAGE, Opcode.MESSAGE_INDEX), 64
"""Opcodes of records that are read twice, and the number of bytes to which they are read at first"""
CHECKSUM_PLACE = 24
"""Offset [B] of the checksum in a chunk record's content"""
HOLE, CUT_CHUNK = 0, -1
"""In place of an opcode: bytes that are no records, the beginning of a chunk at the end of a file"""
PRIVATE = 0x80
"""First opcode for private records of applications"""
CHUNK_OR_DATA_END = re.compile(rb"(?s)(?=\x06.{4}\x00{4}|\x0f\x04\x00{7})")
"""Head of a chunk of less than 4 GiB, or of the record that ends the data section"""
LONGEST_NAME, LONGEST_INDEX, LARGEST_RECORD, LARGEST_SUMMARY = 16, 2**24, 2**30, 2**27
"""Largest sizes [B] of what is read: name of a compression, message indices of a chunk, record, summary section"""
LARGEST_CHUNK = 2**28
"""Largest uncompressed size [B] of a chunk that is unpacked into memory"""
FOOTER_SIZE = 29
"""Size [B] of the footer record"""
MOST_GROWTH = 200
"""Largest uncompressed size of all chunks as a multiple of the file's size; recordings of motion reach ten"""
ALLOWED_SIZE = 2**26
"""Uncompressed size [B] of all chunks that is allowed in a file of any size"""
MOST_RECORDS = 2**20
"""Largest number of records in a chunk; all chunks may hold twice that, and one for each byte of the file"""
BLOCK = 2**20
"""Size [B] of the pieces in which a file is searched, and of messages outside chunks that are read at once"""
STEP = 4096
"""Size [B] of the compressed pieces of a truncated or very large chunk: a piece holds at most some 64 MB"""
DECOMPRESSORS: dict[str, Callable[[], Callable[[bytes], bytes]]] = {
    "zstd": lambda: zstandard.ZstdDecompressor().decompressobj().decompress,
    "lz4": lambda: lz4.frame.LZ4FrameDecompressor().decompress,
    "": lambda: bytes,
}
"""Makers of functions that decompress data piece by piece, by the name of the compression"""
CHANNELS = 2**16
"""Number of possible channels in a file"""
NO_DEFINITION = MessageDefinition(MessageDefinitionFormat.NONE, "")
"""Definition of a type that the bag does not define"""
FORMATS = {"ros2msg": MessageDefinitionFormat.MSG, "ros2idl": MessageDefinitionFormat.IDL}
"""Format of a definition by the encoding of its schema"""
Advance = Callable[[int, int], None]
"""Function that is called with the progress: work done, and work in all"""


BAD_DATA = (zstandard.ZstdError, RuntimeError, EOFError, MemoryError)
"""Errors of decompressors"""


class DamagedError(Exception):
    """A chunk cannot be used; the message is the end of a sentence whose subject is the chunk."""


class Connection(NamedTuple):
    """Topic of a bag with its type and encoding; recorders with several publishers, and merged files, repeat names."""

    topic: str
    """Name of the topic in the bag"""
    type: str
    """Type of the messages; empty if it is unknown"""
    encoding: str
    """Encoding of the messages"""
    definition: MessageDefinition
    """Definition of the type in the bag"""
    messages: int
    """Number of messages"""


class Piece(NamedTuple):
    """Piece of a file: a whole record, or what is none."""

    opcode: int
    """Opcode, `HOLE` or `CUT_CHUNK`"""
    offset: int
    """Offset [B] of the beginning in the file"""
    end: int
    """Offset [B] of the end"""
    content: bytes
    """Content, without the head; only its beginning where it is large"""
    parsed: Any = None
    """The content as the `mcap` library parses it, if `PARSERS` has its opcode; or the index of a chunk whose head
    is wrong"""


class Segment(NamedTuple):
    """Piece of a file that is read at once: a chunk, or messages outside chunks."""

    offset: int
    """Offset [B] of the beginning in the file"""
    begin: int
    """Offset [B] of the beginning of the data"""
    end: int
    """Offset [B] of the end of the data"""
    size: int
    """Uncompressed size [B] of the records"""
    checksum: int = 0
    """CRC-32 of the uncompressed records; 0 if there is none"""
    compression: str = ""
    """Name of the compression; empty if there is none"""
    chunked: bool = True
    """Whether it is a chunk"""
    cut: bool = False
    """Whether it is the beginning of a truncated chunk"""
    indices_end: int = 0
    """Offset [B] of the end of the message indices that follow the data; 0 if there are none"""
    first: int = 0
    """Smallest log time [ns] of the messages"""
    last: int = 0
    """Largest log time [ns] of the messages"""
    counts: Counter[int] = Counter()  # noqa: RUF012  (never changed)
    """Number of messages of each channel"""


class _Exact(ReadDataStream):
    """Stream whose reads return all of the requested bytes or raise `EndOfFile`."""

    def __init__(self, content: bytes) -> None:
        super().__init__(BytesIO(content))
        self._size = len(content)

    def read(self, length: int) -> bytes:
        if length > self._size - self.count:
            raise EndOfFile
        return bytes(super().read(length))


def parsed(opcode: int, content: bytes) -> Any:
    """Content of a record as the `mcap` library parses it; None if it is damaged, or `PARSERS` lacks the opcode."""
    stream = _Exact(content)
    try:
        record = PARSERS[opcode].read(stream)
    except (KeyError, EndOfFile, struct.error, UnicodeDecodeError):
        return None
    return record if stream.count == len(content) else None


class Records:
    """Records of an open MCAP file of `size` [B]."""

    def __init__(self, file: IO[bytes], size: int) -> None:
        self.file, self.size = file, size
        self._index: dict[int, ChunkIndex] = {}  # by the offsets of the chunks
        self._index = {index.chunk_start_offset: index for index in self._read_index()}
        self._starts = sorted(self._index)

    def read(self, offset: int, end: int) -> bytes:
        """Bytes between two offsets; fewer only at the end of the file."""
        self.file.seek(offset)
        return self.file.read(end - offset)

    def magic_at(self, offset: int) -> int:
        """Length [B] of the magic at `offset`; 0 if there is none."""
        return len(MAGIC) if self.read(offset, offset + len(MAGIC)) == MAGIC else 0

    def head_at(self, offset: int) -> tuple[int, int]:
        """Opcode of the record at `offset`, and offset [B] of its end; 0 and `offset` if no record is possible."""
        data = self.read(offset, offset + HEAD.size)
        if len(data) < HEAD.size:
            return 0, offset
        opcode, length = HEAD.unpack(data)
        end = offset + HEAD.size + length
        if opcode == Opcode.CHUNK:
            possible = length == self._chunk_length(offset)
        else:
            possible = opcode in PARSERS or opcode == Opcode.MESSAGE_INDEX or opcode >= PRIVATE
            possible |= opcode == Opcode.MESSAGE and length >= MESSAGE.size
        possible &= length <= LARGEST_RECORD or opcode == Opcode.CHUNK
        return (opcode, end) if possible and end <= self._next_chunk(offset) else (0, offset)

    def heads(self) -> Iterator[tuple[int, int, int]]:
        """Opcode, and offsets [B] of beginning and end, of each record up to the first that is none."""
        opcode, position = 0, self.magic_at(0)
        while position and opcode != Opcode.FOOTER:
            begin = position
            opcode, position = self.head_at(begin)
            if not opcode:
                return
            yield opcode, begin, position

    def record_at(self, offset: int) -> Piece | None:
        """Record that begins at `offset`; None if there is no whole and valid one."""
        if chunk := self._chunk_by_index(offset):
            return chunk
        opcode, end = self.head_at(offset)
        if not opcode:
            return None
        content = self.read(offset + HEAD.size, min(end, offset + MOST_OF_LARGE) if opcode in LARGE else end)
        record = parsed(opcode, content)
        return None if record is None and opcode in PARSERS else Piece(opcode, offset, end, content, record)

    def pieces(self) -> Iterator[Piece]:
        """Pieces of the file after its magic, in order; only heads are read twice."""
        position = self.magic_at(0)
        while position < self.size:
            piece = self.record_at(position) or self._no_record(position)
            yield piece
            position = piece.end
            if piece.opcode == Opcode.FOOTER:
                position += self.magic_at(position)

    def checksum(self, begin: int, end: int) -> int:
        """CRC-32 of the bytes between two offsets [B]."""
        checksum = 0
        for position in range(begin, end, BLOCK):
            checksum = zlib.crc32(self.read(position, min(position + BLOCK, end)), checksum)
        return checksum

    def _chunk_length(self, offset: int) -> int:
        """Length [B] of the content of the chunk at `offset`, by what its beginning says; -1 if there is no chunk."""
        beginning = self.read(offset + HEAD.size, offset + HEAD.size + CHUNK_HEAD.size + LONGEST_NAME + 8)
        if len(beginning) < CHUNK_HEAD.size + 8:
            return -1
        name_end: int = CHUNK_HEAD.size + CHUNK_HEAD.unpack_from(beginning)[-1]
        size = beginning[name_end : name_end + 8]
        return name_end + 8 + int.from_bytes(size, "little") if len(size) == 8 else -1

    def _read_index(self) -> Iterator[ChunkIndex]:
        """Entries of the index for the chunks, if the summary fits its checksum."""
        footer = self.record_at(self.size - len(MAGIC) - FOOTER_SIZE) if self.size > FOOTER_SIZE + len(MAGIC) else None
        if not footer or footer.opcode != Opcode.FOOTER or not self.magic_at(footer.end):
            return
        begin, checksum = footer.parsed.summary_start, footer.parsed.summary_crc
        if checksum and footer.offset - LARGEST_SUMMARY < begin < footer.offset and self.fits_summary(footer):
            data = self.read(begin, footer.offset)
            for opcode, first, last in records_in(data, len(data)):
                if opcode == Opcode.CHUNK_INDEX and (index := parsed(opcode, data[first:last])):
                    yield index

    def fits_summary(self, footer: Piece) -> bool:
        """Whether the summary section fits the checksum in the footer, if that has one."""
        begin, checksum = footer.parsed.summary_start, footer.parsed.summary_crc
        return not (begin and checksum) or (begin <= footer.offset and self.checksum(begin, footer.end - 4) == checksum)

    def _next_chunk(self, offset: int) -> int:
        """Offset of the next chunk behind `offset` that the index knows, or the size of the file."""
        number = bisect_right(self._starts, offset) if self._index else 0
        return self._starts[number] if number < len(self._index) else self.size

    def _chunk_by_index(self, offset: int) -> Piece | None:
        """Chunk at `offset` whose head says something else than the index; None if there is none, or no checksum."""
        index = self._index.get(offset)
        if index is None:
            return None
        end, beginning = offset + index.chunk_length, self.read(offset, offset + MOST_OF_LARGE)
        place = HEAD.size + CHECKSUM_PLACE
        if not (offset + place + 4 <= end - index.compressed_size <= end <= self._next_chunk(offset)):
            return None
        said = HEAD.pack(Opcode.CHUNK, index.chunk_length - HEAD.size), index.uncompressed_size.to_bytes(8, "little")
        name = struct.pack("<I", len(index.compression)) + index.compression.encode()
        right = (beginning[: HEAD.size], beginning[place - 8 : place], beginning[place + 4 :][: len(name)])
        if right == (*said, name) and self._chunk_length(offset) == index.chunk_length - HEAD.size:
            return None
        checksum = beginning[place : place + 4]
        return Piece(Opcode.CHUNK, offset, end, checksum, index) if any(checksum) else None

    def _no_record(self, offset: int) -> Piece:
        """Bytes from `offset` on that are no record: a truncated chunk, or a hole.

        `parsed` is True for a hole that is one record of an unknown kind or form, whose length leads to the next one.
        """
        head = self.read(offset, offset + HEAD.size)
        opcode, length = HEAD.unpack(head) if len(head) == HEAD.size else (0, self.size)
        end, limit = offset + HEAD.size + length, self._next_chunk(offset)
        cut = opcode == Opcode.CHUNK and end > self.size and length == self._chunk_length(offset)
        if cut and not self.magic_at(max(self.size - len(MAGIC), 0)):
            return Piece(CUT_CHUNK, offset, self.size, self.read(offset + HEAD.size, offset + MOST_OF_LARGE))
        if end < limit and self.head_at(end)[0]:
            return Piece(HOLE, offset, end, b"", True)
        for begin in range(offset + 1, limit, BLOCK):
            block = self.read(begin, begin + BLOCK + HEAD.size)
            for candidate in CHUNK_OR_DATA_END.finditer(block, 0, BLOCK + HEAD.size):
                place = begin + candidate.start()
                opcode, end = self.head_at(place) if place < limit else (0, place)
                if opcode and (end == self.size or self.head_at(end)[0]):
                    return Piece(HOLE, offset, place, b"", False)
        return Piece(HOLE, offset, limit, b"", False)


class McapFile:
    """MCAP file that has been looked through: what of it can be read, and its faults."""

    def __init__(self, path: Path, advance: Advance = lambda _done, _total: None) -> None:
        """Look through the file; `advance` is called with the progress in bytes.

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
        self.streams: dict[int, tuple[Channel, Schema | None]] = {}
        """Channels by their numbers, each with its schema, if it has one"""
        self.segments: list[Segment] = []
        """Pieces of the file with messages, in its order"""
        self.spans: dict[int, tuple[int, int]] = {}
        """Smallest and largest log time [ns] of each channel"""
        self.goes_back = False
        """Whether the log times of a channel go back in the order of the file"""
        self.others: list[int] = []
        """Offsets [B] of metadata and attachments"""
        self._declared: dict[tuple[type, int], Any] = {}  # schemas and channels by type and number
        self._doubtful: dict[tuple[type, int], Any] = {}  # those of damaged chunks
        self._statistics: Statistics | None = None
        self._by_index: list[int] = []  # offsets of chunks that only the index tells
        self._unusable: list[tuple[int, int, str]] = []  # bytes from and to, and what to say if they are no hole
        self._header = self._ended = False
        # what chunks may still hold: bytes and records
        self._bytes_left = max(MOST_GROWTH * self.size, ALLOWED_SIZE)
        self._records_left = self.size + 2 * MOST_RECORDS
        self._records = Records(open_regular(path), self.size)
        try:
            self._look_through(advance)
        except BaseException:
            self.close()
            raise

    @property
    def times(self) -> tuple[int, int] | None:
        """Smallest and largest log time [ns] of the messages; None if there are none."""
        segments = self.segments
        return (min(s.first for s in segments), max(s.last for s in segments)) if segments else None

    @property
    def promised(self) -> dict[int, int] | None:
        """Number of messages of each channel according to the statistics record; None if there is none."""
        return self._statistics.channel_message_counts if self._statistics else None

    @property
    def at_once(self) -> int:
        """Largest number of bytes that are unpacked into memory at one time when messages are read by log time."""
        in_memory = [segment for segment in self.segments if segment.size <= LARGEST_CHUNK]
        ends = [end for s in in_memory for end in ((s.first, s.size), (s.last + 1, -s.size))]
        return max(accumulate(size for _, size in sorted(ends)), default=0)

    @property
    def connections(self) -> dict[int, Connection]:
        """Topics by the numbers of their channels."""
        connections, definitions = {}, {0: NO_DEFINITION}  # the schema of many channels is decoded once
        for number, (channel, schema) in self.streams.items():
            if schema and schema.id not in definitions:
                definitions[schema.id] = definition_of(schema.encoding, schema.data.decode("utf-8", "replace"))
            definition, type_name = definitions[schema.id if schema else 0], schema.name if schema else ""
            topic = Connection(channel.topic, type_name, channel.message_encoding, definition, self.counts[number])
            connections[number] = topic
        return connections

    def read(self, segment: int, numbers: Mapping[int, int]) -> Batch:
        """Messages of a segment in its order.

        Args:
            segment: Index of the segment.
            numbers: Number in the batch of each channel that is read.
        """
        number_of = np.full(CHANNELS, -1, np.intp)
        for channel, number in numbers.items():
            number_of[channel] = number
        contents = self._contents(self.segments[segment])
        batch = Batch(number_of[contents.heads["channel"]], contents.heads["log"], contents.messages)
        return batch.part(np.flatnonzero(batch.numbers >= 0))

    def in_file_order(self) -> Iterator[tuple[int, Message | Metadata | Attachment]]:
        """Messages, metadata and attachments in the order of the file, with the offset [B] of the segment or record."""
        entries: list[tuple[int, Segment | None]] = [(segment.offset, segment) for segment in self.segments]
        entries += [(offset, None) for offset in self.others]
        for offset, segment in sorted(entries, key=itemgetter(0)):
            if segment is None:
                yield offset, self._other(offset)
                continue
            contents = self._contents(segment)
            heads = contents.heads[["channel", "sequence", "log", "publish"]].tolist()
            for (channel, sequence, log_time, publish_time), data in zip(heads, contents.messages, strict=True):
                if channel in self.streams:
                    yield offset, Message(channel, log_time, data, publish_time, sequence)

    def metadata(self) -> list[Metadata]:
        """Readable metadata records in the order of the file."""
        return [record for record in map(self._other, self.others) if isinstance(record, Metadata)]

    def close(self) -> None:
        """Close the file."""
        self._records.file.close()

    def _other(self, offset: int) -> Any:
        """Record at an offset, as the `mcap` library parses it; None if there is none any more."""
        record = self._records.record_at(offset)
        return record.parsed if record else None

    def _contents(self, segment: Segment, most: int = LARGEST_CHUNK) -> Contents:
        """Records of a segment.

        Raises:
            DamagedError: They cannot be decompressed, do not fit their size or checksum, or end with half a record.
        """
        data: Any = None
        if segment.size > LARGEST_CHUNK and not segment.cut:
            data = self._unpacked_to_disk(segment)
        else:
            raw = self._records.read(segment.begin, segment.end)
            data = beginning_of(segment, raw) if segment.cut else unpack(segment, raw)
        rest = self._records.read(segment.end, segment.indices_end) if segment.indices_end else b""
        try:
            contents = contents_of(data, [rest[begin:end] for _, begin, end in records_in(rest, len(rest))], most)
        except ValueError as error:
            raise DamagedError(str(error)) from None
        if contents.number <= most and contents.end != len(data):
            raise DamagedError(f"ends in {len(data) - contents.end} bytes that are no records")
        return contents

    def _unpacked_to_disk(self, segment: Segment) -> mmap.mmap:
        """Uncompressed records of a segment in a temporary file; see `unpack`."""
        size = checksum = 0
        begins = range(segment.begin, segment.end, STEP)
        pieces = (self._records.read(begin, min(begin + STEP, segment.end)) for begin in begins)
        with tempfile.TemporaryFile(prefix="knee_contact_chunk_") as file:
            try:
                for data in decompressed(segment, pieces):
                    size, checksum = size + len(data), zlib.crc32(data, checksum)
                    file.write(data)
            except BAD_DATA as error:
                raise DamagedError(f"does not decompress ({' '.join(str(error).split())})") from None
            if size != segment.size or (segment.checksum and checksum != segment.checksum):
                raise DamagedError("does not fit its checksum or its size")
            file.flush()
            return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)

    def _look_through(self, advance: Advance) -> None:
        """Take in all pieces of the file, and note its faults."""
        segment: Segment | None = None
        last = 0  # where the last message of a segment that is no chunk begins
        for piece in self._records.pieces():
            advance(piece.offset, self.size)
            follows = segment is not None and max(segment.indices_end, segment.end) == piece.offset
            chunk, run = (segment, None) if segment and segment.chunked else (None, segment)
            if chunk and follows and piece.opcode == Opcode.MESSAGE_INDEX and piece.end - chunk.end <= LONGEST_INDEX:
                segment = chunk._replace(indices_end=piece.end)
            elif run and follows and piece.opcode == Opcode.MESSAGE and run.size < BLOCK:
                segment, last = run._replace(end=piece.end, size=piece.end - run.begin), piece.offset
            else:
                if run and follows and piece.opcode == HOLE and not piece.parsed:
                    words = f"the message at byte {last} may not be as long as it says; it is left out"
                    self._unusable.append((last, piece.offset, words))
                    segment = run._replace(end=last, size=last - run.begin)
                if segment:
                    self._take(segment)
                segment, last = self._begun(piece), piece.offset
        if segment:
            self._take(segment)
        if self._by_index:
            more = f", and {len(self._by_index) - 1} more," if len(self._by_index) > 1 else ""
            self._note(
                f"the head of the chunk at byte {self._by_index[0]}{more} is damaged; the index tells what it was"
            )
        self._conclude()

    def _begun(self, piece: Piece) -> Segment | None:
        """Segment that begins with a piece; None, after the piece has been taken in, if none does."""
        if piece.opcode == Opcode.MESSAGE:
            return Segment(piece.offset, piece.offset, piece.end, piece.end - piece.offset, chunked=False)
        if isinstance(index := piece.parsed, ChunkIndex) and piece.opcode == Opcode.CHUNK:
            self._by_index.append(piece.offset)
            checksum, begin = int.from_bytes(piece.content, "little"), piece.end - index.compressed_size
            return Segment(piece.offset, begin, piece.end, index.uncompressed_size, checksum, index.compression)
        if piece.opcode in (Opcode.CHUNK, CUT_CHUNK):
            first, last, size, checksum, length = CHUNK_HEAD.unpack_from(piece.content)
            name = piece.content[CHUNK_HEAD.size : CHUNK_HEAD.size + length].decode("ascii", "replace")
            begin = piece.offset + HEAD.size + CHUNK_HEAD.size + length + 8
            cut = piece.opcode == CUT_CHUNK
            return Segment(piece.offset, begin, piece.end, size, checksum, name, True, cut, 0, first, last)
        if piece.opcode == HOLE:
            self._unusable.append((piece.offset, piece.end, ""))
        else:
            self._take_other(piece)
        return None

    def _take(self, segment: Segment) -> None:
        """Take in the records of a segment, or note why it is left out."""
        where, begin, count = f"the chunk at byte {segment.offset}", segment.offset + HEAD.size, 0
        if self.compression is None and segment.chunked:
            self.compression = segment.compression
        try:
            count = self._add(segment)
        except DamagedError as fault:
            self._unusable.append(
                (begin, segment.end, f"{where} {fault}; its {segment.end - begin} bytes are left out")
            )
            data = (
                b""
                if segment.compression
                else self._records.read(segment.begin, min(segment.end, begin + LARGEST_CHUNK))
            )
            for opcode, first, last in records_in(data, MOST_RECORDS):
                if opcode in DECLARATIONS:
                    self._declare(parsed(opcode, data[first:last]), self._doubtful)
        if segment.cut:
            self._note(f"{where} is cut off; {count} messages could be read")

    def _add(self, segment: Segment) -> int:
        """Take in the records of a segment, and return the number of its messages.

        Raises:
            DamagedError: It cannot be used, or holds too many bytes or records.
        """
        if segment.chunked and segment.size > self._bytes_left:
            raise DamagedError(f"is one too many: they hold more than {MOST_GROWTH} times the file")
        self._bytes_left -= segment.size if segment.chunked else 0
        most = min(MOST_RECORDS, self._records_left)
        contents = self._contents(segment, most)
        self._records_left -= contents.number
        if contents.number > most:
            raise DamagedError(f"holds more than {most} records; another tool may write it again in smaller chunks")
        for opcode, content in contents.declarations:
            self._declare(parsed(opcode, content), self._declared)
        if not len(contents.heads):
            return 0
        times = int(contents.heads["log"].min()), int(contents.heads["log"].max())
        if segment.chunked and not (segment.cut or segment.checksum) and times != (segment.first, segment.last):
            self._note(
                f"the chunk at byte {segment.offset}, which has no checksum, tells other times than its messages"
            )
        counts = Counter[int](contents.heads["channel"].tolist())
        self._look_at_times(contents.heads["channel"], contents.heads["log"])
        self.segments.append(segment._replace(first=times[0], last=times[1], counts=counts))
        return len(contents.heads)

    def _look_at_times(self, channels: NDArray[Any], times: NDArray[Any]) -> None:
        """Note the spans of log times of the channels, and whether they go back."""
        order = np.argsort(channels, kind="stable")
        own, logs = channels[order], times[order]
        begins = np.flatnonzero(np.diff(own, prepend=-1))
        self.goes_back |= bool(((logs[1:] < logs[:-1]) & (own[1:] == own[:-1])).any())
        extremes = np.minimum.reduceat(logs, begins).tolist(), np.maximum.reduceat(logs, begins).tolist()
        for channel, begin, first, last in zip(own[begins].tolist(), begins.tolist(), *extremes, strict=True):
            before = self.spans.get(channel, (first, 0))
            self.goes_back |= int(logs[begin]) < before[1]
            self.spans[channel] = min(first, before[0]), max(last, before[1])

    def _declare(self, record: Any, declared: dict[tuple[type, int], Any]) -> None:
        """Take in a schema or channel, which `mcap` has parsed as `record`, into `declared`."""
        if record is None:
            self._note("a topic's or a type's declaration cannot be read")
            return
        known = declared.setdefault((type(record), record.id), record)
        if known != record and declared is self._declared:
            self._note("topics are declared in contradictory ways; the first one counts")

    def _take_other(self, piece: Piece) -> None:
        """Take in a record that belongs to no segment."""
        match piece.parsed:
            case Schema() | Channel():
                self._declare(piece.parsed, self._declared)
            case Metadata() | Attachment():
                self._take_kept(piece)
            case Statistics():
                self._statistics = piece.parsed
            case Header() if not self._header:
                self._header, self.profile = True, piece.parsed.profile
            case DataEnd():
                if piece.parsed.data_section_crc not in (0, self._records.checksum(0, piece.offset)):
                    self._note("the data do not fit their checksum")
            case Footer():
                self._ended = bool(self._records.magic_at(piece.end))
                if not self._records.fits_summary(piece):
                    self._note("the summary does not fit its checksum or its place")

    def _take_kept(self, piece: Piece) -> None:
        """Take in metadata, or an attachment if its checksum is right."""
        checksum = int.from_bytes(piece.content[-4:], "little") if piece.opcode == Opcode.ATTACHMENT else 0
        if checksum and zlib.crc32(piece.content[:-4]) != checksum:
            words = f"the attachment at byte {piece.offset} does not fit its checksum; it is left out"
            self._unusable.append((piece.offset + HEAD.size, piece.end, words))
        else:
            self.others.append(piece.offset)

    def _conclude(self) -> None:
        """Match channels with their schemas, count messages, and add the faults of the whole file."""
        declared = self._doubtful | self._declared
        for (kind, number), channel in declared.items():
            if kind is Channel and (channel.schema_id == 0 or (Schema, channel.schema_id) in declared):
                self.streams[number] = channel, declared.get((Schema, channel.schema_id))
        for segment in self.segments:
            self.counts.update(segment.counts)
        notes, self.faults = self.faults, []
        for begin, end, words in sorted(self._unusable):
            self.unread += end - begin
            self.faults.append(words or f"{end - begin} bytes from byte {begin} on are no records")
        self.faults += notes
        doubtful = {number for kind, number in self._doubtful.keys() - self._declared.keys() if kind is Channel}
        if topics := sorted(self.streams[number][0].topic for number in doubtful & self.streams.keys()):
            self._note(f"only a damaged chunk declares {', '.join(topics)}")
        if self._statistics and self._statistics.message_count != self.counts.total():
            count = self._statistics.message_count
            missing = count - self.counts.total()
            self._note(f"{missing} of {count} messages are missing" if missing > 0 else "the statistics do not fit")
        for number in [number for number in self.counts if number not in self.streams]:
            self._note(f"{self.counts.pop(number)} messages are of channel {number}, which nothing declares")
        if not self._ended:
            self.faults.insert(0, "the end is missing: the recording was cut off")
        if not self._header:
            self.faults.insert(0, "the beginning is damaged")
            encodings = {channel.message_encoding for channel, _ in self.streams.values()}
            self.profile = "ros2" if encodings == {"cdr"} else ""

    def _note(self, fault: str) -> None:
        """Add a fault unless it is known already."""
        if fault not in self.faults:
            self.faults.append(fault)


def unpack(segment: Segment, data: bytes) -> bytes:
    """Uncompressed records of a segment from its `data`.

    Raises:
        DamagedError: They cannot be decompressed, or do not fit their size or checksum.
    """
    try:
        if segment.compression == "zstd":
            if (size := zstandard.frame_content_size(data)) > segment.size:
                raise DamagedError(f"holds {size} bytes and not {segment.size}")
            decompressor = zstandard.ZstdDecompressor()
            data = decompressor.decompress(data, max_output_size=segment.size + 1, allow_extra_data=False)
        else:
            data = b"".join(decompressed(segment, _pieces(data)))
    except BAD_DATA as error:
        raise DamagedError(f"does not decompress ({' '.join(str(error).split())})") from None
    if len(data) != segment.size:
        raise DamagedError(f"holds {len(data)} bytes and not {segment.size}")
    if segment.checksum and zlib.crc32(data) != segment.checksum:
        raise DamagedError("does not fit its checksum")
    return data


def decompressed(segment: Segment, pieces: Iterable[bytes]) -> Iterator[bytes]:
    """Decompressed data of a segment from its pieces, one by one.

    Raises:
        DamagedError: The compression is unknown, or there are more data than the segment should have.
        Exception: One of `BAD_DATA`; the data are damaged.
    """
    if segment.compression not in DECOMPRESSORS:
        raise DamagedError(f"has the unknown compression {segment.compression!r}")
    left, decompress = segment.size, DECOMPRESSORS[segment.compression]()
    for piece in pieces:
        data = decompress(piece)
        left -= len(data)
        if left < 0:
            raise DamagedError(f"holds more than {segment.size} bytes")
        yield data


def _pieces(data: bytes) -> Iterator[bytes]:
    return (data[begin : begin + STEP] for begin in range(0, len(data), STEP))


def beginning_of(segment: Segment, raw: bytes) -> bytes:
    """Whole records at the beginning of a truncated chunk, without a check of their content."""
    data = bytearray()
    try:
        for part in decompressed(segment, _pieces(raw)):
            data += part
            if len(data) > LARGEST_CHUNK:
                return b""
    except BAD_DATA:
        pass
    end = 0
    for _, _, end in records_in(bytes(data), len(data)):  # noqa: B007  (the last one counts)
        pass
    return bytes(data[:end])


def definition_of(encoding: str, text: str) -> MessageDefinition:
    """Definition of a type from the encoding and the text of its schema."""
    return MessageDefinition(FORMATS[encoding], text) if encoding in FORMATS else NO_DEFINITION
