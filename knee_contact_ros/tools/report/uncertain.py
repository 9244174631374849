"""Uncertainty of depth and force from standard deviations of inputs and parameters, beside the numerical error."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from knee_contact_ros.bags.provenance import Provenance
from knee_contact_ros.bags.topic_names import names_in_bag
from knee_contact_ros.lab.uncertainty import (
    LEVEL,
    Propagated,
    deviations_of,
    factor,
    given_in,
    propagated,
    read_deviations,
)
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.parameters.schema import has_both
from knee_contact_ros.streams.topics import KNEE, NANOSECONDS, is_lateral, knee_name
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.tools.report.data import Row
from knee_contact_ros.tools.report.figures import MM, Figure, draw, legend
from knee_contact_ros.tools.report.gather import LARGEST
from knee_contact_ros.tools.report.peaks import stance_peaks
from knee_contact_ros.tools.report.runs import Advance, ReportOptions, Run, stored
from knee_contact_ros.tools.report.words import NONE, Table

SIZE = (5.2, 6.4)
MICRO = 1e6
AROUND = 1.0
"""Time [s] that is drawn on either side of the largest load or contact force"""
LEAST = 1e-3
"""Smallest deviation of the depth that is drawn [µm]"""
SHOWN = 12
"""Largest number of peaks that are listed"""
# "at_largest_load": where the femoral height drives, at the largest contact force
COLUMNS = ("run", "input", "standard_deviation", "depth_at_largest_load_um", "force_at_largest_load_N", "depth_rms_um",
           "force_rms_N")  # fmt: skip
TOGETHER, NUMERICAL = "all of them together", "numerical error (bound)"
HUES = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#7B3294", "#66C2A5")


def with_uncertainty(runs: Sequence[Run], options: ReportOptions, say: Callable[[str], Advance]) -> Sequence[Run]:
    """Add the uncertainty to each run, if the options ask for it; comparisons get none.

    Raises:
        UsageError: file, names or deviations cannot be used, or a recording's parameters changed while it was made.
    """
    if options.uncertainty is None:
        return runs
    read, completed = read_deviations(options.uncertainty), []
    known: dict[tuple[Path, str], list[Propagated]] = {}
    for run in runs:
        if is_lateral(run.topic) and not has_both(run.parameters):
            raise UsageError(
                f"recording {run.source} has answers of the lateral compartment and does not tell its parameters; "
                f"load.compartment of --params is {run.parameters.load.compartment}, and must be both"
            )
    for run in runs:
        knee = knee_name(run.topic)
        if run.beside is None and (run.source, knee) not in known:
            known_by = stored(run.source, options) or load_parameters(list(options.parameters))
            deviations = deviations_of(read, known_by.parameters if isinstance(known_by, Provenance) else known_by)
            names = names_in_bag((), knee) if knee != KNEE else options.names
            solving = say(f"Solving {run.source.name}")
            given = given_in(run.source, known_by, solving, names, replays=2 * len(deviations))
            ours = propagated(given, deviations, say(f"Uncertainty of {run.source.name}"))
            known[run.source, knee] = [by_stamp(one) for one in ours]
        mine = None if run.beside is not None else known[run.source, knee][is_lateral(run.topic)]
        completed.append(run._replace(uncertain=mine))
    return completed


def by_stamp(of: Propagated) -> Propagated:
    """Sort by stamps, which is the order of the ticks in recordings and in the rest of the report."""
    order = np.argsort(of.rows["stamp"], kind="stable")
    return Propagated(of.rows[order], {one: (depth[order], force[order]) for one, (depth, force) in of.parts.items()})


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
    for deviation, (depth, force) in of.parts.items():
        yield deviation.name, deviation.text, MICRO * depth[at], force[at], MICRO * _rms(depth), _rms(force)
    yield TOGETHER, "", MICRO * of.depth[at], of.force[at], MICRO * _rms(of.depth), _rms(of.force)
    depth, force = of.rows["error_estimate"], of.rows["force_error_estimate"]
    yield NUMERICAL, "", MICRO * depth[at], force[at], MICRO * _rms(depth), _rms(force)


def interval_table(run: Run, of: Propagated) -> Table:
    """List force and depth with their intervals at the first peaks of stance, or else at the largest load or force."""
    reach, weight = factor(LEVEL), run.parameters.body_weight
    peaks = [(peak.which or NONE, peak.moment) for peak in stance_peaks(run.gathered)[:SHOWN]]
    if not peaks and run.gathered.largest:
        peaks = [(run.gathered.largest.event.kind, run.gathered.largest)]
    level = f"{100.0 * LEVEL:.0f} %"
    rows = []
    for which, moment in peaks:
        at = int(np.searchsorted(of.rows["stamp"], moment.event.stamp, "right")) - 1
        force, depth = moment.contact_force, MM * moment.penetration_depth
        low, high = (MM * edge[at] for edge in of.depth_interval())
        rows.append((
            which, f"{moment.event.stamp / NANOSECONDS:.3f}", f"{moment.load:.0f}",
            f"{force:.0f} ± {reach * of.force[at]:.0f}", f"{force / weight:.2f} ± {reach * of.force[at] / weight:.2f}",
            f"{depth:.3f} ± {reach * MM * of.depth[at]:.3f}", f"{low:.3f} … {high:.3f}",
            f"{MICRO * of.rows['error_estimate'][at]:.2g}",
        ))  # fmt: skip
    head = ("peak", "stamp [s]", "load [N]", f"contact force [N] ({level})", f"[BW] ({level})",
            f"depth [mm] ({level})", "from … to [mm]", "numerical [µm]")  # fmt: skip
    return Table(head, rows)


def uncertainty_rows(runs: Sequence[Run]) -> Iterator[Row]:
    """Rows of uncertainty.csv: the effects of every input of every run that has its uncertainty."""
    for run in runs:
        if run.uncertain:
            for name, deviation, *numbers in contributions(run, run.uncertain):
                yield (run.label, name, deviation, *(float(number) for number in numbers))


def uncertainty_figures(runs: Sequence[Run]) -> list[Figure]:
    """Draw a figure for every run that has its uncertainty."""
    figures = []
    known = [(run, run.uncertain) for run in runs if run.uncertain]
    for number, (run, of) in enumerate(known, start=1):
        png = draw(SIZE, partial(_panels, of=of, of_largest=run.gathered.of_largest))
        caption = (
            f"Depth and contact force with their {100.0 * LEVEL:.0f} % intervals. Below: what one standard "
            "deviation of each input does to the depth alone, all together, and the bound of the numerical error."
        )
        figures.append(Figure(f"uncertainty_{number}", f"Uncertainty: {run.label}", caption, png))
    return figures


def _panels(canvas: Any, of: Propagated, of_largest: str) -> None:
    """Draw depth, force and the effects of the inputs around the tick where the column `of_largest` is largest."""
    stamps = of.rows["stamp"]
    since = (stamps - stamps[0]) / NANOSECONDS
    at = since[int(of.rows[of_largest].argmax())]
    shown = (since >= at - AROUND) & (since <= at + AROUND)
    time = since[shown]
    above, middle, below = canvas.subplots(3, 1, sharex=True)
    bands = ((above, of.depth_interval(), MM * of.rows["penetration_depth"], MM, "depth [mm]"),
             (middle, of.force_interval(), of.rows["contact_force"], 1.0, "contact force [N]"))  # fmt: skip
    for axis, edges, values, unit, text in bands:
        low, high = (unit * edge[shown] for edge in edges)
        axis.fill_between(time, low, high, color=HUES[0], alpha=0.25, linewidth=0)
        axis.plot(time, values[shown], color=HUES[0], linewidth=1.8)
        axis.set_ylabel(text)
        axis.set_ylim(bottom=min(0.0, float(low.min())))
    for number, (deviation, (part, _)) in enumerate(of.parts.items()):
        micro = MICRO * np.abs(part[shown])
        if micro.max() > LEAST:
            hue, style = HUES[number % len(HUES)], "-" if number < len(HUES) else "--"
            below.plot(time, np.maximum(micro, LEAST), style, color=hue, linewidth=1.4,
                       label=f"{deviation.name}, {deviation.text}")  # fmt: skip
    whole = np.maximum(MICRO * of.depth[shown], LEAST)
    below.plot(time, whole, color="black", linewidth=3.0, zorder=1.5, label=TOGETHER)  # behind what makes most of it
    numerical = np.maximum(MICRO * of.rows["error_estimate"][shown], LEAST)
    below.plot(time, numerical, ":", color="0.35", linewidth=1.6, label=NUMERICAL)
    below.set(yscale="log", ylabel="effect on the depth [µm]", xlabel="time since the first tick [s]")
    legend(canvas, below)


def _rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
