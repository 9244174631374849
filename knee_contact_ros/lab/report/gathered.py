"""What the tables and figures of a report need of a run's answers: totals, gait events, gait cycles and their curves.

All answers of a run are in memory at once.
"""

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ...model.readouts import READOUTS_OF_LAW
from ...model.types import MM, ContactState, Floats, Status
from ...streams.gait_events import (
    GAP,
    HEEL_STRIKE,
    LOAD_PEAK,
    NEARBY,
    TOE_OFF,
    GaitEvent,
    GaitEvents,
)
from ...streams.strides import Span, at_stamps, cut, rows_of, spans, stride_of
from ...streams.topics import NANOSECONDS
from ...streams.watch import Doubts

_MEGA = 1e-6
"""Factor from Pa to MPa"""
CYCLE_PERCENT = np.arange(101.0)
"""Places of the curves in the gait cycle [%], shape (101,)"""
FIRST_PEAK = "first"
SECOND_PEAK = "second"


class Quantity(NamedTuple):
    """Quantity of the tables over the gait cycle, and of a figure if it has one."""

    field: str
    """Name of the field of the answers, or of the readout"""
    factor: float | None
    """Factor from SI units to the unit of the tables; None: a force in body weights"""
    figure: str = ""
    """Name of the figure's file, without the suffix; empty: there is none"""
    title: str = ""
    unit: str = ""
    """Unit on the figure's axis"""

    def scaled(self, values: Any, weight: float) -> Any:
        """Values in the unit of the tables, for a body weight [N]."""
        return values / weight if self.factor is None else self.factor * values


CYCLE_CURVES = {
    "flexion_angle_deg": Quantity(
        "flexion_angle", math.degrees(1.0), "flexion", "Flexion angle", "°"
    ),
    "load_N": Quantity("load", 1.0),
    "load_BW": Quantity("load", None),
    "contact_force_N": Quantity("contact_force", 1.0),
    "contact_force_BW": Quantity("contact_force", None, "contact_force", "Contact force", "BW"),
    "penetration_depth_mm": Quantity("penetration_depth", MM, "depth", "Penetration depth", "mm"),
    "bone_depth_mm": Quantity("bone_depth", MM),
    "contact_point_x_mm": Quantity("contact_point_x", MM, "contact_point", "Contact point", "mm"),
    "sliding_velocity_mm_per_s": Quantity("sliding_velocity", MM),
    "patch_half_width_mm": Quantity(
        "half_width", MM, "patch_half_width", "Patch half-width", "mm"
    ),
    "mean_pressure_MPa": Quantity("mean_pressure", _MEGA),
    "peak_pressure_MPa": Quantity(
        "peak_pressure", _MEGA, "peak_pressure", "Peak contact pressure", "MPa"
    ),
    "cartilage_strain_percent": Quantity("strain", 100.0),
}
"""Curves over the gait cycle, by their names in cycles.csv"""
_CURVE_FIELDS = list(dict.fromkeys(each.field for each in CYCLE_CURVES.values()))
ANSWER_FIELDS = [
    *(field for field in _CURVE_FIELDS if field not in READOUTS_OF_LAW),
    "gap",
    "stamp",
    "error_estimate",
    "force_error_estimate",
    "femoral_height",
    "contact_state",
    "fidelity",
    "status",
    "evaluations",
]
"""Fields of the answers that are kept"""
_AT_EVENTS = ("load_N", "load_BW", "contact_force_N", "contact_force_BW", "penetration_depth_mm")
"""Quantities of `CYCLE_CURVES` that are listed at events"""
EVENT_COLUMNS = ("event", "stamp_s", "time_s", *_AT_EVENTS, "text")
"""Columns of events.csv, after the run's label"""
PEAK_COLUMNS = (
    "peak",
    "stamp_s",
    "time_s",
    "cycle",
    "gait_cycle_percent",
    *_AT_EVENTS,
    "contact_force_error_N",
    "penetration_depth_error_mm",
)
"""Columns of peaks.csv, after the run's label"""
STRIDE_COLUMNS = (
    "heel_strike_s",
    "duration_s",
    "stance_percent",
    "sliding_distance_mm",
    "largest_sliding_velocity_mm_per_s",
    "largest_contact_force_N",
    "largest_penetration_depth_mm",
    "impulse_N_s",
    "stance_impulse_N_s",
    "loading_rate_N_per_s",
    "ringing_N",
    "bone_contact_s",
    "lifted_off_s",
    "largest_patch_half_width_mm",
    "largest_mean_pressure_MPa",
    "largest_peak_pressure_MPa",
    "largest_cartilage_strain_percent",
)
"""Names of a cycle's characteristic values in strides.csv, with their units"""


