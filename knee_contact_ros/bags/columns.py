"""Messages of bags in columns, without an object for each: joined, in the order of arrival, and written in blocks."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise, zip_longest
from typing import Any, NamedTuple

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from knee_contact_ros.bags.recorder import CHUNK_SIZE, ENTRY, MESSAGE, MESSAGE_HEAD, BagWriter
from knee_contact_ros.streams.columns import Column
from knee_contact_ros.system.errors import UsageError

Places = NDArray[np.int64]
"""Indices of records, or offsets of bytes; shape (n,)"""
MESSAGE_HEADS = np.dtype(
    [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log", "<u8"), ("publish", "<u8")]
)
"""Layout `MESSAGE_HEAD` as a NumPy type"""
MOST_AT_ONCE = 2**28
"""Largest size [B] of the chunks that lie in memory at one time"""
FAR, JITTER = 3.0, 0.05
"""Multiples of a topic's usual step: beyond the one messages do not belong together, by the other log times may go
back without any meaning"""
FEW, ENOUGH = 4, 3
"""Messages behind a step back fill a hole if there is at most one of the earlier ones among `FEW`, and, where all
earlier ones are later, if they are less than `ENOUGH`"""
UNSORTED, MOST_STEPS, WINDOW = 3, 10_000, 100_000
"""A topic is just sorted if one of `UNSORTED` steps goes back, or more than `MOST_STEPS`; so many messages before and
behind a step are compared"""
LATEST = np.iinfo(np.int64).max


@dataclass(frozen=True)
class Batch:
    """Sequence of n messages of several topics; arrays have shape (n,)."""

    numbers: NDArray[np.intp]
    """Number of the topic of each message"""
    times: NDArray[Any]
    """Log times [ns], as integers"""
    messages: Column
    """Bytes of the messages"""

    @classmethod
    def together(cls, batches: Sequence[Batch]) -> Batch:
        """Concatenation of batches of one file, at least one, in memory that holds little else."""
        numbers = np.concatenate([batch.numbers for batch in batches])
        times = np.concatenate([batch.times for batch in batches])
        return cls(numbers, times, Column.together([batch.messages.trimmed() for batch in batches]))

    def __len__(self) -> int:
        """Number of messages."""
        return len(self.numbers)

    def __iter__(self) -> Iterator[tuple[int, int, bytes]]:
        """Iterate over the messages: topic number, log time [ns] and bytes."""
        return zip(self.numbers.tolist(), self.times.tolist(), self.messages, strict=True)

    def part(self, chosen: Any) -> Batch:
        """Selection of messages, by a slice, their indices or a mask."""
        return Batch(self.numbers[chosen], self.times[chosen], self.messages.part(chosen))

    def by_time(self) -> Batch:
        """Messages sorted by log time; those with equal times keep their order."""
        if (self.times[1:] >= self.times[:-1]).all():
            return self
        return self.part(np.argsort(self.times, kind="stable"))

    def of(self, number: int) -> Column:
        """Bytes of the messages of the topic with this number."""
        return self.messages.part(np.flatnonzero(self.numbers == number))

    def converted(self, convert: Sequence[Callable[[bytes, int], bytes] | None]) -> Batch:
        """Copy in which the messages of each number are changed by its function, from bytes and log time [ns]."""
        changes = [each or (lambda data, _: data) for each in convert]
        messages = Column.of([changes[number](data, time) for number, time, data in self])
        return Batch(self.numbers, self.times, messages)


def blocks(batches: Iterable[Batch], most: int) -> Iterator[Batch]:
    """Messages of the batches in blocks of `most` messages; only the last block may have fewer."""
    waiting, count = list[Batch](), 0
    for batch in batches:
        rest = batch
        while count + len(rest) >= most:
            yield Batch.together([*waiting, rest.part(slice(most - count))])
            rest, waiting, count = rest.part(slice(most - count, None)), [], 0
        if len(rest):
            waiting.append(rest)
            count += len(rest)
    if waiting:
        yield Batch.together(waiting)


class Part(NamedTuple):
    """Messages of a segment between two cuts."""

    times: tuple[int, int]
    """Smallest and largest log time [ns]"""
    file: int
    """Index of the file"""
    segment: int
    """Index of the segment in the file"""
    begin: int = 0
    """Index of the first one, among those of the topics that are read"""
    end: int | None = None
    """Index behind the last one; None: all are read"""
    ascends: bool = False
    """Whether the log times of each topic are known to ascend in it"""


def by_arrival(files: Sequence[Any], numbers: Sequence[Mapping[int, int]]) -> Iterator[Batch]:
    """Messages of files, which come in the order of recording: by log time, but not over a clock that was set back.

    Clocks can be set back, and our own recordings have stamps as log times, which go back when those of an input do.
    So a bag is cut there, and only what lies between two cuts is sorted: the pipeline gets the messages as the node
    got them.

    Args:
        files: Files (`McapFile` or `SqliteFile`).
        numbers: For each file the number of each topic that is read, by its number in the file.

    Raises:
        UsageError: Too much would lie in memory at once.
    """

    def read(part: Part) -> Batch:
        batch: Batch = files[part.file].read(part.segment, numbers[part.file])
        return batch.part(slice(part.begin, part.end))

    parts = [
        Part(segment.times, index, number)
        for index, file in enumerate(files)
        for number, segment in enumerate(file.segments)
        if not numbers[index].keys().isdisjoint(segment.counts)
    ]
    spans, lives = [file.times for file in files if file.times], [parts]
    if any(file.goes_back for file in files) or any(before[1] > after[0] for before, after in pairwise(spans)):
        lives = _lives([(part, batch.numbers, batch.times) for part in parts for batch in [read(part)]])
    for life in lives:
        if len(lives) > 1 and all(part.ascends for part in life):  # then the file is in the order of arrival
            yield from map(read, life)
        else:
            yield from _by_time(sorted(life), read)


def _lives(pieces: Sequence[tuple[Part, NDArray[np.intp], NDArray[Any]]]) -> list[list[Part]]:
    """Parts between two cuts, of pieces that arrived in this order, with the topics and log times of their messages."""
    topics = np.concatenate([np.empty(0, np.intp), *(topics for _, topics, _ in pieces)])
    stamps = [np.minimum(times, LATEST).astype(np.int64) for *_, times in pieces]
    times = np.concatenate([np.empty(0, np.int64), *stamps])
    every, lives, start = np.unique(topics).tolist(), list[list[Part]]([[]]), 0
    cuts = _cuts([np.flatnonzero(topics == number) for number in every], times)
    for part, own, _ in pieces:
        inner = [cut - start for cut in cuts if start <= cut < start + len(own)]
        for begin, end in pairwise([0, *inner, len(own)]):
            if begin in inner:
                lives.append([])
            if begin < end:
                some = times[start + begin : start + end]
                ascends = all((np.diff(some[own[begin:end] == topic]) >= 0).all() for topic in every)
                lives[-1].append(Part((int(some.min()), int(some.max())), *part[1:3], begin, end, ascends))
        start += len(own)
    return lives


def _cuts(topics: Sequence[NDArray[np.intp]], times: NDArray[np.int64]) -> list[int]:
    """Indices of messages, in the order of arrival, before which the clock was set back.

    Args:
        topics: Indices of the messages of each topic.
        times: Log times [ns] of all messages.
    """
    steps: list[tuple[int, int, float]] = []
    for number, places in enumerate(topics):
        differences = np.diff(times[places])
        back, forward = np.flatnonzero(differences < 0) + 1, differences[differences > 0]
        if len(forward) and len(back) <= min(MOST_STEPS, len(differences) / UNSORTED):
            steps += [(place, number, float(np.median(forward))) for place in places[back].tolist()]
    cuts = [0]
    for place, number, usual in sorted(steps):
        places = topics[number]
        index, begin = np.searchsorted(places, [place, cuts[-1]]).tolist()
        before, after = times[places[max(begin, index - WINDOW) : index]], times[places[index : index + WINDOW]]
        if len(before) and before.max() - after[0] > JITTER * usual and not _fills_a_hole(before, after, usual):
            cuts.append(place)
    return cuts[1:]


def _fills_a_hole(before: NDArray[np.int64], after: NDArray[np.int64], usual: float) -> bool:
    """Whether the messages at the beginning of `after` were written late, as there are none at their times `before`."""
    differences = np.diff(after)
    ends = (differences < 0) | (differences > FAR * usual) | (after[1:] > before.max())
    group = after[: int(np.argmax(ends)) + 1 if ends.any() else len(after)]
    among = np.count_nonzero((before > group[0] - 0.5 * usual) & (before < group[-1] + 0.5 * usual))
    return FEW * int(among) <= len(group) and (bool(group[0] > before.min()) or len(group) < ENOUGH)


def _by_time(parts: Sequence[Part], read: Callable[[Part], Batch]) -> Iterator[Batch]:
    """Messages of ascending parts in the order of log time, at equal times in that of the files."""
    waiting = list[tuple[Part, Batch]]()  # rests of parts, in the order of the files
    for part, following in zip_longest(parts, parts[1:]):
        waiting = sorted([*waiting, (part, read(part).by_time())], key=lambda each: each[0][1:])
        counts = [
            int(np.searchsorted(batch.times, batch.times.dtype.type(following.times[0]))) if following else len(batch)
            for _, batch in waiting
        ]
        if ready := [batch.part(slice(n)) for n, (_, batch) in zip(counts, waiting, strict=True) if n]:
            yield Batch.together(ready).by_time() if len(ready) > 1 else ready[0]
        waiting = [(part, batch.part(slice(n, None))) for n, (part, batch) in zip(counts, waiting, strict=True)]
        waiting = [(part, batch) for part, batch in waiting if len(batch)]
        if (
            sum(len(batch.messages.data) for _, batch in waiting if isinstance(batch.messages.data, bytes))
            > MOST_AT_ONCE
        ):
            raise UsageError(
                f"its chunks overlap in time, so that more than {MOST_AT_ONCE} bytes would lie in memory: "
                "have another tool sort it, as `mcap sort`"
            )


class Messages(NamedTuple):
    """Messages of one topic, and their places among those of other topics."""

    topic: str
    """Absolute name of the topic"""
    stamps: NDArray[np.int64]
    """Stamps [ns], which are log times and publish times, shape (n,)"""
    data: NDArray[np.uint8]
    """CDR bytes of the messages, all of one length, shape (n, length)"""
    place: NDArray[np.int64]
    """Ascending places, shape (n,): messages are written in their order, at equal places in the order of the topics"""


def write_messages(bag: BagWriter, rows: Sequence[Messages]) -> None:
    """Write messages of several topics in the order of their places: the same bytes as by `BagWriter.write`.

    All of them go into one file, whatever its limits.
    """
    file, rows = bag.file, [row for row in rows if len(row.stamps)]
    if not rows:
        return
    order = np.argsort(np.concatenate([row.place for row in rows]), kind="stable")
    records = [_records(row, file.channels[row.topic], file.next_number(row.topic)) for row in rows]
    ends = np.cumsum(np.concatenate([np.full(len(each), each.itemsize) for each in records])[order])
    begins = np.empty_like(ends)
    begins[order] = np.append(0, ends[:-1])
    by_topic = np.split(begins, np.cumsum([len(each) for each in records])[:-1])
    data = np.empty(ends[-1], np.uint8)
    for each, places in zip(records, by_topic, strict=True):
        np.ndarray(len(data) - each.itemsize + 1, each.dtype, data, strides=(1,))[places] = each
    cuts, before = [0], -file.place  # numbers of messages before the chunks end
    while cuts[-1] < len(ends):
        cuts.append(min(int(np.searchsorted(ends, before + CHUNK_SIZE, "right")) + 1, len(ends)))
        before = int(ends[cuts[-1] - 1])
    bounds = np.append(0, ends)[cuts]
    shifts = np.append(-file.place, bounds[1:-1])  # offsets in the data minus those in a chunk
    entries: list[list[tuple[int, int, bytes]]] = [[] for _ in cuts[1:]]  # by chunk: first place, channel, index
    for row, places in zip(rows, by_topic, strict=True):
        numbers = np.searchsorted(places, bounds)
        index = np.column_stack((row.stamps, places - np.repeat(shifts, np.diff(numbers)))).tobytes()
        for chunk, (first, last) in zip(entries, pairwise(numbers.tolist()), strict=True):
            if first < last:
                piece = index[ENTRY.size * first : ENTRY.size * last]
                chunk.append((int(places[first]), file.channels[row.topic], piece))
    stamps = np.concatenate([row.stamps for row in rows])[order]
    firsts, lasts = (extreme.reduceat(stamps, cuts[:-1]).tolist() for extreme in (np.minimum, np.maximum))
    for part, first, last, chunk in zip(pairwise(bounds.tolist()), firsts, lasts, entries, strict=True):
        file.append(data[slice(*part)].data, {channel: piece for _, channel, piece in sorted(chunk)}, first, last)


def _records(rows: Messages, channel: int, sequence: int) -> NDArray[np.void]:
    """Message records of a topic as one item each, shape (n,)."""
    count, length = rows.data.shape
    records = np.empty((count, MESSAGE_HEAD.size + length), dtype=np.uint8)
    heads = np.ndarray(count, MESSAGE_HEADS, records, strides=records.strides[:1])
    heads["opcode"], heads["length"] = Opcode.MESSAGE, MESSAGE.size + length
    heads["channel"], heads["sequence"] = channel, sequence + np.arange(count)
    heads["log"] = heads["publish"] = rows.stamps
    records[:, MESSAGE_HEAD.size :] = rows.data
    return records.view(f"V{records.shape[1]}").reshape(count)
