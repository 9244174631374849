"""Decoded messages of a bag: the answers of a recording as arrays, and all messages of a short bag."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..model.types import Rows, Status
from ..streams.columns import decode_answers
from ..streams.topics import KNEE_CONTACT, MESSAGE_TYPES, deserialize
from ..system.errors import UsageError, join_faults
from ..system.progress import OnProgress, no_progress
from .bag import Bag, damaged, opened_bag
from .names import absolute

BLOCK_SIZE = 8192
"""Largest number of answers that are decoded at a time: 2 MB"""


MOST_OUT_OF_ORDER = 0.01
"""Largest fraction of answers that may be out of order in one run, as a clock was set back"""


class BagMessage(NamedTuple):
    """Decoded message of a bag."""

    topic: str
    """Absolute name of the topic in the node"""
    log_time: int
    """Log time [ns]"""
    message: Any
    """Message as `rosbags` deserializes it"""


def read_bag(path: Path, types: Mapping[str, str]) -> list[BagMessage]:
    """Return all messages of the topics with these types, decoded by the definitions in this package; for short bags.

    Raises:
        UsageError: The bag cannot be read, or a message cannot be decoded.
    """
    with Bag(path) as bag:
        messages = bag.select(types).raw_messages()
        try:
            return [
                BagMessage(topic, time, deserialize(data, topic[1:]))
                for topic, time, data in messages
            ]
        except Exception as error:  # whatever broken bytes provoke in the decoder
            raise damaged(path, error) from None


def answer_topics(bag: Path | Bag) -> list[str]:
    """Return the absolute names of the topics with answers in a bag, in alphabetical order.

    Raises:
        UsageError: There is no such bag, or nothing of it can be read.
    """
    with opened_bag(bag) as open_bag:
        filled = [channel for channel, count in open_bag.message_counts.items() if count]
    wanted = MESSAGE_TYPES[KNEE_CONTACT]
    return sorted({absolute(each.topic) for each in filled if each.type == wanted})


def answer_blocks(
    bag: Path | Bag,
    topic: str = f"/{KNEE_CONTACT}",
    advance: OnProgress = no_progress,
) -> Iterator[Rows]:
    """Yield the answers of a recording in blocks, in the order of log time.

    Args:
        bag: Recording.
        topic: Absolute name of the topic.
        advance: Function that is called after each block with the numbers of answers read so far and in all.

    Raises:
        UsageError: There is no such recording or topic, it is damaged, or a message cannot be decoded.
    """
    with opened_bag(bag) as recording:
        path = recording.path
        reader = recording.select({topic: MESSAGE_TYPES[KNEE_CONTACT]})
        if recording.damage:
            raise UsageError(
                f"{path} is damaged ({join_faults(recording.damage)}): repair it with knee-contact recover"
            )
        first, *others = {channel.definition for channel in reader.requested[topic]}
        if others:
            raise UsageError(
                f"{path}: {topic} has several definitions of its messages: give its recordings one by one"
            )
        done, last = 0, None
        for batch in reader.batches_of(BLOCK_SIZE):
            try:
                answers = decode_answers(batch.messages, first)
            except Exception as error:  # whatever broken bytes and definitions provoke
                reason = " ".join(str(error).split())
                raise UsageError(f"{path}: an answer cannot be decoded: {reason}") from None
            last = _check_one_run(path, topic, answers, last)
            yield answers
            done += len(answers)
            advance(done, reader.message_count)


def _check_one_run(path: Path, topic: str, answers: Rows, last: int | None) -> int:
    """Refuse answers of several runs that another tool has mixed; return the stamp [ns] of the last one.

    `last` is that of the answer before. In a run stamps go back only where an answer says so.
    """
    steps = np.diff(answers["stamp"], prepend=answers["stamp"][0] - 1 if last is None else last)
    mixed = np.count_nonzero((steps <= 0) & ((answers["status"] & Status.TIME_RESET) == 0))
    if mixed > MOST_OUT_OF_ORDER * len(answers):
        raise UsageError(
            f"{path}: {topic} holds answers of several runs, mixed by another tool ({mixed} of {len(answers)} stamps "
            "do not follow the one before): give its recordings one by one"
        )
    return int(answers["stamp"][-1])


def read_answers(bag: Path | Bag, topic: str = f"/{KNEE_CONTACT}") -> Rows:
    """Return all answers of a recording in one array; see `answer_blocks`."""
    return np.concatenate(list(answer_blocks(bag, topic)))
