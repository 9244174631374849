"""Latency at a given rate: all candidates in turns, round after round."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from knee_contact_ros.tools.latency.candidates import BARE, CANDIDATES, OURS, Candidate, rotated, running
from knee_contact_ros.tools.latency.driver import Driver, Run
from knee_contact_ros.tools.latency.figures import Figures, figures, ratios
from knee_contact_ros.tools.latency.report import Cell, Page, Sheet, milliseconds, ratio
from knee_contact_ros.tools.latency.usage import Taken, between, snapshot

WARM_UP = 1.0
"""Time [s] that a node is fed before anything counts"""
ALL = "all"
INTRODUCTION = """
Latency is from just before a force is published to the receipt of its answer, both by the clock of the one process that
publishes angle and force and listens to `knee_contact`; it includes what this process takes, the same for all. Every
candidate is a process of its own, started anew for every round of {duration:g} s at {rate:g} Hz; the order changes from
round to round, and the first second does not count. Read the ratios: times are of this machine and this run.
"""
SLIPS = (
    "How late the measuring process itself was in publishing, which is not part of the latency; and the share of the "
    "machine's processors that others took meanwhile: with more than a few per cent, measure again."
)
CPU = "CPU time per sample is that of the node's process, and behind the plus that of its child processes."


class Part(NamedTuple):
    """Run of one candidate in one round."""

    round: int
    """Number of the round, counted from 1"""
    candidate: Candidate
    run: Run
    taken: Taken
    """Processor time of the node and of others"""


class Line(NamedTuple):
    """Row of the CSV file: a candidate in one round, or in all rounds."""

    candidate: str
    round: str
    rate: float
    """Samples per second [Hz]"""
    published: int
    lost: int
    median_ms: float
    p99_ms: float
    p999_ms: float
    max_ms: float
    cpu_us: float
    """Processor time [µs] per sample of the node's process"""
    cpu_children_us: float
    slip_median_ms: float
    slip_p99_ms: float
    slip_p999_ms: float
    slip_max_ms: float
    others_percent: float
    """Share of the machine's processor time that other processes took"""


def compare(
    driver: Driver, work: Path, rate: float, duration: float, rounds: int, advance: Callable[[int, int], None]
) -> list[Part]:
    """Run all candidates at `rate` [Hz] for `duration` [s] per round; `advance` takes the runs done and their number.

    Raises:
        UsageError: a node failed.
    """
    parts: list[Part] = []
    total = rounds * len(CANDIDATES)
    for number in range(rounds):
        for candidate in rotated(CANDIDATES, number):
            advance(len(parts), total)
            parts.append(measured(driver, work / "node", candidate, number + 1, rate, duration))
    return parts


def measured(driver: Driver, work: Path, candidate: Candidate, number: int, rate: float, duration: float) -> Part:
    """Run one candidate in one round."""
    with running(candidate, driver, work) as node:
        driver.run(rate, round(WARM_UP * rate))
        before = snapshot(node.process.pid)
        run = driver.run(rate, round(duration * rate))
        after = snapshot(node.process.pid)
    shutil.rmtree(work)
    return Part(number, candidate, run, between(before, after))


def pooled(parts: Iterable[Part], candidate: Candidate) -> list[Part]:
    """Parts of a candidate."""
    return [part for part in parts if part.candidate == candidate]


def latencies(parts: Iterable[Part]) -> list[int]:
    """Latencies [ns] of all parts."""
    return [latency for part in parts for latency in part.run.latencies]


def slips(parts: Iterable[Part]) -> list[int]:
    """Times [ns] by which samples were published late, of all parts."""
    return [slip for part in parts for slip in part.run.slips]


