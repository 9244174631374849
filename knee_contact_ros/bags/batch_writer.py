"""Writing of many messages at once: the same bytes as one by one, in a tenth of the time."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from .mcap_file import MESSAGE_HEADS
from .mcap_writer import CHUNK_SIZE, MESSAGE_HEAD, MESSAGE_PREFIX
from .recorder import BagWriter


class TopicMessages(NamedTuple):
    """Messages of one topic, and their places among those of other topics."""

    topic: str
    """Absolute name of the topic"""
    stamps: NDArray[np.int64]
    """Stamps [ns], which are log times and publish times, shape (n,)"""
    data: NDArray[np.uint8]
    """CDR bytes of the messages, all of one length, shape (n, length)"""
    place: NDArray[np.int64]
    """Ascending places, shape (n,): messages are written in their order, at equal places in the order of the topics"""


def write_messages(bag: BagWriter, topics: Sequence[TopicMessages]) -> None:
    """Write messages of several topics in the order of their places, with the same bytes as `BagWriter.write_message`.

    All of them go into one file, regardless of its limits.
    """
    file = bag.file
    topics = [each for each in topics if len(each.stamps)]
    if not topics:
        return
    ids = [file.channels[each.topic] for each in topics]
    counts = [len(each.stamps) for each in topics]
    records = [
        _records_of(each, channel, file.next_sequence(each.topic))
        for each, channel in zip(topics, ids, strict=True)
    ]
    order = np.argsort(np.concatenate([each.place for each in topics]), kind="stable")
    channels = np.repeat(ids, counts)[order]
    stamps = np.concatenate([each.stamps for each in topics])[order]
    ends = np.cumsum(np.repeat([each.itemsize for each in records], counts)[order])
    begins = np.append(0, ends[:-1])
    data = np.empty(ends[-1], np.uint8)
    begins_by_topic = np.split(begins[np.argsort(order)], np.cumsum(counts)[:-1])
    for each, own_begins in zip(records, begins_by_topic, strict=True):
        windows = np.ndarray(len(data) - each.itemsize + 1, each.dtype, data, strides=(1,))
        windows[own_begins] = each
    first = 0
    while first < len(order):
        shift = int(begins[first]) - file.chunk_bytes  # offset in the data minus that in the chunk
        last = min(int(np.searchsorted(ends, shift + CHUNK_SIZE, "right")) + 1, len(order))
        own_channels = channels[first:last]
        own_stamps = stamps[first:last]
        entries = np.column_stack((own_stamps, begins[first:last] - shift))
        index = {
            channel: entries[own_channels == channel].tobytes()
            for channel in dict.fromkeys(own_channels.tolist())
        }
        encoded = data[begins[first] : ends[last - 1]].data
        file.append_encoded(encoded, index, int(own_stamps.min()), int(own_stamps.max()))
        first = last


def _records_of(messages: TopicMessages, channel: int, sequence: int) -> NDArray[np.void]:
    """Return the message records of a topic as one item each, shape (n,)."""
    count, length = messages.data.shape
    records = np.empty((count, MESSAGE_HEAD.size + length), dtype=np.uint8)
    heads = np.ndarray(count, MESSAGE_HEADS, records, strides=records.strides[:1])
    heads["opcode"] = Opcode.MESSAGE
    heads["length"] = MESSAGE_PREFIX.size + length
    heads["channel"] = channel
    heads["sequence"] = sequence + np.arange(count)
    heads["log"] = heads["publish"] = messages.stamps
    records[:, MESSAGE_HEAD.size :] = messages.data
    return records.view(f"V{records.shape[1]}").reshape(count)
