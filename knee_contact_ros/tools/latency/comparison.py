"""Latency at a given rate: all candidates in turn, round after round."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from knee_contact_ros.tools.latency.candidates import BARE, CANDIDATES, OURS, Candidate, forget, rotated, running
from knee_contact_ros.tools.latency.driver import Driver, Run
from knee_contact_ros.tools.latency.figures import Figures, figures, ratios
from knee_contact_ros.tools.latency.report import Cell, Page, Sheet, milliseconds, ratio
from knee_contact_ros.tools.latency.usage import Taken, between, snapshot

WARM_UP = 1.0
"""How long [s] a node is fed before anything counts"""
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
    """One candidate in one round."""

    round: int
    """From 1 on"""
    candidate: Candidate
    run: Run
    taken: Taken
    """By the node, and others"""


class Line(NamedTuple):
    """What the CSV file has for a candidate in a round, or in all of them."""

    candidate: str
    round: str
    rate: float
    """[Hz]"""
    published: int
    lost: int
    median_ms: float
    p99_ms: float
    p999_ms: float
    max_ms: float
    cpu_us: float
    """Per sample, of the node's process"""
    cpu_children_us: float
    slip_median_ms: float
    slip_p99_ms: float
    slip_p999_ms: float
    slip_max_ms: float
    others_percent: float
    """Of the machine's processor time"""


def compare(
    driver: Driver, work: Path, rate: float, duration: float, rounds: int, advance: Callable[[int, int], None]
) -> list[Part]:
    """All candidates, `duration` [s] at `rate` [Hz] per round; `advance` is told how many runs are done.

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
    """One run."""
    with running(candidate, driver, work) as node:
        driver.run(rate, round(WARM_UP * rate))
        before = snapshot(node.process.pid)
        run = driver.run(rate, round(duration * rate))
        after = snapshot(node.process.pid)
    forget(work)
    return Part(number, candidate, run, between(before, after))


def pooled(parts: Iterable[Part], candidate: Candidate) -> list[Part]:
    """The parts of a candidate."""
    return [part for part in parts if part.candidate == candidate]


def latencies(parts: Iterable[Part]) -> list[int]:
    """[ns] of all parts."""
    return [latency for part in parts for latency in part.run.latencies]


def slips(parts: Iterable[Part]) -> list[int]:
    """[ns] of all parts."""
    return [slip for part in parts for slip in part.run.slips]


def line(parts: Sequence[Part], rate: float) -> Line:
    """A row of figures of one part, or of a candidate's parts in all rounds."""
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
    """A row for every part, then, if there is more than one round, one for every candidate."""
    of_candidates = [pooled(parts, candidate) for candidate in CANDIDATES]
    found = [line([part], rate) for each in of_candidates for part in each]
    return found + [line(each, rate) for each in of_candidates if len(each) > 1]


def page(parts: Sequence[Part], rate: float, duration: float) -> Page:
    """What the study says."""
    about: list[list[Cell]] = [[candidate.name, candidate.about] for candidate in CANDIDATES]
    introduction = INTRODUCTION.strip().format(rate=rate, duration=duration)
    return Page(
        "Latency",
        introduction,
        (
            Sheet("Candidates", ("candidate", "what it does"), about, prose=True),
            latency_sheet([line(pooled(parts, candidate), rate) for candidate in CANDIDATES]),
            ratio_sheet(parts),
            slip_sheet([line(pooled(parts, candidate), rate) for candidate in CANDIDATES]),
        ),
        Line._fields,
        lines(parts, rate),
    )


def latency_sheet(found: Sequence[Line]) -> Sheet:
    """A row per candidate."""
    rows: list[list[Cell]] = []
    for each in found:
        times = [milliseconds(time) for time in (each.median_ms, each.p99_ms, each.p999_ms, each.max_ms)]
        children = f" + {each.cpu_children_us:.0f}" if each.cpu_children_us else ""
        rows.append([each.candidate, *times, str(each.lost), f"{each.cpu_us:.0f}{children}"])
    header = ("latency [ms]", "median", "p99", "p99.9", "max", "lost", "CPU [us]")
    return Sheet("Latency", header, rows, CPU)


def ratio_sheet(parts: Sequence[Part]) -> Sheet:
    """Every candidate over the bare node: round by round for ours, all rounds together for the others."""
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
    """Figures of a candidate over those of the bare node."""
    return ratios(figures(latencies(pooled(parts, candidate))), figures(latencies(pooled(parts, BARE))))


def ratio_cells(found: Figures) -> list[Cell]:
    """The largest is one sample's chance: it is left out."""
    return [ratio(each) for each in found[:3]]


def slip_sheet(found: Sequence[Line]) -> Sheet:
    """A row per candidate."""
    rows: list[list[Cell]] = []
    for each in found:
        times = (each.slip_median_ms, each.slip_p99_ms, each.slip_p999_ms, each.slip_max_ms)
        rows.append([each.candidate, *map(milliseconds, times), f"{each.others_percent:.0f}"])
    return Sheet("The measuring process", ("late by [ms]", "median", "p99", "p99.9", "max", "others [%]"), rows, SLIPS)
