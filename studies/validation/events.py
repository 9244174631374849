"""Heel strikes and toe-offs from angle and load, against the plates."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from benchmarks.report import Section
from knee_contact_ros.streams.gait_events import HEEL_STRIKE, TOE_OFF, GaitEvents
from studies.validation.data import BODY_WEIGHT, ON_PLATE, Measured

NANOSECONDS, MS = 1e9, 1e3
NEAR = 0.2
"""Largest time [s] between an event and that of the plate"""


def found_in(measured: Measured) -> dict[str, list[float]]:
    """Times [s] of heel strikes and toe-offs by `pipeline.gait`, from flexion and total load."""
    stamps = np.rint((measured.time - measured.time[0]) * NANOSECONDS).astype(np.int64)
    events = GaitEvents(BODY_WEIGHT)
    all_events = events.add(stamps, measured.flexion, measured.total) + events.finish()
    return {
        kind: sorted(measured.time[0] + each.stamp / NANOSECONDS for each in all_events if each.kind == kind)
        for kind in (HEEL_STRIKE, TOE_OFF)
    }


def errors_of(found: Sequence[float], plate: Sequence[float]) -> list[float]:
    """Times [s] by which events come after those of the plate, for the ones that have a partner."""
    return [
        min((time - other for time in found), key=abs)
        for other in plate
        if found and min(abs(time - other) for time in found) <= NEAR
    ]


def section(trials: Sequence[Measured]) -> Section:
    """Section on how far events lie from those of the plates, and which were missed."""
    rows = []
    for measured in trials:
        within = measured.time[0], measured.time[-1]
        found = found_in(measured)
        for kind, plate in zip((HEEL_STRIKE, TOE_OFF), measured.contacts(), strict=True):
            seen = [time for time in plate if within[0] <= time <= within[1]]
            errors = MS * np.array(errors_of(found[kind], seen))
            numbers = (f"{errors.mean():+.0f} ms", f"{np.abs(errors).max():.0f} ms") if len(errors) else ("-", "-")
            first, last = measured.plate_time[0] + NEAR, measured.plate_time[-1] - NEAR
            covered = [time for time in found[kind] if first <= time <= last]
            extra = len([time for time in covered if not any(abs(time - other) <= NEAR for other in plate)])
            rows.append([measured.name, kind, str(len(seen)), str(len(errors)), *numbers, str(extra)])
    text = (
        "Events as the node and the report find them, from flexion and load alone, beside the vertical ground reaction "
        f"crossing {ON_PLATE:.0f} N. The rules were made on other people ([report.md](report.md)). One overground "
        "step hits "
        "this leg's plate within 50 ms of the trial's beginning, where no rule can look back; the other one misses "
        "the plates, and its heel strike is counted as found where no plate was."
    )
    header = ("trial", "event", "on the plate", "found", "mean error", "largest", "found where no plate was")
    return Section("4. Gait events", text, header, rows)
