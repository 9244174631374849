"""An open file of a bag: its channels and its chunks, which are read into batches of messages."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.records import Metadata
from numpy.typing import NDArray
from rosbags.interfaces import MessageDefinition

from ..streams.columns import Column
from ..streams.output import LOAD_PROVENANCE, PROVENANCE


class Channel(NamedTuple):
    """Topic of a bag with its type and encoding.

    Several channels of a file, or of several files, may be equal: those of several publishers, and of merged files.
    """

    topic: str
    """Name of the topic in the bag"""
    type: str
    """Type of the messages; empty if it is unknown"""
    encoding: str
    """Encoding of the messages"""
    definition: MessageDefinition
    """Definition of the type in the bag"""


class Chunk(NamedTuple):
    """Messages of a file that are read together: a chunk of MCAP, messages outside chunks, or rows of sqlite3."""

    offset: int
    """Offset [B] of the chunk in the file; id of the first row"""
    end: int
    """Offset [B] of the end of its records; id of the last row"""
    records_begin: int
    """Offset [B] of its records, which may be compressed"""
    uncompressed_size: int
    """Size [B] of the uncompressed records"""
    compression: str | None = None
    """Name of the compression, empty if there is none; None outside chunks"""
    checksum: int = 0
    """CRC-32 of the uncompressed records; 0 if there is none"""
    is_cut: bool = False
    """Whether it is the beginning of a truncated chunk"""
    times: tuple[int, int] = (0, 0)
    """Smallest and largest log time [ns] of the messages"""
    counts: Mapping[int, int] = {}
    """Number of messages by the id of their channel"""
    message_starts: NDArray[np.uint32] | None = None
    """Offsets [B] of the message records in the uncompressed records, once they are known"""


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
    def concatenate(cls, batches: Sequence[Batch]) -> Batch:
        """Join batches of one file, at least one, in memory with little else."""
        return cls(
            np.concatenate([batch.numbers for batch in batches]),
            np.concatenate([batch.times for batch in batches]),
            Column.together([batch.messages.trimmed() for batch in batches]),
        )

    def __len__(self) -> int:
        """Number of messages."""
        return len(self.numbers)

    def __iter__(self) -> Iterator[tuple[int, int, bytes]]:
        """Iterate over the messages: topic number, log time [ns] and bytes."""
        return zip(self.numbers.tolist(), self.times.tolist(), self.messages, strict=True)

    def select(self, chosen: Any) -> Batch:
        """Return some of the messages, chosen by a slice, their indices or a mask."""
        return Batch(self.numbers[chosen], self.times[chosen], self.messages.part(chosen))

    def sorted_by_time(self) -> Batch:
        """Sort the messages by log time; those with equal times keep their order."""
        if (self.times[1:] >= self.times[:-1]).all():
            return self
        return self.select(np.argsort(self.times, kind="stable"))

    def messages_of(self, number: int) -> Column:
        """Return the bytes of the messages of the topic with this number."""
        return self.messages.part(np.flatnonzero(self.numbers == number))

    def converted(self, convert: Sequence[Callable[[bytes, int], list[bytes]] | None]) -> Batch:
        """Convert messages by the function of their number, from bytes and log time [ns] to some; None leaves them.

        Those of the third number become such of the first one.
        """
        messages = list[bytes]()
        counts = []
        for number, time, data in self:
            change = convert[number]
            made = change(data, time) if change else [data]
            messages += made
            counts.append(len(made))
        numbers = np.where(self.numbers == 2, 0, self.numbers)
        return Batch(
            np.repeat(numbers, counts), np.repeat(self.times, counts), Column.of(messages)
        )


class BagFile(ABC):
    """Open and checked file of a bag."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.faults: list[str] = []
        """Faults of the file, as sentences"""
        self.channels: dict[int, Channel] = {}
        """Channels by their ids"""
        self.chunks: list[Chunk] = []
        """Chunks with messages, in the order of the file"""
        self.metadata: list[Metadata] = []
        """Metadata records, in the order of the file"""
        self.library = ""
        """Name of the library that has written the file; empty if it is not known"""
        self.goes_back = False
        """Whether the log times of a channel go back in the order of the file"""
        self.close: Callable[[], None]
        """Function that closes the file"""

    @property
    def is_recording(self) -> bool:
        """Whether it is a recording of this package, whose order is that of arrival."""
        return any(record.name in (PROVENANCE, LOAD_PROVENANCE) for record in self.metadata)

    @abstractmethod
    def read_chunk(self, chunk: Chunk, numbers: Mapping[int, int]) -> Batch:
        """Read the messages of a chunk in its order; `numbers` has the number of each channel that is read."""

    @property
    def message_counts(self) -> Counter[int]:
        """Number of messages of each channel that is declared."""
        counts = Counter[int]()
        for chunk in self.chunks:
            counts.update(chunk.counts)
        return Counter({channel: counts[channel] for channel in self.channels})

    def note_undeclared(self) -> int:
        """Return the number of messages; add a fault if some are of undeclared channels."""
        total = sum(sum(chunk.counts.values()) for chunk in self.chunks)
        if lost := total - self.message_counts.total():
            self.faults.append(f"{lost} messages are of topics that nothing declares")
        return total
