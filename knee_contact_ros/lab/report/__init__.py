"""`knee-contact report`: the page with its tables, the CSV files behind it, and the writing of all files."""

from __future__ import annotations

import base64
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from ... import __version__
from ...model.types import MM, ContactState, Status
from ...parameters.schema import Parameters
from ...streams.strides import RISE_TIME
from ...streams.topics import NANOSECONDS, is_lateral
from ...system.errors import IncompleteError, UsageError, join_faults
from ...system.files import install_command
from ...system.output_files import replace, work_folder
from ...system.progress import progress
from ...system.terminal import warn
from ...view.picture import UNDATED
from ..paired import paired
from ..uncertainty import DEFAULT_LEVEL, Propagated
from . import figures
from .figures import MICRO
from .gathered import (
    CYCLE_CURVES,
    CYCLE_PERCENT,
    EVENT_COLUMNS,
    FIRST_PEAK,
    PEAK_COLUMNS,
    SECOND_PEAK,
    Gathered,
)
from .runs import (
    NO_VALUE,
    ReportOptions,
    ReportRun,
    collect,
    differences,
)

_PAGE = "report.html"
_UNCERTAINTY_FILE = "uncertainty.csv"
_PICTURES = (
    "knee_[0-9]*",
    "over_time_[0-9]*",
    "uncertainty_[0-9]*",
    *(q.figure for q in CYCLE_CURVES.values() if q.figure),
)
"""Patterns of the names of the pictures, without their suffix"""
_EARLIER_FILES = (*(f"{name}.{kind}" for name in _PICTURES for kind in UNDATED), _UNCERTAINTY_FILE)
"""Patterns of the files of an earlier report that are removed"""
UNCERTAINTY_COLUMNS = (
    "input",
    "standard_deviation",
    "depth_at_largest_load_um",
    "force_at_largest_load_N",
    "depth_rms_um",
    "force_rms_N",
)
"""Columns of uncertainty.csv, after the run's label; where the femoral height drives, the largest contact force stands
for the largest load"""
_PEAK_QUANTITIES = (
    ("load_BW", "load [BW]", ".2f"),
    ("contact_force_BW", "contact force [BW]", ".2f"),
    ("penetration_depth_mm", "depth [mm]", ".3f"),
)
"""Quantities of the first table, with their names there and digits"""
_CYCLE_ROWS = (
    ("cycle [s]", "duration_s", ".3f"),
    ("stance [% of the cycle]", "stance_percent", ".1f"),
    ("largest contact force [BW]", "largest_contact_force_N", ".2f"),
    ("largest depth [mm]", "largest_penetration_depth_mm", ".3f"),
    ("impulse of stance [BW s]", "stance_impulse_N_s", ".3f"),
    ("impulse of stance [N s]", "stance_impulse_N_s", ".1f"),
    ("impulse of the cycle [BW s]", "impulse_N_s", ".3f"),
    ("impulse of the cycle [N s]", "impulse_N_s", ".1f"),
    ("loading rate [BW/s]", "loading_rate_N_per_s", ".1f"),
    ("largest patch half-width [mm]", "largest_patch_half_width_mm", ".2f"),
    ("largest mean pressure [MPa]", "largest_mean_pressure_MPa", ".2f"),
    ("largest peak pressure [MPa]", "largest_peak_pressure_MPa", ".2f"),
    ("largest nominal strain [%]", "largest_cartilage_strain_percent", ".1f"),
    ("bone contact [s]", "bone_contact_s", ".3f"),
    ("lifted off [s]", "lifted_off_s", ".3f"),
    ("sliding distance [mm]", "sliding_distance_mm", ".1f"),
    ("largest sliding velocity [mm/s]", "largest_sliding_velocity_mm_per_s", ".0f"),
)
"""Rows of the table of cycles: name, number of a cycle (divided by the body weight if the unit has BW), and digits"""
_OF_DEPTH = [key for _, key, _ in _CYCLE_ROWS if re.search("depth|patch|pressure|strain", key)]
"""Numbers of a cycle that are not comparable under different laws"""
_RINGING_TIME = 0.05
"""Time [s] on both sides of a peak within which its ringing is looked for: less than a swing of the contact"""
_LEAST_RINGING = 0.005
"""Smallest ringing that is shown, in body weights: two digits are printed"""
_FINE_STEP = 5e-4
"""Time [s] between samples that show 99 % of what bone adds to a loading rate; at 5 ms they show 59 %"""
_LEAST_GROUP = 3
"""Number of recordings from which their mean and deviation are shown"""


