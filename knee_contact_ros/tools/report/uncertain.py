"""What the standard deviations of inputs and parameters make of depth and force, beside the numerical error."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from knee_contact_ros.bags.provenance import Provenance
from knee_contact_ros.bags.topic_names import names_in_bag
from knee_contact_ros.messages.ros_types import NANOSECONDS
from knee_contact_ros.messages.topics import KNEE, is_lateral, knee_name
from knee_contact_ros.offline.uncertainty.deviations import deviations_of, read_deviations
from knee_contact_ros.offline.uncertainty.propagation import LEVEL, Propagated, factor, propagated
from knee_contact_ros.offline.uncertainty.replay import given_in
from knee_contact_ros.parameters.lateral import has_both
from knee_contact_ros.parameters.reading import load_parameters
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
"""[s] that is drawn on either side of the largest load, or force"""
LEAST = 1e-3
"""[µm] below which nothing is drawn"""
SHOWN = 12
"""Peaks that are listed"""
# "at_largest_load": where the femoral height drives, at the largest contact force
COLUMNS = ("run", "input", "standard_deviation", "depth_at_largest_load_um", "force_at_largest_load_N", "depth_rms_um",
           "force_rms_N")  # fmt: skip
TOGETHER, NUMERICAL = "all of them together", "numerical error (bound)"
HUES = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#7B3294", "#66C2A5")


def with_uncertainty(runs: Sequence[Run], asked: ReportOptions, say: Callable[[str], Advance]) -> Sequence[Run]:
    """The runs, each with what deviations make of it, if they are asked for; comparisons as they are.

    Raises:
        UsageError: file, names or deviations cannot be used, or a recording's parameters changed while it was made.
    """
    if asked.uncertainty is None:
        return runs
    read, found = read_deviations(asked.uncertainty), []
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
            how = stored(run.source, asked) or load_parameters(list(asked.parameters))
            deviations = deviations_of(read, how.parameters if isinstance(how, Provenance) else how)
            names = names_in_bag((), knee) if knee != KNEE else asked.names
            solving = say(f"Solving {run.source.name}")
            given = given_in(run.source, how, solving, names, replays=2 * len(deviations))
            ours = propagated(given, deviations, say(f"Uncertainty of {run.source.name}"))
            known[run.source, knee] = [by_stamp(one) for one in ours]
        mine = None if run.beside is not None else known[run.source, knee][is_lateral(run.topic)]
        found.append(run._replace(uncertain=mine))
    return found


def by_stamp(of: Propagated) -> Propagated:
    """The same in the order of the stamps, as recordings hold their ticks and as a report counts its time."""
    order = np.argsort(of.rows["stamp"], kind="stable")
    return Propagated(of.rows[order], {one: (depth[order], force[order]) for one, (depth, force) in of.parts.items()})


def contribution_table(run: Run, of: Propagated) -> Table:
    """What each input does alone, and all together, beside the numerical error."""
    head = ("input", "± SD", "depth [µm]", "force [N]", "RMS [µm]")
    rows = [
        (name, told, *(f"{number:.3g}" for number in numbers[:3])) for name, told, *numbers in contributions(run, of)
    ]
    where = LARGEST[run.gathered.of_largest]
    return Table(head, rows, f"At the {where}, with sign: what one standard deviation more does. RMS: over all ticks.")


def contributions(run: Run, of: Propagated) -> Iterator[tuple[Any, ...]]:
    """Name, deviation, and what it does: at the largest load, or force, with its sign, and over all ticks."""
    at = int(of.rows[run.gathered.of_largest].argmax())
    for deviation, (depth, force) in of.parts.items():
        yield deviation.name, deviation.text, MICRO * depth[at], force[at], MICRO * _rms(depth), _rms(force)
    yield TOGETHER, "", MICRO * of.depth[at], of.force[at], MICRO * _rms(of.depth), _rms(of.force)
    depth, force = of.rows["error_estimate"], of.rows["force_error_estimate"]
    yield NUMERICAL, "", MICRO * depth[at], force[at], MICRO * _rms(depth), _rms(force)


def interval_table(run: Run, of: Propagated) -> Table:
    """Force and depth at the first peaks of stance, or at the largest load, with their intervals."""
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
    """For the CSV: every input of every run."""
    for run in runs:
        if run.uncertain:
            for name, told, *numbers in contributions(run, run.uncertain):
                yield (run.label, name, told, *(float(number) for number in numbers))


def uncertainty_figures(runs: Sequence[Run]) -> list[Figure]:
    """A figure for every run that has its uncertainty."""
    found = []
    known = [(run, run.uncertain) for run in runs if run.uncertain]
    for number, (run, of) in enumerate(known, start=1):
        png = draw(SIZE, partial(_panels, of=of, of_largest=run.gathered.of_largest))
        caption = (
            f"Depth and contact force with their {100.0 * LEVEL:.0f} % intervals. Below: what one standard "
            "deviation of each input does to the depth alone, all together, and the bound of the numerical error."
        )
        found.append(Figure(f"uncertainty_{number}", f"Uncertainty: {run.label}", caption, png))
    return found


def _panels(canvas: Any, of: Propagated, of_largest: str) -> None:
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
    below.set(yscale="log", ylabel="of the depth [µm]", xlabel="time since the first tick [s]")
    legend(canvas, below)


def _rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
