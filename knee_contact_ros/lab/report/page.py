"""`knee-contact report`: the page with its tables, the CSV files behind it, and how all files are written."""

from __future__ import annotations

import base64
import csv
import io
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from knee_contact_ros import __version__
from knee_contact_ros.bags.provenance import NOT_OF_THE_RESULT
from knee_contact_ros.lab.report import figures, runs
from knee_contact_ros.lab.report.runs import CURVES, LARGEST, MEGA, MM, NONE, PERCENT, Moment, Run
from knee_contact_ros.lab.uncertainty import LEVEL, Propagated, factor
from knee_contact_ros.model.types import Status
from knee_contact_ros.parameters.files import flat_parameters, known_parameters
from knee_contact_ros.parameters.schema import constants_of
from knee_contact_ros.streams.topics import NANOSECONDS, is_lateral
from knee_contact_ros.system.errors import IncompleteError, UsageError, in_a_line
from knee_contact_ros.system.files import how_to_get, require
from knee_contact_ros.system.output_files import replace, work_folder
from knee_contact_ros.system.terminal import progress, warn

OLDEST = (3, 7)
"""Oldest version of matplotlib that puts legends outside of axes; Ubuntu 24.04 has 3.6"""
EXTRA, PAGE, TEMPLATE, UNCERTAINTY = "report", "report.html", "report.html.jinja", "uncertainty.csv"
PICTURES = (
    "knee_[0-9]*", "flexion", "contact_force", "depth", "peak_pressure", "patch_half_width", "contact_point",
    "contact_point_flexion", "over_time_[0-9]*", "uncertainty_[0-9]*",
)  # fmt: skip
"""Patterns of the names of the pictures, without their suffix"""
EARLIER = (*(f"{name}.png" for name in PICTURES), UNCERTAINTY)
"""Patterns of the files of an earlier report that are removed"""
DOUBTFUL = " (implausible)"
"""Mark of what comes from a tick that is `IMPLAUSIBLE`"""
SHOWN = 12
"""Number of peaks of a run whose intervals the page lists"""
MICRO = 1e6
CURVE_COLUMNS = {
    "flexion_angle_deg": ("flexion_angle", math.degrees(1.0)), "load_N": ("load", 1.0), "load_BW": ("load", None),
    "contact_force_N": ("contact_force", 1.0), "contact_force_BW": ("contact_force", None),
    "penetration_depth_mm": ("penetration_depth", MM), "bone_depth_mm": ("bone_depth", MM),
    "contact_point_x_mm": ("contact_point_x", MM), "sliding_velocity_mm_per_s": ("sliding_velocity", MM),
    "patch_half_width_mm": ("half_width", MM), "mean_pressure_MPa": ("mean_pressure", MEGA),
    "peak_pressure_MPa": ("peak_pressure", MEGA), "cartilage_strain_percent": ("strain", 100.0),
}  # fmt: skip
"""Name of a quantity in cycles.csv → field of the answers and factor from SI units; None: in body weights"""
CONTACT_COLUMNS = ("load_N", "load_BW", "contact_force_N", "contact_force_BW", "penetration_depth_mm")
EVENT_COLUMNS = ("run", "event", "stamp_s", "time_s", *CONTACT_COLUMNS, "text")
PEAK_COLUMNS = ("run", "peak", "stamp_s", "time_s", "cycle", "gait_cycle_percent", *CONTACT_COLUMNS,
                "contact_force_error_N", "penetration_depth_error_mm")  # fmt: skip
STRIDE_COLUMNS = ("run", "cycle", "heel_strike_s", *runs.NUMBERS)
# "at_largest_load": where the femoral height drives, at the largest contact force
UNCERTAINTY_COLUMNS = ("run", "input", "standard_deviation", "depth_at_largest_load_um", "force_at_largest_load_N",
                       "depth_rms_um", "force_rms_N")  # fmt: skip
QUANTITIES = (("load", "load [BW]", ".2f"), ("contact_force", "contact force [BW]", ".2f"),
              ("penetration_depth", "depth [mm]", ".3f"))  # fmt: skip
