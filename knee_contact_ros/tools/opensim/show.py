"""Print the summaries of `knee-contact import-opensim`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from knee_contact_ros.messages.stamps import NANOSECONDS
from knee_contact_ros.offline.gait_files.leg_gait import Leg
from knee_contact_ros.offline.gait_files.storage import Stamps
from knee_contact_ros.pipeline.gait.events import LOAD_PEAK, GaitEvents
from knee_contact_ros.system.terminal import WIDTH, say, shown
from knee_contact_ros.tools.opensim.opensim_pipeline import WORDS, Run
from knee_contact_ros.tools.opensim.opensim_quality import Check
from knee_contact_ros.tools.opensim.opensim_results import Files, KneeGait

USUAL_WEIGHT = 737.068
"""Body weight for the search for peaks where no model is given [N]: the default of `body_weight`"""
SHARE = 0.5
"""Share of the axial load that a compartment has by default (`load.share`)"""


def show_knee(knee: KneeGait, files: Files, bag: Path) -> None:
    """Print a knee's columns, spans, range of the angle, load peaks and notes, and where the bag is."""
    console = Console(width=WIDTH, emoji=False)
    degrees = np.degrees(knee.angles.angle)
    rows = Table(box=None, show_header=False, pad_edge=False)
    rows.add_column(no_wrap=True)
    rows.add_column(overflow="fold")
    rows.add_row(f"{knee.side} knee", "")
    rows.add_row("angle", shown(f"{knee.columns['angle']} of {files.kinematics.name}"))
    rows.add_row("", f"{span(knee.angles.stamps)}, {degrees.min():.1f} to {degrees.max():.1f} deg")
    rows.add_row("reaction", shown(f"{knee.columns['reaction']} of {files.reactions.name}"))
    rows.add_row("", span(knee.reactions.stamps))
    if knee.leg:
        add_leg(rows, knee, knee.leg, files)
    if knee.body_weight:
        rows.add_row("body weight", f"{knee.body_weight:.1f} N, of the model's mass")
    console.print(rows, highlight=False)
    console.print(peak_table(knee), highlight=False)
    for line in (*(f"- {note}" for note in knee.notes), "", f"Bag: {bag}", ""):
        say(line, hang=2)


def add_leg(rows: Table, knee: KneeGait, leg: Leg, files: Files) -> None:
    """Add rows on the leg's simulated sensors."""
    hip, ankle = (np.degrees(angles.angle) for angles in (leg.hip, leg.ankle))
    rows.add_row("ground", shown(f"{knee.columns['ground force']} of {(files.ground_data or files.reactions).name}"))
    rows.add_row("", f"{span(leg.ground.stamps)}, {leg.ground.force[:, 1].max():.1f} N upwards at most")
    rows.add_row("hip", f"{hip.min():.1f} to {hip.max():.1f} deg to the vertical")
    rows.add_row("ankle", f"{ankle.min():.1f} to {ankle.max():.1f} deg")


def span(stamps: Stamps) -> str:
    """Text with the number of rows and their first and last time."""
    return f"{len(stamps)} rows, {stamps[0] / NANOSECONDS:.3f} to {stamps[-1] / NANOSECONDS:.3f} s"


def peak_table(knee: KneeGait) -> Table:
    """Make a table of the local peaks of the axial load, and of its largest value."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    weight = knee.body_weight
    for heading in ("", "axial load [N]", f"x {SHARE:g} [N]", *(["x 0.5 [BW]"] if weight else []), "at [s]"):
        table.add_column(shown(heading), justify="right" if heading else "left", no_wrap=True)
    for name, index in peaks(knee).items():
        load = -float(knee.reactions.force[index, 1])
        in_weights = [f"{SHARE * load / weight:.2f}"] if weight else []
        at = f"{knee.reactions.stamps[index] / NANOSECONDS:.3f}"
        table.add_row(name, f"{load:.1f}", f"{SHARE * load:.1f}", *in_weights, at)
    return table


def peaks(knee: KneeGait) -> dict[str, int]:
    """Indices of the local peaks of the load, as `pipeline.gait` finds them, and of the largest load, by name."""
    load, stamps = -knee.reactions.force[:, 1], knee.reactions.stamps
    finder = GaitEvents(knee.body_weight or USUAL_WEIGHT)
    events = finder.add(stamps, np.zeros_like(load), SHARE * load) + finder.finish()
    local = sorted(event.stamp for event in events if event.kind == LOAD_PEAK)
    numbered = {f"peak {n}": int(np.searchsorted(stamps, stamp)) for n, stamp in enumerate(local, start=1)}
    return numbered | {"largest": int(load.argmax())}


def show_steps(run: Run) -> None:
    """Print the duration of each step of a run."""
    console = Console(width=WIDTH, emoji=False)
    took = ", ".join(f"{WORDS[step].lower()} {seconds:.1f} s" for step, seconds in run.seconds.items())
    console.print(f"OpenSim: {took}", highlight=False, markup=False)


def show_checks(checks: Sequence[Check], fault: str = "") -> None:
    """Print residuals, reserves and marker errors with their limits and a conclusion, or `fault` if there are none."""
    console = Console(width=WIDTH, emoji=False)
    if fault:
        console.print(fault, soft_wrap=True, highlight=False, markup=False)
        return
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in ("", "peak", "RMS", "allowed", "", ""):
        table.add_column(heading, justify="right" if heading else "left", overflow="fold")
    for check in checks:
        verdict = "" if check.passed else "ABOVE"
        numbers = (f"{check.peak:.3g}", f"{check.rms:.3g}", f"{check.allowed:.3g}")
        table.add_row(shown(check.name), *numbers, check.unit, verdict)
    console.print(table, highlight=False)
    above = [check.name for check in checks if not check.passed]
    text = "Residuals, reserves and markers are within what the literature allows (doi:10.1115/1.4029304)."
    if above:
        text = (
            f"Do not trust these results before you know why these are above what the literature allows "
            f"(doi:10.1115/1.4029304): {', '.join(above)}."
        )
    console.print(text, highlight=False, markup=False)
