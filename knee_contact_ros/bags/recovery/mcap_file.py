"""An MCAP file, read without trust in its index."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Collection, Iterator
from itertools import accumulate
from pathlib import Path
from typing import IO, Any

from mcap.records import Attachment, Metadata

from knee_contact_ros.bags.recovery.catalogue import Stream
from knee_contact_ros.bags.recovery.chunks import Message, is_message, read_chunk, read_message, records_in, unpack
from knee_contact_ros.bags.recovery.promises import broken_promises, found_counts
from knee_contact_ros.bags.recovery.records import HEAD, parsed, record_at
from knee_contact_ros.bags.recovery.scan import Advance, Scan
from knee_contact_ros.bags.recovery.segments import Segment
from knee_contact_ros.system.regular_file import open_regular


class McapFile:
    """What can be read of an MCAP file, and what is wrong with it."""

    def __init__(self, path: Path, advance: Advance = lambda _done, _total: None) -> None:
        """Go through the file once; `advance` hears of it.

        Raises:
            OSError: it cannot be read.
        """
        self.path = path
        self.size = path.stat().st_size
        self._file = open_regular(path)
        try:
            self._scan = Scan(self._file, self.size, advance)
            self.faults = [*self._scan.faults, *self._scan.catalogue.faults(), *broken_promises(self._file, self._scan)]
        except BaseException:
            self._file.close()
            raise
        self.streams: dict[int, Stream] = self._scan.catalogue.streams()
        """Channels by number"""
        self.counts: Counter[int] = found_counts(self._scan)
        """Messages by channel"""
        for number in [number for number in self.counts if number not in self.streams]:
            self.faults.append(f"{self.counts.pop(number)} messages are of channel {number}, which nothing declares")
        if self._scan.profile is None:
            self.faults.insert(0, "the beginning is damaged")

    @property
    def profile(self) -> str:
        """As the header tells; `ros2` if there is none, and the messages are ROS 2's."""
        if self._scan.profile is not None:
            return self._scan.profile
        encodings = {stream.channel.message_encoding for stream in self.streams.values()}
        return "ros2" if encodings == {"cdr"} else ""

    @property
    def compression(self) -> str | None:
        """The compression of the first chunk; None if there are no chunks."""
        return self._scan.compression

    @property
    def unread(self) -> int:
        """Bytes that are of no use."""
        return self._scan.unread

    @property
    def promised(self) -> dict[int, int] | None:
        """Messages by channel, as the file's statistics tell; None if it has none."""
        return self._scan.statistics.channel_message_counts if self._scan.statistics else None

    @property
    def times(self) -> tuple[int, int] | None:
        """Smallest and largest log time [ns] of the messages found."""
        segments = self._scan.segments
        return (min(s.first for s in segments), max(s.last for s in segments)) if segments else None

    @property
    def at_once(self) -> int:
        """Bytes that are unpacked at a time at most, when messages are read in the order of time."""
        sizes = {chunk.offset: chunk.size for chunk in self._scan.chunks}
        ends = []
        for segment in self._scan.segments:
            size = segment.end - segment.offset if segment.loose else sizes.get(segment.offset, 0)
            ends += [(segment.first, size), (segment.last + 1, -size)]
        return max(accumulate(size for _, size in sorted(ends)), default=0)

    def by_time(self, channels: Collection[int]) -> Iterator[Message]:
        """The messages of some channels in the order of log time; equal times as in the file."""
        wanted = frozenset(channels)
        segments = (
            self._sorted(segment, wanted) for segment in self._scan.segments if not wanted.isdisjoint(segment.counts)
        )
        for _, _, message in heapq.merge(*segments, key=lambda entry: entry[:2]):
            if message is not None:
                yield message

    def metadata(self) -> Iterator[Metadata]:
        """The metadata records that can be read."""
        for offset in self._scan.metadata:
            record = self._record(offset)
            if isinstance(record, Metadata):
                yield record

    def in_file_order(self) -> Iterator[tuple[int, Message | Metadata | Attachment]]:
        """Everything but schemas and channels as the file has it, each with where [B] it was."""
        places = [(segment.offset, segment) for segment in self._scan.segments]
        records = [(offset, None) for offset in (*self._scan.metadata, *self._scan.attachments)]
        for offset, segment in sorted([*places, *records], key=lambda place: place[0]):
            if segment is None:
                yield offset, self._record(offset)
                continue
            for message in self._messages(segment):
                if message.channel in self.streams:
                    yield offset, message

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _record(self, offset: int) -> Any:
        record = record_at(self._file, offset, self.size)
        return parsed(record) if record else None

    def _sorted(self, segment: Segment, wanted: frozenset[int]) -> Iterator[tuple[int, int, Message | None]]:
        """Messages by time; before the first, an entry for which nothing is read."""
        yield segment.first, -1, None
        messages = [message for message in self._messages(segment) if message.channel in wanted]
        messages.sort(key=lambda message: message.log_time)
        for message in messages:
            yield message.log_time, segment.offset, message

    def _messages(self, segment: Segment) -> Iterator[Message]:
        if segment.loose:
            data = _read(self._file, segment.offset, segment.end)
        else:
            content = _read(self._file, segment.offset + HEAD.size, segment.end)
            data = unpack(read_chunk(content), cut=segment.cut).data
        for record in records_in(data):
            if is_message(record) and record.offset not in segment.left_out:
                message = read_message(record.content)
                if message is not None:
                    yield message


def _read(file: IO[bytes], begin: int, end: int) -> bytes:
    file.seek(begin)
    return file.read(end - begin)
