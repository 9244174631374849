"""Messages of bags as columns instead of objects: joined, put in the order of arrival, and written in blocks."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise, zip_longest
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray
from rosbags.interfaces import MessageDefinition

from knee_contact_ros.bags.recorder import CHUNK_SIZE, MESSAGE, MESSAGE_HEAD, BagWriter
from knee_contact_ros.streams.columns import Column
from knee_contact_ros.system.errors import UsageError

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
MOST_AT_ONCE = 2**28
"""Largest size [B] of the chunks in memory at one time"""
JITTER = 0.05
"""Fraction of a topic's usual step by which log times may go back without meaning anything"""
FEW = 4
"""Messages after a step back fill a hole if at most one earlier message lies among `FEW` of them"""
UNSORTED, MOST_STEPS, WINDOW = 3, 10_000, 100_000
"""A topic is simply sorted if one of `UNSORTED` steps goes back, or more than `MOST_STEPS` do; `WINDOW` messages before
and after a step are compared"""
LATEST = np.iinfo(np.int64).max


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


class Segment(NamedTuple):
    """Piece of a file that is read at a time: a chunk, or messages outside chunks."""

    offset: int
    """Offset [B] of the beginning in the file"""
    end: int
    """Offset [B] of its end"""
    begin: int
    """Offset [B] of the beginning of the data"""
    size: int
    """Uncompressed size [B] of the records"""
    compression: str | None = None
    """Name of the chunk's compression, empty if there is none; None outside chunks"""
    checksum: int = 0
    """CRC-32 of the uncompressed records; 0 if there is none"""
    cut: bool = False
    """Whether it is the beginning of a truncated chunk"""
    times: tuple[int, int] = (0, 0)
    """Smallest and largest log time [ns] of the messages"""
    counts: Mapping[int, int] = {}
    """Number of messages of each channel"""
    starts: NDArray[np.uint32] | None = None
    """Offsets [B] of the messages' records in the data, once they are known"""


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
        """Concatenation of batches of one file, at least one, in memory with little else."""
        numbers = np.concatenate([batch.numbers for batch in batches])
        times = np.concatenate([batch.times for batch in batches])
        return cls(
            numbers, times, Column.together([batch.messages.trimmed() for batch in batches])
        )

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


