"""Many messages without an object for each: one piece of memory, and where in it they lie."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Places = NDArray[np.int64]
"""[B] in a piece of memory, shape (n,)"""
MOST_ELSE = 4
"""Times the messages' size that memory around them may have to be kept, or copied, with them"""


@dataclass(frozen=True)
class Column:
    """Messages in their order."""

    data: bytes
    begins: Places
    ends: Places

    @classmethod
    def of(cls, messages: Sequence[bytes]) -> Column:
        """Messages that are objects."""
        lengths = np.fromiter(map(len, messages), np.int64, len(messages))
        ends = np.cumsum(lengths)
        return cls(b"".join(messages), ends - lengths, ends)

    @classmethod
    def together(cls, columns: Sequence[Column]) -> Column:
        """One behind the other."""
        before = np.cumsum([0, *(len(column.data) for column in columns)]).tolist()
        return cls(
            b"".join([column.data for column in columns]),
            np.concatenate([column.begins + size for column, size in zip(columns, before, strict=False)]),
            np.concatenate([column.ends + size for column, size in zip(columns, before, strict=False)]),
        )

    def __len__(self) -> int:
        """How many there are."""
        return len(self.begins)

    def __getitem__(self, index: int) -> bytes:
        """One of them."""
        return self.data[self.begins[index] : self.ends[index]]

    def __iter__(self) -> Iterator[bytes]:
        """One after the other."""
        return map(self.data.__getitem__, map(slice, self.begins.tolist(), self.ends.tolist()))

    def part(self, chosen: Any) -> Column:
        """Some of them: a slice, their places in the column, or whether each is one."""
        return Column(self.data, self.begins[chosen], self.ends[chosen])

    def trimmed(self) -> Column:
        """The same in memory that holds little else."""
        if not len(self):
            return Column(b"", self.begins, self.ends)
        first, last = int(self.begins.min()), int(self.ends.max())
        if last - first > MOST_ELSE * int((self.ends - self.begins).sum()):
            return Column.of(list(self))
        if last - first == len(self.data):
            return self
        return Column(self.data[first:last], self.begins - first, self.ends - first)

    def rows(self, length: int) -> NDArray[np.uint8]:
        """The first bytes of each, shape (n, length); none is shorter."""
        kind = np.dtype(f"V{length}")
        windows = np.ndarray(max(len(self.data) - length + 1, 0), kind, self.data, strides=(1,))
        return windows[self.begins].view(np.uint8).reshape(len(self), length)