"""Fields of a moment that the first table shows, with their names there and the digits"""
CYCLE_ROWS = (
    ("cycle [s]", "duration_s", ".3f"), ("stance [% of the cycle]", "stance_percent", ".1f"),
    ("largest contact force [BW]", "largest_contact_force_N", ".2f"),
    ("… at [% of the cycle]", "force_at_percent", ".1f"),
    ("largest depth [mm]", "largest_penetration_depth_mm", ".3f"), ("… at [% of the cycle]", "depth_at_percent", ".1f"),
    ("impulse of stance [BW s]", "stance_impulse_N_s", ".3f"), ("impulse of stance [N s]", "stance_impulse_N_s", ".1f"),
    ("impulse of the cycle [BW s]", "impulse_N_s", ".3f"), ("impulse of the cycle [N s]", "impulse_N_s", ".1f"),
    ("loading rate [BW/s]", "loading_rate_N_per_s", ".1f"),
    ("largest patch half-width [mm]", "largest_patch_half_width_mm", ".2f"),
    ("largest mean pressure [MPa]", "largest_mean_pressure_MPa", ".2f"),
    ("largest peak pressure [MPa]", "largest_peak_pressure_MPa", ".2f"),
    ("largest nominal strain [%]", "largest_cartilage_strain_percent", ".1f"),
    ("bone contact [s]", "bone_contact_s", ".3f"), ("bone contact [% of the cycle]", "bone_contact_percent", ".1f"),
    ("lifted off [s]", "lifted_off_s", ".3f"), ("sliding distance [mm]", "sliding_distance_mm", ".1f"),
    ("largest sliding velocity [mm/s]", "largest_sliding_velocity_mm_per_s", ".0f"),
)  # fmt: skip
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
        IncompleteError: the report is there, but a bag was damaged and could be taken in part only.
    """
    require(EXTRA, "matplotlib", "jinja2")
    import matplotlib as mpl

    if mpl.__version_info__[:2] < OLDEST:
        raise UsageError(f"matplotlib {mpl.__version__} is too old; {how_to_get(EXTRA)}")
    if options.labels and len(options.labels) != len(options.files):
        raise UsageError(f"--label: {len(options.labels)} given for {len(options.files)} FILEs; give one each, or none")
    with work_folder(output) as work:
        with progress("Reading") as bar:
            found = runs.with_uncertainty(runs.collect(options, work, bar), options, bar)
            bar.describe("Drawing")
            files = contents(found)
        for name, content in files.items():
            (work / name).write_bytes(content if isinstance(content, bytes) else content.encode())
        for pattern in EARLIER:
            for earlier in output.glob(pattern):
                earlier.unlink()
        for name in files:
            replace(work / name, output / name)
    damage = [sentence for run in found if run.beside is None for sentence in run.damage]
    if damage:
        raise IncompleteError(f"{output / PAGE} tells what can be read of a damaged bag: {in_a_line(damage)}")
    kept = sorted({f"{run.name} keeps {', '.join(run.kept)}" for run in found if run.kept})
    warn(f"--compare: {line}" for line in kept)
    return [output / name for name in files]


def contents(found: Sequence[Run]) -> dict[str, str | bytes]:
    """Contents of all files of the report by name, the page first."""
    cyclic = [run for run in found if run.gathered.cycles]
    drawn = {
        "knees": figures.knees(found),
        "cycle": figures.over_cycle(found, cyclic) if cyclic else [],
        "time": figures.over_time(found),
        "uncertain": figures.uncertainty_figures(found),
    }
    pictures = {f"{figure.name}.png": figure.png for several in drawn.values() for figure in several}
    return {PAGE: page(found, drawn), **tables(found), **pictures}


def page(found: Sequence[Run], drawn: Mapping[str, Sequence[figures.Figure]]) -> str:
    """Render the page as HTML text from the runs and their figures."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader(__package__ or "", ""), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        keep_trailing_newline=True,
    )  # fmt: skip
    environment.filters["base64"] = lambda data: base64.b64encode(data).decode("ascii")
    cyclic = [run for run in found if run.gathered.cycles]
    bases = [run for run in found if run.beside is None]
    uncertain = [(run, run.uncertain) for run in found if run.uncertain]
    loads = (figures.which_load(run.parameters) for run in found if not runs.prescribed(run.parameters))
    return environment.get_template(TEMPLATE).render(
        title=f"Knee contact: {', '.join(run.name for run in bases)}",
        lead=lead(found),
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
            (run, figure, interval_table(run, of), contribution_table(run, of))
            for figure, (run, of) in zip(drawn["uncertain"], uncertain, strict=True)
        ],
        runs=[(run, parameter_table(run)) for run in found],
    )