class Gathered:
    """Totals, gait events, gait cycles and their curves of a run."""

    def __init__(
        self,
        columns: Mapping[str, NDArray[Any]],
        body_weight: float,
        doubts: Doubts,
        known: Sequence[GaitEvent] = (),
    ) -> None:
        """Gather them from answers.

        Args:
            columns: fields of the answers, shape (n,), n >= 1 each: `ANSWER_FIELDS`, and where the model is known
                `READOUTS_OF_LAW` and the force's `ringing` [N].
            body_weight: body weight [N].
            doubts: doubts about the run's parameters, to which those about its answers are added.
            known: gait events that an importer read, see `GaitEvents`.
        """
        self.columns = {**columns, "status": columns["status"].astype(np.int64)}
        self.doubts = doubts
        doubts.add_answers(self.columns)
        stamps = columns["stamp"]
        steps = np.diff(stamps, prepend=stamps[0])
        self.elapsed = stamps - stamps[0] - np.cumsum(np.minimum(steps, 0))
        """Time [ns] since the first tick by the stamps; where these go back, the run continues without a pause"""
        restarts = (self.columns["status"] & Status.TIME_RESET) != 0
        begins = (steps <= 0) | (steps > GAP) | restarts
        begins[0] = True
        self.seconds = np.where(begins, 0.0, steps / NANOSECONDS)
        """Time [s] of each tick since the one before, without gaps"""
        self.ticks = len(stamps)
        """Number of ticks"""
        self.spans: list[Span] = []
        """Whole gait cycles, from heel strike to heel strike"""
        self.strikes = 0
        """Number of heel strikes that another one follows: that of cycles, if all cycles are plausible"""
        cycles: list[tuple[dict[str, Any], Floats]] = []
        events: list[dict[str, Any]] = []
        for begin, end in pairwise([*np.flatnonzero(begins).tolist(), self.ticks]):
            part = {name: column[begin:end] for name, column in self.columns.items()}
            found = _events_in(part, GaitEvents(body_weight, known))
            strikes = [each.stamp for each in found if each.kind == HEEL_STRIKE]
            toe_offs = [each.stamp for each in found if each.kind == TOE_OFF]
            self.strikes += max(len(strikes) - 1, 0)
            first = part["stamp"][0]
            since_first = int(self.elapsed[begin] - first)
            whole = [span for span in spans(strikes, toe_offs) if first - NEARBY <= span.start]
            cycles += [_cycle(part, span) for span in whole]
            for event in found:
                row = _event_row(part, event, body_weight)
                row["time_s"] = (event.stamp + since_first) / NANOSECONDS
                row["tick"] += begin
                if event.kind == LOAD_PEAK:
                    row |= _peak_in_cycle(event.stamp, whole, len(self.spans))
                events.append(row)
            self.spans += whole
        names = dict.fromkeys((*EVENT_COLUMNS, *PEAK_COLUMNS, "tick", "status"))
        self.events = pd.DataFrame(events, columns=[*names]).sort_values(
            "time_s", kind="stable", ignore_index=True
        )
        """Gait events in the order of time, with the answers at them"""
        peaks = self.events[self.events["event"] == LOAD_PEAK]
        largest = peaks[peaks["peak"] != ""].groupby(["cycle", "peak"])["load_N"].idxmax()
        self.peaks = peaks.assign(peak=peaks["peak"].where(peaks.index.isin(largest), ""))
        """Peaks of the load; `peak` is `FIRST_PEAK` or `SECOND_PEAK` for the largest in either half of a stance"""
        self.strides = pd.DataFrame([values for values, _ in cycles], columns=[*STRIDE_COLUMNS])
        self.strides.insert(0, "cycle", range(1, len(cycles) + 1))
        """Characteristic values of each cycle, `STRIDE_COLUMNS`, in the units of their names"""
        curves = np.array([curve for _, curve in cycles]).reshape(-1, len(_CURVE_FIELDS), 101)
        self.curves = dict(zip(_CURVE_FIELDS, curves.swapaxes(0, 1), strict=True))
        """Curves at every percent of every cycle by their fields, in SI units, shape (cycles, 101)"""

    @property
    def largest(self) -> int:
        """Tick of the largest load, or with prescribed femoral height of the largest contact force."""
        return int(np.nan_to_num(self.columns[self.driving], nan=-np.inf).argmax())

    @property
    def counted_events(self) -> str:
        """Numbers of gait events by kind, as words."""
        counts = self.events["event"].value_counts()
        return ", ".join(
            f"{kind}s {counts.get(kind, 0)}" for kind in (HEEL_STRIKE, TOE_OFF, LOAD_PEAK)
        )

    @property
    def driving(self) -> str:
        """Field whose largest value is at `largest`."""
        return "load" if self.doubts.inputs.load_driven else "contact_force"