class PageTable(NamedTuple):
    """PageTable of texts whose first column has the names of the rows."""

    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""


def run_report(options: ReportOptions, output: Path) -> list[Path]:
    """Write the report into the folder `output`; return the paths of its files, the page first.

    Raises:
        UsageError: a file, parameter or the folder cannot be used, or a library is missing.
        IncompleteError: the report was written, but a bag was damaged and could be read only in part.
    """
    import matplotlib as mpl

    # Older versions cannot put legends outside of axes; Ubuntu 24.04 has 3.6.
    if mpl.__version_info__[:2] < (3, 7):
        raise UsageError(f"matplotlib {mpl.__version__} is too old; {install_command('report')}")
    if options.labels and len(options.labels) != len(options.files):
        raise UsageError(
            f"--label: {len(options.labels)} given for {len(options.files)} FILEs; give one each, or none"
        )
    with work_folder(output) as work:
        with progress("Reading") as bar:
            found = collect(options, work, bar)
            bar.describe("Drawing")
            files = _contents(found, options.kind)
        for name, content in files.items():
            (work / name).write_bytes(content if isinstance(content, bytes) else content.encode())
        for earlier in [path for pattern in _EARLIER_FILES for path in output.glob(pattern)]:
            earlier.unlink()
        for name in files:
            replace(work / name, output / name)
    damage = [sentence for run in found if run.beside is None for sentence in run.damage]
    if damage:
        raise IncompleteError(
            f"{output / _PAGE} shows what can be read of a damaged bag: {join_faults(damage)}"
        )
    kept = sorted({f"{run.name} keeps {', '.join(run.kept)}" for run in found if run.kept})
    warn(f"--compare: {line}" for line in kept)
    return [output / name for name in files]


def _contents(found: Sequence[ReportRun], kind: str) -> dict[str, str | bytes]:
    """Contents of all files of the report by name, the page first."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    cyclic = [run for run in found if run.gathered.spans]
    known = [(run, _contribution_table(run, run.uncertain)) for run in found if run.uncertain]
    drawn = {
        "knees": figures.knee_figures(found, kind),
        "cycle": figures.cycle_figures(found, cyclic, kind) if cyclic else [],
        "time": figures.time_figures(found, kind),
        "uncertain": figures.uncertainty_figures(found, kind),
    }
    environment = Environment(
        loader=PackageLoader(__package__ or "", ""),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["base64"] = lambda data: base64.b64encode(data).decode("ascii")
    bases = [run for run in found if run.beside is None]
    loads = (figures.which_load(run.parameters) for run in found if not run.prescribed)
    page = environment.get_template("report.html.jinja").render(
        title=f"Knee contact: {', '.join(run.name for run in bases)}",
        lead=_lead(bases),
        loads="; ".join(dict.fromkeys(loads)),
        version=__version__,
        found=found,
        first=_peak_table(found),
        differences=_what_differs(found),
        drawn=drawn,
        overview=_side_by_side([list(summary(run).items()) for run in found], found),
        cycles=_side_by_side(
            [_cycle_summary(run) for run in cyclic], cyclic, _stopped_by_bone(cyclic)
        ),
        paired=_paired_differences(found),
        group=_all_recordings(found),
        sources=figures.sources_of(cyclic),
        still=bool(cyclic) and not figures.moves(cyclic),
        uncertain=[
            (run, each, of) for (run, of), each in zip(known, drawn["uncertain"], strict=True)
        ],
        runs=[(run, differences([run.parameters, Parameters()], " instead of ")) for run in found],
    )
    pictures = {
        f"{figure.name}.{kind}": figure.files[kind]
        for several in drawn.values()
        for figure in several
    }
    return {_PAGE: page, **_csv_files(found), **pictures}


def _lead(bases: Sequence[ReportRun]) -> str:
    """Summarise the page in a sentence; ticks and cycles that both compartments of a knee share count once."""
    knees = [run.gathered for run in bases if not is_lateral(run.topic)]
    files = _count(len({run.source for run in bases}), "recording")
    cycles = _count(sum(len(knee.spans) for knee in knees), "whole gait cycle")
    ticks = sum(knee.ticks for knee in knees)
    return f"Tibiofemoral contact in {files}: {ticks} answers, {cycles}."


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def _what_differs(found: Sequence[ReportRun]) -> list[str]:
    """List the parameters that differ, a line each: in comparisons, and between the recordings."""
    changes = {}
    for run in found:
        if run.beside is not None:
            base = found[run.beside]
            both = [base.parameters if base.known else None, run.parameters]
            changes[run.name] = differences(both, " → ") or ["the comparison changes nothing"]
    if len(set(map(tuple, changes.values()))) == 1:
        lines = list(next(iter(changes.values())))
    else:
        lines = [f"{name}: {line}" for name, several in changes.items() for line in several]
    bases = [run for run in found if run.beside is None]
    if len({run.gait or run.source for run in bases}) > 1:
        gaits = (f"{run.label} {run.gait or run.source.name}" for run in bases)
        lines.append(f"gait: {', '.join(gaits)}")
    known = [run for run in bases if run.known]
    labels = [run.label for run in known]
    return lines + differences([run.parameters for run in known], ", ", labels)


def _peak_table(found: Sequence[ReportRun]) -> PageTable:
    """Compare each run's largest values, as `solve` prints them, and the means of its peaks of stance."""
    kinds = [
        which
        for which in (FIRST_PEAK, SECOND_PEAK)
        if any((run.gathered.peaks["peak"] == which).any() for run in found)
    ]
    notes = ["Largest: anywhere in the recording."]
    if figures.has_several_laws(found):
        notes.append(figures.NOT_COMPARABLE)
    if kinds:
        notes.append(
            "First and second peak: of the stances in whole gait cycles, mean ± standard deviation."
        )
    columns = []
    for run in found:
        cells = _largest_values(run)
        for which in kinds:
            group = run.gathered.peaks[run.gathered.peaks["peak"] == which]
            mark = _implausible(group["status"].to_numpy(int))
            ringing = max((_ringing_near(run, tick) for tick in group["tick"]), default=0.0)
            for column, name, digits in _PEAK_QUANTITIES:
                text = _spread(group[column], digits) + mark + _rings(run, name, ringing)
                cells.append((f"{which} peak: {name}", text))
        columns.append(cells)
        gathered = run.gathered
        stamp = int(gathered.columns["stamp"][gathered.largest])
        in_cycle = any(span.start <= stamp < span.end for span in gathered.spans)
        if run.beside is None and kinds and not in_cycle:
            what = gathered.driving.replace("_", " ")
            since = gathered.elapsed[gathered.largest] / NANOSECONDS
            where = f"{run.label}, {since:.3f} s after the first tick,"
            notes.append(f"The largest {what} of {where} is not within a whole gait cycle.")
    return _side_by_side(columns, found, " ".join(notes))


