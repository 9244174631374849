"""The pieces of an MCAP file that hold messages, and what their indexes should say of them."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import NamedTuple

from mcap.records import MessageIndex


class Segment(NamedTuple):
    """A piece of the file that is read at once: a chunk, or messages outside chunks."""

    first: int
    """Smallest log time [ns]"""
    last: int
    """Largest one"""
    offset: int
    end: int
    """[B]"""
    counts: Counter[int]
    """Messages by channel"""
    left_out: frozenset[int]
    """Where in the chunk messages begin that are not trusted"""
    cut: bool = False
    loose: bool = False
    """Outside chunks"""
    behind_hole: bool = False
    """Nobody knows whether a loose one is not part of a broken chunk"""


@dataclass
class ChunkFacts:
    """What the index of chunks should say of one."""

    offset: int
    length: int
    compression: str
    compressed_size: int
    size: int
    indexes: dict[int, int] = field(default_factory=dict)
    """Where the index of each channel's messages begins"""
    indexes_length: int = 0


class Pending:
    """A segment in the making: its messages by offset, with channel and log time."""

    def __init__(self, offset: int, end: int, *, checked: bool, cut: bool = False) -> None:
        self.offset, self.end, self.checked, self.cut = offset, end, checked, cut
        self.messages: dict[int, tuple[int, int]] = {}
        self.indexed: set[int] = set()  # channels that the index names
        self.listed: set[int] = set()  # offsets that the index gives as they are
        self.wrong = 0  # entries that are not as the index says

    def compare(self, index: MessageIndex) -> None:
        """Take a message index of the chunk."""
        self.indexed.add(index.channel_id)
        for log_time, offset in index.records:
            if self.messages.get(offset) == (index.channel_id, log_time):
                self.listed.add(offset)
            else:
                self.wrong += 1

    def not_as_listed(self) -> frozenset[int]:
        """Offsets of the messages that an index should give, and does not."""
        return frozenset(
            offset
            for offset, (channel, _) in self.messages.items()
            if channel in self.indexed and offset not in self.listed
        )

    def segment(self, left_out: frozenset[int], **kind: bool) -> Segment | None:
        """The segment, without some messages; None if there are no others."""
        kept = [message for offset, message in self.messages.items() if offset not in left_out]
        if not kept:
            return None
        times = [log_time for _, log_time in kept]
        counts = Counter(channel for channel, _ in kept)
        return Segment(min(times), max(times), self.offset, self.end, counts, left_out, self.cut, **kind)