def lead(found: Sequence[Run]) -> str:
    """Summarise the page in a sentence; both compartments of a knee have the same ticks and cycles, counted once."""
    knees = [run for run in found if run.beside is None and not is_lateral(run.topic)]
    cycles = sum(len(run.gathered.cycles) for run in knees)
    files = len({run.source for run in found})
    each = ", each" if files > 1 else ","
    compared = f"{each} computed again with another contact law" if any(run.beside is not None for run in found) else ""
    return (
        f"Tibiofemoral contact in {files} recording{'s' * (files != 1)}{compared}: "
        f"{sum(run.gathered.ticks for run in knees)} ticks, {cycles} whole gait cycle{'s' * (cycles != 1)}."
    )


def what_differs(found: Sequence[Run]) -> list[str]:
    """List the parameters that differ, a line for each: of comparisons, and of the recordings among themselves."""
    changes = {run.name: run.differences for run in found if run.beside is not None}
    if len(set(map(tuple, changes.values()))) == 1:
        lines = list(next(iter(changes.values()))) or ["the comparison changes nothing"]
    else:
        lines = [f"{name}: {line}" for name, several in changes.items() for line in several or ["nothing"]]
    return lines + runs.between([run.parameters for run in found if run.beside is None and run.known])


def first_table(found: Sequence[Run]) -> Table:
    """Compare the largest values of each run, which `solve` prints too, and the means of its peaks of stance."""
    kinds = sorted({peak.which for run in found for peak in run.gathered.peaks} - {""})
    columns, notes, count = [], ["Largest: anywhere in the recording."], 0
    for run in found:
        of, weight, cells = run.gathered, run.parameters.body_weight, []
        units = {"load": 1.0 / weight, "contact_force": 1.0 / weight, "penetration_depth": MM}
        for field, name, digits in QUANTITIES:
            at = int(np.argmax(of.columns[field]))
            mark = DOUBTFUL * bool(int(of.columns["status"][at]) & Status.IMPLAUSIBLE)
            value = f"{units[field] * of.columns[field][at]:{digits}}{mark}"
            driven = field != "load" or not runs.prescribed(run.parameters)
            cells.append((f"largest {name}", value if driven else NONE))
        for which in kinds:
            group = [peak for peak in of.peaks if peak.which == which]
            count, mark = max(count, len(group)), DOUBTFUL * any(peak.implausible for peak in group)
            for field, name, digits in QUANTITIES:
                values = [units[field] * getattr(peak, field) for peak in group]
                cells.append((f"{which} peak: {name}", _spread(values, digits) + mark))
        columns.append(cells)
        if not any(cycle.span.start <= of.largest.event.stamp < cycle.span.end for cycle in of.cycles) and kinds:
            where = f"{of.largest.event.kind} of {run.label}, at {of.largest.event.stamp / NANOSECONDS:.3f} s,"
            notes += [] if run.beside is not None else [f"The {where} lies in no whole gait cycle."]
    several = f", mean ± standard deviation of up to {count}" if count > 1 else ""
    notes[1:1] = [f"First and second peak: of the stances in whole gait cycles{several}."] if kinds else []
    return _side_by_side(columns, found, " ".join(notes))


