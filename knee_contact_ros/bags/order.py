"""Order in which the messages of a bag are read: that of their arrival.

Messages of a bag are sorted by log time, across the files of a bag and of several bags. A recorder's clock can be set
back, though, and our own recordings have stamps as log times, which go back when an input does. Sorting would then
mix two moments. So a bag is cut where its clock was set back, and only what lies between two cuts is sorted: the
pipeline gets the messages offline in the order in which the node got them.

A step back of the log times is no such cut if the messages behind it fill a hole in what came before: then messages
were written late, or into another file of a split bag.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from heapq import heappop, heappush
from itertools import pairwise, zip_longest
from operator import itemgetter
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.bags.columns import Batch

if TYPE_CHECKING:
    from knee_contact_ros.bags.reader import File

Numbers = Mapping[int, int]
"""Number of each topic that is read, by its number in the file"""
FAR = 3.0
"""Multiple of the usual step of a topic beyond which messages do not belong together"""
JITTER = 0.05
"""Part of the usual step by which log times may go back without any meaning"""
FEW = 4
"""Messages behind a step back fill a hole if there is at most one of the earlier ones among so many"""
ENOUGH = 3
"""Number of messages before all others that are a clock set back far, and not one that was written late"""
UNSORTED = 3
"""A topic is not sorted at all if one of so many steps goes back"""
WINDOW = 100_000
"""Largest number of messages that are compared at a step back"""
MOST_STEPS = 10_000
"""Largest number of steps back of a topic that are looked at"""
LATEST = np.iinfo(np.int64).max


class Part(NamedTuple):
    """Messages of a file that are read at once."""

    file: int
    """Index of the file"""
    segment: int
    """Index of the segment in the file"""
    first: int
    """Smallest log time [ns]"""
    last: int
    """Largest log time [ns]"""
    begin: int = 0
    """Index of the first message in the segment, among those of the topics that are read"""
    end: int | None = None
    """Index behind the last message; None: all are read"""
    ascends: bool = False
    """Whether the log times of each topic are known to ascend in it"""


def by_arrival(files: Sequence[File], numbers: Sequence[Numbers]) -> Iterator[Batch]:
    """Messages of files, which come in the order of recording.

    Args:
        files: Files.
        numbers: For each file the numbers of the topics that are read, as in `McapFile.read`.
    """
    lives = _lives(files, numbers)
    for parts in lives:
        if len(lives) == 1 or not all(part.ascends for part in parts):
            yield from _by_time(files, numbers, parts)
            continue
        for part in parts:  # where a clock was set back, the file is in the order of arrival
            yield _read(files, numbers, part)


def _lives(files: Sequence[File], numbers: Sequence[Numbers]) -> list[list[Part]]:
    """Parts of the files between two cuts."""
    parts = [
        Part(index, number, segment.first, segment.last)
        for index, file in enumerate(files)
        for number, segment in enumerate(file.segments)
        if not numbers[index].keys().isdisjoint(segment.counts)
    ]
    if not parts or not (any(file.goes_back for file in files) or _back(files, numbers)):
        return [parts]
    pieces = [_piece(files, numbers, part) for part in parts]
    return _cut(pieces)


Piece = tuple[Part, NDArray[np.intp], NDArray[np.int64]]
"""Part of a file with the numbers of the topics and the log times of its messages"""


def _piece(files: Sequence[File], numbers: Sequence[Numbers], part: Part) -> Piece:
    batch = files[part.file].read(part.segment, numbers[part.file])
    return part, batch.numbers, np.minimum(batch.times, LATEST).astype(np.int64)


def _cut(pieces: Sequence[Piece]) -> list[list[Part]]:
    """Parts between two cuts, of pieces that arrived in this order."""
    times = np.concatenate([piece[2] for piece in pieces])
    starts = np.cumsum([0, *(len(piece[2]) for piece in pieces)]).tolist()
    topics = np.concatenate([piece[1] for piece in pieces])
    found, every = list[list[Part]](), np.unique(topics).tolist()
    for begin, end in pairwise([0, *_cuts(topics, times), len(times)]):
        life = []
        for (part, *_), start, behind in zip(pieces, starts, starts[1:], strict=False):
            first, last = max(begin, start), min(end, behind)
            if first < last:
                own = times[first:last]
                ascends = all((np.diff(own[topics[first:last] == topic]) >= 0).all() for topic in every)
                span = int(own.min()), int(own.max())
                life.append(Part(part.file, part.segment, *span, first - start, last - start, ascends))
        found.append(life)
    return found


def _back(files: Sequence[File], numbers: Sequence[Numbers]) -> bool:
    """Whether the log times of a topic go back from one file to the next."""
    spans: dict[int, list[tuple[int, int]]] = {}
    for file, wanted in zip(files, numbers, strict=True):
        for channel, number in wanted.items():
            if channel in file.spans:
                spans.setdefault(number, []).append(file.spans[channel])
    return any(before[1] > after[0] for each in spans.values() for before, after in pairwise(each))


def _cuts(topics: NDArray[np.intp], times: NDArray[np.int64]) -> list[int]:
    """Indices of messages, in the order of the files, before which the clock was set back."""
    own = {number: np.flatnonzero(topics == number) for number in np.unique(topics).tolist()}
    steps: list[tuple[int, int, float]] = []
    for number, places in own.items():
        differences = np.diff(times[places])
        back, forward = np.flatnonzero(differences < 0) + 1, differences[differences > 0]
        if len(forward) and len(back) <= MOST_STEPS and UNSORTED * len(back) <= len(differences):
            usual = float(np.median(forward))
            steps += [(place, number, usual) for place in places[back].tolist()]
    cuts = [0]
    for place, number, usual in sorted(steps):
        places = own[number]
        index, begin = np.searchsorted(places, [place, cuts[-1]]).tolist()
        before, after = times[places[max(begin, index - WINDOW) : index]], times[places[index : index + WINDOW]]
        if len(before) and before.max() - after[0] > JITTER * usual and not _fills_a_hole(before, after, usual):
            cuts.append(place)
    return cuts[1:]


def _fills_a_hole(before: NDArray[np.int64], after: NDArray[np.int64], usual: float) -> bool:
    """Whether the messages at the beginning of `after` were written late, as there are none at their times `before`."""
    differences = np.diff(after)
    ends = (differences < 0) | (differences > FAR * usual) | (after[1:] > before.max())
    group = after[: int(np.argmax(ends)) + 1 if ends.any() else len(after)]
    among = np.count_nonzero((before > group[0] - 0.5 * usual) & (before < group[-1] + 0.5 * usual))
    return FEW * int(among) <= len(group) and (bool(group[0] > before.min()) or len(group) < ENOUGH)


def _read(files: Sequence[File], numbers: Sequence[Numbers], part: Part) -> Batch:
    batch = files[part.file].read(part.segment, numbers[part.file])
    return batch if part.end is None else batch.part(slice(part.begin, part.end))


def _by_time(files: Sequence[File], numbers: Sequence[Numbers], parts: Iterable[Part]) -> Iterator[Batch]:
    """Messages of parts in the order of log time, at equal times in that of the files."""
    waiting = list[tuple[int, Part, Batch]]()  # rests of parts by time
    ordered = sorted(parts, key=itemgetter(2, 0, 1, 4))
    for part, following in zip_longest(ordered, ordered[1:]):
        batch = _read(files, numbers, part).by_time()
        if not len(batch):
            continue
        if waiting or (following and following.first <= part.last):
            heappush(waiting, (int(batch.times[0]), part, batch))
            yield from _until(following, waiting)
        else:
            yield batch


def _until(following: Part | None, waiting: list[tuple[int, Part, Batch]]) -> Iterator[Batch]:
    """Remove and yield the waiting messages before the following part, all if it is None, in at most one batch."""
    rests: list[tuple[Any, Batch]] = []
    while waiting and (following is None or waiting[0][0] < following.first):
        _, part, batch = heappop(waiting)
        count = int(np.searchsorted(batch.times, batch.times.dtype.type(following.first))) if following else len(batch)
        rests.append((part, batch.part(slice(count))))
        if count < len(batch):
            heappush(waiting, (int(batch.times[count]), part, batch.part(slice(count, None))))
    if rests:
        yield Batch.together(
            [batch for _, batch in sorted(rests, key=lambda rest: (*rest[0][:2], rest[0].begin))]
        ).by_time()
