"""By how much an angle sensor is off and late against a reference, and how surely that is known.

The sensor is taken as offset + gain x reference(t - lag). The lag is where both correlate best (least squares with a
free gain, so that a wrong gain does not pull at it), to a fraction of a sample by a cubic spline through the reference;
the offset is the mean difference then, as parameters correct an offset and no gain. Intervals are a jackknife over
stretches of about a second: each is left out once, and what the answers differ by tells their error, whatever the
sensor's errors look like within a stride (Miller 1974, The jackknife - a review, Biometrika 61:1).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar
from scipy.stats import t as student

from knee_contact_ros.messages.ros_types import NANOSECONDS
from knee_contact_ros.offline.gait_files.storage import Floats
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.tools.sensors.channels import Series

STRETCH = 1.0
"""[s] left out at a time: about a stride"""
FEWEST, MOST = 4, 60
"""Stretches"""
ENOUGH = 40
"""Rows in common, at least"""
MOST_ROWS = 50_000
"""Of more, every so manieth is used: they tell nothing new"""
ALIKE = 0.8
"""Correlation below which two angles are not of one knee"""
MOST_GAIN = 5.0
"""Times that one angle may move as far as the other: soft tissue makes 0.8, degrees for radians 57"""
SURE = 0.95


class Estimate(NamedTuple):
    """A value with its interval."""

    value: float
    half: float
    """Half the width of the 95 % interval"""

    @property
    def bounds(self) -> tuple[float, float]:
        """From where to where."""
        return self.value - self.half, self.value + self.half


class Alignment(NamedTuple):
    """What an angle sensor is off by."""

    offset: Estimate
    """[rad] to be added to the sensor"""
    lag: Estimate
    """[s] by which the sensor is late"""
    gain: Estimate
    """How many times as far as the reference it moves"""
    rows: int
    """In common"""
    stretches: int
    before: tuple[float, float]
    """Correlation, and RMS difference [rad], as they were"""
    after: tuple[float, float]
    """Likewise with offset and lag removed"""


class Pair:
    """Rows of a sensor and a curve of the reference."""

    def __init__(self, sensor: Series, reference: Series, max_gap: float) -> None:
        """Both from one clock; rows beside gaps of the reference longer than `max_gap` [s] are left out of `rows`."""
        first = reference.stamps[0]
        self.times: Floats = (sensor.stamps - first) / NANOSECONDS
        self.values = sensor.values
        self._known: Floats = (reference.stamps - first) / NANOSECONDS
        self._curve = CubicSpline(self._known, reference.values)
        wide = np.diff(self._known) > max_gap
        self._holes = list(zip(self._known[:-1][wide], self._known[1:][wide], strict=True))
        steps = [float(np.median(np.diff(times))) for times in (self.times, self._known)]
        self.step = max(steps)
        """[s] from row to row of the slower one"""

    def rows(self, least: float, most: float) -> NDArray[np.intp]:
        """Rows that have a reference at every lag [s] from `least` to `most`.

        Raises:
            UsageError: there are too few.
        """
        there = (self.times - most >= self._known[0]) & (self.times - least <= self._known[-1])
        for begin, end in self._holes:
            there &= (self.times - least <= begin) | (self.times - most >= end)
        rows = np.flatnonzero(there)
        if len(rows) < ENOUGH:
            raise UsageError(
                f"angle and reference have {len(rows)} rows in common (with lags from {least:.3g} to {most:.3g} s), "
                f"and {ENOUGH} are needed"
            )
        return rows[:: 1 + len(rows) // MOST_ROWS]

    def reference(self, rows: NDArray[np.intp], lag: float) -> Floats:
        """The reference [rad] that rows belong to if the sensor is late by `lag` [s]."""
        found: Floats = self._curve(self.times[rows] - lag)
        return found

    def correlation(self, rows: NDArray[np.intp], lag: float) -> float:
        """Of sensor and reference."""
        return correlation(self.values[rows], self.reference(rows, lag))

    def best(self, rows: NDArray[np.intp], least: float, most: float) -> float:
        """The lag [s] between two at which they correlate best; one best lag is between them."""
        found = minimize_scalar(
            lambda lag: -self.correlation(rows, lag), bounds=(least, most), method="bounded", options={"xatol": 1e-6}
        )
        return float(found.x)


def correlation(one: Floats, other: Floats) -> float:
    """Pearson's; 0 where one of them does not move."""
    a, b = one - one.mean(), other - other.mean()
    scale = math.sqrt(float(a @ a) * float(b @ b))
    return float(a @ b) / scale if scale > 0.0 else 0.0