def cycle_summary(run: Run) -> list[tuple[str, str]]:
    """Names of the rows of the table of cycles, with mean and spread of the characteristic values."""
    weight, rows = run.parameters.body_weight, [("cycles", str(len(run.gathered.cycles)))]
    for name, key, digits in CYCLE_ROWS:
        cycles = run.gathered.cycles if figures.has_bone(run) or not name.startswith("bone") else ()
        values = [cycle.numbers[key] / (weight if "[BW" in name else 1.0) for cycle in cycles]
        rows.append((name, _spread(values, digits)))
    return rows


def summary(run: Run) -> dict[str, str]:
    """Whole run and its accuracy, by the names of the table's rows."""
    of = run.gathered
    stamps = of.columns["stamp"]
    rate = f"{(of.ticks - 1) / of.time:.0f} Hz" if of.time else "one tick"
    missing = of.strikes - len(of.cycles)
    left_out = f" ({missing} more between heel strikes left out: too long, too short, or not one toe-off)"
    longest = f", at most {of.longest_apart:.3f} s at one go" if of.apart_time else ""
    return {
        "file": run.source.name + ("" if run.topic == "/knee_contact" else f" {run.topic}"),
        "load": figures.which_load(run.parameters),
        "from … to [s]": f"{stamps[0] / NANOSECONDS:.3f} … {stamps[-1] / NANOSECONDS:.3f}",
        "ticks": f"{of.ticks} in {of.time:.2f} s ({rate})",
        "gait cycles": f"{len(of.cycles)}{left_out if missing > 0 else ''}",
        "pressure": figures.pressure_of(run),
        "in bone contact": _time(of.bone_time, of.time) if figures.has_bone(run) else "the contact law has one layer",
        "lifted off": _time(of.apart_time, of.time) + longest,
        "error bound of the depth": _bounds(of.columns["error_estimate"], _length),
        "error bound of the contact force": _bounds(of.columns["force_error_estimate"], _newtons),
        "ticks not converged": str(of.flagged["NOT_CONVERGED"]),
        "ticks flagged otherwise": _counts(
            {k: n for k, n in of.flagged.items() if k != "NOT_CONVERGED"}, of.flagged_otherwise
        ),
        "samples refused": _counts(run.refused),
        "levels of the model": ", ".join(f"{k} {100.0 * n / of.ticks:.1f} %" for k, n in sorted(of.levels.items())),
        "contact law evaluations": f"{of.columns['evaluations'].mean():.1f} a tick",
    }


def parameter_table(run: Run) -> Table:
    """List the parameters of a run that matter for its answers, beside their defaults.

    These are all constants that the contact law uses, those that determine the load, and what differs from a default.
    """
    values, contact, load = flat_parameters(run.parameters), run.parameters.contact, run.parameters.load
    shown = {"contact.law", "load.compartment", "body_weight", "femur.geometry", "tibia.geometry"}
    shown |= {
        "contact.femoral_radius",
        "contact.tibial_radius",
        *(f"contact.{name}" for name in constants_of(contact.law)),
    }
    shown |= set() if figures.has_bone(run) else {"contact.foundation_thickness"}
    shown |= {{"measured_share": "load.share_file", "fixed_share": "load.share"}.get(load.rule, "load.compartment")}
    rows = [
        (name, _value(values[name]), "default" if values[name] == default else f"default {_value(default)}", meaning)
        for name, (default, meaning, _) in known_parameters().items()
        if name in values and not name.startswith(NOT_OF_THE_RESULT) and (name in shown or values[name] != default)
    ]
    return Table(("parameter", "value", "", "meaning"), rows)


def contribution_table(run: Run, of: Propagated) -> Table:
    """List the effect of each input's standard deviation, of all together, and the numerical error."""
    head = ("input", "± SD", "depth [µm]", "force [N]", "RMS [µm]")
    rows = [
        (name, deviation, *(f"{number:.3g}" for number in numbers[:3]))
        for name, deviation, *numbers in contributions(run, of)
    ]
    where = LARGEST[run.gathered.of_largest]
    return Table(head, rows, f"At the {where}, with sign: what one standard deviation more does. RMS: over all ticks.")


