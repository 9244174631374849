"""Write many messages at once into a bag: the same bytes as one by one.

The `mcap` library's writer takes one message at a time. Its chunk builder takes bytes as well, and is handed the
messages of a block as they would lie in the chunk, with their index; the library compresses and writes the chunk.
"""

from __future__ import annotations

from collections.abc import Sequence
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import MessageIndex
from numpy.typing import NDArray

from knee_contact_ros.bags.mcap_records import HEAD, MESSAGE_HEAD
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
    """The messages of a channel in a block; arrays have shape (n,)."""

    number: int
    stamps: NDArray[np.int64]
    begins: NDArray[np.int64]
    """Where in the block its records begin, growing"""


class Block(NamedTuple):
    """Message records, one behind the other."""

    data: NDArray[np.uint8]
    """All bytes"""
    ends: NDArray[np.int64]
    """Where each record ends in them"""
    channels: list[Channel]


class Index(MessageIndex):
    """The library's, of which many entries are added and written at once: an array (n, 2) may stand for them."""

    def write(self, stream: RecordBuilder) -> None:
        """Write the record."""
        entries = np.concatenate([np.reshape(np.asarray(entry, "<u8"), (-1, 2)) for entry in self.records]).tobytes()
        stream.start_record(Opcode.MESSAGE_INDEX)
        stream.write2(self.channel_id)
        stream.write4(len(entries))
        stream.write(entries)
        stream.finish_record()  # type: ignore[no-untyped-call]


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
        found.append(Channel(number, row.stamps, own))
    return Block(data, ends, found)


def _split(values: NDArray[np.int64], like: Sequence[NDArray[Any]]) -> list[NDArray[np.int64]]:
    """Parts of values, as many in each as there are in those."""
    return np.split(values, np.cumsum([len(part) for part in like])[:-1])


def write_block(writer: Any, block: Block) -> None:
    """Hand a block to an `mcap.writer.Writer`, chunk by chunk as it would cut them itself."""
    builder, limit, done, start = writer._Writer__chunk_builder, writer._Writer__chunk_size, 0, 0
    while done < len(block.ends):
        done = min(int(np.searchsorted(block.ends, limit - builder.count + start, "right")) + 1, len(block.ends))
        end = int(block.ends[done - 1])
        _add(builder, block, start, end)
        writer._Writer__maybe_finalize_chunk()
        start = end
    _count(writer._Writer__statistics, block.channels)


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


def _add(builder: Any, block: Block, start: int, end: int) -> None:
    """Add the records between two places [B] of a block to a chunk."""
    indices, offset, first_ones = builder.message_indices, builder.count - start, []
    for channel in block.channels:
        part = slice(*np.searchsorted(channel.begins, (start, end)))
        stamps, begins = channel.stamps[part], channel.begins[part]
        if len(stamps):
            first_ones.append((begins[0], channel.number, np.column_stack((stamps, begins + offset))))
    for _, number, entries in sorted(first_ones, key=itemgetter(0)):
        known: Any = indices.get(number)
        if not isinstance(known, Index):
            indices[number] = known = Index(number, known.records if known else [])
        known.records.append(entries)
        first, last = int(entries[:, 0].min()), int(entries[:, 0].max())
        builder.message_start_time = min(first, builder.message_start_time) if builder.num_messages else first
        builder.message_end_time = max(last, builder.message_end_time)
        builder.num_messages += len(entries)
    builder.record_writer.write(block.data[start:end].data)


def _count(statistics: Any, channels: Sequence[Channel]) -> None:
    """Take messages into account in the file's statistics."""
    for channel in channels:
        first, last = int(channel.stamps.min()), int(channel.stamps.max())
        statistics.message_start_time = min(first, statistics.message_start_time) if statistics.message_count else first
        statistics.message_end_time = max(last, statistics.message_end_time)
        statistics.message_count += len(channel.stamps)
        statistics.channel_message_counts[channel.number] += len(channel.stamps)
