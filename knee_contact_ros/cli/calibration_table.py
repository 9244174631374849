"""The table that `calibrate` prints."""

from __future__ import annotations

from pathlib import Path

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from knee_contact_ros.system.terminal import WIDTH, say, shown, warn
from knee_contact_ros.tools.calibration.in_memory import Calibration
from knee_contact_ros.tools.calibration.run import UNITS


def show_calibration(calibration: Calibration, output: Path) -> None:
    """Print the fitted values with their intervals, the residual of each column, the output file, and warnings."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in ("parameter [unit]", "start", "fitted", f"{100.0 * calibration.level:g} % interval"):
        table.add_column(heading.replace("[", r"\["), justify="right" if heading in ("start", "fitted") else "left")
    for unknown in calibration.unknowns:
        name = unknown.name + (f"\n  [{unknown.unit}]" if unknown.unit else "")
        value = calibration.values[unknown.name]
        numbers = (f"{unknown.start:.6g}", f"{value:.6g}", _interval(calibration, unknown.name))
        table.add_row(escape(name), *map(shown, numbers))
    Console(width=WIDTH, emoji=False).print(table, highlight=False)
    for name, misfit in calibration.rms.items():
        known = "noise given" if name in calibration.given else "noise found"
        say(f"{name}: RMS {misfit:.4g} {UNITS[name]} left, {known} {calibration.noise[name]:.4g} {UNITS[name]}")
    for remark in calibration.remarks:
        say(remark)
    say("")
    say(f"Parameters: {output}")
    warn(calibration.warnings)


def _interval(calibration: Calibration, name: str) -> str:
    """Return the interval of a parameter as text."""
    if name not in calibration.intervals:
        return "-"
    low, high, low_open, high_open = calibration.intervals[name]
    if low_open and high_open:
        return "not bounded"
    if low_open:
        return f"below {high:.6g}"
    return f"above {low:.6g}" if high_open else f"{low:.6g} to {high:.6g}"
