"""The tables that `solve`, `demo`, `estimate-load` and `recover` print."""

import math
from collections.abc import Mapping, Sequence
from functools import reduce
from operator import or_
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from ..bags.recover import Recovery
from ..model.types import MM, Status
from ..offline.estimate_load import LoadSummary
from ..offline.summary import Moment, Summary
from ..parameters.load_schema import LoadParameters
from ..results import begin_of, stamp_text
from ..streams.topics import LATERAL, MEDIAL, NANOSECONDS
from ..system.terminal import (
    UNBOUNDED,
    VERBOSE,
    WIDTH,
    as_json,
    is_set,
    print_json,
    safe_cell,
    say,
    show_pairs,
    show_table,
)

_MAX_PEAKS = 12
"""Largest number of load peaks that have a row each"""
_MAX_FAULTS = 20
"""Largest number of faults that are printed"""
_DOUBTFUL_MARK = " !"
"""Mark of a row with values of a tick that is `IMPLAUSIBLE`"""
_ONE_PEAK = 100_000_000
"""Time [ns] within which the largest load, force and depth belong to one peak"""
_MICROMETRES = 1e6
_NOT_CALIBRATED = (
    "not calibrated to this person: for looking, nothing may be limited or triggered by it"
)


def show_summary(summary: Summary, live: Mapping[str, str], files: Mapping[str, str]) -> None:
    """Print the peaks, the figures of the run with further rows `live`, and the names and places of the `files`."""
    if as_json():
        print_json(**_figures(summary), warnings=summary.sentences, about=live, files=files)
        return
    console = Console(width=WIDTH, emoji=False)
    for name, compartment in _compartments(summary):
        if name:
            console.print(f"{name} compartment")
        console.print(_peak_table(compartment))
    begin = begin_of(summary.first_stamp)
    since = f" from {begin / NANOSECONDS:.3f} s on" if begin else ""
    runs = f" in {summary.runs} runs" if summary.runs > 1 else ""
    figures = [("answers", f"{summary.ticks} in {summary.duration:.2f} s{since}{runs}")]
    if len(summary.load_peaks) > _MAX_PEAKS:
        figures.append(("peaks", f"{len(summary.load_peaks)} of the load"))
    figures += [(name, safe_cell(value)) for name, value in live.items()]
    if summary.split:
        figures.append(("share of the load", summary.split.text))
    verbose = is_set(VERBOSE)
    if summary.refused or verbose:
        figures.append(("samples refused", count_text(summary.refused)))
    for name, each in _compartments(summary):
        prefix = f"{name}: " if name else ""
        depth = _error_text(each.largest_error * _MICROMETRES, "µm")
        force = _error_text(each.largest_force_error, "N")
        cost = f"{each.evaluations / max(each.ticks, 1):.1f} contact law evaluations per tick"
        figures += [
            ("answers flagged", prefix + count_text(each.flagged, each.ticks_flagged)),
            ("numerical error", f"{prefix}at most {depth} of depth, {force} of force"),
        ]
        if verbose:
            figures += [("levels", prefix + _shares(each.levels)), ("cost", prefix + cost)]
    figures += [("warning", safe_cell(sentence)) for sentence in summary.sentences]
    show_pairs(figures)
    console.print()
    for name, path in files.items():
        say(f"{name}: {path}")


def _figures(summary: Summary) -> dict[str, Any]:
    """Return all figures of a summary by name, those of the lateral compartment within."""
    figures = vars(summary)
    if summary.lateral:
        figures = figures | {"lateral": _figures(summary.lateral)}
    return {name: value for name, value in figures.items() if name[0] != "_" and name != "doubts"}


def _compartments(summary: Summary) -> list[tuple[str, Summary]]:
    """Return the name and the summary of each compartment; the name is empty if there is only one."""
    return [(MEDIAL, summary), (LATERAL, summary.lateral)] if summary.lateral else [("", summary)]


def _error_text(error: float, unit: str) -> str:
    """Return an estimated error as text, with its unit."""
    return f"{error:.2g} {unit}" if math.isfinite(error) else "no bound"


