"""Writing of many messages at once, from arrays, into a bag: the same bytes as one by one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from knee_contact_ros.bags.mcap_chunks import MESSAGE_HEADS
from knee_contact_ros.bags.mcap_layout import ENTRY, MESSAGE, MESSAGE_HEAD
from knee_contact_ros.bags.writer import BagWriter

Places = NDArray[np.int64]
"""Indices of records, or offsets of bytes; shape (n,)"""
Records = NDArray[np.void]
"""Message records as one item each; shape (n,)"""


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
    stamps = np.concatenate([row.stamps for row in rows])[order]
    channels = [file.channels[row.topic] for row in rows]
    numbers = [file.next_number(row.topic) for row in rows]
    data, ends, begins = _in_order(list(map(_records, rows, channels, numbers)), order)
    cuts = file.mcap.cuts(ends.data)
    bounds = np.append(0, ends)[cuts]
    shifts = np.append(-file.mcap.place, bounds[1:-1])  # offsets in the data minus those in a chunk
    by_channel = [
        _entries(channel, row, begin, bounds, shifts)
        for channel, row, begin in zip(channels, rows, begins, strict=True)
    ]
    by_chunk = zip(*by_channel, strict=True)
    firsts, lasts = (extreme.reduceat(stamps, cuts[:-1]).tolist() for extreme in (np.minimum, np.maximum))
    for part, first, last, parts in zip(pairwise(bounds.tolist()), firsts, lasts, by_chunk, strict=True):
        entries = {channel: packed for _, channel, packed in sorted(parts) if packed}
        file.mcap.append(data[slice(*part)].data, entries, first, last)


def _in_order(records: Sequence[Records], order: Places) -> tuple[NDArray[np.uint8], Places, list[Places]]:
    """Records of several topics in one piece of memory; offsets [B] of all ends, and of the beginnings by topic."""
    lengths = np.concatenate([np.full(len(rows), rows.itemsize) for rows in records])[order]
    ends = np.cumsum(lengths)
    data, begins = np.empty(ends[-1], np.uint8), np.empty_like(ends)
    begins[order] = ends - lengths
    by_topic = np.split(begins, np.cumsum([len(rows) for rows in records])[:-1])
    for rows, places in zip(records, by_topic, strict=True):
        windows = np.ndarray(len(data) - rows.itemsize + 1, rows.dtype, data, strides=(1,))
        windows[places] = rows
    return data, ends, by_topic


def _entries(
    channel: int, row: Messages, begins: Places, bounds: Places, shifts: Places
) -> Iterator[tuple[int, int, bytes]]:
    """For each part of the data: offset [B] of the channel's next record, the channel, and its message index entries.

    A part goes into one chunk. `bounds` are the offsets [B] at which the parts begin and end; subtracting the shift of
    its part from an offset in the data gives the offset in the chunk.
    """
    numbers = np.searchsorted(begins, bounds)
    packed = np.column_stack((row.stamps, begins - np.repeat(shifts, np.diff(numbers)))).tobytes()
    following = np.append(begins, bounds[-1])[numbers[:-1]].tolist()
    for begin, (first, last) in zip(following, pairwise(numbers.tolist()), strict=True):
        yield begin, channel, packed[ENTRY.size * first : ENTRY.size * last]


def _records(rows: Messages, channel: int, sequence: int) -> Records:
    """Message records of a topic as one item each, shape (n,)."""
    count, length = rows.data.shape
    records = np.empty((count, MESSAGE_HEAD.size + length), dtype=np.uint8)
    heads = np.ndarray(count, MESSAGE_HEADS, records, strides=records.strides[:1])
    heads["opcode"], heads["length"] = Opcode.MESSAGE, MESSAGE.size + length
    heads["channel"], heads["sequence"] = channel, sequence + np.arange(count)
    heads["log"] = heads["publish"] = rows.stamps
    records[:, MESSAGE_HEAD.size :] = rows.data
    return records.view(f"V{records.shape[1]}").reshape(count)