def _largest_values(run: ReportRun) -> list[tuple[str, str]]:
    """Return names and texts of the largest values of a run."""
    cells = []
    for column, name, digits in _PEAK_QUANTITIES:
        quantity = CYCLE_CURVES[column]
        values = run.gathered.columns[quantity.field]
        at = int(np.argmax(values))
        text = f"{quantity.scaled(values[at], run.weight):{digits}}"
        text += _implausible(run.gathered.columns["status"][at])
        if column == "load_BW" and run.prescribed:
            text = NO_VALUE
        cells.append((f"largest {name}", text + _rings(run, name, _ringing_near(run, at))))
    return cells


def _implausible(status: Any) -> str:
    """Return the mark of a value if one of the ticks that it comes from is implausible."""
    return " (implausible)" if np.any(status & int(Status.IMPLAUSIBLE)) else ""


def _cycle_summary(run: ReportRun) -> list[tuple[str, str]]:
    """Return the rows of the table of cycles by name: mean and spread of the characteristic values."""
    strides = run.gathered.strides
    rows = [("cycles", str(len(strides)))]
    for name, key, digits in _CYCLE_ROWS:
        values = strides[key] / (run.weight if "[BW" in name else 1.0)
        if name.startswith("bone") and not run.has_bone:
            values = values[:0]
        text = _spread(values, digits) + _rings(run, name, strides["ringing_N"].max())
        if "sliding" in name and text != NO_VALUE and run.is_hinge:
            text += " of a fixed hinge"
        if "strain" in name and text != NO_VALUE and run.model and run.model.patch:
            text += f" of {MM * run.model.patch.thickness:g} mm"
        rows.append((name, text))
    return rows


