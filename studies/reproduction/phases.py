"""Moments of the gait that the paper names, found in the data."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import find_peaks

from studies.gait import BODY_WEIGHT, HEEL_STRIKE
from studies.reproduction.scenes import gait

FLEXED = np.radians(55.0)
CYCLE = HEEL_STRIKE["right"]
"""Start and end [s] of the one complete gait cycle"""
APART = 0.2
"""Least time [s] between two load peaks"""
AROUND_PEAK = 0.05
"""Largest time [s] between a peak of the contact and that of the load"""


class Moment(NamedTuple):
    """A named time [s]."""

    name: str
    time: float


def load_peaks(side: str) -> list[float]:
    """Times [s] of the load's peaks: above one body weight, the largest within `APART` on both sides."""
    time, _, load = gait(side)
    found, _ = find_peaks(load, height=BODY_WEIGHT, distance=APART / (time[1] - time[0]))
    return [float(t) for t in time[found]]


def second_stance() -> tuple[float, float]:
    """Times [s] of the two load peaks after the right leg's second heel strike."""
    first, second = (time for time in load_peaks("right") if time > CYCLE[1])
    return first, second


def phases() -> tuple[Moment, ...]:
    """The four phases of the right leg, in the paper's order, which is also their order in time."""
    first, second = second_stance()
    return (
        Moment("55° flexion", passages()[-1]),
        Moment("heel strike", CYCLE[1]),
        Moment("first peak", first),
        Moment("second peak", second),
    )


def passages() -> list[float]:
    """Times [s] at which the right leg's swing passes through 55 degrees."""
    time, angle, _ = gait("right")
    return [crossing for crossing in crossings(time, angle, FLEXED) if crossing < CYCLE[1]]


def crossings(time: NDArray[np.float64], values: NDArray[np.float64], level: float) -> list[float]:
    """Times [s] at which a piecewise linear series passes through a level."""
    above = values - level
    left = np.flatnonzero(above[:-1] * above[1:] < 0.0)
    part = above[left] / (above[left] - above[left + 1])
    return [float(t) for t in time[left] + part * (time[left + 1] - time[left])]


def at(moment: float, values: NDArray[Any], side: str = "right") -> float:
    """Value of a series at a time [s]."""
    return float(np.interp(moment, gait(side)[0], values))


def peak(moment: float, values: NDArray[Any], side: str = "right") -> float:
    """Largest value of a series around a load peak."""
    return float(values[np.abs(gait(side)[0] - moment) <= AROUND_PEAK].max())


def within(start: float, end: float, step: float | None = None) -> NDArray[np.bool_]:
    """Mask of the samples of the right leg in a time range [s]."""
    time = gait("right", step)[0]
    return np.asarray((time >= start) & (time <= end))
