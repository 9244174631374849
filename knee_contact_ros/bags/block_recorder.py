"""Write many messages at once into a bag: the same bytes as one by one.

The `mcap` library's writer takes one message at a time. Its chunk builder takes bytes as well, and is handed the
messages of a block as they would lie in the chunk, with their index; the library compresses and writes the chunk.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from knee_contact_ros.bags.mcap_records import HEAD, MESSAGE_HEAD
from knee_contact_ros.bags.mcap_writer import Index, count_messages
from knee_contact_ros.bags.writer import BagWriter


class Messages(NamedTuple):
    """Messages of a channel, and where they belong among those of others."""

    topic: str
    stamps: NDArray[np.int64]
    """[ns], shape (n,)"""
    data: NDArray[np.uint8]
    """Shape (n, length)"""
    place: NDArray[np.int64]
    """Shape (n,), growing: messages are written in this order, those of one place in that of the channels given"""


class Channel(NamedTuple):
    """The messages of a channel in a block."""

    number: int
    begins: NDArray[np.int64]
    """Where in the block its records begin, growing; shape (n,)"""
    entries: NDArray[np.int64]
    """Stamp [ns] and place of each, as its index has them; shape (n, 2)"""


class Block(NamedTuple):
    """Message records, one behind the other; arrays have shape (n,)."""

    data: NDArray[np.uint8]
    """All bytes"""
    ends: NDArray[np.int64]
    """Where each record ends in them"""
    stamps: NDArray[np.int64]
    channels: list[Channel]


def write_messages(bag: BagWriter, rows: Sequence[Messages]) -> None:
    """Write messages of several topics in the order of their places: the same bytes as by `BagWriter.write`.

    All go into one file.
    """
    rows = [row for row in rows if len(row.stamps)]
    if not rows:
        return
    file = bag.file
    block = block_of(rows, [file.channels[row.topic] for row in rows], [bag.counts[row.topic] for row in rows])
    write_block(file.writer, block)
    for row in rows:
        bag.counts[row.topic] += len(row.stamps)
        file.count(row.topic, len(row.stamps), int(row.stamps.min()), int(row.stamps.max()))


def block_of(rows: Sequence[Messages], channels: Sequence[int], sequences: Sequence[int]) -> Block:
    """Message records in their order; `channels` and `sequences` give each topic's channel and next sequence number."""
    records = [_records(*what) for what in zip(rows, channels, sequences, strict=True)]
    order = np.argsort(np.concatenate([row.place for row in rows]), kind="stable")
    lengths = np.concatenate([np.full(len(record), record.itemsize) for record in records])
    ends = np.cumsum(lengths[order])
    begins = np.empty(len(order), dtype=np.int64)
    begins[order] = ends - lengths[order]
    data = np.empty(ends[-1] if len(ends) else 0, dtype=np.uint8)
    found = []
    for row, record, number, own in zip(rows, records, channels, _split(begins, records), strict=True):
        windows = np.ndarray(max(len(data) - record.itemsize + 1, 0), record.dtype, data, strides=(1,))
        windows[own] = record
        found.append(Channel(number, own, np.column_stack((row.stamps, own))))
    return Block(data, ends, np.concatenate([row.stamps for row in rows])[order], found)


def _split(values: NDArray[np.int64], like: Sequence[NDArray[Any]]) -> list[NDArray[np.int64]]:
    """Parts of values, as many in each as there are in those."""
    return np.split(values, np.cumsum([len(part) for part in like])[:-1])


def write_block(writer: Any, block: Block) -> None:
    """Hand a block to an `mcap.writer.Writer`, chunk by chunk as it would cut them itself."""
    builder, limit = writer._Writer__chunk_builder, writer._Writer__chunk_size
    cuts, start, room = [0], 0, limit - builder.count
    while cuts[-1] < len(block.ends):
        cuts.append(min(int(np.searchsorted(block.ends, start + room, "right")) + 1, len(block.ends)))
        start, room = int(block.ends[cuts[-1] - 1]), limit
    places = [0, *block.ends[np.array(cuts[1:], np.intp) - 1].tolist()]
    by_channel = [np.searchsorted(channel.begins, places).tolist() for channel in block.channels]
    for number, (begin, end) in enumerate(pairwise(cuts)):
        parts = [slice(*of_channel[number : number + 2]) for of_channel in by_channel]
        _add_indices(builder, block.channels, parts, builder.count - places[number])
        _count(builder, "num_messages", block.stamps[begin:end])
        builder.record_writer.write(block.data[places[number] : places[number + 1]].data)
        writer._Writer__maybe_finalize_chunk()
    statistics = writer._Writer__statistics
    _count(statistics, "message_count", block.stamps)
    for channel in block.channels:
        statistics.channel_message_counts[channel.number] += len(channel.begins)


def _records(rows: Messages, channel: int, sequence: int) -> NDArray[Any]:
    """Message records, each as one thing, shape (n,)."""
    number, length = rows.data.shape
    records = np.empty((number, MESSAGE_HEAD.itemsize + length), dtype=np.uint8)
    heads = np.ndarray(number, MESSAGE_HEAD, records, strides=records.strides[:1])
    heads["opcode"], heads["length"] = Opcode.MESSAGE, MESSAGE_HEAD.itemsize - HEAD.size + length
    heads["channel"], heads["sequence"] = channel, sequence + np.arange(number)
    heads["log"] = heads["publish"] = rows.stamps
    records[:, MESSAGE_HEAD.itemsize :] = rows.data
    return records.view(f"V{records.shape[1]}").reshape(number)


def _add_indices(builder: Any, channels: Sequence[Channel], parts: Sequence[slice], offset: int) -> None:
    """Add a part of each channel to the indices of a chunk, in which the block begins at an offset [B]."""
    there = [(channel, part) for channel, part in zip(channels, parts, strict=True) if part.start < part.stop]
    for channel, part in sorted(there, key=lambda each: int(each[0].begins[each[1].start])):
        index = builder.message_indices.get(channel.number)
        if not isinstance(index, Index):
            index = Index(channel.number, index.records if index else [])
            builder.message_indices[channel.number] = index
        entries: Any = (channel.entries[part] + (0, offset)).tobytes()
        index.records.append(entries)


def _count(told: Any, count: str, stamps: NDArray[np.int64]) -> None:
    count_messages(told, count, len(stamps), int(stamps.min()), int(stamps.max()))