def line(parts: Sequence[Part], rate: float) -> Line:
    """Row of the CSV file for one part, or for a candidate's parts in all rounds."""
    published = sum(part.run.published for part in parts)
    return Line(
        parts[0].candidate.name,
        str(parts[0].round) if len(parts) == 1 else ALL,
        rate,
        published,
        sum(part.run.lost for part in parts),
        *figures(latencies(parts)),
        1e6 * sum(part.taken.cpu for part in parts) / published,
        1e6 * sum(part.taken.cpu_children for part in parts) / published,
        *figures(slips(parts)),
        1e2 * sum(part.taken.others for part in parts) / sum(part.taken.machine for part in parts),
    )


def lines(parts: Sequence[Part], rate: float) -> list[Line]:
    """Rows of the CSV file: one for every part and, if there are several rounds, one for every candidate."""
    of_candidates = [pooled(parts, candidate) for candidate in CANDIDATES]
    single = [line([part], rate) for each in of_candidates for part in each]
    return single + [line(each, rate) for each in of_candidates if len(each) > 1]


def page(parts: Sequence[Part], rate: float, duration: float) -> Page:
    """Page of the comparison, with its data."""
    about: list[list[Cell]] = [[candidate.name, candidate.about] for candidate in CANDIDATES]
    summary = [line(pooled(parts, candidate), rate) for candidate in CANDIDATES]
    introduction = INTRODUCTION.strip().format(rate=rate, duration=duration)
    return Page(
        "Latency",
        introduction,
        (
            Sheet("Candidates", ("candidate", "what it does"), about, prose=True),
            latency_sheet(summary),
            ratio_sheet(parts),
            slip_sheet(summary),
        ),
        Line._fields,
        lines(parts, rate),
    )


def latency_sheet(summary: Sequence[Line]) -> Sheet:
    """Table of latencies, losses and processor times: a row per candidate."""
    rows: list[list[Cell]] = []
    for each in summary:
        times = [milliseconds(time) for time in (each.median_ms, each.p99_ms, each.p999_ms, each.max_ms)]
        children = f" + {each.cpu_children_us:.0f}" if each.cpu_children_us else ""
        rows.append([each.candidate, *times, str(each.lost), f"{each.cpu_us:.0f}{children}"])
    header = ("latency [ms]", "median", "p99", "p99.9", "max", "lost", "CPU [us]")
    return Sheet("Latency", header, rows, CPU)


def ratio_sheet(parts: Sequence[Part]) -> Sheet:
    """Table of ratios to the bare node: round by round for ours, all rounds together for the others."""
    rows: list[list[Cell]] = []
    numbers = sorted({part.round for part in parts})
    for number in numbers if len(numbers) > 1 else ():
        this_round = [part for part in parts if part.round == number]
        rows.append([f"{OURS.name}, round {number}", *ratio_cells(over_bare(this_round, OURS))])
    rows += [
        [candidate.name, *ratio_cells(over_bare(parts, candidate))] for candidate in CANDIDATES if candidate != BARE
    ]
    return Sheet("Ratios", (f"latency over that of {BARE.name}", "median", "p99", "p99.9"), rows)


def over_bare(parts: Sequence[Part], candidate: Candidate) -> Figures:
    """Figures of a candidate's latency over those of the bare node."""
    return ratios(figures(latencies(pooled(parts, candidate))), figures(latencies(pooled(parts, BARE))))


def ratio_cells(relative: Figures) -> list[Cell]:
    """Cells of the ratios, without the largest latency, which is one sample's chance."""
    return [ratio(each) for each in relative[:3]]


def slip_sheet(summary: Sequence[Line]) -> Sheet:
    """Table of how late samples were published: a row per candidate."""
    rows: list[list[Cell]] = []
    for each in summary:
        times = (each.slip_median_ms, each.slip_p99_ms, each.slip_p999_ms, each.slip_max_ms)
        rows.append([each.candidate, *map(milliseconds, times), f"{each.others_percent:.0f}"])
    return Sheet("The measuring process", ("late by [ms]", "median", "p99", "p99.9", "max", "others [%]"), rows, SLIPS)
