"""Notices that the clock of one stream was set, ahead or back, by less than `pairing.max_gap`.

Its stamps then look like those after a pause, or like late ones. But the lead of the forces over the angles, as they
arrive, has changed for good. It is judged only after a sample that did not continue its stream, as a latency may change
too.
"""

from collections import deque
from collections.abc import Callable, Sequence
from itertools import islice

from .topics import NANOSECONDS

JUDGED = 8
"""Number of leads whose median is judged"""
BEFORE = 2 * JUDGED
"""Number of leads before a doubtful sample that must be known"""
FIRST_JUDGED = 5
"""Number of leads that are judged at once; all of them are judged later"""
LEAST_CHANGE = NANOSECONDS // 200
"""Smallest change [ns] that counts, beyond the scatter of the leads before it"""
FAMILIAR_TIME = NANOSECONDS * 9 // 10
"""Time [ns] without a change before a doubtful sample, after which the leads are believed"""
KEPT_LEADS = 1000
"""Largest number of leads that are kept"""


class ClockSets:
    """Compares the leads before a doubtful sample with those after it."""

    def __init__(self, max_gap: int, on_change: Callable[[], object]) -> None:
        """Begin without leads; changes up to `max_gap` [ns] count. `on_change` is called when `apart` has changed."""
        self.leads: deque[int] = deque(maxlen=KEPT_LEADS)
        """Stamps of loads minus those of angles [ns], as they came in turns"""
        self.apart = 0
        """Change of the lead [ns], if a clock was set"""
        self.due = 0
        """Number of leads after which the next judgement is due; 0 if none is"""
        self._begin: int | None = None  # stamp from which on the lead has not changed
        self._last = 0
        self._before: list[int] = []  # leads before the doubtful sample
        self._is_familiar = False  # whether these are believed
        self._usual = 0  # median of the last of these
        self._least = 0  # smallest change [ns] of the lead that counts
        self._max_gap = max_gap
        self._on_change = on_change

    def add_lead(self, stamp: int, lead: int) -> None:
        """Add a lead [ns] at a stamp [ns]."""
        self.leads.append(lead)
        self._last = stamp
        if self._begin is None:
            self._begin = stamp
        if self.due:
            self.due -= 1
            if not self.due:
                self._judge(JUDGED)

    def add_leads(self, stamps: Sequence[int], leads: Sequence[int]) -> None:
        """Add leads [ns] at stamps [ns] while no judgement is due."""
        if leads:
            self.leads.extend(leads)
            self._begin = stamps[0] if self._begin is None else self._begin
            self._last = stamps[-1]

    def note_doubt(self, interval: int) -> None:
        """Remember the leads before a sample that does not continue its stream.

        Args:
            interval: Interval [ns] of the faster stream, by which a lead changes if a stream goes on at another phase.
        """
        if not self.due:
            self._before = list(self.leads)
            begin = self._last if self._begin is None else self._begin
            self._is_familiar = self._last - begin >= FAMILIAR_TIME
            last = sorted(self._before[-BEFORE:])
            if len(last) == BEFORE:
                self._usual = last[JUDGED]
                self._least = LEAST_CHANGE + max(last[-2] - last[1], interval)

    def judge(self, has_jumped: bool) -> None:
        """Judge the leads, as a stream goes on after a doubtful sample; it may have jumped."""
        is_anew = has_jumped and not self.apart
        if is_anew:
            self.leads.clear()  # those of before are no measure for those that come
        if is_anew or len(self._before) < BEFORE:
            self._forget()
        else:
            self.due = JUDGED
            self._judge(FIRST_JUDGED)

    def clear(self) -> None:
        """Forget all leads."""
        self.leads.clear()
        self._forget()
        self._set_apart(0)

    def _forget(self) -> None:
        self._begin, self._before, self.due = None, [], 0

    def _judge(self, number: int) -> None:
        lead = sorted(islice(reversed(self.leads), number))[number // 2]
        change = lead - self._usual
        if abs(change) <= self._least or self._was_there(lead):
            self._set_apart(0)
        elif self.apart or (self._is_familiar and abs(change) <= self._max_gap):
            self._set_apart(change)
            self.due = JUDGED
        else:
            self._forget()

    def _was_there(self, lead: int) -> bool:
        """Whether a lead [ns] is none of a clock that is set now, but of one that is set right."""
        return sum(abs(before - lead) <= self._least for before in self._before) >= BEFORE

    def _set_apart(self, apart: int) -> None:
        if apart != self.apart:
            self.apart = apart
            self._on_change()
