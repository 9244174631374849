"""The table that `recover` prints."""

from __future__ import annotations

from rich import box
from rich.console import Console
from rich.table import Table

from knee_contact_ros.bags.recover import Recovery
from knee_contact_ros.streams.topics import NANOSECONDS
from knee_contact_ros.system.terminal import WIDTH, say, shown

MOST_FAULTS = 20
"""Largest number of faults that are printed"""


def show_recovery(recovery: Recovery, output: str) -> None:
    """Print the recovered and the missing messages of each topic, the faults, and the output file."""
    console = Console(width=WIDTH, emoji=False)
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("topic, and its type", overflow="fold")
    table.add_column("messages", justify="right", no_wrap=True)
    table.add_column("missing", justify="right", no_wrap=True)
    for row in recovery.topics:
        missing = "unknown" if row.missing is None else str(row.missing)
        table.add_row(f"{shown(row.topic)}\n  {shown(row.type)}", str(row.messages), missing)
    console.print(table)
    lines = [f"{recovery.unread} of {recovery.size} bytes could not be read"]
    if recovery.times:
        first, last = recovery.times
        lines.insert(0, f"from {first / NANOSECONDS:.3f} s to {last / NANOSECONDS:.3f} s")
    lines += [f"- {fault}" for fault in recovery.faults[:MOST_FAULTS]]
    if len(recovery.faults) > MOST_FAULTS:
        lines.append(f"- and {len(recovery.faults) - MOST_FAULTS} more, all in the file's metadata")
    for line in [*lines, f"Recovered: {output}"]:
        say(line)
