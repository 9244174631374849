"""The answers in a recording, as columns of numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import groupby, islice
from operator import itemgetter
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import MessageDefinition

from knee_contact_ros.bags.reader import BagReader, RawMessage
from knee_contact_ros.bags.recovery.source import in_a_line, open_bag
from knee_contact_ros.bags.topic_names import absolute
from knee_contact_ros.messages.answer_layout import decode_answers
from knee_contact_ros.messages.topics import KNEE_CONTACT, MESSAGE_TYPES
from knee_contact_ros.system.errors import UsageError

BLOCK = 8192
"""Messages that are decoded at once"""
Floats = NDArray[np.float64]


class Answers(NamedTuple):
    """Answers in their order, one per element; stamps, and behind them the numbers of `NUMBERS`, all of shape (n,)."""

    stamps: NDArray[np.int64]
    """[ns]"""
    flexion_angle: Floats
    """[rad]"""
    load: Floats
    """[N]"""
    contact_force: Floats
    """[N]"""
    penetration_depth: Floats
    """[m]"""
    gap: Floats
    """[m]"""
    penetration_rate: Floats
    """[m/s]"""
    sliding_velocity: Floats
    """[m/s]; not a number in recordings that were made before it was added"""
    contact_point_x: Floats
    """[m] tibia frame"""
    contact_point_y: Floats
    """[m]"""
    femoral_height: Floats
    """[m]"""
    cartilage_depth: Floats
    """[m]"""
    bone_depth: Floats
    """[m]"""
    contact_state: Floats
    """`ContactState`"""
    fidelity: Floats
    """`Fidelity`"""
    status: Floats
    """Set of `Status` bits"""
    error_estimate: Floats
    """[m]"""
    force_error_estimate: Floats
    """[N]; not a number in recordings that were made before it was added"""
    evaluations: Floats
    """Contact law evaluations"""


def answer_topics(path: Path) -> list[str]:
    """Absolute names of the topics of a bag that hold answers, in the order of their names.

    Raises:
        UsageError: no such bag, or not a bag.
    """
    if not path.exists():
        raise UsageError(f"no recording at {path}: give an .mcap file or a rosbag2 folder")
    reader, _ = open_bag(path)
    try:
        return sorted({
            absolute(connection.topic)
            for connection in reader.connections
            if connection.msgtype == MESSAGE_TYPES[KNEE_CONTACT] and connection.msgcount
        })  # fmt: skip
    finally:
        reader.close()


def answer_blocks(
    path: Path, topic: str = f"/{KNEE_CONTACT}", advance: Callable[[int, int], None] | None = None
) -> Iterator[Answers]:
    """The answers on a topic (absolute name) of a recording, by the block, in the order of log time.

    `advance` is called now and then with the number of answers read and in all.

    Raises:
        UsageError: no such recording or topic, it is damaged, or a message cannot be decoded.
    """
    with BagReader(path, {topic: MESSAGE_TYPES[KNEE_CONTACT]}) as reader:
        if reader.damage:
            raise UsageError(f"{path} is damaged ({in_a_line(reader.damage)}): make it whole with knee-contact recover")
        done = 0
        for block, described in _blocks(reader.described_messages()):
            try:
                stamps, numbers = decode_answers(block, described)
            except Exception as error:  # whatever broken bytes and definitions provoke
                raise UsageError(f"{path}: an answer cannot be decoded: {' '.join(str(error).split())}") from None
            yield Answers(stamps, *numbers.T)
            done += len(block)
            if advance:
                advance(done, reader.count)


def read_answers(path: Path, topic: str = f"/{KNEE_CONTACT}") -> Answers:
    """All of them at once; see `answer_blocks`."""
    return Answers(*(np.concatenate(columns) for columns in zip(*answer_blocks(path, topic), strict=True)))


def _blocks(
    messages: Iterable[tuple[RawMessage, MessageDefinition]],
) -> Iterator[tuple[list[bytes], MessageDefinition]]:
    """Bytes of messages that share their definition."""
    for described, alike in groupby(messages, key=itemgetter(1)):
        while block := [message.data for message, _ in islice(alike, BLOCK)]:
            yield block, described
