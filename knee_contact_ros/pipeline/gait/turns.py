"""Finds the turns of a smoothed signal while it grows, independent of how it is cut into batches."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from knee_contact_ros.pipeline.gait.signal import Floats


class Extremum(NamedTuple):
    """Local extremum of a signal."""

    place: int
    """Index of the extremum, counted from the signal's first point; for a plateau that of its start"""
    value: float
    highest: bool
    """Whether it is a maximum"""
    known: int
    """Index of the point at which it is known to be an extremum"""


class LocalExtrema:
    """Finder of all local extrema of a signal."""

    def __init__(self) -> None:
        self._last = np.empty(0)
        self._place = 0
        """Index of the next point"""
        self._moved: tuple[float, int, float] | None = None
        """Last step that was not zero: its sign, and the index and value at which it ended"""

    def add(self, values: Floats) -> list[Extremum]:
        """Take points, shape (n,); return the extrema that they show."""
        start = self._place - len(self._last)
        joined = np.concatenate((self._last, values))
        self._last, self._place = joined[-1:], self._place + len(values)
        steps = np.diff(joined)
        moving = np.flatnonzero(steps)
        signs, ends, heights = np.sign(steps[moving]), moving + 1 + start, joined[moving + 1]
        if self._moved is not None:
            signs, ends, heights = (np.append(*pair) for pair in zip(self._moved, (signs, ends, heights), strict=True))
        if len(signs):
            self._moved = float(signs[-1]), int(ends[-1]), float(heights[-1])
        return [
            Extremum(int(ends[step]), float(heights[step]), bool(signs[step] > 0.0), int(ends[step + 1]))
            for step in np.flatnonzero(signs[1:] != signs[:-1])
        ]


class Turn(NamedTuple):
    """Extremum from which a signal has returned by a given amount."""

    place: int
    """Index of the extremum"""
    highest: bool
    """Whether it is a maximum"""
    since: int
    """Index of the previous turn; 0 for the first one"""
    known: int
    """Index of the point at which it is known to be a turn"""


class Turns:
    """Finder of the turns of a signal, without those of small fluctuations."""

    def __init__(self, least: float) -> None:
        """Find turns from which the signal returns by at least this amount."""
        self._least = least
        self._latest: Extremum | None = None
        self._since = 0

    def add(self, extremum: Extremum) -> Turn | None:
        """Take the next local extremum; return the turn that it shows."""
        latest = self._latest
        if latest is None or latest.highest == extremum.highest:
            if latest is None or (extremum.value > latest.value) == latest.highest:
                self._latest = extremum
            return None
        if abs(extremum.value - latest.value) < self._least:
            return None
        turn = Turn(latest.place, latest.highest, self._since, extremum.known)
        self._latest, self._since = extremum, latest.place
        return turn

    def finish(self, index: int, value: float, least: float) -> Turn | None:
        """Return the turn that the signal's last point shows, if the signal has returned by `least`."""
        latest = self._latest
        if latest is None or ((latest.value - value) if latest.highest else (value - latest.value)) < least:
            return None
        return Turn(latest.place, latest.highest, self._since, index)
