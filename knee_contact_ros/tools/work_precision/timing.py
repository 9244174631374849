"""How often a run is timed, and the statistics of its times.

A machine has phases of seconds to minutes in which everything takes half as long again: its other processors are busy,
or the host of a virtual machine is. One look measures the phase, so all runs are timed in turns, minutes apart.
"""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from typing import NamedTuple

ENOUGH = 1.0
"""Seconds of one run in all turns together, about, after which it is not timed again"""
LEAST_TURNS = 2
"""Least number of turns of a run that takes longer, where more than one was asked for"""
RUNS = 5
"""Number of short runs in one turn, one after another; the quickest counts"""
SLICE = 0.05
"""Seconds of such runs after which a turn ends"""


class Times(NamedTuple):
    """Statistics of a run's times in all turns."""

    least: float
    """Shortest time; this and the median are in the unit of the turns"""
    median: float
    spread_percent: float
    """Time between the quickest and the slowest turn, as a part of the median"""
    turns: int


def turns_for(seconds: float, most: int) -> int:
    """Number of turns in which a run of `seconds` [s] is timed, at most `most`."""
    return min(most, max(LEAST_TURNS, int(ENOUGH / seconds) if seconds > 0.0 else most))


def runs_for(seconds: float) -> int:
    """Number of runs of `seconds` [s] that a turn has."""
    return min(RUNS, max(1, int(SLICE / seconds))) if seconds > 0.0 else RUNS


def summed_up(turns: Sequence[float]) -> Times:
    """Statistics of the times of all turns, of which there is at least one, in any unit."""
    median = statistics.median(turns)
    return Times(min(turns), median, 100.0 * (max(turns) - min(turns)) / median, len(turns))
