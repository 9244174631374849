"""A long run of our node alone: its memory, and whether its recording equals what its samples give offline."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from functools import partial
from itertools import zip_longest
from pathlib import Path
from typing import NamedTuple

from knee_contact_ros.bags.reader import BagReader
from knee_contact_ros.offline.solve import solve
from knee_contact_ros.offline.stage import RECORDING, node_process
from knee_contact_ros.parameters.reading import load_parameters
from knee_contact_ros.streams.topics import KNEE_CONTACT, MESSAGE_TYPES
from knee_contact_ros.tools.latency.candidates import OURS, PARAMETERS, running
from knee_contact_ros.tools.latency.driver import Driver
from knee_contact_ros.tools.latency.figures import figures
from knee_contact_ros.tools.latency.report import Cell, Page, Sheet, milliseconds
from knee_contact_ros.tools.latency.usage import Usage, between, snapshot

PERIOD = 10_000
"""Ticks between two looks at the memory"""
WARM_UP = 50_000
"""Ticks after which memory must not grow"""
PATIENCE = 1200.0
"""Time [s] within which the node must complete its files"""
MB = 1e6
NODE = "node"
RECORDED = OURS._replace(start=partial(node_process, [PARAMETERS]))
"""The node, whose recording must be complete here"""
Advance = Callable[[int, int], None]
INTRODUCTION = """
The node ({about}) alone, fed at {rate:g} Hz.
Memory is resident memory, looked at every {period} ticks. At the end the recording is computed again offline, and all
bytes of its `knee_contact` messages are compared.
"""


class Moment(NamedTuple):
    """Memory, losses and latencies after a number of ticks."""

    ticks: int
    resident_mb: float
    """Resident memory [MB] of the node's process"""
    children: tuple[Usage, ...]
    """The node's child processes"""
    lost: int
    """Samples without an answer so far"""
    published_rate: float
    """Rate [Hz] since the moment before, as all further fields"""
    median_ms: float
    p99_ms: float
    p999_ms: float
    max_ms: float
    others_percent: float
    """Share of the machine's processor time that other processes took"""


class Comparison(NamedTuple):
    """Differences between a recording and the same samples computed offline."""

    recorded: int
    """Number of answers in the recording"""
    computed: int
    """Number of answers offline"""
    different: int
    """Number of answers whose bytes or stamps differ, or that one of the two lacks"""


def run_long(driver: Driver, work: Path, rate: float, ticks: int, advance: Advance) -> list[Moment]:
    """Run the node for a number of ticks at `rate` [Hz]; its recording stays in `work`.

    Raises:
        UsageError: the node failed.
    """
    moments: list[Moment] = []
    done = lost = 0
    with running(RECORDED, driver, work / NODE, PATIENCE) as node:
        while done < ticks:
            advance(done, ticks)
            before = snapshot(node.process.pid)
            run = driver.run(rate, min(PERIOD, ticks - done))
            after = snapshot(node.process.pid)
            node.check()
            done, lost = done + run.published, lost + run.lost
            own, *children = after.family
            moments.append(
                Moment(
                    done, own.resident / MB, tuple(children), lost, run.published_rate, *figures(run.latencies),
                    between(before, after).others_percent,
                )
            )  # fmt: skip
        advance(done, ticks)
    return moments


def computed_again(work: Path, advance: Advance) -> Comparison:
    """Compute the recording offline, compare both, and remove the files.

    Raises:
        UsageError: the recording cannot be used.
    """
    recording, offline = work / NODE / RECORDING, work / "offline.mcap"
    solve(recording, load_parameters([PARAMETERS]), offline, advance)
    comparison = compare(recording, offline)
    offline.unlink()
    shutil.rmtree(work / NODE)
    return comparison


def compare(recording: Path, offline: Path) -> Comparison:
    """Compare all answers of two recordings, in their order."""
    types = {f"/{KNEE_CONTACT}": MESSAGE_TYPES[KNEE_CONTACT]}
    recorded = computed = different = 0
    with BagReader(recording, types) as one, BagReader(offline, types) as other:
        for mine, theirs in zip_longest(one.raw_messages(), other.raw_messages()):
            recorded += mine is not None
            computed += theirs is not None
            different += mine != theirs
    return Comparison(recorded, computed, different)


def warm(moments: Sequence[Moment]) -> Sequence[Moment]:
    """Moments after the warm-up, or the last one of a run that is too short for one."""
    return [moment for moment in moments if moment.ticks >= WARM_UP] or moments[-1:]


def page(rate: float, moments: Sequence[Moment], compared: Comparison) -> Page:
    """Page of the long run, with its data."""
    counted, last = warm(moments), moments[-1]
    first, largest = counted[0].resident_mb, max(moment.resident_mb for moment in counted)
    rows: list[list[Cell]] = [
        ["ticks", str(last.ticks)],
        ["lost", str(last.lost)],
        ["lowest rate published [Hz]", f"{min(moment.published_rate for moment in moments):.0f}"],
        ["largest median of latency [ms]", milliseconds(max(moment.median_ms for moment in moments))],
        ["largest p99 of latency [ms]", milliseconds(max(moment.p99_ms for moment in moments))],
        [f"node's memory after {counted[0].ticks} ticks [MB]", f"{first:.1f}"],
        ["its largest growth since then [MB]", f"{largest - first:.1f}"],
        ["node's memory at the end [MB]", f"{last.resident_mb:.1f}"],
        ["its child processes' memory at the end [MB]", in_short(last.children) or "-"],
        ["others' part of the machine, at most [%]", f"{max(moment.others_percent for moment in moments):.0f}"],
        ["answers recorded", str(compared.recorded)],
        ["answers offline", str(compared.computed)],
        ["of these not identical", str(compared.different)],
    ]
    introduction = INTRODUCTION.strip().format(about=OURS.about, rate=rate, period=PERIOD)
    lines = [moment._replace(children=in_short(moment.children)) for moment in moments]  # type: ignore[arg-type]
    return Page("Soak", introduction, (Sheet("Figures", ("long run", "value"), rows),), Moment._fields, lines)


def in_short(children: Sequence[Usage]) -> str:
    """Format the process number and memory [MB] of every child process."""
    return ", ".join(f"{child.process}: {child.resident / MB:.1f}" for child in children)