def _stopped_by_bone(cyclic: Sequence[ReportRun]) -> str:
    """Sentence on the loading rates where some runs reach bone and others do not; empty otherwise."""
    reach = {bool((run.gathered.strides["bone_contact_s"] > 0.0).any()) for run in cyclic}
    if len(reach) < 2 or any(run.parameters.fidelity.level == "quasi_static" for run in cyclic):
        return ""
    step = max(float(np.median(run.gathered.seconds)) for run in cyclic)
    said = (
        "Where bone stops the femur, the contact force exceeds the load for some milliseconds, as the model's femur "
        "has mass: loading rates are higher."
    )
    if step > _FINE_STEP:
        said += f" Samples {MM * step:.2g} ms apart miss part of this, in some strides more."
    return said


def _paired_differences(found: Sequence[ReportRun]) -> PageTable:
    """Compare each comparison with its run, stride by stride: mean difference, 95 % interval, and ringing."""
    compared = [(found[run.beside], run) for run in found if run.beside is not None]
    columns = []
    for base, run in compared:
        if len(base.gathered.strides) < 2:
            continue
        table = paired(base.gathered.strides, run.gathered.strides)
        cells = []
        for name, key, digits in _CYCLE_ROWS[2:]:  # duration and stance are those of the inputs
            one = table.loc[key] / (run.weight if "[BW" in name else 1.0)
            known = np.isfinite(one["difference"]) and (
                run.has_bone or not name.startswith("bone")
            )
            known &= key not in _OF_DEPTH or not figures.has_several_laws([base, run])
            known &= "sliding" not in name or not run.is_hinge  # it is that of the angle
            ringing = (
                _rings(each, name, each.gathered.strides["ringing_N"].max())
                for each in (run, base)
            )
            text = _difference(one, digits) + next(filter(None, ringing), "")
            cells.append((name, text if known else NO_VALUE))
        columns.append((run, cells))
    note = (
        "Comparison minus recording, mean of the strides with its 95 % interval (Student's). An interval that "
        "contains 0 shows no difference."
    )
    if any(figures.has_several_laws(pair) for pair in compared):
        note += " Left out: depth, patch, pressure and strain under different laws, as they are not comparable."
    return _side_by_side([cells for _, cells in columns], [run for run, _ in columns], note)


def _difference(one: Any, digits: str) -> str:
    """Return a row of `paired` as text: the difference and its interval."""
    return f"{one['difference']:+{digits}} ({one['low']:+{digits}} to {one['high']:+{digits}})"


def _all_recordings(found: Sequence[ReportRun]) -> PageTable:
    """Compare the means of all recordings: their mean and deviation, and the paired differences of a comparison."""
    bases = [run for run in found if len(run.gathered.strides) and not is_lateral(run.topic)]
    bases, compared = (
        [run for run in bases if (run.beside is None) is own] for own in (True, False)
    )
    if len(bases) < _LEAST_GROUP:
        return PageTable((), [])
    first, second = (
        pd.DataFrame(
            [
                {
                    name: run.gathered.strides[key].mean() / (run.weight if "[BW" in name else 1.0)
                    for name, key, _ in _CYCLE_ROWS
                }
                for run in runs
            ]
        )
        for runs in (bases, compared or bases)
    )
    table = paired(first, second)
    rows = []
    several_laws = figures.has_several_laws([*bases, *compared])
    no_mean = figures.has_several_laws(bases)
    for name, key, digits in _CYCLE_ROWS:
        if no_mean and (key in _OF_DEPTH or name.startswith("bone")):
            continue
        one = table.loc[name]
        cells = [name, f"{one['first']:{digits}} ± {one['first_sd']:{digits}}"]
        if compared:
            left_out = several_laws and key in _OF_DEPTH
            cells.append(f"{one['second']:{digits}} ± {one['second_sd']:{digits}}")
            cells.append(NO_VALUE if left_out else _difference(one, digits))
        if "sliding" in name and any(run.is_hinge for run in bases):
            continue
        if np.isfinite(one["first"]) and not (several_laws and "strain" in name):
            rows.append(cells)
    head = ["", f"{len(bases)} recordings"]
    if compared:
        head += [f"with {compared[0].label.rpartition(', with ')[2]}", "difference"]
    note = "Mean ± standard deviation over the recordings, each one the mean of its cycles."
    if no_mean:
        note += " Left out: what is not comparable under different laws."
    if compared:
        note += " Differences are paired by recording, with their 95 % interval (Student's)."
    return PageTable(head, rows, note)


