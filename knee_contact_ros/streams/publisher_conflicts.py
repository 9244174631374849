"""Detection of several publishers that send one quantity and disagree."""

import itertools
from collections import deque

import numpy as np

from ..model.types import NANOSECOND, Floats, Stamps

UNCONFIRMED_FACTOR = 4.0
"""Multiple of the allowed difference unless there are known to be several publishers, as one sensor may be noisy"""
LONGEST_RETURN = 0.05
"""Longest time [s] in which a quantity of a knee cannot change and change back"""
LARGEST_REST = 0.5
"""Largest fraction of a change that remains after the way back"""
REPORTED_FRACTION = 0.05
"""Fraction of samples that go back and forth from which they are reported"""
REPORTED_NUMBER = 10
"""Number of samples that go back and forth from which they are reported"""
CHECKED_SAMPLES = 8192
"""Number of samples that are checked together"""


class PublisherConflict:
    """Detects that several publishers of one quantity disagree, so that samples alternate.

    A message does not say who sent it. But a knee does not turn forth, back and forth again between samples; if samples
    do so often, they come from two sources.
    """

    def __init__(self, topic: str, difference: float, unit: str) -> None:
        """Begin without samples of a topic, whose publishers disagree above a `difference` in a unit."""
        self._topic = topic
        self._difference = difference
        self._unit = unit
        self._unchecked: list[tuple[int, float]] = []
        self._kept: deque[list[tuple[int, float]]] = deque(maxlen=2)  # of the last checks
        self._last_stamps = np.empty(0, np.int64)  # of the last two checked samples
        self._last_values = np.empty(0)
        self._checked = 0
        self._swings = np.empty(0)  # sizes of the changes back and forth

    def add_sample(self, stamp: int, value: float) -> None:
        """Add a sample with its stamp [ns]."""
        self._unchecked.append((stamp, value))
        if len(self._unchecked) >= CHECKED_SAMPLES:
            self.check_samples()

    def check_samples(self) -> None:
        """Check the samples that have come since the last check."""
        unchecked, self._unchecked = self._unchecked, []
        self._kept.append(unchecked)
        self.add_samples(
            np.array([stamp for stamp, _ in unchecked], np.int64),
            np.array([value for _, value in unchecked]),
        )

    def recent_samples(self, duration: float) -> tuple[Stamps, Floats]:
        """Stamps [ns] and values, shape (n,), within a `duration` [s] before the last sample.

        Only those since the last two checks are known, about two seconds live.
        """
        samples = [*itertools.chain(*self._kept), *self._unchecked]
        stamps = np.array([stamp for stamp, _ in samples], np.int64)
        values = np.array([value for _, value in samples])
        recent = np.abs(stamps - stamps[-1:]) <= duration / NANOSECOND
        return stamps[recent], values[recent]

    def add_samples(self, stamps: Stamps, values: Floats) -> None:
        """Add many samples, shape (n,), and check them."""
        if self._unchecked:
            self.check_samples()
        stamps = np.append(self._last_stamps, stamps)
        values = np.append(self._last_values, values)
        self._last_stamps = stamps[-2:]
        self._last_values = values[-2:]
        if len(stamps) < 3:
            return
        steps = np.diff(values)
        durations = np.abs(stamps[2:] - stamps[:-2]) * NANOSECOND
        sizes = np.minimum(np.abs(steps[:-1]), np.abs(steps[1:]))
        rests = np.abs(steps[:-1] + steps[1:])
        is_back = (rests < LARGEST_REST * sizes) & (durations < LONGEST_RETURN)
        swings = sizes[is_back & (sizes > self._difference)]
        self._checked += len(durations)
        self._swings = np.concatenate([self._swings, swings])[-CHECKED_SAMPLES:]

    def sentence(self, several: str = "", joint: str = "") -> str:
        """Sentence that publishers disagree; empty if they agree. `several`: it is known that there are several.

        It is about the samples up to the last check.
        """
        swings = self._swings
        if not several:
            swings = swings[swings > UNCONFIRMED_FACTOR * self._difference]
        reported = REPORTED_FRACTION * min(self._checked, CHECKED_SAMPLES)
        if len(swings) < max(REPORTED_NUMBER, reported):
            return ""
        what = f"the joint {joint!r} of {self._topic}" if joint else self._topic
        size = float(np.median(swings))
        text = f"{size:.0f}" if size >= 10 else f"{size:.2f}"
        finding = f"{what} goes back and forth by about {text} {self._unit} between samples"
        if several:
            return f"{finding}: {several} send it and disagree; remap or stop one of them"
        return f"{finding}: do two publishers send it, or is the sensor that noisy?"

    def clear_findings(self) -> None:
        """Forget what was found; called once a second live, so that a sentence is about now."""
        self._checked = 0
        self._swings = np.empty(0)
