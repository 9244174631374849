"""Totals of a whole run and its course over time, in memory that does not grow with the run's length."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.model.types import ContactState, Fidelity, Rows, Status
from knee_contact_ros.offline.summary import bound
from knee_contact_ros.streams.topics import NANOSECONDS
from knee_contact_ros.streams.watch import Doubts

Floats = NDArray[np.float64]

BUCKETS = 2000
"""Number of time buckets at most: more than a picture has pixels"""
FIRST_WIDTH = 5_000_000
"""Initial width of a bucket [ns]"""
ERROR_BINS = np.logspace(-18, 6, 24 * 100 + 1)
"""Edges of the histogram bins from which the median error is taken, [m] or [N]; each bin is 2.3 % wide"""


class Errors:
    """Largest and median of estimated errors; an estimate that is NaN bounds nothing."""

    def __init__(self) -> None:
        self.largest = 0.0
        self.known = False
        """Whether any estimate is a number; in recordings from before the estimate was added none is"""
        self._counts = np.zeros(len(ERROR_BINS) + 1, dtype=np.int64)

    def add(self, errors: Floats) -> None:
        """Add estimated errors [m] or [N], shape (n,), n >= 1."""
        self.largest = max(self.largest, bound(errors))
        self.known |= not np.isnan(errors).all()
        self._counts += np.bincount(np.searchsorted(ERROR_BINS, errors), minlength=len(self._counts))

    @property
    def median(self) -> float:
        """Median error, exact to 2.3 %: the upper edge of the bin that holds it; infinite beyond the last bin."""
        place = int(np.searchsorted(np.cumsum(self._counts), 0.5 * self._counts.sum()))
        if not place:
            return 0.0
        return float(ERROR_BINS[place]) if place < len(ERROR_BINS) else math.inf


class Totals:
    """Counts, extremes and durations over all answers of a run."""

    def __init__(self, doubts: Doubts) -> None:
        """Begin with the doubts about the run's parameters; implausible answers are added to them."""
        self.doubts = doubts
        self.ticks = 0
        self.first_stamp = self.last_stamp = 0
        """[ns]"""
        self.flagged: Counter[str] = Counter()
        """Number of ticks by the name of each status bit that they have"""
        self.levels: Counter[str] = Counter()
        """Number of ticks by the model level that computed them"""
        self.evaluations = 0
        self.depth_errors, self.force_errors = Errors(), Errors()
        """Estimated errors of the depth [m] and of the contact force [N]"""
        self.largest_force = self.largest_load = self.largest_depth = -math.inf
        """[N], [N], [m]"""
        self.bone_time = self.apart_time = self.time = 0.0
        """Durations [s] of contact in the second layer, of no contact, and of the whole run without its gaps"""
        self.longest_apart = 0.0
        """Longest uninterrupted duration without contact [s]"""
        self._apart_for = 0.0

    def add(self, answers: Rows, steps: Floats) -> None:
        """Add answers, n >= 1; `steps` [s], shape (n,), are the times since the answer before, 0 behind a gap."""
        self.first_stamp = self.first_stamp if self.ticks else int(answers["stamp"][0])
        self.last_stamp = int(answers["stamp"][-1])
        self.ticks += len(answers)
        self.evaluations += int(answers["evaluations"].sum())
        self.depth_errors.add(answers["error_estimate"])
        self.force_errors.add(answers["force_error_estimate"])
        self.largest_force = max(self.largest_force, float(answers["contact_force"].max()))
        self.largest_load = max(self.largest_load, float(answers["load"].max()))
        self.largest_depth = max(self.largest_depth, float(answers["penetration_depth"].max()))
        for level, count in zip(*np.unique(answers["fidelity"], return_counts=True), strict=True):
            self.levels[Fidelity(int(level)).name.lower()] += int(count)
        status = answers["status"].astype(np.int64)
        self.doubts.add_all(answers["stamp"], answers["load"], answers["penetration_depth"], status)
        for bit in Status:
            if count := int(np.count_nonzero(status & bit)):
                self.flagged[bit.name or ""] += count
        self._times(answers["contact_state"], steps)

    def _times(self, state: Floats, steps: Floats) -> None:
        self.time += float(steps.sum())
        self.bone_time += float(steps[state == ContactState.BONE].sum())
        apart = state == ContactState.SEPARATED
        self.apart_time += float(steps[apart].sum())
        for group in np.split(np.arange(len(state)), np.flatnonzero(np.diff(apart)) + 1):
            if apart[group[0]]:
                self._apart_for += float(steps[group].sum())
                self.longest_apart = max(self.longest_apart, self._apart_for)
            else:
                self._apart_for = 0.0


class Course:
    """Smallest and largest values of columns in time buckets, which double in width whenever they are all used."""

    def __init__(self, columns: int) -> None:
        self.width = FIRST_WIDTH
        """Width of a bucket [ns]"""
        self.begin = np.full(BUCKETS, np.inf)
        """Time [ns] of the first value in each bucket, shape (buckets,)"""
        self.lowest = np.full((BUCKETS, columns), np.inf)
        self.highest = np.full((BUCKETS, columns), -np.inf)

    def add(self, elapsed: NDArray[np.int64], values: Floats) -> None:
        """Add values, shape (n, columns), at increasing times `elapsed` [ns] since the run's beginning, shape (n,)."""
        while int(elapsed[-1]) // self.width >= BUCKETS:
            self._widen()
        buckets, starts = np.unique(elapsed // self.width, return_index=True)
        self.begin[buckets] = np.minimum(self.begin[buckets], elapsed[starts])
        self.lowest[buckets] = np.minimum(self.lowest[buckets], np.minimum.reduceat(values, starts))
        self.highest[buckets] = np.maximum(self.highest[buckets], np.maximum.reduceat(values, starts))

    def _widen(self) -> None:
        self.width *= 2
        for buckets, merge, empty in (
            (self.begin, np.minimum, np.inf),
            (self.lowest, np.minimum, np.inf),
            (self.highest, np.maximum, -np.inf),
        ):
            buckets[: BUCKETS // 2] = merge(buckets[::2], buckets[1::2])
            buckets[BUCKETS // 2 :] = empty

    def lines(self) -> tuple[Floats, Floats, Floats]:
        """Times [s], shape (n,), smallest and largest values, shape (n, columns) each, of the buckets with values."""
        used = np.flatnonzero(np.isfinite(self.lowest[:, 0]))
        return self.begin[used] / NANOSECONDS, self.lowest[used], self.highest[used]
