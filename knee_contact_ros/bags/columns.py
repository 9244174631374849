"""Messages of bags in columns, without an object for each: joined, cut, found in chunks, and written in blocks."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from knee_contact_ros.bags.recorder import CHUNK_SIZE, ENTRY, HEAD, INDEX, MESSAGE, MESSAGE_HEAD, BagWriter
from knee_contact_ros.streams.columns import Column

Places = NDArray[np.int64]
"""Indices of records, or offsets of bytes; shape (n,)"""
MESSAGE_HEADS = np.dtype(
    [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log", "<u8"), ("publish", "<u8")]
)
"""Layout `MESSAGE_HEAD` as a NumPy type"""
DECLARATIONS = (Opcode.SCHEMA, Opcode.CHANNEL)
"""Opcodes of the records that declare types and topics"""


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

    def between(self, start: int | None, stop: int | None) -> Batch:
        """Messages whose log time [ns] is at least `start` and less than `stop`; None means no limit."""
        chosen = np.ones(len(self), dtype=bool)
        if start is not None:
            chosen &= self.times >= start
        if stop is not None:
            chosen &= self.times < stop
        return self if chosen.all() else self.part(np.flatnonzero(chosen))

    def by_time(self) -> Batch:
        """Messages sorted by log time; those with equal times keep their order."""
        if (self.times[1:] >= self.times[:-1]).all():
            return self
        return self.part(np.argsort(self.times, kind="stable"))

    def of(self, number: int) -> Column:
        """Bytes of the messages of the topic with this number."""
        return self.messages.part(np.flatnonzero(self.numbers == number))

    def changed(self, change: Callable[[bytes], bytes], chosen: NDArray[np.bool_]) -> Batch:
        """Copy in which `change` has been applied to the bytes of the messages that the mask `chosen` selects."""
        pairs = zip(self.messages, chosen.tolist(), strict=True)
        return Batch(self.numbers, self.times, Column.of([change(data) if mask else data for data, mask in pairs]))

    def converted(self, convert: Sequence[Callable[[bytes, int], bytes] | None]) -> Batch:
        """Copy in which the messages of each number are changed by its function, from bytes and log time [ns]."""
        changes = [each or (lambda data, _: data) for each in convert]
        return replace(self, messages=Column.of([changes[number](data, time) for number, time, data in self]))


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


class Contents(NamedTuple):
    """Messages of a chunk, or outside chunks, and its other records; arrays have shape (n,) for n messages."""

    heads: NDArray[Any]
    """Heads of the messages, as `MESSAGE_HEADS`"""
    messages: Column
    """Encoded messages"""
    declarations: list[tuple[int, bytes]]
    """Opcodes and contents of schema and channel records"""
    number: int
    """Number of all records"""
    end: int
    """Offset [B] of the end of the last record"""


def contents_of(data: bytes, indices: Sequence[bytes], most: int) -> Contents:
    """Records in `data` up to the first that is not whole, but at most `most` + 1.

    The contents of the message indices that follow a chunk tell at once where all messages begin, which is only known
    from the record before otherwise. They are believed if the chunk then consists of nothing but messages.

    Raises:
        ValueError: A message is too short.
    """
    begins = _indexed(data, indices)
    if begins is not None:
        return _contents(data, begins, [], len(begins), len(data))
    places, declarations, number, end = list[int](), list[tuple[int, bytes]](), 0, 0
    for opcode, begin, end in records_in(data, most):
        number += 1
        if opcode == Opcode.MESSAGE:
            if end - begin < MESSAGE.size:
                raise ValueError("has a message that is too short")
            places.append(begin - HEAD.size)
        elif opcode in DECLARATIONS:
            declarations.append((opcode, data[begin:end]))
    return _contents(data, np.array(places, np.int64), declarations, number, end)


def records_in(data: bytes, most: int) -> Iterator[tuple[int, int, int]]:
    """Opcode, and offsets [B] of content and end, of at most `most` + 1 whole records at the beginning of `data`."""
    position, end, head, size, count = 0, len(data), HEAD.unpack_from, HEAD.size, 0
    while position + size <= end and count <= most:
        opcode, length = head(data, position)
        begin, position = position + size, position + size + length
        if position > end or not opcode:
            return
        count += 1
        yield opcode, begin, position


def _indexed(data: bytes, indices: Sequence[bytes]) -> Places | None:
    """Offsets [B] of the messages of a chunk according to the `indices`; None unless these are certainly right."""
    if not indices or any(len(index) % ENTRY.size != INDEX.size for index in indices):
        return None
    places = np.concatenate([np.frombuffer(index, "<u8", offset=INDEX.size)[1::2] for index in indices])
    if not len(places) or int(places.max()) > len(data) - MESSAGE_HEAD.size:
        return None
    begins = np.sort(places.astype(np.int64), kind="stable")  # fast, because it consists of sorted runs
    heads, lengths = _heads(data, begins), np.diff(begins, append=len(data)) - HEAD.size
    right = begins[0] == 0 and int(lengths.min()) >= MESSAGE.size and (heads["length"] == lengths).all()
    return begins if right and (heads["opcode"] == Opcode.MESSAGE).all() else None


def _contents(data: bytes, begins: Places, declarations: list[tuple[int, bytes]], number: int, end: int) -> Contents:
    heads = _heads(data, begins)
    ends = begins + HEAD.size + heads["length"].astype(np.int64)
    return Contents(heads, Column(data, begins + MESSAGE_HEAD.size, ends), declarations, number, end)


def _heads(data: bytes, begins: Places) -> NDArray[Any]:
    """Heads of the message records at the given offsets, as `MESSAGE_HEADS`."""
    heads = np.dtype(f"V{MESSAGE_HEAD.size}")  # one item each, which is copied at once
    windows = np.ndarray(max(len(data) - heads.itemsize + 1, 0), heads, data, strides=(1,))
    return windows[begins].view(MESSAGE_HEADS)


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
