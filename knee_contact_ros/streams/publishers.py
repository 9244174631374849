"""Notices that several publishers give one quantity, and disagree: their samples alternate.

A message does not say who sent it. But a knee does not turn back and forth between two samples, and back again: where
samples do so often, they are of two sources.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.model.types import NANOSECOND

DIFFERENT_ANGLES, DIFFERENT_FORCES = 0.03, 50.0
"""Differences [rad] and [N] from which two publishers disagree"""
UNSURE = 4.0
"""Multiple of these where it is not known that there are two publishers: one sensor may be noisy"""
SHORT = 0.05
"""Longest time [s] in which a quantity cannot change and change back"""
BACK = 0.5
"""Largest part of a change that is left after the way back"""
OFTEN, ENOUGH = 0.05, 10
"""Part of the samples, and their number, from which an alternation is told"""
MOST = 8192
"""Number of samples that are looked at together"""


class Publishers:
    """Samples of a quantity in the order of their arrival."""

    def __init__(self, topic: str, difference: float, unit: str) -> None:
        """Begin without samples: of a topic, whose publishers disagree from a `difference` in a unit on."""
        self._topic, self._difference, self._unit = topic, difference, unit
        self._waiting: list[tuple[int, float]] = []  # samples that have yet to be looked at
        self._last = np.empty(0, np.int64), np.empty(0)  # the last two of those that were
        self._samples = 0
        self._found = np.empty(0)  # sizes of the changes back and forth

    def add(self, stamp: int, value: float) -> None:
        """Add a sample with its stamp [ns]."""
        self._waiting.append((stamp, value))
        if len(self._waiting) >= MOST:
            self.look()

    def look(self) -> None:
        """Look at the samples that have come since the last look."""
        waiting, self._waiting = self._waiting, []
        self.add_all(np.array([stamp for stamp, _ in waiting], np.int64), np.array([value for _, value in waiting]))

    def add_all(self, stamps: NDArray[np.int64], values: NDArray[np.float64]) -> None:
        """Add many samples, shape (n,), and look at them."""
        if self._waiting:
            self.look()
        stamps, values = np.append(self._last[0], stamps), np.append(self._last[1], values)
        self._last = stamps[-2:], values[-2:]
        if len(stamps) < 3:
            return
        steps, lasts = np.diff(values), stamps[2:] - stamps[:-2]
        sizes = np.minimum(np.abs(steps[:-1]), np.abs(steps[1:]))
        left = np.abs(steps[:-1] + steps[1:])
        found = (sizes > self._difference) & (left < BACK * sizes) & (np.abs(lasts) * NANOSECOND < SHORT)
        self._samples += len(lasts)
        self._found = np.concatenate([self._found, sizes[found]])[-MOST:]

    def sentence(self, several: str = "", joint: str = "") -> str:
        """Sentence that publishers disagree, which are `several` if it is known; empty if they agree."""
        self.look()
        found = self._found if several else self._found[self._found > UNSURE * self._difference]
        if len(found) < max(ENOUGH, OFTEN * min(self._samples, MOST)):
            return ""
        what = f"the joint {joint!r} of {self._topic}" if joint else self._topic
        apart = float(np.median(found))
        often = f"{what} goes back and forth by about {apart:.{0 if apart >= 10 else 2}f} {self._unit} between samples"
        if several:
            return f"{often}: {several} send it and disagree; remap or stop one of them"
        return f"{often}: do two publishers send it, or is the sensor that noisy?"

    def forget(self) -> None:
        """Forget what was found: once a second live, so that it is about now."""
        self.look()
        self._samples, self._found = 0, np.empty(0)
