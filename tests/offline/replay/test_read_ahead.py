"""A thread reads ahead: no farther than it may, everything in order, and it goes when nobody wants more."""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Iterator
from contextlib import closing

import pytest

from knee_contact_ros.bags.reader import RawMessage
from knee_contact_ros.commands.replay import BLOCK, BLOCKS, read_ahead
from knee_contact_ros.system.errors import UsageError


def messages(count: int | None = None) -> Iterator[RawMessage]:
    for number in itertools.count() if count is None else range(count):
        yield RawMessage("/a", number, b"")


@pytest.mark.parametrize("count", [0, 1, BLOCK, 3 * BLOCK + 7])
def test_all_messages_come_in_order(count: int) -> None:
    assert list(read_ahead(messages(count))) == list(messages(count))


def test_an_endless_bag_is_read_only_so_far() -> None:
    read = 0

    def counted() -> Iterator[RawMessage]:
        nonlocal read
        for message in messages():
            read += 1
            yield message

    with closing(read_ahead(counted())) as wanted:
        for _ in range(10 * BLOCK):
            next(wanted)
        seen = -1
        while seen != read:  # until it stands still
            seen = read
            time.sleep(0.3)
        assert read <= 10 * BLOCK + (BLOCKS + 2) * BLOCK
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("read ahead")]


def test_what_was_read_comes_before_the_error() -> None:
    def broken() -> Iterator[RawMessage]:
        yield from messages(BLOCK + 5)
        raise UsageError("the bag is damaged")

    with closing(read_ahead(broken())) as read:
        assert list(itertools.islice(read, BLOCK + 5)) == list(messages(BLOCK + 5))
        with pytest.raises(UsageError, match="damaged"):
            next(read)