class File(ABC):
    """Open and checked file of a bag."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.faults: list[str] = []
        """Faults of the file, as sentences"""
        self.connections: dict[int, Connection] = {}
        """Topics by the numbers of their channels"""
        self.segments: list[Segment] = []
        """Pieces of the file with messages, in its order"""
        self.goes_back = False
        """Whether the log times of a channel go back in the order of the file"""
        self.is_recording = False
        """Whether it is a recording of this package, whose order is that of arrival"""
        self.close: Callable[[], None]
        """Function that closes the file"""

    @abstractmethod
    def read(self, segment: Segment, numbers: Mapping[int, int]) -> Batch:
        """Messages of a segment in its order; `numbers` has the number in the batch of each channel that is read."""

    @property
    def counts(self) -> Counter[int]:
        """Number of messages of each channel that is declared."""
        counts = Counter[int]()
        for segment in self.segments:
            counts.update(segment.counts)
        return Counter({number: counts[number] for number in self.connections})

    def note_undeclared(self) -> int:
        """Return the number of messages; add a fault if some are of undeclared topics."""
        total = sum(sum(segment.counts.values()) for segment in self.segments)
        if lost := total - self.counts.total():
            self.faults.append(f"{lost} messages are of topics that nothing declares")
        return total


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
    """Messages of a segment, or some of them."""

    times: tuple[int, int]
    """Smallest and largest log time [ns]"""
    file: int
    """Index of the file"""
    segment: int
    """Index of the segment in the file"""
    chosen: slice = slice(None)
    """Which of its messages on the topics that are read"""


def by_arrival(files: Sequence[File], numbers: Sequence[Mapping[int, int]]) -> Iterator[Batch]:
    """Messages of files in the order of arrival: by log time, but not across a clock that was set back.

    Clocks can be set back, and our own recordings have stamps as log times, which go back when those of an input do.
    So a bag is cut there, and messages are sorted only between two cuts: the pipeline gets them in the order in which
    the node got them.

    Args:
        files: Files in the order of recording.
        numbers: For each file the number of each topic that is read, by its number in the file.

    Raises:
        UsageError: Too much would be in memory at a time.
    """

    def read(part: Part) -> Batch:
        file = files[part.file]
        return file.read(file.segments[part.segment], numbers[part.file]).part(part.chosen)

    parts = [
        Part(segment.times, index, number)
        for index, file in enumerate(files)
        for number, segment in enumerate(file.segments)
        if not numbers[index].keys().isdisjoint(segment.counts)
    ]
    spans = [
        (min(s.times[0] for s in f.segments), max(s.times[1] for s in f.segments))
        for f in files
        if f.segments
    ]
    if not any(file.goes_back for file in files) and all(
        one[1] <= other[0] for one, other in pairwise(spans)
    ):
        yield from _by_time(parts, read)
        return
    arrays = [
        (batch.numbers, np.minimum(batch.times, LATEST).astype(np.int64))
        for batch in map(read, parts)
    ]
    topics = np.concatenate([np.empty(0, np.intp), *(topics for topics, _ in arrays)])
    times = np.concatenate([np.empty(0, np.int64), *(times for _, times in arrays)])
    ends, every = (
        np.cumsum([len(times) for _, times in arrays]).tolist(),
        np.unique(topics).tolist(),
    )
    late = not any(file.is_recording for file in files)
    cuts = [
        0,
        *_cuts([np.flatnonzero(topics == number) for number in every], times, late),
        len(times),
    ]
    for first, last in pairwise(cuts):
        life = []
        for part, end, (_, own) in zip(parts, ends, arrays, strict=True):
            chosen = slice(max(first - end + len(own), 0), max(last - end + len(own), 0))
            if len(some := own[chosen]):
                life.append(
                    Part((int(some.min()), int(some.max())), part.file, part.segment, chosen)
                )
        stamps = [times[first:last][topics[first:last] == number] for number in every]
        if len(cuts) > 2 and all(
            (np.diff(each) >= 0).all() for each in stamps
        ):  # then they came in this order
            yield from map(read, life)
        else:
            yield from _by_time(life, read)


def _cuts(topics: Sequence[NDArray[np.intp]], times: NDArray[np.int64], late: bool) -> list[int]:
    """Indices of messages, in the order of arrival, before which the clock was set back.

    Args:
        topics: Indices of the messages of each topic.
        times: Log times [ns] of all messages.
        late: Whether messages that fill a hole may have been written late.
    """
    steps: list[tuple[int, int, float]] = []
    for number, places in enumerate(topics):
        differences = np.diff(times[places])
        back, forward = np.flatnonzero(differences < 0) + 1, differences[differences > 0]
        if len(forward) and len(back) <= min(MOST_STEPS, len(differences) / UNSORTED):
            steps += [
                (place, number, float(np.median(forward))) for place in places[back].tolist()
            ]
    cuts = [0]
    for place, number, usual in sorted(steps):
        places = topics[number]
        index, begin = np.searchsorted(places, [place, cuts[-1]]).tolist()
        before, after = (
            times[places[max(begin, index - WINDOW) : index]],
            times[places[index : index + WINDOW]],
        )
        is_back = len(before) and before.max() - after[0] > JITTER * usual
        if is_back and not (late and _fills_a_hole(before, after, usual)):
            cuts.append(place)
    return cuts[1:]


def _fills_a_hole(before: NDArray[np.int64], after: NDArray[np.int64], usual: float) -> bool:
    """Whether the messages up to the next step back, or to times after all `before`, fill a hole in these."""
    ends = (np.diff(after) < 0) | (after[1:] > before.max())
    group = after[: int(np.argmax(ends)) + 1 if ends.any() else len(after)]
    among = np.count_nonzero(
        (before > group[0] - 0.5 * usual) & (before < group[-1] + 0.5 * usual)
    )
    return FEW * int(among) <= len(group) and bool(group[0] > before.min())


def _by_time(parts: Sequence[Part], read: Callable[[Part], Batch]) -> Iterator[Batch]:
    """Messages of parts in the order of log time."""
    waiting = list[Batch]()
    for part, following in zip_longest(ordered := sorted(parts), ordered[1:]):
        batch = (
            Batch.together([*waiting, read(part)]).by_time() if waiting else read(part).by_time()
        )
        until = batch.times.dtype.type(following.times[0]) if following else None
        ready = len(batch) if until is None else int(np.searchsorted(batch.times, until))
        yield batch.part(slice(ready))
        waiting = [batch.part(slice(ready, None))] if ready < len(batch) else []
        if sum(len(batch.messages.data) for batch in waiting) > MOST_AT_ONCE:
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
    """Write messages of several topics in the order of their places, with the same bytes as `BagWriter.write`.

    All of them go into one file, regardless of its limits.
    """
    file, rows = bag.file, [row for row in rows if len(row.stamps)]
    if not rows:
        return
    records = [
        _records(row, file.channels[row.topic], file.next_number(row.topic)) for row in rows
    ]
    order = np.argsort(np.concatenate([row.place for row in rows]), kind="stable")
    channels = np.repeat(
        [file.channels[row.topic] for row in rows], [len(row.stamps) for row in rows]
    )[order]
    stamps = np.concatenate([row.stamps for row in rows])[order]
    ends = np.cumsum(
        np.concatenate([np.full(len(each), each.itemsize) for each in records])[order]
    )
    begins = np.append(0, ends[:-1])
    data = np.empty(ends[-1], np.uint8)
    by_topic = np.split(begins[np.argsort(order)], np.cumsum([len(each) for each in records])[:-1])
    for each, own_begins in zip(records, by_topic, strict=True):
        np.ndarray(len(data) - each.itemsize + 1, each.dtype, data, strides=(1,))[own_begins] = (
            each
        )
    first = 0
    while first < len(order):
        shift = int(begins[first]) - file.place  # offset in the data minus that in the chunk
        last = min(int(np.searchsorted(ends, shift + CHUNK_SIZE, "right")) + 1, len(order))
        own, own_stamps = channels[first:last], stamps[first:last]
        entries = np.column_stack((own_stamps, begins[first:last] - shift))
        index = {
            channel: entries[own == channel].tobytes() for channel in dict.fromkeys(own.tolist())
        }
        file.append(
            data[begins[first] : ends[last - 1]].data,
            index,
            int(own_stamps.min()),
            int(own_stamps.max()),
        )
        first = last


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
