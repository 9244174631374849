"""The table that `estimate-load` prints."""

from __future__ import annotations

from collections.abc import Mapping

from rich import box
from rich.console import Console
from rich.table import Table

from knee_contact_ros.offline.estimate_load import LoadSummary
from knee_contact_ros.offline.summary_table import counts, figure_table
from knee_contact_ros.parameters.schema import LoadParameters
from knee_contact_ros.system.terminal import WIDTH, say, shown

NOT_CALIBRATED = "not calibrated to this person: for looking, not for gating anything"


def show_load(summary: LoadSummary, parameters: LoadParameters, rows: Mapping[str, str], output: str) -> None:
    """Print the peak of the joint reaction with its parts and standard deviation, its mean, and figures of the run."""
    console, weight = Console(width=WIDTH, emoji=False), parameters.person.constants.weight
    peak = summary.peak
    assert peak is not None  # noqa: S101  (there is an estimate)
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in ("", "[N]", "[BW]"):
        table.add_column(heading.replace("[", "\\["), justify="right" if heading else "left", no_wrap=True)
    parts = {
        "largest joint reaction": peak.axial_force, "  without muscles": peak.resultant_force,
        "  quadriceps": peak.quadriceps_force, "  hamstrings": peak.hamstrings_force,
        "  gastrocnemius": peak.gastrocnemius_force, "standard deviation": peak.standard_deviation,
        "mean joint reaction": float(summary.axial.mean()),
    }  # fmt: skip
    for name, force in parts.items():
        table.add_row(name, f"{force:.1f}", f"{force / weight:.2f}")
    console.print(table)
    figures = figure_table()
    figures.add_row("estimates", f"{len(summary.axial)} over {summary.duration:.2f} s")
    figures.add_row("level", summary.level)
    figures.add_row("constants", "fitted to this person's knee" if summary.calibrated else NOT_CALIBRATED)
    for name, value in rows.items():
        figures.add_row(name, shown(value))
    figures.add_row("samples refused", counts(summary.refused))
    figures.add_row("estimates flagged", counts(summary.flagged))
    console.print(figures)
    console.print()
    say(f"Bag: {output}")