def seconds(stamp: int) -> str:
    """Return the text of a stamp [ns] in seconds, with all its digits."""
    return f"{stamp // NANOSECONDS}.{stamp % NANOSECONDS:09d}"


def _events_in(part: Mapping[str, NDArray[Any]], finder: GaitEvents) -> list[GaitEvent]:
    """Find the gait events of answers without gaps, in the order of time."""
    found = finder.add_samples(part["stamp"], part["flexion_angle"], part["load"])
    return sorted(found + finder.finish_events())


def _event_row(
    part: Mapping[str, NDArray[Any]], event: GaitEvent, body_weight: float
) -> dict[str, Any]:
    """Return the answers at an event of a part; its tick is counted in the part."""
    tick = max(int(np.searchsorted(part["stamp"], event.stamp, "right")) - 1, 0)
    return {
        "event": event.kind,
        "stamp_s": seconds(event.stamp),
        "text": event.text,
        "peak": "",
        "tick": tick,
        "status": part["status"][tick],
        **{
            name: CYCLE_CURVES[name].scaled(part[CYCLE_CURVES[name].field][tick], body_weight)
            for name in _AT_EVENTS
        },
        "contact_force_error_N": part["force_error_estimate"][tick],
        "penetration_depth_error_mm": MM * part["error_estimate"][tick],
    }


def _peak_in_cycle(stamp: int, cycles: Sequence[Span], before: int) -> dict[str, Any]:
    """Return the cycle of a load peak and its place there, if it is in one; `before` cycles are in earlier parts."""
    for number, span in enumerate(cycles, start=before + 1):
        if span.start <= stamp < span.end:
            row: dict[str, Any] = {"cycle": number, "gait_cycle_percent": span.percent(stamp)}
            if stamp < span.toe_off:
                is_first = 2 * stamp < span.start + span.toe_off
                row["peak"] = FIRST_PEAK if is_first else SECOND_PEAK
            return row
    return {}


def _cycle(columns: Mapping[str, NDArray[Any]], span: Span) -> tuple[dict[str, Any], Floats]:
    """Return a cycle's values, `STRIDE_COLUMNS`, NaN where unknown, and its curves, shape (`_CURVE_FIELDS`, 101)."""
    part = rows_of(span, columns["stamp"])
    near = {name: column[part] for name, column in columns.items()}
    stamps = near["stamp"]
    stride = stride_of(span, near, near.get("ringing"))
    unknown = np.full(len(stamps), np.nan)
    curves = [near.get(name, unknown) for name in _CURVE_FIELDS]
    values = np.column_stack([*curves, near["contact_state"]])
    time, cycle = cut(stamps, values, span.start, span.end)
    state = cycle[:, -1]
    largest = dict(zip(_CURVE_FIELDS, cycle[:, :-1].max(axis=0).tolist(), strict=True))
    speeds = np.abs(cycle[:, _CURVE_FIELDS.index("sliding_velocity")])
    speed = speeds[state != ContactState.SEPARATED].max(initial=0.0)
    steps = np.diff(time)
    apart, bone = (
        float(steps[state[1:] == each].sum())
        for each in (ContactState.SEPARATED, ContactState.BONE)
    )
    numbers = (
        seconds(span.start),
        span.duration,
        span.stance,
        MM * stride.sliding_distance,
        MM * float(speed),
        stride.peak_force,
        MM * stride.peak_depth,
        stride.impulse,
        stride.stance_impulse,
        stride.loading_rate,
        stride.ringing,
        bone,
        apart,
        MM * largest["half_width"],
        _MEGA * largest["mean_pressure"],
        _MEGA * largest["peak_pressure"],
        100.0 * largest["strain"],
    )
    places = np.round((span.end - span.start) * CYCLE_PERCENT / 100.0).astype(np.int64)
    at_percents = at_stamps(stamps, values, span.start + places)[:, :-1].T
    return dict(zip(STRIDE_COLUMNS, numbers, strict=True)), at_percents
