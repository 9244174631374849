"""What processes take, as the kernel tells in /proc."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from time import perf_counter, process_time
from typing import NamedTuple

PROC = Path("/proc")


class Usage(NamedTuple):
    """What one process uses."""

    process: int
    parent: int
    cpu: float
    """[s] of all its threads, in user and system mode"""
    cpu_ended: float
    """[s] of those of its children that have ended"""
    resident: int
    """[B]"""


class Snapshot(NamedTuple):
    """What a process, its children, and the whole machine have used so far."""

    family: list[Usage]
    """The process, then its children, their children and so on"""
    cpu_of_all: float
    """[s] What a process took that has ended is its parent's"""
    own: float
    """CPU time [s] of this process"""
    at: float
    """[s]"""


class Taken(NamedTuple):
    """Between two snapshots; only of processes that were there all the time."""

    cpu: float
    """[s] of the process"""
    cpu_children: float
    """[s] of its children together"""
    others: float
    """[s] of all processes but these and this one"""
    machine: float
    """[s] that all processors together had"""

    @property
    def others_percent(self) -> float:
        """What others took of the machine."""
        return 1e2 * self.others / self.machine


def snapshot(process: int) -> Snapshot:
    """What a process has taken so far, and all; nothing is said of a process that has ended."""
    found = processes()
    family = [process] if process in found else []
    for member in family:  # it grows meanwhile
        family += sorted(number for number, usage in found.items() if usage.parent == member)
    cpu_of_all = sum(usage.cpu + usage.cpu_ended for usage in found.values())
    return Snapshot([found[member] for member in family], cpu_of_all, process_time(), perf_counter())


def between(before: Snapshot, after: Snapshot) -> Taken:
    """What was taken from one snapshot to a later one."""
    earlier = {usage.process: usage.cpu for usage in before.family}
    cpu = [usage.cpu - earlier[usage.process] for usage in after.family if usage.process in earlier] or [0.0]
    others = after.cpu_of_all - before.cpu_of_all - (after.own - before.own) - sum(cpu)
    machine = (after.at - before.at) * (os.cpu_count() or 1)
    return Taken(cpu[0], sum(cpu[1:]), max(others, 0.0), machine)


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
