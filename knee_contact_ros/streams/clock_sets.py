"""Notices that the clock of one stream was set, ahead or back.

If that was by less than `pairing.max_gap`, its stamps look like those after a pause, or like late ones. If it was by
more, the stream has jumped, but where samples come in bursts, stamps of both streams may still meet. The lead of the
forces over the angles, as they arrive, has changed for good. It is judged only after a sample that did not continue its
stream, as a latency may change too.
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
        """Begin without leads.

        Changes up to `max_gap` [ns] count without a jump, larger ones after it. `on_change` is called when `apart` has
        changed.
        """
        self.leads: deque[int] = deque(maxlen=KEPT_LEADS)
        """Stamps of loads minus those of angles [ns], as they came in turns"""
        self.apart = 0
        """Change of the lead [ns], if a clock was set"""
        self.agree = True
        """Whether the leads after each jump were found to be those of before"""
        self.due = 0
        """Number of leads after which the next judgement is due; 0 if none is"""
        self._begin: int | None = None  # stamp from which on the lead has not changed
        self._before: list[int] = []  # leads before the doubtful sample
        self._jumps = (
            0  # number of jumps since the doubtful sample; of both streams, they show no clock
        )
        self._agreed = True  # `agree` before the jumps
        self._is_familiar = False  # whether these are believed
        self._usual = 0  # median of the last of these
        self._least = 0  # smallest change [ns] of the lead that counts
        self._max_gap = max_gap
        self._on_change = on_change

    def add_lead(self, stamp: int, lead: int) -> None:
        """Add a lead [ns] at a stamp [ns]."""
        self.leads.append(lead)
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

    def note_doubt(self, interval: int, last: int | None) -> None:
        """Remember the leads before a sample that does not continue its stream.

        Args:
            interval: Interval [ns] of the faster stream, by which a lead changes if a stream goes on at another phase.
            last: Stamp [ns] of the last accepted load; None if the clocks differ.
        """
        if not (self.due or self.apart):
            self._before = list(self.leads)
            if last is None or self._begin is None:
                self._is_familiar = False
            else:
                self._is_familiar = last - self._begin >= FAMILIAR_TIME
            leads = sorted(self._before[-BEFORE:])
            if len(leads) == BEFORE:
                self._usual = leads[JUDGED]
                self._least = LEAST_CHANGE + max(leads[-2] - leads[1], interval)

    def judge(self, has_jumped: bool) -> None:
        """Judge the leads, as a stream goes on after a doubtful sample; it may have jumped."""
        if has_jumped:
            if not self._jumps:
                self._agreed, self.agree = self.agree, False
            self._jumps += 1
        if len(self._before) < BEFORE:
            self._forget()
        elif has_jumped:
            self.due = JUDGED
        elif not self._jumps:
            self.due = JUDGED
            self._judge(FIRST_JUDGED)

    def clear(self) -> None:
        """Forget all leads."""
        self.leads.clear()
        self._forget()
        self.agree = True
        self._set_apart(0)

    def _forget(self) -> None:
        if self._jumps:
            self.leads.clear()  # those of before are no measure for those that come
        self._begin, self._before, self.due, self._jumps = None, [], 0, 0

    def _judge(self, number: int) -> None:
        lead = sorted(islice(reversed(self.leads), number))[number // 2]
        change = lead - self._usual
        if abs(change) <= self._least or self._was_there(lead):
            if self._jumps:
                self.agree = self._agreed and self._least <= self._max_gap
                self._forget()
            self._set_apart(0)
        elif not self._is_set_right(lead) and (
            self.apart or (self._is_familiar and self._jumps == int(abs(change) > self._max_gap))
        ):
            self._set_apart(change)
            self.due = JUDGED
        else:
            self._forget()
            self._set_apart(0)

    def _is_set_right(self, lead: int) -> bool:
        """Whether stamps [ns] meet that lay apart by more than a usual latency: a wrong clock was set right."""
        return abs(lead) <= self._least and 2 * abs(self._usual) > self._max_gap

    def _was_there(self, lead: int) -> bool:
        """Whether a lead [ns] is none of a clock that is set now, but of one that is set right."""
        return sum(abs(before - lead) <= self._least for before in self._before) >= BEFORE

    def _set_apart(self, apart: int) -> None:
        if apart != self.apart:
            self.apart = apart
            self._on_change()