def aligned(sensor: Series, reference: Series, longest: float, max_gap: float) -> Alignment:
    """What the sensor is off by; lags up to `longest` [s] are tried, to both sides.

    Raises:
        UsageError: too little in common, the two are not alike at any lag, or one moves many times as far.
    """
    pair = Pair(sensor, reference, max_gap)
    rows = pair.rows(-longest, longest)
    lags = np.linspace(-longest, longest, 1 + 2 * math.ceil(longest / (0.5 * pair.step)))
    found = [pair.correlation(rows, float(lag)) for lag in lags]
    at = int(np.argmax(found))
    _check(sensor, reference, found, lags, at)
    near = (float(lags[at - 1]), float(lags[at + 1]))
    margin = 4.0 * pair.step
    rows = pair.rows(near[0] - margin, near[1] + margin)  # more of them than with the longest lags
    lag = pair.best(rows, *near)
    made = _estimated(pair, rows, lag, (near[0] - margin, near[1] + margin))
    if not 1.0 / MOST_GAIN <= made.gain.value <= MOST_GAIN:
        raise UsageError(
            f"{sensor.where} moves {made.gain.value:.3g} times as far as {reference.where}: are both units right?"
        )
    return made


def _check(sensor: Series, reference: Series, found: list[float], lags: Floats, at: int) -> None:
    """Refuse a fit that is none."""
    if max(found) < ALIKE:
        against = -min(found)
        why = (
            f"but against each other with {against:.2f}: is a sign turned?"
            if against >= ALIKE
            else "are both of one knee, in one time?"
        )
        raise UsageError(f"{sensor.where} and {reference.where} go together with r = {max(found):.2f} at best; {why}")
    if at in (0, len(lags) - 1):
        raise UsageError(
            f"{sensor.where} and {reference.where} fit best at the longest lag tried, {lags[at]:g} s: see --longest-lag"
        )


def _estimated(pair: Pair, rows: NDArray[np.intp], lag: float, within: tuple[float, float]) -> Alignment:
    """The estimates and their intervals."""
    span = pair.times[rows[-1]] - pair.times[rows[0]]
    number = int(np.clip(round(span / STRETCH), FEWEST, MOST))
    of_row = np.minimum((np.arange(len(rows)) * number) // len(rows), number - 1)
    whole = np.array(_values(pair, rows, lag))
    without = []
    for stretch in range(number):
        kept = rows[of_row != stretch]
        without.append(_values(pair, kept, pair.best(kept, *within)))
    spread = np.array(without) - np.mean(without, axis=0)
    error = np.sqrt((number - 1) / number * (spread**2).sum(axis=0))
    half = float(student.ppf(0.5 * (1.0 + SURE), number - 1)) * error
    offset, late, gain = (Estimate(float(v), float(h)) for v, h in zip(whole, half, strict=True))
    sensor, raw, moved = pair.values[rows], pair.reference(rows, 0.0), pair.reference(rows, lag)
    return Alignment(
        offset, late, gain, len(rows), number,
        (correlation(sensor, raw), _rms(sensor - raw)),
        (correlation(sensor, moved), _rms(sensor + whole[0] - moved)),
    )  # fmt: skip


def _values(pair: Pair, rows: NDArray[np.intp], lag: float) -> tuple[float, float, float]:
    """Offset [rad], lag [s] and gain."""
    sensor, moved = pair.values[rows], pair.reference(rows, lag)
    around = moved - moved.mean()
    return float(np.mean(moved - sensor)), lag, float(around @ sensor) / float(around @ around)


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))
