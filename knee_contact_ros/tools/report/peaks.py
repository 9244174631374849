"""Peaks of stance: the gait cycle in which each lies, and whether it is the first or the second of its stance."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from knee_contact_ros.streams.gait_events import LOAD_PEAK
from knee_contact_ros.tools.report.cycles import Cycle
from knee_contact_ros.tools.report.gather import Gathered, Moment

FIRST, SECOND = "first", "second"


class StancePeak(NamedTuple):
    """Peak of the load in stance, with the contact at it."""

    moment: Moment
    cycle: int | None
    """Index of the gait cycle in which the peak lies; None: it lies in no whole cycle"""
    percent: float | None
    """Percent of the gait cycle at which the peak lies; None: it lies in no whole cycle"""
    which: str
    """`FIRST` or `SECOND` for the largest peak in the first or second half of its stance; else empty"""


def stance_peaks(gathered: Gathered) -> list[StancePeak]:
    """Find the peaks of stance of a run, in the order of time."""
    starts = np.array([cycle.span.start for cycle in gathered.cycles], dtype=np.int64)
    peaks: list[StancePeak] = []
    largest: dict[tuple[int, str], int] = {}
    for moment in gathered.moments:
        if moment.event.kind != LOAD_PEAK:
            continue
        place = cycle_of(gathered.cycles, starts, moment)
        percent = None if place is None else gathered.cycles[place].span.percent(moment.event.stamp)
        peaks.append(StancePeak(moment, place, percent, ""))
        half = "" if place is None else _half(moment, gathered.cycles[place])
        if place is not None and half:
            before = largest.setdefault((place, half), len(peaks) - 1)
            if moment.load > peaks[before].moment.load:
                largest[place, half] = len(peaks) - 1
    for (_, half), index in largest.items():
        peaks[index] = peaks[index]._replace(which=half)
    return peaks


def cycle_of(cycles: list[Cycle], starts: np.ndarray[tuple[int], np.dtype[np.int64]], moment: Moment) -> int | None:
    """Index of the cycle in which a moment lies, or None; `starts` [ns] are the cycles' heel strikes, in any order."""
    stamp = moment.event.stamp
    near = np.flatnonzero(starts <= stamp)
    if not len(near):
        return None
    place = int(near[starts[near].argmax()])
    return place if stamp < cycles[place].span.end else None


def _half(moment: Moment, cycle: Cycle) -> str:
    span, stamp = cycle.span, moment.event.stamp
    if stamp >= span.toe_off:
        return ""
    return FIRST if 2 * stamp < span.start + span.toe_off else SECOND
