"""Resamples a signal of any rate on a fixed grid and smooths it, independent of how it is cut into batches.

The value of a grid point depends on the samples around it alone, bit for bit: every step is done number by number, in
the same order.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

PERIOD = 5_000_000
"""Period of the grid [ns]; its points are the multiples"""
RATE = 1_000_000_000 // PERIOD
"""Number of grid points per second"""
SMOOTHING = 0.02
"""Standard deviation [s] of the Gaussian: gait below 6 Hz passes, noise of single samples is reduced to a quarter"""
REACH = round(3.0 * SMOOTHING * RATE)
"""Number of grid points on either side that a smoothed one depends on"""


def _gaussian() -> Floats:
    weights = np.exp(-0.5 * (np.arange(-REACH, REACH + 1) / (SMOOTHING * RATE)) ** 2)
    return np.asarray(weights / weights.sum())


WEIGHTS = _gaussian()


class Grid:
    """Linear interpolation of samples at multiples of `PERIOD`."""

    def __init__(self) -> None:
        self.first = 0
        """Index of the first grid point: its stamp over `PERIOD`"""
        self._next: int | None = None
        self._last_stamps = np.empty(0, dtype=np.int64)
        self._last_values = np.empty((0, 2))

    def add(self, stamps: NDArray[np.int64], values: Floats) -> Floats:
        """Take samples, at least one, with increasing stamps [ns], shape (n,), and values, shape (n, 2).

        Returns:
            Values at the new grid points, shape (m, 2).
        """
        if self._next is None:
            self.first = self._next = -(-int(stamps[0]) // PERIOD)
        stamps = np.concatenate((self._last_stamps, stamps))
        values = np.concatenate((self._last_values, values))
        at = PERIOD * np.arange(self._next, int(stamps[-1]) // PERIOD + 1)
        self._next += len(at)
        self._last_stamps, self._last_values = stamps[-1:], values[-1:]
        after = np.searchsorted(stamps, at)
        before = np.maximum(after - 1, 0)
        apart = np.maximum(stamps[after] - stamps[before], 1)  # 1: the first sample lies on the grid
        share = ((stamps[after] - at) / apart)[:, None]
        return np.asarray(values[after] - (values[after] - values[before]) * share)


class Smoother:
    """Gaussian filter over grid points. Beyond the ends the signal is continued by its mirror image through the end."""

    def __init__(self) -> None:
        self._points = np.empty((0, 2))
        self._begun = False

    def add(self, points: Floats) -> Floats:
        """Take grid points, shape (n, 2); return the smoothed points that they complete, shape (m, 2)."""
        self._points = np.concatenate((self._points, points))
        if not self._begun:
            if len(self._points) <= REACH:
                return np.empty((0, 2))
            mirrored = 2.0 * self._points[:1] - self._points[REACH:0:-1]
            self._points = np.concatenate((mirrored, self._points))
            self._begun = True
        ready = len(self._points) - 2 * REACH
        smooth = np.zeros((max(ready, 0), 2))
        for place, weight in enumerate(WEIGHTS[: 2 * REACH + 1] if ready > 0 else ()):
            smooth += weight * self._points[place : place + ready]
        self._points = self._points[max(ready, 0) :]
        return smooth

    def finish(self) -> Floats:
        """Return the remaining smoothed points, up to the last grid point, shape (m, 2)."""
        if not self._begun:
            return np.empty((0, 2))
        return self.add(2.0 * self._points[-1:] - self._points[-2 : -2 - REACH : -1])