def _peak_table(summary: Summary) -> Table:
    """Make the table of the load peaks (or of their mean if there are many) and the largest values, in N, BW and mm.

    Stamps that are dates are given as the time since the first one: seconds since 1970 are too long to be read.
    """
    weight = summary.body_weight
    begin = begin_of(summary.first_stamp)
    several_runs = summary.runs > 1
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("", no_wrap=True)
    headings = ["load [N]", "[BW]", "contact force [N]", "[BW]", "depth [mm]", "at [s]"]
    if several_runs:
        headings.append("run")
    for heading in headings:
        table.add_column(escape(heading), justify="right", no_wrap=True)

    def add_row(name: str, doubtful: int, values: Sequence[float], moment: Moment | None) -> None:
        load, force, depth = values
        mark = _DOUBTFUL_MARK if doubtful & Status.IMPLAUSIBLE else ""
        cells = [f"{load:.1f}", f"{load / weight:.2f}", f"{force:.1f}", f"{force / weight:.2f}"]
        cells.append(f"{MM * depth:.3f}")
        if moment:
            cells.append(stamp_text(moment.stamp, begin))
        if moment and several_runs:
            cells.append(str(moment.run))
        table.add_row(name + mark, *cells)

    peaks = summary.load_peaks
    if len(peaks) > _MAX_PEAKS:
        status = reduce(or_, (peak.status for peak in peaks))
        _, *means, _, _ = np.mean(peaks, axis=0)
        add_row("mean peak", status, means, None)
    else:
        for number, peak in enumerate(peaks, start=1):
            peak_values = peak.load, peak.contact_force, peak.penetration_depth
            add_row(f"peak {number}", peak.status, peak_values, peak)
    fields = "load", "contact_force", "penetration_depth"
    largest = [summary.peaks[field] for field in fields]
    stamps = [moment.stamp for moment in largest]
    one_run = len({moment.run for moment in largest}) == 1
    together = one_run and max(stamps) - min(stamps) <= _ONE_PEAK
    status = reduce(or_, (moment.status for moment in largest))
    values = [getattr(moment, field) for moment, field in zip(largest, fields, strict=True)]
    add_row("largest", status, values, largest[-1] if together else None)
    if summary.flagged["IMPLAUSIBLE"]:
        table.caption = "! from an answer that is IMPLAUSIBLE"
        table.caption_justify = "left"
    # Large forces and hours may need more than the terminal has.
    if Console(width=UNBOUNDED).measure(table).maximum > WIDTH:
        table.collapse_padding = True
    return table


def count_text(counter: Mapping[str, int], total: int | None = None) -> str:
    """Return the total of a counter as text, with the count of each name in brackets; `total` where names overlap."""
    whole = str(sum(counter.values()) if total is None else total)
    reasons = ", ".join(f"{count} x {name}" for name, count in counter.items())
    return f"{whole} ({reasons})" if reasons else whole


def _shares(levels: Mapping[str, int]) -> str:
    """Return the share of each level in percent, as text."""
    whole = max(sum(levels.values()), 1)
    return ", ".join(
        f"{name} {100.0 * count / whole:.1f} %" for name, count in sorted(levels.items())
    )


def show_load(
    summary: LoadSummary, parameters: LoadParameters, rows: Mapping[str, str], output: str
) -> None:
    """Print the peak of the joint reaction with its parts and standard deviation, its mean, and figures of the run."""
    peak = summary.peak
    stamps = summary.stamps
    weight = parameters.person.constants.weight
    constants = "fitted to this person's knee" if summary.calibrated else _NOT_CALIBRATED
    flagged = int(np.count_nonzero(summary.estimates["status"]))
    mean = float(summary.axial.mean())
    if as_json():
        print_json(
            largest=peak,
            mean_axial_force=mean,
            estimates=len(stamps),
            duration=(stamps[-1] - stamps[0]) / NANOSECONDS,
            level=summary.level,
            calibrated=summary.calibrated,
            refused=summary.refused,
            flagged=summary.flagged,
            estimates_flagged=flagged,
            about=rows,
            files={"Bag": output},
        )
        return
    parts = {
        "largest joint reaction": peak.axial_force,
        "by the sensors": peak.sensed_force,
        "  without muscles": peak.resultant_force,
        "  quadriceps": peak.quadriceps_force,
        "  hamstrings": peak.hamstrings_force,
        "  gastrocnemius": peak.gastrocnemius_force,
        "expected in walking": peak.expected_force,
        "standard deviation": peak.standard_deviation,
        "mean joint reaction": mean,
    }
    cells = [
        (name, f"{force:.1f}", f"{force / weight:.2f}")
        for name, force in parts.items()
        if not math.isnan(force)
    ]
    show_table(("", "[N]", "[BW]"), cells, right=["[N]", "[BW]"])
    show_pairs(
        [
            ("estimates", f"{len(stamps)} in {(stamps[-1] - stamps[0]) / NANOSECONDS:.2f} s"),
            ("level", summary.level),
            ("constants", constants),
            *((name, safe_cell(value)) for name, value in rows.items()),
            ("samples refused", count_text(summary.refused)),
            ("estimates flagged", count_text(summary.flagged, flagged)),
        ]
    )
    say("")
    say(f"Bag: {output}")


def show_recovery(recovery: Recovery, output: str) -> None:
    """Print the recovered and the missing messages of each topic, the faults, and the output file."""
    if as_json():
        print_json(**recovery._asdict(), files={"Recovered": output})
        return
    rows = [
        (
            f"{safe_cell(topic)}\n  {safe_cell(kind)}",
            str(count),
            "unknown" if missing is None else str(missing),
        )
        for topic, kind, count, missing in recovery.topics
    ]
    show_table(("topic, and its type", "messages", "missing"), rows, right=("messages", "missing"))
    first, last = recovery.times
    begin = begin_of(first)
    since = f" since {begin / NANOSECONDS:.3f} s" if begin else ""
    say(f"from {stamp_text(first, begin)} s to {stamp_text(last, begin)} s{since}")
    say(f"{recovery.unread_bytes} of {recovery.size} bytes could not be read")
    for fault in recovery.faults[:_MAX_FAULTS]:
        say(f"- {fault}")
    if (others := len(recovery.faults) - _MAX_FAULTS) > 0:
        say(f"- and {others} more, all in the file's metadata")
    say(f"Recovered: {output}")
