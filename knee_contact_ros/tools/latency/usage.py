"""Processor time and memory of processes, read from /proc."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from time import perf_counter, process_time
from typing import NamedTuple

PROC = Path("/proc")


class Usage(NamedTuple):
    """Processor time and memory of one process."""

    process: int
    parent: int
    cpu: float
    """Processor time [s] of all its threads, in user and system mode"""
    cpu_ended: float
    """Processor time [s] of those of its children that have ended"""
    resident: int
    """Resident memory [B]"""


class Snapshot(NamedTuple):
    """Processor time and memory of a process, its children, and the whole machine so far."""

    family: list[Usage]
    """The process, then its children, their children and so on"""
    cpu_of_all: float
    """Processor time [s] of all processes; that of an ended process is its parent's"""
    own: float
    """Processor time [s] of this process"""
    at: float
    """Time [s] of the snapshot, by a clock of its own"""


class Taken(NamedTuple):
    """Processor time between two snapshots, of processes that existed all the time."""

    cpu: float
    """Processor time [s] of the process"""
    cpu_children: float
    """Processor time [s] of its children together"""
    others: float
    """Processor time [s] of all processes but these and this one"""
    machine: float
    """Processor time [s] that the machine had in all"""

    @property
    def others_percent(self) -> float:
        """Share of the machine's processor time that other processes took."""
        return 1e2 * self.others / self.machine


def snapshot(process: int) -> Snapshot:
    """Take a snapshot of a process and of the machine; a process that has ended has no family."""
    usages = processes()
    family = [process] if process in usages else []
    for member in family:  # it grows meanwhile
        family += sorted(number for number, usage in usages.items() if usage.parent == member)
    cpu_of_all = sum(usage.cpu + usage.cpu_ended for usage in usages.values())
    return Snapshot([usages[member] for member in family], cpu_of_all, process_time(), perf_counter())


def between(before: Snapshot, after: Snapshot) -> Taken:
    """Compute what was used from one snapshot to a later one."""
    earlier = {usage.process: usage.cpu for usage in before.family}
    cpu = [usage.cpu - earlier[usage.process] for usage in after.family if usage.process in earlier] or [0.0]
    others = after.cpu_of_all - before.cpu_of_all - (after.own - before.own) - sum(cpu)
    machine = (after.at - before.at) * (os.cpu_count() or 1)
    return Taken(cpu[0], sum(cpu[1:]), max(others, 0.0), machine)


def processes() -> dict[int, Usage]:
    """Usage of all processes, by their numbers."""
    usages = {}
    for folder in PROC.iterdir():
        if folder.name.isdigit():
            with suppress(OSError):  # it has ended meanwhile
                usages[int(folder.name)] = read(int(folder.name))
    return usages


def read(process: int) -> Usage:
    """Read the usage of a process.

    Raises:
        OSError: no such process.
    """
    # The name stands in brackets and may hold any characters.
    fields = (PROC / str(process) / "stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
    second = os.sysconf("SC_CLK_TCK")
    cpu, cpu_ended = (sum(map(int, fields[first : first + 2])) / second for first in (11, 13))
    return Usage(process, int(fields[1]), cpu, cpu_ended, int(fields[21]) * os.sysconf("SC_PAGE_SIZE"))