def _ringing_near(run: ReportRun, tick: int) -> float:
    """Largest ringing [N] within `_RINGING_TIME` of a tick; 0 if it is not known."""
    elapsed = run.gathered.elapsed
    near = np.abs(elapsed - elapsed[tick]) <= _RINGING_TIME * NANOSECONDS
    return float(np.abs(run.gathered.columns.get("ringing", np.zeros(len(near)))[near]).max())


def _rings(run: ReportRun, name: str, ringing: float) -> str:
    """Return the mark of a largest force or loading rate that contains ringing, with how much at most, else nothing.

    `ringing` [N] is the largest where the value comes from.
    """
    if not (run.ringing and run.ringing.is_told and ringing > _LEAST_RINGING * run.weight):
        return ""
    largest = ringing / run.weight
    if name == "loading rate [BW/s]":
        return f" (rings: ± {2.0 * largest / RISE_TIME:.1f})"
    return f" (rings: ± {largest:.2f})" if name.endswith("contact force [BW]") else ""


def summary(run: ReportRun) -> dict[str, str]:
    """Return the rows of the table on the whole run and its accuracy, by name."""
    gathered = run.gathered
    stamps, state, status = (
        gathered.columns[name] for name in ("stamp", "contact_state", "status")
    )
    time = float(gathered.seconds.sum())
    rate = f"{(gathered.ticks - 1) / time:.0f} Hz" if time else "one tick"
    cycles = str(len(gathered.spans))
    missing = gathered.strikes - len(gathered.spans)
    if missing > 0:
        cycles += f" ({missing} more between heel strikes left out: too long, too short, or not one toe-off)"
    bone = "the contact law has one layer"
    if run.has_bone:
        bone = _time_of(gathered, state == ContactState.BONE)
    flags = {bit.name or "": int(np.count_nonzero(status & bit)) for bit in Status}
    not_converged = flags.pop("NOT_CONVERGED")
    otherwise = int(np.count_nonzero(status & ~int(Status.NOT_CONVERGED)))
    return {
        "file": run.source.name + ("" if run.topic == "/knee_contact" else f" {run.topic}"),
        "load": f"{figures.which_load(run.parameters)}; body weight {run.weight:.1f} N",
        "stamps from … to [s]": f"{stamps[0] / NANOSECONDS:.3f} … {stamps[-1] / NANOSECONDS:.3f}",
        "ticks": f"{gathered.ticks} in {time:.2f} s ({rate})",
        "gait cycles": cycles,
        "pressure": figures.pressure_of(run),
        "in bone contact": bone,
        "lifted off": _time_of(gathered, state == ContactState.SEPARATED),
        "error bound of the depth": _bounds(
            MICRO * gathered.columns["error_estimate"], "µm", MICRO
        ),
        "error bound of the contact force": _bounds(
            gathered.columns["force_error_estimate"], "N", math.inf
        ),
        "ticks not converged": str(not_converged),
        "ticks flagged otherwise": f"{otherwise}{_counted(flags)}",
        "samples refused": f"{sum(run.refused.values())}{_counted(run.refused)}",
        "contact law evaluations": f"{gathered.columns['evaluations'].mean():.1f} a tick",
    }


def _time_of(gathered: Gathered, which: Any) -> str:
    """Return the time of some ticks, and its fraction of the whole, as text."""
    part = float(gathered.seconds[which].sum())
    return f"{part:.3f} s ({100.0 * part / (float(gathered.seconds.sum()) or 1.0):.1f} %)"


def _counted(counts: Mapping[str, int]) -> str:
    """Return the numbers above 0 with their reasons, in brackets."""
    texts = [f"{count} × {name}" for name, count in counts.items() if count]
    return f" ({', '.join(texts)})" if texts else ""


def _contribution_table(run: ReportRun, of: Propagated) -> PageTable:
    """Make a table with the effect of each input's standard deviation, of all together, and the numerical error."""
    rows = [
        (name, deviation, *(f"{number:.3g}" for number in numbers[:3]))
        for name, deviation, *numbers in _contributions(run, of)
    ]
    at = int(of.rows[run.gathered.driving].argmax())
    where = run.gathered.driving.replace("_", " ")
    low, high = (MM * edge[at] for edge in of.depth_interval())
    least, most = (edge[at] for edge in of.force_interval())
    note = (
        f"At the largest {where}, with sign: what one standard deviation more does; together the depth lies between "
        f"{low:.3f} and {high:.3f} mm, and the contact force between {least:.0f} and {most:.0f} N "
        f"({DEFAULT_LEVEL:.0%}). RMS: over all ticks."
    )
    if of.without_effect:
        idle = ", ".join(f"{each.name} ({each.text})" for each in of.without_effect)
        note += f" Without effect on depth and force, and left out: {idle}."
    return PageTable(("input", "± SD", "depth [µm]", "force [N]", "RMS [µm]"), rows, note)


