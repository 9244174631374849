"""Write many messages at once into a bag: the same bytes as one by one.

The `mcap` library's writer takes one message at a time. Its chunk builder takes bytes as well, and is handed the
messages of a block as they would lie in the chunk, with their index; the library compresses and writes the chunk.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from knee_contact_ros.bags.mcap_writer import Index
from knee_contact_ros.bags.writer import BagWriter

HEAD = np.dtype(
    [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log", "<u8"), ("publish", "<u8")]
)
"""What a message record begins with"""
OPCODE_AND_LENGTH = 9
"""[B] that its length does not count"""


class Messages(NamedTuple):
    """Messages of a channel, and where they belong among those of others."""

    topic: str
    stamps: NDArray[np.int64]
    """[ns], shape (n,)"""
    data: NDArray[np.uint8]
    """Shape (n, length)"""
    place: NDArray[np.int64]
    """Shape (n,), growing: messages are written in this order, those of one place in that of the channels given"""


class Block(NamedTuple):
    """Message records, one behind the other; arrays have shape (n,)."""

    data: NDArray[np.uint8]
    """All bytes"""
    ends: NDArray[np.int64]
    """Where each record ends in them"""
    channels: NDArray[np.int64]
    stamps: NDArray[np.int64]


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
    lengths = np.concatenate([np.full(len(record), record.shape[1]) for record in records])
    ends = np.cumsum(lengths[order])
    begins = np.empty(len(order), dtype=np.int64)
    begins[order] = ends - lengths[order]
    data = np.empty(ends[-1] if len(ends) else 0, dtype=np.uint8)
    done = 0
    for record in records:
        data[begins[done : done + len(record), None] + np.arange(record.shape[1])] = record
        done += len(record)
    channel = np.concatenate([np.full(len(row.stamps), number) for row, number in zip(rows, channels, strict=True)])
    return Block(data, ends, channel[order], np.concatenate([row.stamps for row in rows])[order])


def write_block(writer: Any, block: Block) -> None:
    """Hand a block to an `mcap.writer.Writer`, chunk by chunk as it would cut them itself."""
    builder, limit, done = writer._Writer__chunk_builder, writer._Writer__chunk_size, 0
    while done < len(block.ends):
        start = int(block.ends[done - 1]) if done else 0
        offset = builder.count - start
        end = min(int(np.searchsorted(block.ends, limit - offset, "right")) + 1, len(block.ends))
        _add(builder, block, slice(done, end), start)
        _count(writer._Writer__statistics, block, slice(done, end))
        writer._Writer__maybe_finalize_chunk()
        done = end


def _records(rows: Messages, channel: int, sequence: int) -> NDArray[np.uint8]:
    """Message records, shape (n, length)."""
    number, length = rows.data.shape
    heads = np.empty(number, dtype=HEAD)
    heads["opcode"], heads["length"] = Opcode.MESSAGE, HEAD.itemsize - OPCODE_AND_LENGTH + length
    heads["channel"], heads["sequence"] = channel, sequence + np.arange(number)
    heads["log"] = heads["publish"] = rows.stamps
    return np.hstack([heads.view(np.uint8).reshape(number, HEAD.itemsize), rows.data])


def _add(builder: Any, block: Block, part: slice, start: int) -> None:
    """Add records, which begin at `start` in the block, to a chunk."""
    offset = builder.count - start
    stamps, channels = block.stamps[part], block.channels[part]
    begins = np.concatenate([[start], block.ends[part][:-1]]) + offset
    for channel in dict.fromkeys(channels.tolist()):
        chosen = channels == channel
        index = builder.message_indices.setdefault(channel, Index(channel, []))
        index.records.extend(zip(stamps[chosen].tolist(), begins[chosen].tolist(), strict=True))
    first, last = int(stamps.min()), int(stamps.max())
    builder.message_start_time = min(first, builder.message_start_time) if builder.num_messages else first
    builder.message_end_time = max(last, builder.message_end_time)
    builder.num_messages += len(stamps)
    builder.record_writer.write(block.data[start : block.ends[part][-1]].data)


def _count(statistics: Any, block: Block, part: slice) -> None:
    """Take records into account in the file's statistics."""
    stamps, channels = block.stamps[part], block.channels[part]
    first, last = int(stamps.min()), int(stamps.max())
    statistics.message_start_time = min(first, statistics.message_start_time) if statistics.message_count else first
    statistics.message_end_time = max(last, statistics.message_end_time)
    statistics.message_count += len(stamps)
    for channel, count in zip(*np.unique(channels, return_counts=True), strict=True):
        statistics.channel_message_counts[int(channel)] += int(count)
