"""The answers in a recording, as columns of numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.cdr_blocks import TOLD, decode_contacts
from knee_contact_ros.errors import UsageError
from knee_contact_ros.messages import deserialize, stamp_to_ns
from knee_contact_ros.salvage.source import in_a_line, open_bag
from knee_contact_ros.stream_in.bag import BagReader, RawMessage
from knee_contact_ros.stream_in.names import absolute
from knee_contact_ros.topics import KNEE_CONTACT, MESSAGE_TYPES

BLOCK = 8192
"""Messages that are decoded at once"""
Floats = NDArray[np.float64]


class Answers(NamedTuple):
    """Answers in their order, one per element; named as the fields of `KneeContact`, all of shape (n,)."""

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
        for block in _blocks(reader.raw_messages()):
            stamps, numbers = decode_contacts(block) or _one_by_one(path, block)
            yield Answers(stamps, *numbers.T)
            done += len(block)
            if advance:
                advance(done, reader.count)


def read_answers(path: Path, topic: str = f"/{KNEE_CONTACT}") -> Answers:
    """All of them at once; see `answer_blocks`."""
    return Answers(*(np.concatenate(columns) for columns in zip(*answer_blocks(path, topic), strict=True)))


def _blocks(messages: Iterable[RawMessage]) -> Iterator[list[bytes]]:
    coming = iter(messages)
    while block := [message.data for message in islice(coming, BLOCK)]:
        yield block


def _one_by_one(path: Path, messages: Sequence[bytes]) -> tuple[NDArray[np.int64], Floats]:
    """The same where the layout changes from message to message."""
    try:
        decoded = [deserialize(data, KNEE_CONTACT) for data in messages]
    except Exception as error:  # whatever broken bytes provoke in a deserializer
        raise UsageError(f"{path}: an answer cannot be decoded: {' '.join(str(error).split())}") from None
    stamps = np.array([stamp_to_ns(message.header.stamp) for message in decoded], dtype=np.int64)
    return stamps, np.array([_numbers(message) for message in decoded], dtype=np.float64).reshape(-1, TOLD)


def _numbers(message: Any) -> list[float]:
    special = {"contact_point_x": message.contact_point.x, "contact_point_y": message.contact_point.y}
    return [special[name] if name in special else getattr(message, name) for name in Answers._fields[1:]]
