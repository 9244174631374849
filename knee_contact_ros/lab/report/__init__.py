"""`knee-contact report`: the page with its tables, the CSV files behind it, and the writing of all files."""

from __future__ import annotations

import base64
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from knee_contact_ros import __version__
from knee_contact_ros.lab.report import figures, runs
from knee_contact_ros.lab.report.runs import CURVES, FIRST, NONE, PERCENT, SECOND, Run
from knee_contact_ros.lab.uncertainty import LEVEL, Propagated
from knee_contact_ros.model.types import MM, ContactState, Status
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.streams.topics import NANOSECONDS, is_lateral
from knee_contact_ros.system.errors import IncompleteError, UsageError, join_faults
from knee_contact_ros.system.files import install_command
from knee_contact_ros.system.output_files import replace, work_folder
from knee_contact_ros.system.progress import progress
from knee_contact_ros.system.terminal import warn

OLDEST = (3, 7)
"""Oldest version of matplotlib that puts legends outside of axes; Ubuntu 24.04 has 3.6"""
EXTRA, PAGE, TEMPLATE, UNCERTAINTY = (
    "report",
    "report.html",
    "report.html.jinja",
    "uncertainty.csv",
)
PICTURES = (
    "knee_[0-9]*",
    "over_time_[0-9]*",
    "uncertainty_[0-9]*",
    *(q.figure for q in CURVES.values() if q.figure),
)
"""Patterns of the names of the pictures, without their suffix"""
EARLIER = (*(f"{name}.png" for name in PICTURES), UNCERTAINTY)
"""Patterns of the files of an earlier report that are removed"""
DOUBTFUL = " (implausible)"
"""Mark of values from a tick that is `IMPLAUSIBLE`"""
MICRO = 1e6
UNCERTAINTY_COLUMNS = (
    "input",
    "standard_deviation",
    "depth_at_largest_load_um",
    "force_at_largest_load_N",
    "depth_rms_um",
    "force_rms_N",
)
# "at_largest_load": where the femoral height drives, at the largest contact force
QUANTITIES = (
    ("load_BW", "load [BW]", ".2f"),
    ("contact_force_BW", "contact force [BW]", ".2f"),
    ("penetration_depth_mm", "depth [mm]", ".3f"),
)
"""Quantities of the first table, with their names there and digits"""
CYCLE_ROWS = (
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


class Table(NamedTuple):
    """Table of texts whose first column has the names of the rows."""

    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""


def run_report(options: runs.ReportOptions, output: Path) -> list[Path]:
    """Write the report into the folder `output`; return the paths of its files, the page first.

    Raises:
        UsageError: a file, parameter or the folder cannot be used, or a library is missing.
        IncompleteError: the report was written, but a bag was damaged and could be read only in part.
    """
    import matplotlib as mpl

    if mpl.__version_info__[:2] < OLDEST:
        raise UsageError(f"matplotlib {mpl.__version__} is too old; {install_command(EXTRA)}")
    if options.labels and len(options.labels) != len(options.files):
        raise UsageError(
            f"--label: {len(options.labels)} given for {len(options.files)} FILEs; give one each, or none"
        )
    with work_folder(output) as work:
        with progress("Reading") as bar:
            found = runs.collect(options, work, bar)
            bar.describe("Drawing")
            files = contents(found)
        for name, content in files.items():
            (work / name).write_bytes(content if isinstance(content, bytes) else content.encode())
        for earlier in [path for pattern in EARLIER for path in output.glob(pattern)]:
            earlier.unlink()
        for name in files:
            replace(work / name, output / name)
    damage = [sentence for run in found if run.beside is None for sentence in run.damage]
    if damage:
        raise IncompleteError(
            f"{output / PAGE} shows what can be read of a damaged bag: {join_faults(damage)}"
        )
    kept = sorted({f"{run.name} keeps {', '.join(run.kept)}" for run in found if run.kept})
    warn(f"--compare: {line}" for line in kept)
    return [output / name for name in files]


def contents(found: Sequence[Run]) -> dict[str, str | bytes]:
    """Contents of all files of the report by name, the page first."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    cyclic = [run for run in found if run.gathered.spans]
    known = [(run, contribution_table(run, run.uncertain)) for run in found if run.uncertain]
    drawn = {
        "knees": figures.knees(found),
        "cycle": figures.over_cycle(found, cyclic) if cyclic else [],
        "time": figures.over_time(found),
        "uncertain": figures.uncertainty(found),
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
    page = environment.get_template(TEMPLATE).render(
        title=f"Knee contact: {', '.join(run.name for run in bases)}",
        lead=lead(bases),
        loads="; ".join(dict.fromkeys(loads)),
        version=__version__,
        found=found,
        first=first_table(found),
        differences=what_differs(found),
        drawn=drawn,
        overview=_side_by_side([list(summary(run).items()) for run in found], found),
        cycles=_side_by_side([cycle_summary(run) for run in cyclic], cyclic),
        still=bool(cyclic) and not figures.moves(cyclic),
        uncertain=[
            (run, each, of) for (run, of), each in zip(known, drawn["uncertain"], strict=True)
        ],
        runs=[
            (run, runs.between([run.parameters, Parameters()], " instead of ")) for run in found
        ],
    )
    pictures = {
        f"{figure.name}.png": figure.png for several in drawn.values() for figure in several
    }
    return {PAGE: page, **tables(found), **pictures}


def lead(bases: Sequence[Run]) -> str:
    """Summarise the page in a sentence; ticks and cycles that both compartments of a knee share count once."""
    knees = [run.gathered for run in bases if not is_lateral(run.topic)]
    cycles, files = sum(len(of.spans) for of in knees), len({run.source for run in bases})
    return (
        f"Tibiofemoral contact in {files} recording{'s' * (files != 1)}: {sum(of.ticks for of in knees)} ticks, "
        f"{cycles} whole gait cycle{'s' * (cycles != 1)}."
    )


def what_differs(found: Sequence[Run]) -> list[str]:
    """List the parameters that differ, a line each: in comparisons, and between the recordings."""
    changes = {}
    for run, base in ((run, found[run.beside]) for run in found if run.beside is not None):
        lines = runs.between([base.parameters if base.known else None, run.parameters], " → ")
        changes[run.name] = lines or ["the comparison changes nothing"]
    if len(set(map(tuple, changes.values()))) == 1:
        lines = list(next(iter(changes.values())))
    else:
        lines = [f"{name}: {line}" for name, several in changes.items() for line in several]
    return lines + runs.between(
        [run.parameters for run in found if run.beside is None and run.known]
    )


def first_table(found: Sequence[Run]) -> Table:
    """Compare each run's largest values, as `solve` prints them, and the means of its peaks of stance."""
    kinds = [
        which
        for which in (FIRST, SECOND)
        if any((run.gathered.peaks["peak"] == which).any() for run in found)
    ]
    columns, notes = [], ["Largest: anywhere in the recording."]
    notes += (
        ["First and second peak: of the stances in whole gait cycles, mean ± standard deviation."]
        if kinds
        else []
    )
    for run in found:
        of, cells = run.gathered, []
        for column, name, digits in QUANTITIES:
            values = of.columns[CURVES[column].field]
            at = int(np.argmax(values))
            mark = DOUBTFUL * bool(int(of.columns["status"][at]) & Status.IMPLAUSIBLE)
            value = f"{CURVES[column].scaled(values[at], run.weight):{digits}}{mark}"
            cells.append(
                (f"largest {name}", NONE if column == "load_BW" and run.prescribed else value)
            )
        for which in kinds:
            group = of.peaks[of.peaks["peak"] == which]
            mark = DOUBTFUL * bool((group["status"].to_numpy(int) & Status.IMPLAUSIBLE).any())
            cells += [
                (f"{which} peak: {name}", _spread(group[column], digits) + mark)
                for column, name, digits in QUANTITIES
            ]
        columns.append(cells)
        stamp, what = int(of.columns["stamp"][of.largest]), of.driving.replace("_", " ")
        if (
            run.beside is None
            and kinds
            and not any(span.start <= stamp < span.end for span in of.spans)
        ):
            where = f"{run.label}, at {stamp / NANOSECONDS:.3f} s,"
            notes.append(f"The largest {what} of {where} is not within a whole gait cycle.")
    return _side_by_side(columns, found, " ".join(notes))


def cycle_summary(run: Run) -> list[tuple[str, str]]:
    """Rows of the table of cycles by name: mean and spread of the characteristic values."""
    weight, strides = run.weight, run.gathered.strides
    rows = [("cycles", str(len(strides)))]
    for name, key, digits in CYCLE_ROWS:
        own = strides[key][: 0 if name.startswith("bone") and not run.has_bone else None]
        rows.append((name, _spread(own / (weight if "[BW" in name else 1.0), digits)))
    return rows


def summary(run: Run) -> dict[str, str]:
    """Rows of the table on the whole run and its accuracy, by name."""
    of, bits = run.gathered, Counter[str]()
    stamps, state, status = of.columns["stamp"], of.columns["contact_state"], of.columns["status"]
    apart, missing, time = (
        state == ContactState.SEPARATED,
        of.strikes - len(of.spans),
        float(of.seconds.sum()),
    )
    left_out = (
        f" ({missing} more between heel strikes left out: too long, too short, or not one toe-off)"
    )
    bits.update(
        {bit.name or "": n for bit in Status if (n := int(np.count_nonzero(status & bit)))}
    )
    otherwise = int(np.count_nonzero(status & ~int(Status.NOT_CONVERGED)))

    def told(which: Any) -> str:
        """Time of some ticks, and its fraction of the whole."""
        part = float(of.seconds[which].sum())
        return f"{part:.3f} s ({100.0 * part / (time or 1.0):.1f} %)"

    return {
        "file": run.source.name + ("" if run.topic == "/knee_contact" else f" {run.topic}"),
        "load": figures.which_load(run.parameters),
        "from … to [s]": f"{stamps[0] / NANOSECONDS:.3f} … {stamps[-1] / NANOSECONDS:.3f}",
        "ticks": f"{of.ticks} in {time:.2f} s ({f'{(of.ticks - 1) / time:.0f} Hz' if time else 'one tick'})",
        "gait cycles": f"{len(of.spans)}{left_out if missing > 0 else ''}",
        "pressure": figures.pressure_of(run),
        "in bone contact": told(state == ContactState.BONE)
        if run.has_bone
        else "the contact law has one layer",
        "lifted off": told(apart),
        "error bound of the depth": _bounds(MICRO * of.columns["error_estimate"], "µm", MICRO),
        "error bound of the contact force": _bounds(
            of.columns["force_error_estimate"], "N", math.inf
        ),
        "ticks not converged": str(bits.pop("NOT_CONVERGED", 0)),
        "ticks flagged otherwise": f"{otherwise}{_counted(bits)}",
        "samples refused": f"{sum(run.refused.values())}{_counted(run.refused)}",
        "contact law evaluations": f"{of.columns['evaluations'].mean():.1f} a tick",
    }


def _counted(counts: Mapping[str, int]) -> str:
    """Numbers with their reasons, in brackets."""
    return (
        f" ({', '.join(f'{count} × {name}' for name, count in counts.items())})" if counts else ""
    )


def contribution_table(run: Run, of: Propagated) -> Table:
    """Table with the effect of each input's standard deviation, of all together, and the numerical error."""
    rows = [
        (name, deviation, *(f"{number:.3g}" for number in numbers[:3]))
        for name, deviation, *numbers in contributions(run, of)
    ]
    at, where = int(of.rows[run.gathered.driving].argmax()), run.gathered.driving.replace("_", " ")
    low, high = (MM * edge[at] for edge in of.depth_interval())
    least, most = (edge[at] for edge in of.force_interval())
    note = (
        f"At the largest {where}, with sign: what one standard deviation more does; together the depth lies between "
        f"{low:.3f} and {high:.3f} mm, and the contact force between {least:.0f} and {most:.0f} N ({LEVEL:.0%}). "
        "RMS: over all ticks."
    )
    return Table(("input", "± SD", "depth [µm]", "force [N]", "RMS [µm]"), rows, note)


def contributions(run: Run, of: Propagated) -> Iterator[tuple[Any, ...]]:
    """Effects of each input's standard deviation, of all together, and the numerical error.

    Each item has a name, the standard deviation as text, the effects on depth [µm] and force [N] at the largest load
    (or contact force) with their signs, and the RMS of these effects over all ticks, in the same units.
    """
    at = int(of.rows[run.gathered.driving].argmax())
    effects = [(deviation.name, deviation.text, *part) for deviation, part in of.parts.items()]
    effects.append((figures.ALL_OF_THEM, "", of.depth, of.force))
    effects.append(
        (figures.NUMERICAL, "", of.rows["error_estimate"], of.rows["force_error_estimate"])
    )
    for name, deviation, depth, force in effects:
        rms = [float(np.sqrt(np.mean(np.square(each)))) for each in (depth, force)]
        yield name, deviation, MICRO * float(depth[at]), float(force[at]), MICRO * rms[0], rms[1]


def tables(found: Sequence[Run]) -> dict[str, str]:
    """Contents of the report's CSV files by file name: floats with nine significant digits, NaN as an empty cell."""
    several = {
        "cycles.csv": [curves_of(run) for run in found],
        "events.csv": [run.gathered.events[[*runs.EVENT_COLUMNS]] for run in found],
        "peaks.csv": [run.gathered.peaks[[*runs.PEAK_COLUMNS]] for run in found],
        "strides.csv": [run.gathered.strides for run in found],
    }
    if any(run.uncertain for run in found):
        several[UNCERTAINTY] = [
            pd.DataFrame(
                contributions(run, run.uncertain) if run.uncertain else [],
                columns=[*UNCERTAINTY_COLUMNS],
            )
            for run in found
        ]
    files = {}
    for name, parts in several.items():
        for run, rows in zip(found, parts, strict=True):
            rows.insert(0, "run", run.label)
        joined = pd.concat([rows for rows in parts if len(rows)] or parts[:1])
        files[name] = joined.to_csv(index=False, float_format="%.9g", lineterminator="\n")
    return files


def curves_of(run: Run) -> pd.DataFrame:
    """Return the columns of cycles.csv: mean and (for several cycles) standard deviation at every percent."""
    columns = {"gait_cycle_percent": PERCENT.astype(int), "cycles": len(run.gathered.spans)}
    for name, quantity in CURVES.items():
        curves = pd.DataFrame(quantity.scaled(run.gathered.curves[quantity.field], run.weight))
        columns |= {
            f"{name}_mean": curves.mean(skipna=False),
            f"{name}_sd": curves.std(skipna=False),
        }
    return pd.DataFrame(columns)[: None if run.gathered.spans else 0]


def _side_by_side(
    columns: Sequence[Sequence[tuple[str, str]]], found: Sequence[Run], note: str = ""
) -> Table:
    """Make a table with a row for each quantity (name and text) that some run has, and a column for each run."""
    rows = [
        (several[0][0], *(text for _, text in several)) for several in zip(*columns, strict=True)
    ]
    return Table(
        ("", *(run.label for run in found)), [row for row in rows if {*row[1:]} != {NONE}], note
    )


def _spread(values: pd.Series[float], digits: str) -> str:
    """Mean and sample standard deviation of some values in a number format; a dash where one is not finite."""
    if not len(values) or not np.isfinite(values).all():
        return NONE
    mean = f"{values.mean():{digits}}"
    return mean if len(values) == 1 else f"{mean} ± {values.std():{digits}}"


def _bounds(errors: Any, unit: str, most: float) -> str:
    """Text of the largest and the median error bound; NaN, or `most` and more, means no bound."""
    if np.isnan(errors).all():
        return "not in this recording"
    bounds = np.nan_to_num(errors, nan=math.inf)
    largest, median = (
        f"{each:.2g} {unit}" if each < most else "no bound"
        for each in (bounds.max(), np.median(bounds))
    )
    return f"{largest} at most, {median} median"
