"""The report's tables, as text with units."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from knee_contact_ros.messages.ros_types import NANOSECONDS
from knee_contact_ros.pipeline.gait.events import HEEL_STRIKE, LOAD_PEAK, TOE_OFF
from knee_contact_ros.tools.report.cycles import Cycle
from knee_contact_ros.tools.report.figures import has_bone, pressure_of
from knee_contact_ros.tools.report.gather import LARGEST, Moment
from knee_contact_ros.tools.report.peaks import FIRST, SECOND, StancePeak, stance_peaks
from knee_contact_ros.tools.report.published import which_load
from knee_contact_ros.tools.report.runs import Run, own_values
from knee_contact_ros.tools.report.totals import Totals

MM, MICROMETRE, MEGA = 1e3, 1e6, 1e-6
SHOWN = 12
"""Peaks and events of a run that the page lists; the files have all"""
NONE = "–"
ONE_LAYER = "the contact law has one layer"


class Table(NamedTuple):
    """A table of texts; the first column names the rows."""

    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""


def first_table(runs: Sequence[Run]) -> Table:
    """The peaks of all runs at a glance; without any, where the load or the contact force is largest."""
    peaks = [stance_peaks(run.gathered) for run in runs]
    found = [which for which in (FIRST, SECOND) if any(peak.which == which for each in peaks for peak in each)]
    head = [f"{which} peak: " for which in found]
    if not found:
        head = [" or ".join(dict.fromkeys(LARGEST[run.gathered.of_largest] for run in runs)) + ": "]
    columns = [f"{name}{quantity}" for name in head for quantity in ("load [BW]", "contact force [BW]", "depth [mm]")]
    rows = []
    for run, each in zip(runs, peaks, strict=True):
        moments = [[peak.moment for peak in each if peak.which == which] for which in found]
        if not found:
            moments = [[run.gathered.largest] if run.gathered.largest else []]
        rows.append((run.label, *(cell for group in moments for cell in _means(group, run.parameters.body_weight))))
    count = max((len([peak for peak in each if peak.which == which]) for each in peaks for which in found), default=0)
    note = f"Mean ± standard deviation of up to {count} stances." if count > 1 else ""
    return Table(("", *columns), rows, note)


def _means(moments: Sequence[Moment], weight: float) -> tuple[str, str, str]:
    """Load, contact force and depth."""
    return (
        _spread([moment.load / weight for moment in moments], ".2f"),
        _spread([moment.contact_force / weight for moment in moments], ".2f"),
        _spread([MM * moment.penetration_depth for moment in moments], ".3f"),
    )


def peak_table(run: Run) -> Table:
    """The first peaks of stance, and mean and spread of all first and second ones."""
    peaks, weight = stance_peaks(run.gathered), run.parameters.body_weight
    head = ("peak", "load [N]", "load [BW]", "contact force [N]", "contact force [BW]", "depth [mm]", "gait cycle [%]",
            "stamp [s]")  # fmt: skip
    rows = [
        (
            peak.which or NONE, *_forces(peak, weight), f"{MM * peak.moment.penetration_depth:.3f}",
            NONE if peak.percent is None else f"{peak.percent:.1f}", f"{peak.moment.event.stamp / NANOSECONDS:.3f}",
        )
        for peak in peaks[:SHOWN]
    ]  # fmt: skip
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
    """What the gait cycles amount to: a row per quantity, a column per run."""
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
    rows += [
        (name, *(_spread([of(c, run.parameters.body_weight) for c in _told(run, name)], digits) for run in cyclic))
        for name, of, digits in quantities
    ]
    return Table(("", *(run.label for run in cyclic)), rows)


def run_table(runs: Sequence[Run]) -> Table:
    """What each whole run amounts to, and how exact it is."""
    rows: Mapping[str, Callable[[Run], str]] = {
        "file": lambda run: run.source.name + ("" if run.topic == "/knee_contact" else f" {run.topic}"),
        "load": lambda run: which_load(run.parameters),
        "from … to [s]": _span,
        "ticks": lambda run: f"{run.gathered.totals.ticks} in {run.gathered.totals.time:.2f} s ({_rate(run)})",
        "gait cycles": _cycles,
        "largest load": lambda run: _force(run.gathered.totals.largest_load, run),
        "largest contact force": lambda run: _force(run.gathered.totals.largest_force, run),
        "largest depth": lambda run: f"{MM * run.gathered.totals.largest_depth:.3f} mm",
        "pressure": pressure_of,
        "in bone contact": lambda run: _time(run.gathered.totals.bone_time, run) if has_bone(run) else ONE_LAYER,
        "lifted off": _lifted,
        "error bound of the depth": _depth_error,
        "error bound of the contact force": _force_error,
        "ticks not converged": lambda run: str(run.gathered.totals.flagged["NOT_CONVERGED"]),
        "ticks flagged otherwise": lambda run: _counts({
            name: count for name, count in run.gathered.totals.flagged.items() if name != "NOT_CONVERGED"
        }),
        "samples refused": lambda run: _counts(run.refused),
        "levels of the model": lambda run: _shares(run.gathered.totals.levels),
        "contact law evaluations": lambda run: _cost(run.gathered.totals),
    }  # fmt: skip
    return Table(("", *(run.label for run in runs)), [(name, *map(of, runs)) for name, of in rows.items()])


def event_table(run: Run) -> Table:
    """The first events of a run."""
    moments = run.gathered.moments
    rows = [
        (moment.event.kind, f"{moment.event.stamp / NANOSECONDS:.3f}", f"{moment.elapsed:.3f}", moment.event.text)
        for moment in moments[: 2 * SHOWN]
    ]
    counts = {kind: sum(moment.event.kind == kind for moment in moments) for kind in (HEEL_STRIKE, TOE_OFF, LOAD_PEAK)}
    told = ", ".join(f"{count} {kind}{'s' * (count != 1)}" for kind, count in counts.items())
    more = f" The first {2 * SHOWN} are shown; all are in events.csv." if len(moments) > 2 * SHOWN else ""
    return Table(("event", "stamp [s]", "since the first tick [s]", ""), rows, f"{told}.{more}")


def parameter_table(run: Run) -> Table:
    """The parameters that matter, beside their defaults."""
    rows = [
        (name, _value(value), "default" if value == default else f"default {_value(default)}", meaning)
        for name, value, default, meaning in own_values(run.parameters)
    ]
    return Table(("parameter", "value", "", "meaning"), rows)


def _told(run: Run, name: str) -> Sequence[Cycle]:
    """Cycles that have a quantity: none of those in bone, if the law has none."""
    return run.gathered.cycles if has_bone(run) or not name.startswith("bone") else ()


def _forces(peak: StancePeak, weight: float) -> tuple[str, str, str, str]:
    load, force = peak.moment.load, peak.moment.contact_force
    return f"{load:.1f}", f"{load / weight:.2f}", f"{force:.1f}", f"{force / weight:.2f}"


def _spread(values: Sequence[float], digits: str) -> str:
    if not values or not np.isfinite(values).all():
        return NONE
    mean = f"{np.mean(values):{digits}}"
    return mean if len(values) == 1 else f"{mean} ± {np.std(values, ddof=1):{digits}}"


def _span(run: Run) -> str:
    totals = run.gathered.totals
    return f"{totals.first_stamp / NANOSECONDS:.3f} … {totals.last_stamp / NANOSECONDS:.3f}"


def _rate(run: Run) -> str:
    totals = run.gathered.totals
    return f"{(totals.ticks - 1) / totals.time:.0f} Hz" if totals.time else "one tick"


def _cycles(run: Run) -> str:
    whole, missing = len(run.gathered.cycles), run.gathered.strikes - len(run.gathered.cycles)
    left_out = f" ({missing} more between heel strikes left out: too long, too short, or not one toe-off)"
    return f"{whole}{left_out if missing > 0 else ''}"


def _force(force: float, run: Run) -> str:
    return f"{force / run.parameters.body_weight:.2f} BW ({force:.1f} N)"


def _time(time: float, run: Run) -> str:
    whole = run.gathered.totals.time
    return f"{time:.3f} s ({100.0 * time / whole if whole else 0.0:.1f} %)"


def _lifted(run: Run) -> str:
    totals = run.gathered.totals
    longest = f", at most {totals.longest_apart:.3f} s at one go" if totals.apart_time else ""
    return _time(totals.apart_time, run) + longest


def _depth_error(run: Run) -> str:
    errors = run.gathered.totals.depth_errors
    return f"{_length(errors.largest)} at most, {_length(errors.median)} median"


def _force_error(run: Run) -> str:
    errors = run.gathered.totals.force_errors
    if not errors.told:
        return "not in this recording"
    return f"{_newtons(errors.largest)} at most, {_newtons(errors.median)} median"


def _length(error: float) -> str:
    """An error [m]; beyond a metre there is none that bounds anything."""
    if error >= 1.0:
        return "no bound"
    return f"{MICROMETRE * error:.2g} µm" if error < 1e-3 else f"{MM * error:.2g} mm"


def _newtons(error: float) -> str:
    return f"{error:.2g} N" if math.isfinite(error) else "no bound"


def _cost(totals: Totals) -> str:
    return f"{totals.evaluations / totals.ticks:.1f} a tick"


def _counts(counts: Mapping[str, int]) -> str:
    reasons = ", ".join(f"{count} × {name}" for name, count in counts.items())
    return f"{sum(counts.values())}" + (f" ({reasons})" if reasons else "")


def _shares(levels: Mapping[str, int]) -> str:
    whole = max(sum(levels.values()), 1)
    return ", ".join(f"{name} {100.0 * count / whole:.1f} %" for name, count in sorted(levels.items()))


def _value(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.7g}" if math.isfinite(value) else str(value)
    return str(value) if value != "" else "none"
