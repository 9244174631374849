"""Tables of the report, as texts with units."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from knee_contact_ros.streams.gait_events import HEEL_STRIKE, LOAD_PEAK, TOE_OFF
from knee_contact_ros.streams.topics import NANOSECONDS
from knee_contact_ros.tools.report.cycles import Cycle
from knee_contact_ros.tools.report.figures import has_bone
from knee_contact_ros.tools.report.gather import LARGEST, Moment
from knee_contact_ros.tools.report.over_cycle import pressure_of
from knee_contact_ros.tools.report.peaks import FIRST, SECOND, stance_peaks
from knee_contact_ros.tools.report.published import which_load
from knee_contact_ros.tools.report.runs import Run, own_values

MM, MICROMETRE, MEGA = 1e3, 1e6, 1e-6
SHOWN = 12
"""Number of peaks of a run that the page lists, and half the number of its events; the CSV files have all"""
NONE = "–"
ONE_LAYER = "the contact law has one layer"


class Table(NamedTuple):
    """Table of texts whose first column has the names of the rows."""

    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""


def first_table(runs: Sequence[Run]) -> Table:
    """Compare the peaks of stance of all runs; without any, the ticks with the largest load or contact force."""
    peaks = [stance_peaks(run.gathered) for run in runs]
    kinds = [which for which in (FIRST, SECOND) if any(peak.which == which for each in peaks for peak in each)]
    head = [f"{which} peak: " for which in kinds]
    if not kinds:
        head = [" or ".join(dict.fromkeys(LARGEST[run.gathered.of_largest] for run in runs)) + ": "]
    columns = [f"{name}{quantity}" for name in head for quantity in ("load [BW]", "contact force [BW]", "depth [mm]")]
    rows = []
    for run, each in zip(runs, peaks, strict=True):
        moments = [[peak.moment for peak in each if peak.which == which] for which in kinds]
        if not kinds:
            moments = [[run.gathered.largest] if run.gathered.largest else []]
        rows.append((run.label, *(cell for group in moments for cell in _means(group, run.parameters.body_weight))))
    count = max((len([peak for peak in each if peak.which == which]) for each in peaks for which in kinds), default=0)
    note = f"Mean ± standard deviation of up to {count} stances." if count > 1 else ""
    return Table(("", *columns), rows, note)


def _means(moments: Sequence[Moment], weight: float) -> tuple[str, str, str]:
    """Mean and spread of load [BW], contact force [BW] and depth [mm] at some moments; `weight` is the body's [N]."""
    return (
        _spread([moment.load / weight for moment in moments], ".2f"),
        _spread([moment.contact_force / weight for moment in moments], ".2f"),
        _spread([MM * moment.penetration_depth for moment in moments], ".3f"),
    )


def peak_table(run: Run) -> Table:
    """List the first peaks of stance of a run, then mean and spread of all its first and all its second peaks."""
    peaks, weight = stance_peaks(run.gathered), run.parameters.body_weight
    head = ("peak", "load [N]", "load [BW]", "contact force [N]", "contact force [BW]", "depth [mm]", "gait cycle [%]",
            "stamp [s]")  # fmt: skip
    rows = []
    for which, moment, percent in ((peak.which, peak.moment, peak.percent) for peak in peaks[:SHOWN]):
        load, force = moment.load, moment.contact_force
        rows.append((
            which or NONE, f"{load:.1f}", f"{load / weight:.2f}", f"{force:.1f}", f"{force / weight:.2f}",
            f"{MM * moment.penetration_depth:.3f}", NONE if percent is None else f"{percent:.1f}",
            f"{moment.event.stamp / NANOSECONDS:.3f}",
        ))  # fmt: skip
    for which in (FIRST, SECOND):
        same = [peak for peak in peaks if peak.which == which]
        if len(same) > 1:
            columns = (
                _spread([peak.moment.load for peak in same], ".0f"),
                _spread([peak.moment.load / weight for peak in same], ".2f"),
                _spread([peak.moment.contact_force for peak in same], ".0f"),
                _spread([peak.moment.contact_force / weight for peak in same], ".2f"),
                _spread([MM * peak.moment.penetration_depth for peak in same], ".3f"),
                _spread([peak.percent for peak in same if peak.percent is not None], ".1f"),
            )
            rows.append((f"{which}, mean ± SD of {len(same)}", *columns, NONE))
    note = f"The first {SHOWN} of {len(peaks)}; all are in peaks.csv." if len(peaks) > SHOWN else ""
    return Table(head, rows, note)