def contributions(run: Run, of: Propagated) -> Iterator[tuple[Any, ...]]:
    """Effects of each input's standard deviation, of all together, and the numerical error.

    Each item has a name, the standard deviation as text, the effects on depth [µm] and force [N] at the largest load
    (or contact force) with their signs, and the RMS of these effects over all ticks, in the same units.
    """
    at = int(of.rows[run.gathered.of_largest].argmax())
    effects = [(deviation.name, deviation.text, *part) for deviation, part in of.parts.items()]
    effects.append((figures.ALL_OF_THEM, "", of.depth, of.force))
    effects.append((figures.NUMERICAL, "", of.rows["error_estimate"], of.rows["force_error_estimate"]))
    for name, deviation, depth, force in effects:
        rms = [float(np.sqrt(np.mean(np.square(each)))) for each in (depth, force)]
        yield name, deviation, MICRO * float(depth[at]), float(force[at]), MICRO * rms[0], rms[1]


def interval_table(run: Run, of: Propagated) -> Table:
    """List force and depth with their intervals at the first peaks of stance, or else at the largest load or force."""
    reach, weight, level = factor(LEVEL), run.parameters.body_weight, f"{100.0 * LEVEL:.0f} %"
    largest, rows = run.gathered.largest, []
    for moment in run.gathered.peaks[:SHOWN] or [largest._replace(which=largest.event.kind)]:
        at = int(np.searchsorted(of.rows["stamp"], moment.event.stamp, "right")) - 1
        force, depth = moment.contact_force, MM * moment.penetration_depth
        low, high = (MM * edge[at] for edge in of.depth_interval())
        rows.append((
            moment.which or NONE, f"{moment.event.stamp / NANOSECONDS:.3f}", f"{moment.load:.0f}",
            f"{force:.0f} ± {reach * of.force[at]:.0f}", f"{force / weight:.2f} ± {reach * of.force[at] / weight:.2f}",
            f"{depth:.3f} ± {reach * MM * of.depth[at]:.3f}", f"{low:.3f} … {high:.3f}",
            f"{MICRO * of.rows['error_estimate'][at]:.2g}",
        ))  # fmt: skip
    head = ("peak", "stamp [s]", "load [N]", f"contact force [N] ({level})", f"[BW] ({level})",
            f"depth [mm] ({level})", "from … to [mm]", "numerical [µm]")  # fmt: skip
    return Table(head, rows)


def tables(found: Sequence[Run]) -> dict[str, str]:
    """Contents of the report's CSV files, by file name."""
    statistics = [f"{name}_{kind}" for name in CURVE_COLUMNS for kind in ("mean", "sd")]
    files = {
        "cycles.csv": _csv(("run", "gait_cycle_percent", "cycles", *statistics), curve_rows(found)),
        "events.csv": _csv(EVENT_COLUMNS, (
            (run.label, moment.event.kind, *_when(moment), *_contact(moment, run), moment.event.text)
            for run in found for moment in run.gathered.moments
        )),
        "peaks.csv": _csv(PEAK_COLUMNS, (
            (run.label, peak.which, *_when(peak), None if peak.cycle is None else peak.cycle + 1, peak.percent,
             *_contact(peak, run), peak.force_error, MM * peak.depth_error)
            for run in found for peak in run.gathered.peaks
        )),
        "strides.csv": _csv(STRIDE_COLUMNS, (
            (run.label, number, _seconds(cycle.span.start), *(cycle.numbers[name] for name in runs.NUMBERS))
            for run in found for number, cycle in enumerate(run.gathered.cycles, start=1)
        )),
    }  # fmt: skip
    if any(run.uncertain for run in found):
        files[UNCERTAINTY] = _csv(UNCERTAINTY_COLUMNS, (
            (run.label, *row) for run in found if run.uncertain for row in contributions(run, run.uncertain)
        ))  # fmt: skip
    return files


