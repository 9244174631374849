"""Answers in a recording, as a structured array."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from itertools import groupby, islice
from operator import itemgetter
from pathlib import Path

import numpy as np
from rosbags.interfaces import MessageDefinition

from knee_contact_ros.bags.bag_files import in_a_line
from knee_contact_ros.bags.reader import BagReader, RawMessage
from knee_contact_ros.bags.stored_bag import StoredBag
from knee_contact_ros.bags.topic_names import absolute
from knee_contact_ros.model.types import Rows
from knee_contact_ros.streams.columns import decode_answers
from knee_contact_ros.streams.topics import KNEE_CONTACT, MESSAGE_TYPES
from knee_contact_ros.system.errors import UsageError

BLOCK = 8192
"""Largest number of messages that are decoded at once"""


def answer_topics(path: Path) -> list[str]:
    """Absolute names of the topics with answers in a bag, in alphabetical order.

    Raises:
        UsageError: There is no such bag, or nothing of it can be read.
    """
    if not path.exists():
        raise UsageError(f"no recording at {path}: give an .mcap file or a rosbag2 folder")
    with closing(StoredBag(path)) as bag:
        return sorted({
            absolute(connection.topic)
            for connection in bag.connections
            if connection.type == MESSAGE_TYPES[KNEE_CONTACT] and connection.messages
        })  # fmt: skip


def answer_blocks(
    path: Path, topic: str = f"/{KNEE_CONTACT}", advance: Callable[[int, int], None] | None = None
) -> Iterator[Rows]:
    """Answers of a recording in blocks, in the order of log time.

    Args:
        path: Recording.
        topic: Absolute name of the topic.
        advance: Function that is called after each block with the numbers of answers read so far and in all.

    Raises:
        UsageError: There is no such recording or topic, it is damaged, or a message cannot be decoded.
    """
    with BagReader(path, {topic: MESSAGE_TYPES[KNEE_CONTACT]}) as reader:
        if reader.damage:
            raise UsageError(f"{path} is damaged ({in_a_line(reader.damage)}): make it whole with knee-contact recover")
        done = 0
        for block, definition in _blocks(reader.described_messages()):
            try:
                answers = decode_answers(block, definition)
            except Exception as error:  # whatever broken bytes and definitions provoke
                raise UsageError(f"{path}: an answer cannot be decoded: {' '.join(str(error).split())}") from None
            yield answers
            done += len(block)
            if advance:
                advance(done, reader.count)


def read_answers(path: Path, topic: str = f"/{KNEE_CONTACT}") -> Rows:
    """All answers of a recording in one array; see `answer_blocks`."""
    return np.concatenate(list(answer_blocks(path, topic)))


def _blocks(
    messages: Iterable[tuple[RawMessage, MessageDefinition]],
) -> Iterator[tuple[list[bytes], MessageDefinition]]:
    """Blocks of messages with the same definition of their type, and the definition."""
    for definition, group in groupby(messages, key=itemgetter(1)):
        while block := [message.data for message, _ in islice(group, BLOCK)]:
            yield block, definition
