"""Counts the samples that are missing in a stream, as holes in its stamps show: what a full queue has dropped.

Only a stream with even steps shows them. A hole opens a stretch that ends when the steps are even again, as before it;
in between, short steps make up for long ones, as after a stamp that was taken late. If the steps have become others,
the rate was changed, and nothing is counted.
"""

from collections.abc import Iterable

STEPS = 8
"""Number of past steps that bound the next one, and are judged together. Tuned; `studies.pairing` would notice."""
MOST_LOST = 3
"""Largest number of missing samples per sample that came; where more seem to be missing, samples come in bursts"""
LONGEST = 8 * STEPS
"""Largest number of steps without even ones between; a stream that needs more is an uneven one"""


class Holes:
    """Counts the samples that are missing in one stream."""

    def __init__(self, max_gap: int) -> None:
        """Begin without holes; steps longer than `max_gap` [ns] are pauses or jumps."""
        self.missing = 0
        """Number of samples that are missing in holes up to `max_gap`; answers after longer ones are flagged"""
        self.skipped = 0
        """Number of samples that would fill the pauses and jumps"""
        self.is_open = False
        """Whether `add_step` has to be called with every step"""
        self.clock_is_set = False
        """Whether the next hole is none, as the clock was set there"""
        self._max_gap = max_gap
        self._usual = 0.0  # step [ns] before the stretch
        self._least = 0.0  # part of it by which a step must be longer to be a hole
        self._surplus = 0  # missing samples of the stretch, less those that made up for them
        self._came = self._number = 0  # steps before the stretch, and in it
        self._time = 0  # their sum in it [ns]
        self._is_made_up = False  # whether one was short
        self._since = 0  # steps since the last hole
        self._late = self._late_after = 0  # samples refused behind a stamp [ns]
        self._end = 0  # stamp [ns] at the end of the last stretch

    def add_step(self, step: int, steps: Iterable[int], last: int) -> None:
        """Add a step [ns] that is long, or any while a stretch is open.

        `steps` are the `STEPS` before it, and `last` is the stamp [ns] at their end.
        """
        ordered = sorted(steps)
        if not self.is_open:
            usual, is_set = _even_step(ordered, spare=1), self.clock_is_set
            self.clock_is_set = False
            if not usual or is_set:
                return
            self.is_open, self._usual = True, usual
            self._least = 0.5 + (ordered[-2] - ordered[1]) / (2.0 * usual)
            self._came = self._since = round((last - self._end) / usual)
            self._number = self._time = 0
            self._surplus = -self._late if self._late_after == last else 0
            self._is_made_up = False
        missing = round(step / self._usual + 0.5 - self._least) - 1
        self._since = 0 if missing > 0 else self._since + 1
        if step > self._max_gap:
            self.skipped += missing
        else:
            self._surplus += missing
            self._number += 1
            self._time += step
            self._is_made_up |= 10 * step < 9 * self._usual
        if self._number > STEPS:
            self._judge(ordered, last)

    def note_late(self, last: int) -> None:
        """Note a sample that was refused behind the last stamp [ns]: it came, and is not missing."""
        if self.is_open:
            self._surplus -= 1
        else:
            self._late = 1 + (self._late if self._late_after == last else 0)
            self._late_after = last

    def forget(self) -> None:
        """Count nothing for the open stretch, or for the next hole: the clock was set."""
        self.is_open, self.clock_is_set = False, True

    def _judge(self, ordered: list[int], last: int) -> None:
        """Count what is missing, if the last steps are as before, or most are; end the stretch, unless in holes."""
        usual = self._usual
        is_usual = abs(_even_step(ordered, spare=1) - usual) < usual / 6.0
        is_end = self._since > STEPS if is_usual else _even_step(ordered, spare=0) > 0.0
        are_most = 10 * ordered[0] > 9 * usual and 10 * ordered[STEPS // 2] < 11 * usual
        surplus = self._surplus
        if self._is_made_up:
            surplus = min(surplus, round(self._time / usual) - self._number)
        is_plausible = surplus <= MOST_LOST * (self._came + self._number)
        if is_plausible and (are_most or (is_usual and is_end)):
            self.missing += max(surplus, 0)
            self._came = self._surplus = self._number = self._time = 0
            self._is_made_up = False
        if is_end or self._number > LONGEST:
            self.is_open, self._end = False, last


def _even_step(ordered: list[int], spare: int) -> float:
    """Mean of steps [ns] in order, if all are near to it, by a third, except so many at both ends; else 0."""
    inner = ordered[spare : len(ordered) - spare]
    mean = sum(inner) / len(inner)
    return mean if 3 * inner[0] > 2 * mean and 3 * inner[-1] < 4 * mean else 0.0
