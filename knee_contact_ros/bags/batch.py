"""Messages as they come out of a bag's files: columns, and not an object for each."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.messages.column import Column


@dataclass(frozen=True)
class Batch:
    """Messages of several topics in their order; arrays have shape (n,)."""

    numbers: NDArray[np.intp]
    """Of their topics"""
    times: NDArray[Any]
    """[ns] log times, whole numbers"""
    messages: Column

    @classmethod
    def together(cls, batches: Sequence[Batch]) -> Batch:
        """One behind the other, in memory that holds little else; at least one, of one file."""
        numbers, times = (np.concatenate([getattr(each, name) for each in batches]) for name in ("numbers", "times"))
        return cls(numbers, times, Column.together([batch.messages.trimmed() for batch in batches]))

    def __len__(self) -> int:
        """How many there are."""
        return len(self.numbers)

    def __iter__(self) -> Iterator[tuple[int, int, bytes]]:
        """Number, time [ns] and bytes, one after the other."""
        return zip(self.numbers.tolist(), self.times.tolist(), self.messages, strict=True)

    def part(self, chosen: Any) -> Batch:
        """Some of them: a slice, their places in the batch, or whether each is one."""
        return Batch(self.numbers[chosen], self.times[chosen], self.messages.part(chosen))

    def between(self, start: int | None, stop: int | None) -> Batch:
        """Those from a time [ns] to before another one."""
        if start is None and stop is None:
            return self
        chosen = np.ones(len(self), dtype=bool)
        if start is not None:
            chosen &= self.times >= start
        if stop is not None:
            chosen &= self.times < stop
        return self.part(np.flatnonzero(chosen))

    def by_time(self) -> Batch:
        """In the order of time; equal times stay as they are."""
        if (self.times[1:] >= self.times[:-1]).all():
            return self
        return self.part(np.argsort(self.times, kind="stable"))

    def of(self, number: int) -> Column:
        """The messages of a topic."""
        return self.messages.part(np.flatnonzero(self.numbers == number))

    def changed(self, change: Callable[[bytes], bytes], chosen: NDArray[np.bool_]) -> Batch:
        """With other bytes in the place of some messages."""
        others = [change(data) if told else data for data, told in zip(self.messages, chosen.tolist(), strict=True)]
        return Batch(self.numbers, self.times, Column.of(others))


def blocks(batches: Iterable[Batch], most: int) -> Iterator[Batch]:
    """The same messages by so many: fewer only at the end."""
    waiting, number = list[Batch](), 0
    for batch in batches:
        rest = batch
        while number + len(rest) >= most:
            yield Batch.together([*waiting, rest.part(slice(most - number))])
            rest, waiting, number = rest.part(slice(most - number, None)), [], 0
        if len(rest):
            waiting.append(rest)
            number += len(rest)
    if waiting:
        yield Batch.together(waiting)
