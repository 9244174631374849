"""Tables of the data behind the report, in CSV format."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from knee_contact_ros.streams.topics import NANOSECONDS
from knee_contact_ros.tools.report.cycles import CURVES, PERCENT
from knee_contact_ros.tools.report.peaks import stance_peaks
from knee_contact_ros.tools.report.runs import Run

MM, DEGREES, MEGA, PERCENT_OF = 1e3, math.degrees(1.0), 1e-6, 100.0
CURVE_COLUMNS = {
    "flexion_angle_deg": ("flexion_angle", DEGREES),
    "load_N": ("load", 1.0),
    "load_BW": ("load", None),
    "contact_force_N": ("contact_force", 1.0),
    "contact_force_BW": ("contact_force", None),
    "penetration_depth_mm": ("penetration_depth", MM),
    "bone_depth_mm": ("bone_depth", MM),
    "contact_point_x_mm": ("contact_point_x", MM),
    "sliding_velocity_mm_per_s": ("sliding_velocity", MM),
    "patch_half_width_mm": ("half_width", MM),
    "mean_pressure_MPa": ("mean_pressure", MEGA),
    "peak_pressure_MPa": ("peak_pressure", MEGA),
    "cartilage_strain_percent": ("strain", PERCENT_OF),
}
"""Name of a quantity in cycles.csv → field of the answers and factor from SI units; None: in body weights"""
EVENT_COLUMNS = ("run", "event", "stamp_s", "time_s", "load_N", "load_BW", "contact_force_N", "contact_force_BW",
                 "penetration_depth_mm", "text")  # fmt: skip
PEAK_COLUMNS = ("run", "peak", "stamp_s", "time_s", "cycle", "gait_cycle_percent", "load_N", "load_BW",
                "contact_force_N", "contact_force_BW", "penetration_depth_mm", "contact_force_error_N",
                "penetration_depth_error_mm")  # fmt: skip
STRIDE_COLUMNS = ("run", "cycle", "heel_strike_s", "duration_s", "stance_percent", "sliding_distance_mm",
                  "largest_sliding_velocity_mm_per_s", "largest_contact_force_N", "largest_penetration_depth_mm",
                  "impulse_N_s", "stance_impulse_N_s", "loading_rate_N_per_s", "bone_contact_s",
                  "lifted_off_s", "largest_patch_half_width_mm", "largest_mean_pressure_MPa",
                  "largest_peak_pressure_MPa", "largest_cartilage_strain_percent")  # fmt: skip
Row = Sequence[str | float | int | None]


def tables(runs: Sequence[Run]) -> dict[str, str]:
    """Contents of the report's CSV files, by file name."""
    statistics = [f"{name}_{kind}" for name in CURVE_COLUMNS for kind in ("mean", "sd")]
    return {
        "cycles.csv": as_csv(("run", "gait_cycle_percent", "cycles", *statistics), curve_rows(runs)),
        "events.csv": as_csv(EVENT_COLUMNS, event_rows(runs)),
        "peaks.csv": as_csv(PEAK_COLUMNS, peak_rows(runs)),
        "strides.csv": as_csv(STRIDE_COLUMNS, stride_rows(runs)),
    }


def as_csv(columns: Sequence[str], rows: Iterable[Row]) -> str:
    """Write a table as CSV text: floats with nine significant digits, None as an empty cell."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([f"{value:.9g}" if isinstance(value, float) else value for value in row] for row in rows)
    return file.getvalue()


def curve_rows(runs: Sequence[Run]) -> Iterator[Row]:
    """Rows of cycles.csv: mean and standard deviation at every percent; a single cycle has no standard deviation."""
    for run in runs:
        mean, deviation = run.gathered.mean, run.gathered.mean.deviation
        if not mean.count:
            continue
        factors = [
            (CURVES.index(column), 1.0 / run.parameters.body_weight if factor is None else factor)
            for column, factor in CURVE_COLUMNS.values()
        ]
        for percent, values, spread in zip(
            PERCENT, mean.mean, np.full_like(mean.mean, np.nan) if deviation is None else deviation, strict=True
        ):
            numbers = [
                number
                for column, factor in factors
                for number in (_or_none(factor * values[column]), _or_none(factor * spread[column]))
            ]
            yield (run.label, int(percent), mean.count, *numbers)


def event_rows(runs: Sequence[Run]) -> Iterator[Row]:
    """Rows of events.csv: every gait event of every run."""
    for run in runs:
        weight = run.parameters.body_weight
        for moment in run.gathered.moments:
            yield (
                run.label, moment.event.kind, _seconds(moment.event.stamp), moment.elapsed, moment.load,
                moment.load / weight, moment.contact_force, moment.contact_force / weight,
                MM * moment.penetration_depth, moment.event.text,
            )  # fmt: skip


def peak_rows(runs: Sequence[Run]) -> Iterator[Row]:
    """Rows of peaks.csv: every peak of stance of every run; cycles are counted from 1."""
    for run in runs:
        weight = run.parameters.body_weight
        for peak in stance_peaks(run.gathered):
            moment = peak.moment
            yield (
                run.label, peak.which, _seconds(moment.event.stamp), moment.elapsed,
                None if peak.cycle is None else peak.cycle + 1, peak.percent, moment.load, moment.load / weight,
                moment.contact_force, moment.contact_force / weight, MM * moment.penetration_depth,
                _or_none(moment.force_error), _or_none(MM * moment.depth_error),
            )  # fmt: skip


def stride_rows(runs: Sequence[Run]) -> Iterator[Row]:
    """Rows of strides.csv: every whole gait cycle of every run, counted from 1."""
    for run in runs:
        for number, cycle in enumerate(run.gathered.cycles, start=1):
            yield (
                run.label, number, _seconds(cycle.span.start), cycle.span.duration, cycle.span.stance,
                _or_none(MM * cycle.sliding_distance), _or_none(MM * cycle.largest_sliding_velocity),
                cycle.largest_force, MM * cycle.largest_depth, cycle.impulse, cycle.stance_impulse,
                cycle.loading_rate, cycle.bone_time, cycle.apart_time, _or_none(MM * cycle.largest_half_width),
                _or_none(MEGA * cycle.largest_mean_pressure), _or_none(MEGA * cycle.largest_peak_pressure),
                _or_none(PERCENT_OF * cycle.largest_strain),
            )  # fmt: skip


def _seconds(stamp: int) -> str:
    """Text of a stamp [ns] in seconds, with all its digits."""
    return f"{stamp // NANOSECONDS}.{stamp % NANOSECONDS:09d}"


def _or_none(number: float) -> float | None:
    return None if math.isnan(number) else float(number)