def curve_rows(found: Sequence[Run]) -> Iterator[tuple[Any, ...]]:
    """Rows of cycles.csv: mean and standard deviation at every percent; a single cycle has no standard deviation."""
    for run in found:
        mean, deviation = run.gathered.mean, run.gathered.deviation
        spread = np.full_like(mean, np.nan) if deviation is None else deviation
        columns = [CURVES.index(field) for field, _ in CURVE_COLUMNS.values()]
        factors = [each or 1.0 / run.parameters.body_weight for _, each in CURVE_COLUMNS.values()]
        both = np.stack([mean[:, columns] * factors, spread[:, columns] * factors], axis=2)
        for percent, values in zip(PERCENT, both.reshape(-1, 2 * len(columns)).tolist(), strict=False):
            yield (run.label, int(percent), len(run.gathered.cycles), *values)


def _csv(columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Write a table as CSV text: floats with nine significant digits, None and NaN as empty cells."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(columns)
    for row in rows:
        writer.writerow([f"{v:.9g}".replace("nan", "") if isinstance(v, float) else v for v in row])
    return file.getvalue()


def _when(moment: Moment) -> tuple[str, float]:
    """Stamp [s] and time since the first tick [s] of a moment."""
    return _seconds(moment.event.stamp), moment.elapsed


def _contact(moment: Moment, run: Run) -> tuple[float, ...]:
    """Values of `CONTACT_COLUMNS` at a moment."""
    load, force, depth = _in_weights(moment, run.parameters.body_weight)
    return moment.load, load, moment.contact_force, force, depth


def _in_weights(moment: Moment, weight: float) -> tuple[float, float, float]:
    """Load [BW], contact force [BW] and depth [mm] at a moment; `weight` is the body's [N]."""
    return moment.load / weight, moment.contact_force / weight, MM * moment.penetration_depth


def _seconds(stamp: int) -> str:
    """Text of a stamp [ns] in seconds, with all its digits."""
    return f"{stamp // NANOSECONDS}.{stamp % NANOSECONDS:09d}"


def _side_by_side(columns: Sequence[Sequence[tuple[str, str]]], found: Sequence[Run], note: str = "") -> Table:
    """Make a table with a row for each quantity (name and text) that some run has, and a column for each run."""
    rows = [(several[0][0], *(text for _, text in several)) for several in zip(*columns, strict=True)]
    return Table(("", *(run.label for run in found)), [row for row in rows if {*row[1:]} != {NONE}], note)


def _spread(values: Any, digits: str) -> str:
    """Mean and sample standard deviation of some values in a number format; a dash where one is not finite."""
    if not len(values) or not np.isfinite(values).all():
        return NONE
    mean = f"{np.mean(values):{digits}}"
    return mean if len(values) == 1 else f"{mean} ± {np.std(values, ddof=1):{digits}}"


def _time(time: float, whole: float) -> str:
    return f"{time:.3f} s ({100.0 * time / whole if whole else 0.0:.1f} %)"


def _bounds(errors: Any, text: Callable[[float], str]) -> str:
    """Text of the largest and the median of estimated errors, one of which that is NaN bounds nothing."""
    if np.isnan(errors).all():
        return "not in this recording"
    bounds = np.nan_to_num(errors, nan=math.inf, posinf=math.inf)
    return f"{text(float(bounds.max()))} at most, {text(float(np.median(bounds)))} median"


def _length(error: float) -> str:
    """Text of an error bound [m]; one of a metre or more bounds nothing."""
    if error >= 1.0:
        return "no bound"
    return f"{MICRO * error:.2g} µm" if error < 1e-3 else f"{MM * error:.2g} mm"


def _newtons(error: float) -> str:
    return f"{error:.2g} N" if math.isfinite(error) else "no bound"


def _counts(counts: Mapping[str, int], total: int | None = None) -> str:
    reasons = ", ".join(f"{count} × {name}" for name, count in counts.items())
    return f"{sum(counts.values()) if total is None else total}" + (f" ({reasons})" if reasons else "")


def _value(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.7g}" if math.isfinite(value) else str(value)
    return str(value) if value != "" else "none"
