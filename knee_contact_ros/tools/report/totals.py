"""What a whole run amounts to, and its course over time, in numbers that do not grow with it."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.core.types import ContactState, Fidelity, Rows, Status
from knee_contact_ros.messages.ros_types import NANOSECONDS
from knee_contact_ros.offline.summary import bound
from knee_contact_ros.parameters.plausibility import Doubts

Floats = NDArray[np.float64]

BUCKETS = 2000
"""Of time, at most: more than a picture has pixels"""
FIRST_WIDTH = 5_000_000
"""[ns] of a bucket at first"""
ERROR_BINS = np.logspace(-18, 6, 24 * 100 + 1)
"""Edges of the bins that the median error comes from, [m] or [N]: each 2.3 % wide"""


class Errors:
    """Estimated errors; one that is not a number bounds nothing."""

    def __init__(self) -> None:
        self.largest = 0.0
        self.told = False
        """Whether one is a number: in recordings from before the estimate was added none is"""
        self._counts = np.zeros(len(ERROR_BINS) + 1, dtype=np.int64)

    def add(self, errors: Floats) -> None:
        """Take errors, at least one."""
        self.largest = max(self.largest, bound(errors))
        self.told |= not np.isnan(errors).all()
        self._counts += np.bincount(np.searchsorted(ERROR_BINS, errors), minlength=len(self._counts))

    @property
    def median(self) -> float:
        """To 2.3 %: the upper edge of the bin that holds it; infinite beyond the last one."""
        place = int(np.searchsorted(np.cumsum(self._counts), 0.5 * self._counts.sum()))
        if not place:
            return 0.0
        return float(ERROR_BINS[place]) if place < len(ERROR_BINS) else math.inf


class Totals:
    """Counts and extremes of answers."""

    def __init__(self, doubts: Doubts) -> None:
        """`doubts` are those about the run's parameters; what makes no sense in the answers is added."""
        self.doubts = doubts
        self.ticks = 0
        self.first_stamp = self.last_stamp = 0
        """[ns]"""
        self.flagged: Counter[str] = Counter()
        """Ticks per status bit"""
        self.levels: Counter[str] = Counter()
        """Ticks by the level that computed them"""
        self.evaluations = 0
        self.depth_errors, self.force_errors = Errors(), Errors()
        """[m] of the depth, [N] of the contact force"""
        self.largest_force = self.largest_load = self.largest_depth = -math.inf
        """[N], [N], [m]"""
        self.bone_time = self.apart_time = self.time = 0.0
        """[s] with contact in the second layer; without contact; of all, without the gaps"""
        self.longest_apart = 0.0
        """[s] without contact at one go"""
        self._apart_for = 0.0

    def add(self, answers: Rows, steps: Floats) -> None:
        """Take answers, at least one; `steps` [s], shape (n,), is the time since the one before; after a gap 0."""
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
    """Columns over time as smallest and largest values in buckets, which become wider as the run goes on."""

    def __init__(self, columns: int) -> None:
        self.width = FIRST_WIDTH
        """[ns]"""
        self.begin = np.full(BUCKETS, np.inf)
        """[ns] of the first value in a bucket"""
        self.lowest = np.full((BUCKETS, columns), np.inf)
        self.highest = np.full((BUCKETS, columns), -np.inf)

    def add(self, elapsed: NDArray[np.int64], values: Floats) -> None:
        """Take values, shape (n, columns), at times [ns] since the run's beginning."""
        while int(elapsed[-1]) // self.width >= BUCKETS:
            self._widen()
        buckets, starts = np.unique(elapsed // self.width, return_index=True)
        self.begin[buckets] = np.minimum(self.begin[buckets], elapsed[starts])
        self.lowest[buckets] = np.minimum(self.lowest[buckets], np.minimum.reduceat(values, starts))
        self.highest[buckets] = np.maximum(self.highest[buckets], np.maximum.reduceat(values, starts))

    def _widen(self) -> None:
        self.width *= 2
        self.begin = np.concatenate(
            (np.minimum(self.begin[::2], self.begin[1::2]), np.full_like(self.begin[::2], np.inf))
        )
        self.lowest = np.concatenate(
            (np.minimum(self.lowest[::2], self.lowest[1::2]), np.full_like(self.lowest[::2], np.inf))
        )
        self.highest = np.concatenate(
            (np.maximum(self.highest[::2], self.highest[1::2]), np.full_like(self.highest[::2], -np.inf))
        )

    def lines(self) -> tuple[Floats, Floats, Floats]:
        """Time [s], shape (n,), and the smallest and largest values, shape (n, columns), where there are any."""
        used = np.flatnonzero(np.isfinite(self.lowest[:, 0]))
        return self.begin[used] / NANOSECONDS, self.lowest[used], self.highest[used]
