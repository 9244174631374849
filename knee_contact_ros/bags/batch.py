"""Messages of a bag in columns, without an object for each message."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.streams.columns import Column


@dataclass(frozen=True)
class Batch:
    """Sequence of n messages of several topics; arrays have shape (n,)."""

    numbers: NDArray[np.intp]
    """Number of the topic of each message"""
    times: NDArray[Any]
    """Log times [ns], as integers"""
    messages: Column
    """Bytes of the messages"""

    @classmethod
    def together(cls, batches: Sequence[Batch]) -> Batch:
        """Concatenation of batches of one file, at least one, in memory that holds little else."""
        numbers = np.concatenate([batch.numbers for batch in batches])
        times = np.concatenate([batch.times for batch in batches])
        return cls(numbers, times, Column.together([batch.messages.trimmed() for batch in batches]))

    def __len__(self) -> int:
        """Number of messages."""
        return len(self.numbers)

    def __iter__(self) -> Iterator[tuple[int, int, bytes]]:
        """Iterate over the messages: topic number, log time [ns] and bytes."""
        return zip(self.numbers.tolist(), self.times.tolist(), self.messages, strict=True)

    def part(self, chosen: Any) -> Batch:
        """Selection of messages, by a slice, their indices or a mask."""
        return Batch(self.numbers[chosen], self.times[chosen], self.messages.part(chosen))

    def between(self, start: int | None, stop: int | None) -> Batch:
        """Messages whose log time [ns] is at least `start` and less than `stop`; None means no limit."""
        if start is None and stop is None:
            return self
        chosen = np.ones(len(self), dtype=bool)
        if start is not None:
            chosen &= self.times >= start
        if stop is not None:
            chosen &= self.times < stop
        return self.part(np.flatnonzero(chosen))

    def by_time(self) -> Batch:
        """Messages sorted by log time; those with equal times keep their order."""
        if (self.times[1:] >= self.times[:-1]).all():
            return self
        return self.part(np.argsort(self.times, kind="stable"))

    def of(self, number: int) -> Column:
        """Bytes of the messages of the topic with this number."""
        return self.messages.part(np.flatnonzero(self.numbers == number))

    def changed(self, change: Callable[[bytes], bytes], chosen: NDArray[np.bool_]) -> Batch:
        """Copy in which `change` has been applied to the bytes of the messages that the mask `chosen` selects."""
        pairs = zip(self.messages, chosen.tolist(), strict=True)
        return Batch(self.numbers, self.times, Column.of([change(data) if mask else data for data, mask in pairs]))


def blocks(batches: Iterable[Batch], most: int) -> Iterator[Batch]:
    """Messages of the batches in blocks of `most` messages; only the last block may have fewer."""
    waiting, count = list[Batch](), 0
    for batch in batches:
        rest = batch
        while count + len(rest) >= most:
            yield Batch.together([*waiting, rest.part(slice(most - count))])
            rest, waiting, count = rest.part(slice(most - count, None)), [], 0
        if len(rest):
            waiting.append(rest)
            count += len(rest)
    if waiting:
        yield Batch.together(waiting)