def cycle_table(cyclic: Sequence[Run]) -> Table:
    """Summarise the gait cycles: a row for each quantity, a column for each run."""
    quantities: Sequence[tuple[str, Callable[[Cycle, float], float], str]] = (
        ("cycle [s]", lambda c, _: c.span.duration, ".3f"),
        ("stance [% of the cycle]", lambda c, _: c.span.stance, ".1f"),
        ("largest contact force [BW]", lambda c, w: c.largest_force / w, ".2f"),
        ("… at [% of the cycle]", lambda c, _: c.largest_force_at, ".1f"),
        ("largest depth [mm]", lambda c, _: MM * c.largest_depth, ".3f"),
        ("… at [% of the cycle]", lambda c, _: c.largest_depth_at, ".1f"),
        ("impulse of stance [BW s]", lambda c, w: c.stance_impulse / w, ".3f"),
        ("impulse of stance [N s]", lambda c, _: c.stance_impulse, ".1f"),
        ("impulse of the cycle [BW s]", lambda c, w: c.impulse / w, ".3f"),
        ("impulse of the cycle [N s]", lambda c, _: c.impulse, ".1f"),
        ("loading rate [BW/s]", lambda c, w: c.loading_rate / w, ".1f"),
        ("largest patch half-width [mm]", lambda c, _: MM * c.largest_half_width, ".2f"),
        ("largest mean pressure [MPa]", lambda c, _: MEGA * c.largest_mean_pressure, ".2f"),
        ("largest peak pressure [MPa]", lambda c, _: MEGA * c.largest_peak_pressure, ".2f"),
        ("largest nominal strain [%]", lambda c, _: 100.0 * c.largest_strain, ".1f"),
        ("bone contact [s]", lambda c, _: c.bone_time, ".3f"),
        ("bone contact [% of the cycle]", lambda c, _: 100.0 * c.bone_time / c.span.duration, ".1f"),
        ("lifted off [s]", lambda c, _: c.apart_time, ".3f"),
        ("sliding distance [mm]", lambda c, _: MM * c.sliding_distance, ".1f"),
        ("largest sliding velocity [mm/s]", lambda c, _: MM * c.largest_sliding_velocity, ".0f"),
    )
    rows = [("cycles", *(str(run.gathered.mean.count) for run in cyclic))]
    for name, value_of, digits in quantities:
        cells = []
        for run in cyclic:
            cycles = run.gathered.cycles if has_bone(run) or not name.startswith("bone") else ()
            cells.append(_spread([value_of(cycle, run.parameters.body_weight) for cycle in cycles], digits))
        rows.append((name, *cells))
    return Table(("", *(run.label for run in cyclic)), rows)


def run_table(runs: Sequence[Run]) -> Table:
    """Summarise each whole run and its accuracy: a row for each quantity, a column for each run."""
    columns = [_summary(run) for run in runs]
    rows = [(name, *(column[name] for column in columns)) for name in columns[0]]
    return Table(("", *(run.label for run in runs)), rows)


