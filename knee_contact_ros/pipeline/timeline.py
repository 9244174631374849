"""Which samples of a stream to believe, by their stamps: one that goes on as before, at once; one that does not, later.

A sample whose stamp lies far ahead of the one before is wrong, or the stream has paused; far behind it is wrong, or the
clock was set back, or a bag begins anew. What comes next tells. Until then such samples are kept aside, and none is
lost by that: they are believed as soon as the other stream is at the same time, or nothing has come for a while that
goes on from the last one believed; they are refused once something has.

No clock in here: what is believed depends on the samples and their order alone.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from itertools import pairwise
from typing import Any, Generic, Protocol, TypeVar

STEPS = 8
"""So many steps of a stream tell how far the next one may go: the longest of them but one, for one may be a pause"""
FAR = 3
"""A step is far if it is longer than so many of that one"""
SILENT = 4
"""So many of that one, or of the longest of those kept aside, without a sample that goes on, and they are believed"""
ENOUGH = 3
"""So many samples of both streams make a jump of both: a pair of wrong stamps is none. More of one stream, after a
pause, are no burst of wrong stamps either: what then comes from within the pause is"""


class Stamped(Protocol):
    """A sample."""

    @property
    def stamp(self) -> int:
        """[ns]."""


S = TypeVar("S", bound=Stamped)


class Timeline(Generic[S]):
    """The stamps of one stream."""

    def __init__(self, max_gap: int, most: int, refuse: Callable[[str], None], name: str) -> None:
        """`max_gap` [ns]: what lies behind by no more is late. No more than `most` samples are kept aside.

        `refuse` is told why, once for each sample refused.
        """
        self.last: int | None = None
        """Stamp [ns] of the last sample that was believed"""
        self.aside: list[S] = []
        """Samples that may be believed later, their stamps growing"""
        self.jumps = 0
        """How often the stream went on elsewhere"""
        self.steps: deque[int] = deque(maxlen=STEPS)
        """The last ones [ns] forward"""
        self.far = max_gap
        """A step [ns] beyond is far"""
        self._max_gap, self._most, self._refuse, self._name = max_gap, most, refuse, name

    def take(self, sample: S, other: Timeline[Any]) -> list[S]:
        """Take a sample; give those that are believed now, oldest first. `other` is the stream that it pairs with.

        The first one's stamp is not later than `last` was if the stream has jumped back.
        """
        stamp, last = sample.stamp, self.last
        if last is not None:
            step = stamp - last
            near = 0 < step <= self.far
            if near or (step > 0 and other.has_reached(stamp)):
                passed = [] if not self.aside or (near and self._is_alone(other)) else self._pass_by(stamp)
                self._go_to(stamp)
                return [*passed, sample]
            if -self._max_gap <= step <= 0 and not (self.aside and stamp > self.aside[-1].stamp):
                self._refuse(f"{self._name}_not_in_order")
                return []
        return self._put_aside(sample, other)

    def look_again(self, other: Timeline[Any], jumped: bool) -> list[S]:
        """Samples kept aside that are believed now that the other stream has gone on, or has `jumped`."""
        if not self.aside:
            return []
        if jumped and other.last is not None and abs(self.aside[-1].stamp - other.last) <= self._max_gap:
            return self.believe()
        return self.believe(self._believable(other))

    def has_reached(self, stamp: int) -> bool:
        """Whether a sample of the other stream with this stamp [ns] is no surprise: not later than this one's next."""
        return self.last is not None and stamp <= self.last + self.far // FAR

    def believe(self, number: int | None = None) -> list[S]:
        """Go on with the oldest of those kept aside, or with all of them."""
        if number == 0:
            return []
        believed, self.aside = self.aside[:number], [] if number is None else self.aside[number:]
        for sample in believed:
            self.jumps += self.last is not None and not 0 < sample.stamp - self.last <= self._max_gap
            if self.last is not None and sample.stamp <= self.last:  # its jumps on the way there are none of its steps
                self.go_on(self.last, [step for step in self.steps if step <= self._max_gap])
            self._go_to(sample.stamp)
        return believed

    def drop_aside(self) -> None:
        """Refuse what was kept aside."""
        for _ in self.aside:
            self._refuse(f"{self._name}_off_time")
        self.aside = []

    def go_on(self, last: int | None, steps: Iterable[int]) -> None:
        """As after samples up to `last` [ns], the last of them with these steps [ns]; nothing is aside."""
        self.last = last
        self.steps = deque(steps, maxlen=STEPS)
        self.far = FAR * _longest_but_one(self.steps) if self.steps else self._max_gap

    def clear(self) -> None:
        """Forget everything; what was kept aside is refused."""
        self.drop_aside()
        self.go_on(None, ())

    def _put_aside(self, sample: S, other: Timeline[Any]) -> list[S]:
        """Keep a sample for later; give those that are believed with it."""
        if self.aside and sample.stamp <= self.aside[-1].stamp:
            if self._is_late_aside(sample.stamp):
                self._refuse(f"{self._name}_not_in_order")
                return []
            self.drop_aside()
        self.aside.append(sample)
        return self.believe(None if len(self.aside) >= self._most else self._believable(other))

    def _is_late_aside(self, stamp: int) -> bool:
        """Whether it belongs to those kept aside, and comes after a later one; else the stream does not go on there."""
        first, newest, many = self.aside[0].stamp, self.aside[-1].stamp, len(self.aside) > ENOUGH
        before = self.last if many and self.last is not None and self.last < first else first - self.far
        return stamp == newest or (len(self.aside) > 1 and stamp >= max(before, newest - self._max_gap))

    def _believable(self, other: Timeline[Any]) -> int:
        """With how many of those kept aside, the oldest ones, the stream goes on."""
        first, newest, every = self.aside[0].stamp, self.aside[-1].stamp, len(self.aside)
        enough = self.last is None or every + len(other.aside) >= ENOUGH
        if other.aside and enough and abs(newest - other.aside[-1].stamp) <= self._max_gap:
            return every
        if every > 1 and (newest - first >= self._silence() or self._is_alone(other)):
            return every
        return self._near(other)

    def _near(self, other: Timeline[Any]) -> int:
        """How many of those kept aside are not far, one after the other, or no surprise to the other stream."""
        at = self.last
        for number, sample in enumerate(self.aside):
            goes_on = at is not None and at < sample.stamp <= at + self.far
            if not (goes_on or ((at is None or at < sample.stamp) and other.has_reached(sample.stamp))):
                return number
            at = sample.stamp
        return len(self.aside)

    def _pass_by(self, stamp: int) -> list[S]:
        """The stream goes on with a later stamp: what was kept aside in between is believed, and the rest refused."""
        last = -1 if self.last is None else self.last
        between = [sample for sample in self.aside if last < sample.stamp < stamp]
        self.aside = [sample for sample in self.aside if not last < sample.stamp < stamp]
        self.drop_aside()
        for sample in between:
            self._go_to(sample.stamp)
        return between

    def _silence(self) -> int:
        """For how long [ns] nothing must go on from the last sample believed until something else is believed."""
        if not self.steps:
            return 0
        own = (after.stamp - before.stamp for before, after in pairwise(self.aside))
        return min(SILENT * max(_longest_but_one(self.steps), *own), self._max_gap)

    def _is_alone(self, other: Timeline[Any]) -> bool:
        """Whether what was kept aside is at the other stream's time, and what was believed is not."""
        if self.last is None or other.last is None:
            return False
        return abs(self.aside[-1].stamp - other.last) <= self._max_gap < abs(self.last - other.last)

    def _go_to(self, stamp: int) -> None:
        if self.last is not None and stamp > self.last:
            step, steps = stamp - self.last, self.steps
            gone = steps[0] if len(steps) == STEPS else 0
            steps.append(step)
            if FAR * step >= self.far or FAR * gone >= self.far or len(steps) <= 2:  # else it stays as it is
                self.far = FAR * _longest_but_one(steps)
        self.last = stamp


def _longest_but_one(steps: deque[int]) -> int:
    """The longest step [ns] but one; the only one if there is one."""
    return sorted(steps)[-2:][0]
