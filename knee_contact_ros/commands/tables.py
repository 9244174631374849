"""The tables that `solve`, `demo`, `estimate-load` and `recover` print."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from knee_contact_ros.bags.recover import Recovery
from knee_contact_ros.model.types import MM, Status
from knee_contact_ros.offline.estimate_load import LoadSummary
from knee_contact_ros.offline.summary import Moment, Summary
from knee_contact_ros.parameters.load_schema import LoadParameters
from knee_contact_ros.results import begin_of, stamp_text
from knee_contact_ros.streams.topics import LATERAL, MEDIAL, NANOSECONDS
from knee_contact_ros.system.terminal import (
    UNBOUNDED,
    WIDTH,
    safe_cell,
    say,
    show_pairs,
    show_table,
)

MOST_PEAKS = 12
"""Largest number of load peaks that have a row each"""
DOUBTFUL = " !"
"""Mark of a row with values of a tick that is `IMPLAUSIBLE`"""
ONE_MOMENT = 100_000_000
"""Time [ns] within which the largest load, force and depth belong to one peak"""
MICROMETRE = 1e6


def show_summary(summary: Summary, live: Mapping[str, str], files: Mapping[str, str]) -> None:
    """Print the peaks, the figures of the run with further rows `live`, and the names and places of the `files`."""
    console = Console(width=WIDTH, emoji=False)
    for name, compartment in compartments(summary):
        if name:
            console.print(f"{name} compartment")
        console.print(peak_table(compartment))
    begin = begin_of(summary.first_stamp)
    since = f" from {begin / NANOSECONDS:.3f} s on" if begin else ""
    runs = f" in {summary.runs} runs" if summary.runs > 1 else ""
    figures = [("ticks", f"{summary.ticks} over {summary.duration:.2f} s{since}{runs}")]
    if len(summary.load_peaks) > MOST_PEAKS:
        figures.append(("peaks", f"{len(summary.load_peaks)} of the load"))
    figures += [(name, safe_cell(value)) for name, value in live.items()]
    if summary.split:
        figures.append(("share of the load", summary.split.text))
    figures.append(("samples refused", counts(summary.refused)))
    for name, each in compartments(summary):
        of = f"{name}: " if name else ""
        depth = error_text(each.largest_error * MICROMETRE, "um")
        errors = f"{depth} of depth at most, {error_text(each.largest_force_error, 'N')} of force"
        figures += [
            ("ticks flagged", of + counts(each.flagged, each.ticks_flagged)),
            ("error estimate", of + errors),
            ("levels", of + _shares(each.levels)),
            (
                "cost",
                f"{of}{each.evaluations / max(each.ticks, 1):.1f} contact law evaluations per tick",
            ),
        ]
    show_pairs([*figures, *(("warning", safe_cell(sentence)) for sentence in summary.sentences)])
    console.print()
    for name, path in files.items():
        say(f"{name}: {path}")


def compartments(summary: Summary) -> list[tuple[str, Summary]]:
    """Return the name and the summary of each compartment; the name is empty if there is only one."""
    return [(MEDIAL, summary), (LATERAL, summary.lateral)] if summary.lateral else [("", summary)]


def error_text(error: float, unit: str) -> str:
    """Return an estimated error as text, with its unit."""
    return f"{error:.2g} {unit}" if math.isfinite(error) else "no bound"


def peak_table(summary: Summary) -> Table:
    """Make the table of the load peaks (or of their mean if there are many) and the largest values, in N, BW and mm.

    Stamps that are dates are given as the time since the first one: seconds since 1970 are too long to be read.
    """
    begin = begin_of(summary.first_stamp)
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("", no_wrap=True)
    headings = ["load [N]", "[BW]", "contact force [N]", "[BW]", "depth [mm]", "at [s]"] + [
        "run"
    ] * (summary.runs > 1)
    for heading in headings:
        table.add_column(escape(heading), justify="right", no_wrap=True)

    def moment(peak: Moment) -> tuple[str, ...]:
        return stamp_text(peak.stamp, begin), *([str(peak.run)] if summary.runs > 1 else [])

    def forces(load: float, force: float, depth: float) -> tuple[str, ...]:
        weight = summary.body_weight
        return (
            f"{load:.1f}",
            f"{load / weight:.2f}",
            f"{force:.1f}",
            f"{force / weight:.2f}",
            f"{depth * MM:.3f}",
        )

    peaks = summary.load_peaks
    if len(peaks) > MOST_PEAKS:
        _, *means, _, _ = np.mean(peaks, axis=0)
        doubtful = any(peak.status & Status.IMPLAUSIBLE for peak in peaks)
        table.add_row("mean peak" + DOUBTFUL * doubtful, *forces(*means), "")
        peaks = []
    for number, peak in enumerate(peaks, start=1):
        values = forces(peak.load, peak.contact_force, peak.penetration_depth)
        name = f"peak {number}" + DOUBTFUL * bool(peak.status & Status.IMPLAUSIBLE)
        table.add_row(name, *values, *moment(peak))
    load, force, depth = (
        summary.peaks[name] for name in ("load", "contact_force", "penetration_depth")
    )
    largest = forces(load.load, force.contact_force, depth.penetration_depth)
    stamps, one_run = (load.stamp, force.stamp, depth.stamp), load.run == force.run == depth.run
    when = moment(depth) if one_run and max(stamps) - min(stamps) <= ONE_MOMENT else ("",)
    doubtful = bool((load.status | force.status | depth.status) & Status.IMPLAUSIBLE)
    table.add_row("largest" + DOUBTFUL * doubtful, *largest, *when)
    if summary.flagged["IMPLAUSIBLE"]:
        table.caption, table.caption_justify = "! from an answer that is IMPLAUSIBLE", "left"
    if Console(width=UNBOUNDED).measure(table).maximum > WIDTH:  # large forces, hours
        table.collapse_padding = True
    return table


def counts(counter: Mapping[str, int], total: int | None = None) -> str:
    """Return the total of a counter as text, with the count of each name in brackets; `total` where names overlap."""
    reasons = ", ".join(f"{count} x {name}" for name, count in counter.items())
    return f"{sum(counter.values()) if total is None else total}" + (
        f" ({reasons})" if reasons else ""
    )


def _shares(levels: Mapping[str, int]) -> str:
    """Return the share of each level in percent, as text."""
    whole = max(sum(levels.values()), 1)
    return ", ".join(
        f"{name} {100.0 * count / whole:.1f} %" for name, count in sorted(levels.items())
    )


NOT_CALIBRATED = "not calibrated to this person: for looking, not for gating anything"


def show_load(
    summary: LoadSummary, parameters: LoadParameters, rows: Mapping[str, str], output: str
) -> None:
    """Print the peak of the joint reaction with its parts and standard deviation, its mean, and figures of the run."""
    peak, stamps, weight = summary.peak, summary.stamps, parameters.person.constants.weight
    parts = {
        "largest joint reaction": peak.axial_force,
        "  without muscles": peak.resultant_force,
        "  quadriceps": peak.quadriceps_force,
        "  hamstrings": peak.hamstrings_force,
        "  gastrocnemius": peak.gastrocnemius_force,
        "standard deviation": peak.standard_deviation,
        "mean joint reaction": float(summary.axial.mean()),
    }
    cells = [(name, f"{force:.1f}", f"{force / weight:.2f}") for name, force in parts.items()]
    show_table(("", "[N]", "[BW]"), cells, right=["[N]", "[BW]"])
    show_pairs(
        [
            ("estimates", f"{len(stamps)} over {(stamps[-1] - stamps[0]) / NANOSECONDS:.2f} s"),
            ("level", summary.level),
            (
                "constants",
                "fitted to this person's knee" if summary.calibrated else NOT_CALIBRATED,
            ),
            *((name, safe_cell(value)) for name, value in rows.items()),
            ("samples refused", counts(summary.refused)),
            (
                "estimates flagged",
                counts(summary.flagged, int(np.count_nonzero(summary.estimates["status"]))),
            ),
        ]
    )
    say("")
    say(f"Bag: {output}")


MOST_FAULTS = 20
"""Largest number of faults that are printed"""


def show_recovery(recovery: Recovery, output: str) -> None:
    """Print the recovered and the missing messages of each topic, the faults, and the output file."""
    rows = [
        (
            f"{safe_cell(topic)}\n  {safe_cell(kind)}",
            str(count),
            "unknown" if missing is None else str(missing),
        )
        for topic, kind, count, missing in recovery.topics
    ]
    show_table(("topic, and its type", "messages", "missing"), rows, right=("messages", "missing"))
    lines = [f"{recovery.unread} of {recovery.size} bytes could not be read"]
    first, last = recovery.times
    lines.insert(0, f"from {first / NANOSECONDS:.3f} s to {last / NANOSECONDS:.3f} s")
    lines += [f"- {fault}" for fault in recovery.faults[:MOST_FAULTS]]
    if len(recovery.faults) > MOST_FAULTS:
        lines.append(
            f"- and {len(recovery.faults) - MOST_FAULTS} more, all in the file's metadata"
        )
    for line in [*lines, f"Recovered: {output}"]:
        say(line)
