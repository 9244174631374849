"""Rules by which an extremum of flexion angle or load is a gait event; `events.py` describes them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from knee_contact_ros.pipeline.gait.signal import RATE, Floats

TURN, TURN_AT_END = math.radians(3.0), math.radians(0.5)
"""Angle [rad] by which the knee must turn back after an extremum; at the end of a run"""
FALL, FALL_TIME = math.radians(5.0), 0.1
"""Smallest extension of the knee [rad] before heel strike, within this time [s]"""
SWING = math.radians(20.0)
"""Smallest flexion around toe-off [rad]"""
RATE_OVER = 0.04
"""Time [s] over which the flexion rate is taken"""
LONGEST_TURN = 1.0
"""Longest time [s] of a flexion around toe-off, and from its end, or from an extension peak, to the next turn"""
UNLOADED, LEAST_LOAD = 0.45, 0.5
"""Share of the stance's load below which the leg swings; smallest load of a stance [BW]"""
LOADING_TIME = 0.4
"""Time [s] of stance within which its load is looked for"""
BEFORE_LANDING = (0.25, 0.07)
"""Times [s] before the extension peak between which the leg swings"""
AFTER_LEAVING = (0.08, 0.2)
"""Times [s] after the largest flexion rate between which the leg swings"""
PEAK_LOAD, PEAK_DISTANCE, PEAK_PROMINENCE = 1.0, 0.25, 0.15
"""Smallest load [BW] of a peak, smallest time [s] between two, smallest range [BW] of the load around"""
ANGLE, LOAD = 0, 1
"""Columns of the smoothed signals"""


def points(time: float) -> int:
    """Number of grid points in a time [s]."""
    return round(time * RATE)


class Stretch(NamedTuple):
    """Part of the smoothed signals."""

    values: Floats
    """Angle [rad] and load [BW], shape (n, 2)"""
    first: int
    """Index of the first point"""

    @property
    def end(self) -> int:
        """Index behind the last point."""
        return self.first + len(self.values)

    def between(self, column: int, first: int, last: int) -> Floats:
        """Values of a column from one index to another, both included, as far as there are any."""
        return self.values[max(first - self.first, 0) : max(last + 1 - self.first, 0), column]

    def fraction(self, index: int, sign: float, heights: Floats) -> float:
        """Fractional index of the peak of a parabola through the point of `heights` at `index` and its neighbours.

        `sign` is 1 for a maximum, and -1 for a minimum.
        """
        place = index - self.first
        if not 0 < place < len(heights) - 1:
            return float(index)
        left, middle, right = sign * heights[place - 1 : place + 2]
        bend = left - 2.0 * middle + right
        return index + (min(max(0.5 * float((left - right) / bend), -0.5), 0.5) if bend < 0.0 else 0.0)


def extension_peak(of: Stretch, index: int) -> float | None:
    """Fractional index of the extension peak before a heel strike, if a minimum of the angle at `index` is one."""
    fall = of.between(ANGLE, index - points(FALL_TIME), index).max() - of.values[index - of.first, ANGLE]
    begin, end = (index - points(time) for time in BEFORE_LANDING)
    swing = of.between(LOAD, begin, max(end, of.first, 0))
    stance = of.between(LOAD, index, index + points(LOADING_TIME))
    if fall < FALL or not _unloaded(swing, stance):
        return None
    return of.fraction(index, -1.0, of.values[:, ANGLE])


def flexion_rate_peak(of: Stretch, index: int, since: int) -> float | None:
    """Fractional index of the largest flexion rate between a turn `since` and a maximum of the angle at `index`.

    None if the foot does not leave the ground there.
    """
    begin = max(since, index - points(LONGEST_TURN))
    rise = of.between(ANGLE, begin, index)
    if rise[-1] - rise[0] < SWING:
        return None
    angle, reach = of.values[:, ANGLE], points(RATE_OVER / 2.0)
    rates = np.full(len(angle), -np.inf)
    rates[reach : len(angle) - reach] = angle[2 * reach :] - angle[: len(angle) - 2 * reach]
    quickest = begin + int(rates[begin - of.first : index - of.first + 1].argmax())
    if quickest - reach <= of.first:  # it may have been quicker before
        return None
    stance = of.between(LOAD, quickest - points(LOADING_TIME), quickest)
    swing = of.between(LOAD, *(quickest + points(time) for time in AFTER_LEAVING))
    if not _unloaded(swing, stance):
        return None
    return of.fraction(quickest, 1.0, rates)


def is_load_peak(of: Stretch, index: int) -> bool:
    """Whether a maximum of the load at `index` is a peak of stance."""
    reach = points(PEAK_DISTANCE)
    before, after = of.between(LOAD, index - reach, index), of.between(LOAD, index, index + reach)
    load = before[-1]
    if before.argmax() < len(before) - 1 or after.max() > load:
        return False
    return bool(load - min(before.min(), after.min()) >= PEAK_PROMINENCE)


def _unloaded(swing: Floats, stance: Floats) -> bool:
    """Whether the loads `swing` are those of a swing phase, compared with the loads `stance`."""
    if not (len(swing) and len(stance)):
        return False
    return bool(stance.max() >= LEAST_LOAD and swing.max() <= UNLOADED * stance.max())
