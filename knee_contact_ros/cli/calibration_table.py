"""What `calibrate` prints."""

from __future__ import annotations

from pathlib import Path

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from knee_contact_ros.system.terminal import WIDTH, say, shown, warn
from knee_contact_ros.tools.calibration.in_memory import Calibration
from knee_contact_ros.tools.calibration.run import UNITS


def show_calibration(found: Calibration, output: Path) -> None:
    """Print the fitted values with their intervals, what is left of each column, the file, and warnings."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in ("parameter [unit]", "start", "fitted", f"{100.0 * found.level:g} % interval"):
        table.add_column(heading.replace("[", r"\["), justify="right" if heading in ("start", "fitted") else "left")
    for unknown in found.unknowns:
        name = unknown.name + (f"\n  [{unknown.unit}]" if unknown.unit else "")
        numbers = (f"{unknown.start:.6g}", f"{found.values[unknown.name]:.6g}", _interval(found, unknown.name))
        table.add_row(escape(name), *map(shown, numbers))
    Console(width=WIDTH, emoji=False).print(table, highlight=False)
    for name, misfit in found.rms.items():
        known = "noise given" if name in found.given else "noise found"
        say(f"{name}: RMS {misfit:.4g} {UNITS[name]} left, {known} {found.noise[name]:.4g} {UNITS[name]}")
    for remark in found.remarks:
        say(remark)
    say("")
    say(f"Parameters: {output}")
    warn(found.warnings)


def _interval(found: Calibration, name: str) -> str:
    """The interval in a cell."""
    if name not in found.intervals:
        return "-"
    low, high, low_open, high_open = found.intervals[name]
    if low_open and high_open:
        return "not bounded"
    if low_open:
        return f"below {high:.6g}"
    return f"above {low:.6g}" if high_open else f"{low:.6g} to {high:.6g}"
