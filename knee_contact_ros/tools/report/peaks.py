"""The peaks of stance: where in which cycle they lie, and which of the two they are."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from knee_contact_ros.pipeline.gait.events import LOAD_PEAK
from knee_contact_ros.tools.report.cycles import Cycle
from knee_contact_ros.tools.report.gather import Gathered, Moment

FIRST, SECOND = "first", "second"


class StancePeak(NamedTuple):
    """A peak of the load and the contact at it."""

    moment: Moment
    cycle: int | None
    """Index of its gait cycle; None: it lies in no whole one"""
    percent: float | None
    """[%] of the gait cycle"""
    which: str
    """`FIRST` or `SECOND`: the largest in the first or second half of its stance; else empty"""


def stance_peaks(gathered: Gathered) -> list[StancePeak]:
    """All peaks, in their order."""
    starts = np.array([cycle.span.start for cycle in gathered.cycles], dtype=np.int64)
    found: list[StancePeak] = []
    largest: dict[tuple[int, str], int] = {}
    for moment in gathered.moments:
        if moment.event.kind != LOAD_PEAK:
            continue
        place = cycle_of(gathered.cycles, starts, moment)
        percent = None if place is None else gathered.cycles[place].span.percent(moment.event.stamp)
        found.append(StancePeak(moment, place, percent, ""))
        half = "" if place is None else _half(moment, gathered.cycles[place])
        if place is not None and half:
            before = largest.setdefault((place, half), len(found) - 1)
            if moment.load > found[before].moment.load:
                largest[place, half] = len(found) - 1
    for (_, half), index in largest.items():
        found[index] = found[index]._replace(which=half)
    return found


def cycle_of(cycles: list[Cycle], starts: np.ndarray[tuple[int], np.dtype[np.int64]], moment: Moment) -> int | None:
    """Index of the cycle that a moment lies in; `starts` are the cycles' heel strikes. Stamps may have gone back."""
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
