"""What processes take, as the kernel tells in /proc."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

PROC = Path("/proc")


class Usage(NamedTuple):
    """Of one process."""

    process: int
    parent: int
    cpu: float
    """[s] of all its threads, in user and system mode"""
    cpu_ended: float
    """[s] of those of its children that have ended"""
    resident: int
    """[B]"""


def usages(process: int) -> list[Usage]:
    """Of a process, then of its children, their children and so on; empty if it has ended."""
    found = processes()
    if process not in found:
        return []
    family = [process]
    for member in family:  # it grows meanwhile
        family += sorted(number for number, usage in found.items() if usage.parent == member)
    return [found[member] for member in family]


def cpu_of_all() -> float:
    """Seconds that all processes have taken: what one took that has ended is its parent's."""
    return sum(usage.cpu + usage.cpu_ended for usage in processes().values())


def processes() -> dict[int, Usage]:
    """All processes by their numbers."""
    found = {}
    for folder in PROC.iterdir():
        if folder.name.isdigit():
            with suppress(OSError):  # it has ended meanwhile
                found[int(folder.name)] = read(int(folder.name))
    return found


def read(process: int) -> Usage:
    """What a process takes.

    Raises:
        OSError: no such process.
    """
    # The name stands in brackets and may hold any characters.
    fields = (PROC / str(process) / "stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
    second = os.sysconf("SC_CLK_TCK")
    cpu, cpu_ended = (sum(map(int, fields[first : first + 2])) / second for first in (11, 13))
    return Usage(process, int(fields[1]), cpu, cpu_ended, int(fields[21]) * os.sysconf("SC_PAGE_SIZE"))


def cpu_since(before: list[Usage], after: list[Usage]) -> tuple[float, float]:
    """Seconds that the process itself has taken, and its children together: those that were there all the time."""
    earlier = {usage.process: usage.cpu for usage in before}
    taken = [usage.cpu - earlier.get(usage.process, usage.cpu) for usage in after]
    return (taken[0], sum(taken[1:])) if taken else (0.0, 0.0)
