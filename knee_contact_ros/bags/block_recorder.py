"""Write many messages at once into a bag: the same bytes as one by one, from columns of numbers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from knee_contact_ros.bags.mcap_layout import ENTRY, MESSAGE, MESSAGE_HEAD
from knee_contact_ros.bags.mcap_records import MESSAGE_HEADS
from knee_contact_ros.bags.writer import BagWriter

Places = NDArray[np.int64]
"""Numbers of records, or of bytes"""
Records = NDArray[np.void]
"""Each as one thing; shape (n,)"""


class Messages(NamedTuple):
    """Messages of a channel, and where they belong among those of others."""

    topic: str
    stamps: NDArray[np.int64]
    """[ns], shape (n,)"""
    data: NDArray[np.uint8]
    """Shape (n, length)"""
    place: NDArray[np.int64]
    """Shape (n,), growing: messages are written in this order, those of one place in that of the channels given"""


def write_messages(bag: BagWriter, rows: Sequence[Messages]) -> None:
    """Write messages of several topics in the order of their places: the same bytes as by `BagWriter.write`.

    All go into one file.
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
    shifts = np.append(-file.mcap.place, bounds[1:-1])  # from places in the data to those in a chunk
    by_channel = [_entries(*each, bounds, shifts) for each in zip(channels, rows, begins, strict=True)]
    by_chunk = zip(*by_channel, strict=True)
    firsts, lasts = (extreme.reduceat(stamps, cuts[:-1]).tolist() for extreme in (np.minimum, np.maximum))
    for part, first, last, each in zip(pairwise(bounds.tolist()), firsts, lasts, by_chunk, strict=True):
        entries = {channel: packed for _, channel, packed in sorted(each) if packed}
        file.mcap.append(data[slice(*part)].data, entries, first, last)


def _in_order(records: Sequence[Records], order: Places) -> tuple[NDArray[np.uint8], Places, list[Places]]:
    """Records of several topics, one behind the other; where each ends, and where those of each topic begin [B]."""
    lengths = np.concatenate([np.full(len(each), each.itemsize) for each in records])[order]
    ends = np.cumsum(lengths)
    data, begins = np.empty(ends[-1], np.uint8), np.empty_like(ends)
    begins[order] = ends - lengths
    by_topic = np.split(begins, np.cumsum([len(each) for each in records])[:-1])
    for each, own in zip(records, by_topic, strict=True):
        windows = np.ndarray(len(data) - each.itemsize + 1, each.dtype, data, strides=(1,))
        windows[own] = each
    return data, ends, by_topic


def _entries(
    channel: int, row: Messages, begins: Places, bounds: Places, shifts: Places
) -> Iterator[tuple[int, int, bytes]]:
    """For each chunk's part of the data: where the channel's next record begins [B], the channel, and its entries.

    `bounds` are those of the parts in the data [B]; `shifts` lead from there to places in the chunks.
    """
    numbers = np.searchsorted(begins, bounds)
    packed = np.column_stack((row.stamps, begins - np.repeat(shifts, np.diff(numbers)))).tobytes()
    following = np.append(begins, bounds[-1])[numbers[:-1]].tolist()
    for begin, (first, last) in zip(following, pairwise(numbers.tolist()), strict=True):
        yield begin, channel, packed[ENTRY.size * first : ENTRY.size * last]


def _records(rows: Messages, channel: int, sequence: int) -> Records:
    """Message records, each as one thing, shape (n,)."""
    number, length = rows.data.shape
    records = np.empty((number, MESSAGE_HEAD.size + length), dtype=np.uint8)
    heads = np.ndarray(number, MESSAGE_HEADS, records, strides=records.strides[:1])
    heads["opcode"], heads["length"] = Opcode.MESSAGE, MESSAGE.size + length
    heads["channel"], heads["sequence"] = channel, sequence + np.arange(number)
    heads["log"] = heads["publish"] = rows.stamps
    records[:, MESSAGE_HEAD.size :] = rows.data
    return records.view(f"V{records.shape[1]}").reshape(number)