def _summary(run: Run) -> dict[str, str]:
    """Column of a run in `run_table`, by the names of the rows."""
    cycles, totals, weight = len(run.gathered.cycles), run.gathered.totals, run.parameters.body_weight
    depth, force = totals.depth_errors, totals.force_errors
    rate = f"{(totals.ticks - 1) / totals.time:.0f} Hz" if totals.time else "one tick"
    missing = run.gathered.strikes - cycles
    left_out = f" ({missing} more between heel strikes left out: too long, too short, or not one toe-off)"
    longest = f", at most {totals.longest_apart:.3f} s at one go" if totals.apart_time else ""
    force_bound = f"{_newtons(force.largest)} at most, {_newtons(force.median)} median"
    levels = sum(totals.levels.values())
    return {
        "file": run.source.name + ("" if run.topic == "/knee_contact" else f" {run.topic}"),
        "load": which_load(run.parameters),
        "from … to [s]": f"{totals.first_stamp / NANOSECONDS:.3f} … {totals.last_stamp / NANOSECONDS:.3f}",
        "ticks": f"{totals.ticks} in {totals.time:.2f} s ({rate})",
        "gait cycles": f"{cycles}{left_out if missing > 0 else ''}",
        "largest load": f"{totals.largest_load / weight:.2f} BW ({totals.largest_load:.1f} N)",
        "largest contact force": f"{totals.largest_force / weight:.2f} BW ({totals.largest_force:.1f} N)",
        "largest depth": f"{MM * totals.largest_depth:.3f} mm",
        "pressure": pressure_of(run),
        "in bone contact": _time(totals.bone_time, totals.time) if has_bone(run) else ONE_LAYER,
        "lifted off": _time(totals.apart_time, totals.time) + longest,
        "error bound of the depth": f"{_length(depth.largest)} at most, {_length(depth.median)} median",
        "error bound of the contact force": force_bound if force.known else "not in this recording",
        "ticks not converged": str(totals.flagged["NOT_CONVERGED"]),
        "ticks flagged otherwise": _counts({k: n for k, n in totals.flagged.items() if k != "NOT_CONVERGED"}),
        "samples refused": _counts(run.refused),
        "levels of the model": ", ".join(f"{k} {100.0 * n / levels:.1f} %" for k, n in sorted(totals.levels.items())),
        "contact law evaluations": f"{totals.evaluations / totals.ticks:.1f} a tick",
    }


def event_table(run: Run) -> Table:
    """List the first gait events of a run, with the number of all."""
    moments = run.gathered.moments
    rows = [
        (moment.event.kind, f"{moment.event.stamp / NANOSECONDS:.3f}", f"{moment.elapsed:.3f}", moment.event.text)
        for moment in moments[: 2 * SHOWN]
    ]
    counts = {kind: sum(moment.event.kind == kind for moment in moments) for kind in (HEEL_STRIKE, TOE_OFF, LOAD_PEAK)}
    numbers = ", ".join(f"{count} {kind}{'s' * (count != 1)}" for kind, count in counts.items())
    more = f" The first {2 * SHOWN} are shown; all are in events.csv." if len(moments) > 2 * SHOWN else ""
    return Table(("event", "stamp [s]", "since the first tick [s]", ""), rows, f"{numbers}.{more}")


def parameter_table(run: Run) -> Table:
    """List the parameters of a run that matter for its answers, beside their defaults."""
    rows = [
        (name, _value(value), "default" if value == default else f"default {_value(default)}", meaning)
        for name, value, default, meaning in own_values(run.parameters)
    ]
    return Table(("parameter", "value", "", "meaning"), rows)


def _spread(values: Sequence[float], digits: str) -> str:
    """Mean and sample standard deviation of some values in a number format; a dash where one is not finite."""
    if not values or not np.isfinite(values).all():
        return NONE
    mean = f"{np.mean(values):{digits}}"
    return mean if len(values) == 1 else f"{mean} ± {np.std(values, ddof=1):{digits}}"


def _time(time: float, whole: float) -> str:
    return f"{time:.3f} s ({100.0 * time / whole if whole else 0.0:.1f} %)"


def _length(error: float) -> str:
    """Text of an error bound [m]; one of a metre or more bounds nothing."""
    if error >= 1.0:
        return "no bound"
    return f"{MICROMETRE * error:.2g} µm" if error < 1e-3 else f"{MM * error:.2g} mm"


def _newtons(error: float) -> str:
    return f"{error:.2g} N" if math.isfinite(error) else "no bound"


def _counts(counts: Mapping[str, int]) -> str:
    reasons = ", ".join(f"{count} × {name}" for name, count in counts.items())
    return f"{sum(counts.values())}" + (f" ({reasons})" if reasons else "")


def _value(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.7g}" if math.isfinite(value) else str(value)
    return str(value) if value != "" else "none"
