"""The order in which the messages of a bag arrived at its recorder.

That is by log time, but not across a clock that was set back. Clocks can be set back, and our own recordings have
stamps as log times, which go back when those of an input do. So a bag is cut where a clock was set back, and messages
are sorted only between two cuts: the pipeline gets them in the order in which the node got them. Our own recordings
have before each answer the samples that it is computed from, and are computed again in that order.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import pairwise, zip_longest
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..system.errors import UsageError
from .bag_file import BagFile, Batch
from .mcap_writer import LIBRARY

MAX_BYTES_IN_MEMORY = 2**28
"""Largest size [B] of the chunks in memory at one time"""
JITTER = 0.05
"""Part of a topic's usual step by which log times may go back without meaning anything: a recorder with several threads
exchanges neighbours. Tuned; tests/offline/test_streams_as_they_are.py would notice"""
HOLE_FACTOR = 4
"""Messages after a step back fill a hole if they are at least this many for each earlier message in their span.
Tuned; the same tests would notice"""
MOST_EXCHANGED = 10
"""Steps of a topic by which neighbours are exchanged at most. Behind a clock that was set back by as little, messages
have times that others had before; exchanged ones lie between these"""
UNSORTED_FACTOR = 3
"""A topic of which one in `UNSORTED_FACTOR` steps goes back has no order that could be kept: it is sorted. Tuned"""
MAX_STEPS_BACK = 10_000
"""Largest number of steps back of a topic that are looked at; a topic with more is sorted. It bounds the time"""
WINDOW = 100_000
"""Number of messages before and after a step back that are compared. It bounds the time"""
LARGEST_LOG_TIME = np.iinfo(np.int64).max


class ChunkSlice(NamedTuple):
    """Messages of a chunk, or some of them."""

    times: tuple[int, int]
    """Smallest and largest log time [ns]"""
    file: int
    """Index of the file"""
    chunk: int
    """Index of the chunk in the file"""
    chosen: slice = slice(None)
    """Which of the messages on the topics that are read"""


def by_arrival(
    files: Sequence[BagFile], numbers: Sequence[Mapping[int, int]], of_ticks: bool = False
) -> Iterator[Batch]:
    """Yield the messages of files in the order of arrival.

    Args:
        files: Files in the order of recording.
        numbers: For each file the number of each topic that is read, by the id of its channel.
        of_ticks: Whether our own recordings are read in their order: before each answer what it is computed from.

    Raises:
        UsageError: Too much would be in memory at a time.
    """

    def read(part: ChunkSlice) -> Batch:
        file = files[part.file]
        return file.read_chunk(file.chunks[part.chunk], numbers[part.file]).select(part.chosen)

    parts = [
        ChunkSlice(chunk.times, index, number)
        for index, file in enumerate(files)
        for number, chunk in enumerate(file.chunks)
        if not numbers[index].keys().isdisjoint(chunk.counts)
    ]
    if of_ticks and all(file.is_recording and file.library == LIBRARY for file in files):
        yield from map(read, parts)
        return
    if _is_in_order(files):
        yield from _by_time(parts, read)
        return
    topics = [np.empty(0, np.intp)]
    times = [np.empty(0, np.int64)]
    for batch in map(read, parts):
        topics.append(batch.numbers)
        times.append(np.minimum(batch.times, LARGEST_LOG_TIME).astype(np.int64))
    begins = np.cumsum([len(each) for each in times])
    is_recording = any(file.is_recording for file in files)
    all_topics = np.concatenate(topics)
    all_times = np.concatenate(times)
    cuts = _cuts(all_topics, all_times, late=not is_recording)
    for first, last in pairwise([0, *cuts, len(all_times)]):
        between = []
        for part, begin, own in zip(parts, begins.tolist(), times[1:], strict=False):
            chosen = slice(max(first - begin, 0), max(last - begin, 0))
            if len(some := own[chosen]):
                span = int(some.min()), int(some.max())
                between.append(part._replace(times=span, chosen=chosen))
        if cuts and _each_sorted(all_topics[first:last], all_times[first:last]):
            yield from map(read, between)  # they came in this order
        else:
            yield from _by_time(between, read)


def _is_in_order(files: Sequence[BagFile]) -> bool:
    """Return whether no log time goes back, in a file or from one to the next."""
    spans = [
        (
            min(chunk.times[0] for chunk in file.chunks),
            max(chunk.times[1] for chunk in file.chunks),
        )
        for file in files
        if file.chunks
    ]
    in_turn = all(before[1] <= after[0] for before, after in pairwise(spans))
    return in_turn and not any(file.goes_back for file in files)


def _each_sorted(topics: NDArray[np.intp], times: NDArray[np.int64]) -> bool:
    """Return whether the log times of no topic go back."""
    return all((np.diff(times[topics == topic]) >= 0).all() for topic in np.unique(topics))


def _cuts(topics: NDArray[np.intp], times: NDArray[np.int64], late: bool) -> list[int]:
    """Return the indices of messages, in the order of arrival, before which the clock was set back.

    Args:
        topics: Numbers of the topics of all messages.
        times: Log times [ns] of all messages.
        late: Whether messages that fill a hole may have been written late.
    """
    steps: list[tuple[int, float, NDArray[np.intp]]] = []
    for topic in np.unique(topics):
        places = np.flatnonzero(topics == topic)
        differences = np.diff(times[places])
        back = np.flatnonzero(differences < 0) + 1
        forward = differences[differences > 0]
        if len(forward) and len(back) <= min(MAX_STEPS_BACK, len(differences) / UNSORTED_FACTOR):
            usual = float(np.median(forward))
            steps += [(place, usual, places) for place in places[back].tolist()]
    cuts = [0]
    for place, usual, places in sorted(steps, key=lambda step: step[0]):
        index, begin = np.searchsorted(places, [place, cuts[-1]]).tolist()
        before = times[places[max(begin, index - WINDOW) : index]]
        after = times[places[index : index + WINDOW]]
        is_back = len(before) and before.max() - after[0] > JITTER * usual
        if is_back and not (late and _fills_a_hole(before, after, usual)):
            cuts.append(place)
    return cuts[1:]


def _fills_a_hole(before: NDArray[np.int64], after: NDArray[np.int64], usual: float) -> bool:
    """Return whether the messages up to the next step back, or to times after all `before`, fill a hole in these."""
    ends = (np.diff(after) < 0) | (after[1:] > before.max())
    group = after[: int(np.argmax(ends)) + 1 if ends.any() else len(after)]
    half = 0.5 * usual
    if before.max() - group[0] <= MOST_EXCHANGED * usual and len(group) <= MOST_EXCHANGED:
        near = before[before >= group[0] - half]
        if np.abs(np.subtract.outer(group, near)).min() > half:
            return True
    among = np.count_nonzero((before > group[0] - half) & (before < group[-1] + half))
    return HOLE_FACTOR * int(among) <= len(group) and bool(group[0] > before.min())


def _by_time(parts: Sequence[ChunkSlice], read: Callable[[ChunkSlice], Batch]) -> Iterator[Batch]:
    """Yield the messages of chunks in the order of log time."""
    waiting = list[Batch]()
    ordered = sorted(parts)
    for part, following in zip_longest(ordered, ordered[1:]):
        batch = read(part)
        if waiting:
            batch = Batch.concatenate([*waiting, batch])
        batch = batch.sorted_by_time()
        ready = len(batch)
        if following:
            ready = int(np.searchsorted(batch.times, batch.times.dtype.type(following.times[0])))
        yield batch.select(slice(ready))
        waiting = [batch.select(slice(ready, None))] if ready < len(batch) else []
        if sum(len(batch.messages.data) for batch in waiting) > MAX_BYTES_IN_MEMORY:
            raise UsageError(
                f"its chunks overlap in time, so that more than {MAX_BYTES_IN_MEMORY} bytes would lie in "
                "memory: have another tool sort it, as `mcap sort`"
            )


def in_batches_of(size: int, batches: Iterable[Batch]) -> Iterator[Batch]:
    """Yield the messages of batches in batches of `size` messages; only the last one may have fewer."""
    waiting = list[Batch]()
    count = 0
    for batch in batches:
        rest = batch
        while count + len(rest) >= size:
            yield Batch.concatenate([*waiting, rest.select(slice(size - count))])
            rest = rest.select(slice(size - count, None))
            waiting = []
            count = 0
        if len(rest):
            waiting.append(rest)
            count += len(rest)
    if waiting:
        yield Batch.concatenate(waiting)
