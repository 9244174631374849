"""Reading a bag in a thread, some messages ahead of their use: the bag of an hour does not fit into memory."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from queue import Full, Queue
from threading import Event, Thread

from knee_contact_ros.bags.reader import RawMessage

BLOCK = 256
"""Number of messages that are handed over at once: each handover wakes the other thread"""
BLOCKS = 64
"""Largest number of waiting blocks: 8 s of two topics at 1 kHz, some MB"""
LOOK_PERIOD = 0.1
"""Time [s] after which a thread that cannot hand over looks whether it is still wanted"""
SWITCH_INTERVAL = 1e-4
"""Time [s] for which a thread may keep the interpreter while another wants it; Python's default is 5 ms"""

Block = list[RawMessage]


class ReadAhead:
    """Messages of an iterator, which a thread of its own reads ahead."""

    def __init__(self, messages: Iterator[RawMessage]) -> None:
        self._queue: Queue[Block | Exception | None] = Queue(BLOCKS)
        self._unwanted = Event()
        self._thread = Thread(target=self._read, args=(messages,), name="read ahead", daemon=True)

    def __enter__(self) -> ReadAhead:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._unwanted.set()
        self._thread.join()

    def __iter__(self) -> Iterator[RawMessage]:
        """Yield the messages; an error is raised after all messages that were read before it."""
        while (block := self._queue.get()) is not None:
            if isinstance(block, Exception):
                raise block
            yield from block

    def _read(self, messages: Iterator[RawMessage]) -> None:
        block: Block = []
        ending: Exception | None = None
        try:
            for message in messages:
                block.append(message)
                if len(block) == BLOCK:
                    if not self._hand_over(block):
                        return
                    block = []
        except Exception as error:  # whatever it is, it belongs to whoever uses the messages
            ending = error
        if self._hand_over(block):
            self._hand_over(ending)

    def _hand_over(self, item: Block | Exception | None) -> bool:
        """Hand over a block, an error or the end (None); return False if nobody wants it any more."""
        while not self._unwanted.is_set():
            try:
                self._queue.put(item, timeout=LOOK_PERIOD)
            except Full:
                continue
            return True
        return False


@contextmanager
def quick_switching() -> Iterator[None]:
    """Let a thread that wakes up have the interpreter at once while another thread reads."""
    usual = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH_INTERVAL)
    try:
        yield
    finally:
        sys.setswitchinterval(usual)
