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
    name: str
    cpu: float
    """[s] of all its threads, in user and system mode"""
    resident: int
    """[B]"""


def usages(process: int) -> list[Usage]:
    """Of a process, then of its children, their children and so on; empty if it has ended."""
    parents, found = {}, {}
    for folder in PROC.iterdir():
        if folder.name.isdigit():
            with suppress(OSError):  # it has ended meanwhile
                number = int(folder.name)
                parents[number], found[number] = read(number)
    if process not in found:
        return []
    family = [process]
    for member in family:  # it grows meanwhile
        family += sorted(child for child, parent in parents.items() if parent == member)
    return [found[member] for member in family]


def read(process: int) -> tuple[int, Usage]:
    """The parent of a process, and what it takes.

    Raises:
        OSError: no such process.
    """
    # The name stands in brackets and may hold any characters.
    before, _, after = (PROC / str(process) / "stat").read_text(encoding="utf-8", errors="replace").rpartition(")")
    fields = after.split()
    cpu = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    resident = int(fields[21]) * os.sysconf("SC_PAGE_SIZE")
    return int(fields[1]), Usage(process, before.partition("(")[2], cpu, resident)


def machine_time() -> tuple[float, float]:
    """Seconds that all processors together have been busy, or taken away by a host, and in all, since the start."""
    text = (PROC / "stat").read_text(encoding="utf-8")
    user, nice, system, idle, waiting, *interrupts_and_stolen = map(int, text.split()[1:9])
    busy = user + nice + system + sum(interrupts_and_stolen)
    return busy / os.sysconf("SC_CLK_TCK"), (busy + idle + waiting) / os.sysconf("SC_CLK_TCK")


def cpu_since(before: list[Usage], after: list[Usage]) -> tuple[float, float]:
    """Seconds that the process itself has taken, and its children together: those that were there all the time."""
    earlier = {usage.process: usage.cpu for usage in before}
    taken = [usage.cpu - earlier.get(usage.process, usage.cpu) for usage in after]
    return (taken[0], sum(taken[1:])) if taken else (0.0, 0.0)
