"""Reading of an MCAP file by what its inspection has found, in the order of time or of the file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from heapq import heappop, heappush
from itertools import accumulate, zip_longest
from operator import attrgetter, itemgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.records import Attachment, Metadata

from knee_contact_ros.bags.batch import Batch
from knee_contact_ros.bags.mcap_chunks import Contents, beginning_of, contents_of, read_chunk, records_in, unpack
from knee_contact_ros.bags.mcap_inspection import CHUNK, LOOSE, Advance, Inspection, Segment
from knee_contact_ros.bags.mcap_layout import HEAD
from knee_contact_ros.bags.mcap_records import parsed, read_at, record_at
from knee_contact_ros.streams.columns import Column
from knee_contact_ros.system.files import open_regular

CHANNELS = 2**16
"""Number of possible channels in a file"""


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


class McapFile(Inspection):
    """MCAP file that has been inspected, and what of it can be read."""

    def __init__(self, path: Path, advance: Advance = lambda _done, _total: None) -> None:
        """Inspect the file; `advance` is called with the progress.

        Raises:
            OSError: The file cannot be read.
        """
        self.path = path
        file = open_regular(path)
        try:
            super().__init__(file, path.stat().st_size, advance)
        except BaseException:
            file.close()
            raise

    @property
    def times(self) -> tuple[int, int] | None:
        """Smallest and largest log time [ns] of the messages; None if there are none."""
        segments = self.segments
        return (min(s.first for s in segments), max(s.last for s in segments)) if segments else None

    @property
    def at_once(self) -> int:
        """Largest number of bytes that are unpacked at one time when messages are read in the order of log time."""
        ends = [end for s in self.segments for end in ((s.first, s.size), (s.last + 1, -s.size))]
        return max(accumulate(size for _, size in sorted(ends)), default=0)

    def by_time(self, numbers: Mapping[int, int]) -> Iterator[Batch]:
        """Messages in the order of log time, at equal times in that of the file.

        Args:
            numbers: Number in the batches of each channel that is read.
        """
        number_of = np.full(CHANNELS, -1, np.intp)
        for channel, number in numbers.items():
            number_of[channel] = number
        segments = [segment for segment in self.segments if not numbers.keys().isdisjoint(segment.counts)]
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
        entries: list[tuple[int, Segment | None]] = [(segment.offset, segment) for segment in self.segments]
        entries += [(offset, None) for offset in self.others]
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
        yield from (record for record in map(self._record, self.others) if isinstance(record, Metadata))

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
