"""Many messages in one piece of memory, without an object for each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Places = NDArray[np.int64]
"""Offsets [B] in a piece of memory, shape (n,)"""
MOST_ELSE = 4
"""Largest memory that is kept, or copied, for some messages, as a multiple of their size"""


@dataclass(frozen=True)
class Column:
    """Sequence of messages in one piece of memory."""

    data: bytes
    """The memory"""
    begins: Places
    """Offsets at which the messages begin"""
    ends: Places
    """Offsets behind the messages"""

    @classmethod
    def of(cls, messages: Sequence[bytes]) -> Column:
        """Column of messages that are separate objects."""
        lengths = np.fromiter(map(len, messages), np.int64, len(messages))
        ends = np.cumsum(lengths)
        return cls(b"".join(messages), ends - lengths, ends)

    @classmethod
    def together(cls, columns: Sequence[Column]) -> Column:
        """Concatenation of columns."""
        before = np.cumsum([0, *(len(column.data) for column in columns)]).tolist()
        return cls(
            b"".join([column.data for column in columns]),
            np.concatenate([column.begins + size for column, size in zip(columns, before, strict=False)]),
            np.concatenate([column.ends + size for column, size in zip(columns, before, strict=False)]),
        )

    def __len__(self) -> int:
        """Number of messages."""
        return len(self.begins)

    def __getitem__(self, index: int) -> bytes:
        """Message at an index."""
        return self.data[self.begins[index] : self.ends[index]]

    def __iter__(self) -> Iterator[bytes]:
        """Iterate over the messages."""
        return map(self.data.__getitem__, map(slice, self.begins.tolist(), self.ends.tolist()))

    def part(self, chosen: Any) -> Column:
        """Selection of messages, by a slice, their indices or a mask; it shares the memory."""
        return Column(self.data, self.begins[chosen], self.ends[chosen])

    def trimmed(self) -> Column:
        """Same messages in memory that holds little else."""
        if not len(self):
            return Column(b"", self.begins, self.ends)
        first, last = int(self.begins.min()), int(self.ends.max())
        if last - first > MOST_ELSE * int((self.ends - self.begins).sum()):
            return Column.of(list(self))
        if last - first == len(self.data):
            return self
        return Column(self.data[first:last], self.begins - first, self.ends - first)

    def rows(self, length: int) -> NDArray[np.uint8]:
        """First `length` bytes of each message, shape (n, length); no message may be shorter."""
        kind = np.dtype(f"V{length}")
        windows = np.ndarray(max(len(self.data) - length + 1, 0), kind, self.data, strides=(1,))
        return windows[self.begins].view(np.uint8).reshape(len(self), length)