def _contributions(run: ReportRun, of: Propagated) -> Iterator[tuple[Any, ...]]:
    """Yield the effects of each input's standard deviation, of all together, and the numerical error.

    Each item has a name, the standard deviation as text, the effects on depth [µm] and force [N] at the largest load
    (or contact force) with their signs, and the RMS of these effects over all ticks, in the same units.
    """
    at = int(of.rows[run.gathered.driving].argmax())
    errors = (of.rows["error_estimate"], of.rows["force_error_estimate"])
    for name, deviation, depth, force in (
        *(
            (deviation.name, deviation.text, *part)
            for deviation, part in of.parts.items()
            if deviation not in of.without_effect
        ),
        (figures.ALL_INPUTS, "", of.depth, of.force),
        (figures.NUMERICAL_ERROR, "", *errors),
    ):
        rms = [float(np.sqrt(np.mean(np.square(each)))) for each in (depth, force)]
        yield name, deviation, MICRO * float(depth[at]), float(force[at]), MICRO * rms[0], rms[1]


def _csv_files(found: Sequence[ReportRun]) -> dict[str, str]:
    """Return the CSV files by name: floats with nine significant digits, NaN as an empty cell."""
    several = {
        "cycles.csv": [_mean_curves(run) for run in found],
        "events.csv": [run.gathered.events[[*EVENT_COLUMNS]] for run in found],
        "peaks.csv": [run.gathered.peaks[[*PEAK_COLUMNS]] for run in found],
        "strides.csv": [run.gathered.strides for run in found],
    }
    if any(run.uncertain for run in found):
        rows = [_contributions(run, run.uncertain) if run.uncertain else [] for run in found]
        columns = [*UNCERTAINTY_COLUMNS]
        several[_UNCERTAINTY_FILE] = [pd.DataFrame(each, columns=columns) for each in rows]
    files = {}
    for name, parts in several.items():
        for run, part in zip(found, parts, strict=True):
            part.insert(0, "run", run.label)
        joined = pd.concat([part for part in parts if len(part)] or parts[:1])
        files[name] = joined.to_csv(index=False, float_format="%.9g", lineterminator="\n")
    return files


def _mean_curves(run: ReportRun) -> pd.DataFrame:
    """Return the columns of cycles.csv: mean and (for several cycles) standard deviation at every percent."""
    cycles = len(run.gathered.spans)
    columns = {"gait_cycle_percent": CYCLE_PERCENT.astype(int), "cycles": cycles}
    for name, quantity in CYCLE_CURVES.items():
        curves = pd.DataFrame(quantity.scaled(run.gathered.curves[quantity.field], run.weight))
        columns[f"{name}_mean"] = curves.mean(skipna=False)
        columns[f"{name}_sd"] = curves.std(skipna=False)
    return pd.DataFrame(columns)[: None if cycles else 0]


def _side_by_side(
    columns: Sequence[Sequence[tuple[str, str]]], found: Sequence[ReportRun], note: str = ""
) -> PageTable:
    """Make a table with a row for each quantity (name and text) that some run has, and a column for each run."""
    rows = []
    for cells in zip(*columns, strict=True):
        texts = [text for _, text in cells]
        if set(texts) != {NO_VALUE}:
            rows.append([cells[0][0], *texts])
    return PageTable(("", *(run.label for run in found)), rows, note)


def _spread(values: pd.Series[float], digits: str) -> str:
    """Return the mean and sample standard deviation in a number format; a dash if a value is not finite."""
    if not len(values) or not np.isfinite(values).all():
        return NO_VALUE
    mean = f"{values.mean():{digits}}"
    return mean if len(values) == 1 else f"{mean} ± {values.std():{digits}}"


def _bounds(errors: Any, unit: str, most: float) -> str:
    """Return the text of the largest and the median error bound; NaN, or `most` and more, means no bound."""
    if np.isnan(errors).all():
        return "not in this recording"
    bounds = np.nan_to_num(errors, nan=math.inf)
    largest, median = (
        f"{each:.2g} {unit}" if each < most else "no bound"
        for each in (bounds.max(), np.median(bounds))
    )
    return f"{largest} at most, {median} median"
