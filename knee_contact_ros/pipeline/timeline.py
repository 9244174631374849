"""Decides by their stamps which samples of a stream to believe: one that continues the stream at once, others later.

A sample whose stamp lies far ahead of the one before is wrong, or the stream has paused; far behind, it is wrong, or
the clock was set back, or a bag begins anew. The following samples show which. Until then such samples are kept aside,
and none is lost by that: they are believed as soon as the other stream is at the same time, or if for a while no sample
continues the stream from the last one believed; they are refused once one does.

No clock is used: what is believed depends on the samples and their order alone.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from itertools import pairwise
from typing import Any, Generic, Protocol, TypeVar

STEPS = 8
"""Number of past steps that show how far the next one may go; the second longest counts, as one may be a pause"""
FAR = 3
"""Multiple of the second longest step beyond which a step is far"""
SILENT = 4
"""Multiple of that step, or of the longest step of those kept aside, after which samples kept aside are believed"""
ENOUGH = 3
"""Number of samples of both streams that make a jump of both: a pair of wrong stamps does not. More samples than this
of one stream, after a pause, are not a burst of wrong stamps either: samples from within the pause are wrong then"""


class Stamped(Protocol):
    """Sample with a stamp."""

    @property
    def stamp(self) -> int:
        """Stamp [ns]."""


S = TypeVar("S", bound=Stamped)


class Timeline(Generic[S]):
    """Decides which samples of one stream to believe."""

    def __init__(self, max_gap: int, most: int, refuse: Callable[[str], None], name: str) -> None:
        """Begin a stream.

        Args:
            max_gap: Largest time [ns] by which a sample that lies behind is merely late.
            most: Largest number of samples that are kept aside.
            refuse: Called with the reason for each sample that is refused.
            name: Name of the stream, with which the reasons begin.
        """
        self.last: int | None = None
        """Stamp [ns] of the last sample that was believed"""
        self.pending: list[S] = []
        """Samples that may be believed later, in increasing order of their stamps"""
        self.jumps = 0
        """Number of jumps of the stream"""
        self.steps: deque[int] = deque(maxlen=STEPS)
        """Last steps forward [ns]"""
        self.far = max_gap
        """Longest step [ns] that is not far"""
        self._max_gap, self._most, self._refuse, self._name = max_gap, most, refuse, name

    def take(self, sample: S, other: Timeline[Any]) -> list[S]:
        """Take a sample; return those that are believed now, oldest first. `other` is the stream that it pairs with.

        If the stream has jumped back, the stamp of the first one is not later than `last` was.
        """
        stamp, last = sample.stamp, self.last
        if last is not None:
            step = stamp - last
            near = 0 < step <= self.far
            if near or (step > 0 and other.has_reached(stamp)):
                passed = [] if not self.pending or (near and self._is_alone(other)) else self._pass_by(stamp)
                self._go_to(stamp)
                return [*passed, sample]
            if -self._max_gap <= step <= 0 and not (self.pending and stamp > self.pending[-1].stamp):
                self._refuse(f"{self._name}_not_in_order")
                return []
        return self._hold_back(sample, other)

    def look_again(self, other: Timeline[Any], jumped: bool) -> list[S]:
        """Return samples kept aside that are believed now that the other stream has new samples, or has `jumped`."""
        if not self.pending:
            return []
        if jumped and other.last is not None and abs(self.pending[-1].stamp - other.last) <= self._max_gap:
            return self.believe()
        return self.believe(self._believable(other))

    def has_reached(self, stamp: int) -> bool:
        """Whether a stamp [ns] is not later than this stream's next sample is expected."""
        return self.last is not None and stamp <= self.last + self.far // FAR

    def believe(self, number: int | None = None) -> list[S]:
        """Believe the oldest samples of those kept aside, or all of them; return them."""
        if number == 0:
            return []
        believed, self.pending = self.pending[:number], [] if number is None else self.pending[number:]
        for sample in believed:
            self.jumps += self.last is not None and not 0 < sample.stamp - self.last <= self._max_gap
            if self.last is not None and sample.stamp <= self.last:  # the jumps on the way there are no steps
                self.go_on(self.last, [step for step in self.steps if step <= self._max_gap])
            self._go_to(sample.stamp)
        return believed

    def drop_aside(self) -> None:
        """Refuse the samples that were kept aside."""
        for _ in self.pending:
            self._refuse(f"{self._name}_off_time")
        self.pending = []

    def go_on(self, last: int | None, steps: Iterable[int]) -> None:
        """Set the state after samples up to a stamp [ns] with these last steps [ns], and none kept aside."""
        self.last = last
        self.steps = deque(steps, maxlen=STEPS)
        self.far = FAR * _longest_but_one(self.steps) if self.steps else self._max_gap

    def clear(self) -> None:
        """Forget everything; the samples that were kept aside are refused."""
        self.drop_aside()
        self.go_on(None, ())

    def _hold_back(self, sample: S, other: Timeline[Any]) -> list[S]:
        """Keep a sample for later; return those that are believed because of it."""
        if self.pending and sample.stamp <= self.pending[-1].stamp:
            if self._is_late_aside(sample.stamp):
                self._refuse(f"{self._name}_not_in_order")
                return []
            self.drop_aside()
        self.pending.append(sample)
        return self.believe(None if len(self.pending) >= self._most else self._believable(other))

    def _is_late_aside(self, stamp: int) -> bool:
        """Whether a sample belongs to those kept aside, but is late; if not, the stream does not continue there."""
        first, newest, many = self.pending[0].stamp, self.pending[-1].stamp, len(self.pending) > ENOUGH
        before = self.last if many and self.last is not None and self.last < first else first - self.far
        return stamp == newest or (len(self.pending) > 1 and stamp >= max(before, newest - self._max_gap))

    def _believable(self, other: Timeline[Any]) -> int:
        """Number of samples kept aside, from the oldest on, with which the stream continues."""
        first, newest, every = self.pending[0].stamp, self.pending[-1].stamp, len(self.pending)
        enough = self.last is None or every + len(other.pending) >= ENOUGH
        if other.pending and enough and abs(newest - other.pending[-1].stamp) <= self._max_gap:
            return every
        if every > 1 and (newest - first >= self._silence() or self._is_alone(other)):
            return every
        return self._near(other)

    def _near(self, other: Timeline[Any]) -> int:
        """Number of the oldest samples kept aside that are not far from each other or from the other stream."""
        at = self.last
        for number, sample in enumerate(self.pending):
            goes_on = at is not None and at < sample.stamp <= at + self.far
            if not (goes_on or ((at is None or at < sample.stamp) and other.has_reached(sample.stamp))):
                return number
            at = sample.stamp
        return len(self.pending)

    def _pass_by(self, stamp: int) -> list[S]:
        """Continue the stream at a later stamp: believe the samples kept aside before it, and refuse the others."""
        last = -1 if self.last is None else self.last
        between = [sample for sample in self.pending if last < sample.stamp < stamp]
        self.pending = [sample for sample in self.pending if not last < sample.stamp < stamp]
        self.drop_aside()
        for sample in between:
            self._go_to(sample.stamp)
        return between

    def _silence(self) -> int:
        """Time [ns] without a sample that continues the stream, after which samples kept aside are believed."""
        if not self.steps:
            return 0
        own = (after.stamp - before.stamp for before, after in pairwise(self.pending))
        return min(SILENT * max(_longest_but_one(self.steps), *own), self._max_gap)

    def _is_alone(self, other: Timeline[Any]) -> bool:
        """Whether the samples kept aside are at the other stream's time, and those believed are not."""
        if self.last is None or other.last is None:
            return False
        return abs(self.pending[-1].stamp - other.last) <= self._max_gap < abs(self.last - other.last)

    def _go_to(self, stamp: int) -> None:
        if self.last is not None and stamp > self.last:
            step, steps = stamp - self.last, self.steps
            gone = steps[0] if len(steps) == STEPS else 0
            steps.append(step)
            if FAR * step >= self.far or FAR * gone >= self.far or len(steps) <= 2:  # else it stays as it is
                self.far = FAR * _longest_but_one(steps)
        self.last = stamp


def _longest_but_one(steps: deque[int]) -> int:
    """Second longest step [ns]; the only one if there is one."""
    return sorted(steps)[-2:][0]
