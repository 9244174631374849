"""Measure the node beside bare ones, over real topics on this machine only: `python -m benchmarks.latency --help`.

Latency, losses and processor time of the node, recording and drawing, and of rclpy nodes that compute nothing. Writes
latency.md and latency.csv; with --sustained or --soak the pages sustained or soak instead.
"""

from __future__ import annotations

import csv
import math
import os
import shutil
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from itertools import zip_longest
from pathlib import Path
from statistics import mean, median
from typing import Any, NamedTuple

import click

from benchmarks.latency.driver import (
    BARE,
    CANDIDATES,
    DISTRIBUTIONS,
    OURS,
    PARAMETERS,
    Candidate,
    Driver,
    Figures,
    Run,
    Taken,
    Usage,
    between,
    figures,
    joined,
    ratios,
    rotated,
    running,
    snapshot,
)
from benchmarks.report import Section, machine, save, table
from knee_contact_ros.bags.reader import BagReader
from knee_contact_ros.commands.demo import RECORDING, node_process
from knee_contact_ros.offline.solve import solve
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.streams.topics import KNEE_CONTACT, MESSAGE_TYPES
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.output_files import replace, work_folder
from knee_contact_ros.system.processes import Child
from knee_contact_ros.system.ros import private_graph
from knee_contact_ros.system.terminal import progress

Advance = Callable[[int, int], None]
"""Takes what is done and how much there is to do"""


class Page(NamedTuple):
    """One part of the measurement: its tables and its data."""

    title: str
    introduction: str
    sections: Sequence[Section]
    fields: Sequence[str]
    """Names of the columns of the data"""
    lines: Sequence[Sequence[Any]]
    """Rows of the data"""


def write(page: Page, folder: Path, command: str) -> list[Path]:
    """Write page and data under the page's title, and return their paths; `command` is what has made them."""
    paths = [folder / f"{page.title.lower()}{suffix}" for suffix in (".md", ".csv")]
    sections = [Section("", page.introduction, (), ()), *page.sections]
    save(paths[0], page.title, command, sections, machine(*DISTRIBUTIONS))
    with paths[1].open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(page.fields)
        writer.writerows([f"{value:.6g}" if isinstance(value, float) else value for value in row] for row in page.lines)
    return paths


def milliseconds(time: float) -> str:
    """Format a time [ms]."""
    return "-" if math.isnan(time) else f"{time:.3f}" if time < 100.0 else f"{time:.0f}"


def ratio(value: float) -> str:
    """Format a ratio."""
    return "-" if math.isnan(value) else f"{value:.2f}"


# Latency at a given rate: all candidates take turns, round after round.

WARM_UP = 1.0
"""Time [s] that a node is fed before anything counts"""
LATENCY_INTRODUCTION = """
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
    """Row of latency.csv: a candidate in one round, or in all rounds."""

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


def compare(driver: Driver, work: Path, rate: float, duration: float, rounds: int, advance: Advance) -> list[Part]:
    """Run all candidates at `rate` [Hz] for `duration` [s] per round.

    Raises:
        UsageError: a node failed.
    """
    parts: list[Part] = []
    for number in range(rounds):
        for candidate in rotated(CANDIDATES, number):
            advance(len(parts), rounds * len(CANDIDATES))
            with running(candidate, driver, work / "node") as node:
                driver.run(rate, round(WARM_UP * rate))
                before = snapshot(node.process.pid)
                run = driver.run(rate, round(duration * rate))
                after = snapshot(node.process.pid)
            shutil.rmtree(work / "node")
            parts.append(Part(number + 1, candidate, run, between(before, after)))
    return parts


def pooled(parts: Iterable[Part], candidate: Candidate) -> list[Part]:
    """Parts of a candidate."""
    return [part for part in parts if part.candidate == candidate]


def latencies(parts: Iterable[Part]) -> Figures:
    """Figures of the latencies of all parts."""
    return figures([latency for part in parts for latency in part.run.latencies])


def line(parts: Sequence[Part], rate: float) -> Line:
    """Row of latency.csv for one part, or for a candidate's parts in all rounds."""
    published = sum(part.run.published for part in parts)
    return Line(
        parts[0].candidate.name, str(parts[0].round) if len(parts) == 1 else "all", rate, published,
        sum(part.run.lost for part in parts), *latencies(parts),
        1e6 * sum(part.taken.cpu for part in parts) / published,
        1e6 * sum(part.taken.cpu_children for part in parts) / published,
        *figures([slip for part in parts for slip in part.run.slips]),
        1e2 * sum(part.taken.others for part in parts) / sum(part.taken.machine for part in parts),
    )  # fmt: skip


def latency_page(parts: Sequence[Part], rate: float, duration: float) -> Page:
    """Page of the comparison; its data have a row per candidate and round, and one per candidate for all rounds."""
    of_candidates = [pooled(parts, candidate) for candidate in CANDIDATES]
    lines = [line([part], rate) for each in of_candidates for part in each]
    lines += [line(each, rate) for each in of_candidates if len(each) > 1]
    candidates = [[each.name, each.about] for each in CANDIDATES]
    about = Section("Candidates", "", ("candidate", "what it does"), candidates)
    summary = [line(each, rate) for each in of_candidates]
    sheets = (about, latency_sheet(summary), ratio_sheet(parts), slip_sheet(summary))
    introduction = LATENCY_INTRODUCTION.strip().format(rate=rate, duration=duration)
    return Page("Latency", introduction, sheets, Line._fields, lines)


def latency_sheet(summary: Sequence[Line]) -> Section:
    """Table of latencies, losses and processor times: a row per candidate."""
    rows = []
    for each in summary:
        times = map(milliseconds, (each.median_ms, each.p99_ms, each.p999_ms, each.max_ms))
        children = f" + {each.cpu_children_us:.0f}" if each.cpu_children_us else ""
        rows.append([each.candidate, *times, str(each.lost), f"{each.cpu_us:.0f}{children}"])
    return Section("Latency", CPU, ("latency [ms]", "median", "p99", "p99.9", "max", "lost", "CPU [us]"), rows)


def ratio_sheet(parts: Sequence[Part]) -> Section:
    """Table of ratios to the bare node: round by round for ours, all rounds together for the others."""
    rounds = sorted({part.round for part in parts})
    chosen = [(f"{OURS.name}, round {number}", OURS, [part for part in parts if part.round == number])
              for number in rounds if len(rounds) > 1]  # fmt: skip
    chosen += [(candidate.name, candidate, list(parts)) for candidate in CANDIDATES if candidate != BARE]
    rows = []
    for name, candidate, of in chosen:
        over_bare = ratios(latencies(pooled(of, candidate)), latencies(pooled(of, BARE)))
        rows.append([name, *map(ratio, over_bare[:3])])  # the largest latency is one sample's chance
    return Section("Ratios", "", (f"latency over that of {BARE.name}", "median", "p99", "p99.9"), rows)


def slip_sheet(summary: Sequence[Line]) -> Section:
    """Table of how late samples were published: a row per candidate."""
    rows = []
    for each in summary:
        times = (each.slip_median_ms, each.slip_p99_ms, each.slip_p999_ms, each.slip_max_ms)
        rows.append([each.candidate, *map(milliseconds, times), f"{each.others_percent:.0f}"])
    return Section(
        "The measuring process", SLIPS, ("late by [ms]", "median", "p99", "p99.9", "max", "others [%]"), rows
    )


# The highest rate that a node sustains: every sample is answered, and the last ones soon.

FIRST, FACTOR, BISECTIONS = 500.0, 1.25, 2
"""Rate [Hz] at which a search begins, ratio of each rate to the one before, and halvings of the last interval"""
STEP = 3.0
"""Time [s] for which a rate is tried"""
TRIES = 2
"""Failures in a row after which a rate is not sustained: the machine has other things to do at times"""
SOON = 0.05
"""Time [s] within which the median sample and the last one must be answered"""
PUNCTUAL = 0.98
"""Share of a rate at which samples must have been published"""
HIGHEST = 100_000.0
"""Rate [Hz] that no machine reaches, at which the search ends"""
SUSTAINED, NODE, SENDER = "sustained", "node", "sender"
SUSTAINED_INTRODUCTION = """
A rate is sustained if every sample of {step:g} s is answered, the last one and the median one within {soon:g} ms, and
at least {punctual:g} % of the rate was published. It rises from {first:g} Hz by a factor of {factor:g} until it fails
twice in a row; {bisections} bisections follow. What the limit is: `node` if answers were missing or late, `sender` if
the process that publishes and listens could do no more (one and the same for all candidates; then the node may sustain
more). A candidate is started anew for every round.
"""


class Step(NamedTuple):
    """One attempt at a rate: a row of sustained.csv."""

    round: int
    candidate: str
    rate: float
    """Rate [Hz] at which samples were due"""
    published_rate: float
    """Rate [Hz] at which samples were published"""
    published: int
    lost: int
    median_ms: float
    tail_ms: float
    """Time [ms] from the last publishing to the last answer"""
    verdict: str
    others_percent: float
    """Share of the machine's processor time that other processes took"""


def search(attempt: Callable[[float], Step]) -> list[Step]:
    """Search the highest sustained rate [Hz], and return all attempts."""
    steps: list[Step] = []

    def sustains(rate: float) -> bool:
        for _ in range(TRIES):
            steps.append(attempt(rate))
            if steps[-1].verdict == SUSTAINED:
                return True
        return False

    low, high = 0.0, FIRST
    while sustains(high):
        low, high = high, high * FACTOR
        if high >= HIGHEST:
            return steps
    for _ in range(BISECTIONS if low else 0):
        rate = math.sqrt(low * high)
        low, high = (rate, high) if sustains(rate) else (low, rate)
    return steps


def judged(run: Run, rate: float) -> str:
    """Verdict on a run at a rate [Hz]: `SUSTAINED`, or whether `NODE` or `SENDER` was the limit."""
    if run.published_rate < PUNCTUAL * rate:
        return SENDER
    soon = run.tail <= SOON and 1e-3 * figures(run.latencies).median <= SOON
    return SUSTAINED if soon and not run.lost else NODE


def attempt_at(driver: Driver, node: Child, candidate: Candidate, number: int, rate: float) -> Step:
    """Try a rate [Hz] once with a node that is running."""
    before = snapshot(node.process.pid)
    run = driver.run(rate, round(STEP * rate))
    taken = between(before, snapshot(node.process.pid))
    return Step(
        number, candidate.name, rate, run.published_rate, run.published, run.lost,
        figures(run.latencies).median, 1e3 * run.tail, judged(run, rate), taken.others_percent,
    )  # fmt: skip


def find_rates(driver: Driver, work: Path, rounds: int, advance: Advance) -> list[Step]:
    """Search the rates of all candidates, round after round.

    Raises:
        UsageError: a node failed.
    """
    steps: list[Step] = []
    for number in range(rounds):
        for done, candidate in enumerate(rotated(CANDIDATES, number)):
            advance(number * len(CANDIDATES) + done, rounds * len(CANDIDATES))
            with running(candidate, driver, work / "node") as node:
                driver.run(FIRST, round(FIRST))
                steps += search(partial(attempt_at, driver, node, candidate, number + 1))
            shutil.rmtree(work / "node")
    return steps


def highest(steps: Iterable[Step], candidate: Candidate, number: int) -> float:
    """Highest rate [Hz] that a candidate sustained in a round; 0 if there is none."""
    mine = [step for step in steps if step.candidate == candidate.name and step.round == number]
    return max((step.rate for step in mine if step.verdict == SUSTAINED), default=0.0)


def limit(steps: Iterable[Step], candidate: Candidate, number: int) -> str:
    """Verdicts on the lowest rate that a candidate did not sustain in a round."""
    best = highest(steps, candidate, number)
    mine = [step for step in steps if step.candidate == candidate.name and step.round == number and step.rate > best]
    lowest = min((step.rate for step in mine), default=0.0)
    return "/".join(sorted({step.verdict for step in mine if step.rate == lowest})) or "-"


def sustained_page(steps: Sequence[Step]) -> Page:
    """Page of the sustained rates, with its data."""
    numbers = sorted({step.round for step in steps})
    rows = []
    for candidate in CANDIDATES:
        rates = [highest(steps, candidate, number) for number in numbers]
        bare = [highest(steps, BARE, number) for number in numbers]
        to_bare = [mine / theirs for mine, theirs in zip(rates, bare, strict=True) if theirs]
        limits = sorted({limit(steps, candidate, number) for number in numbers})
        others = [step.others_percent for step in steps if step.candidate == candidate.name]
        rows.append(
            [candidate.name, f"{median(rates):.0f}", f"{min(rates):.0f}-{max(rates):.0f}", ", ".join(limits),
             ratio(median(to_bare)) if to_bare else "-", f"{mean(others):.0f} %" if others else "-"]
        )  # fmt: skip
    introduction = SUSTAINED_INTRODUCTION.strip().format(
        step=STEP, soon=1e3 * SOON, punctual=1e2 * PUNCTUAL, first=FIRST, factor=FACTOR, bisections=BISECTIONS
    )
    header = ("sustained [Hz]", "median", "rounds", "limit", f"/ {BARE.name}", "others")
    about = "Others are the other processes of this machine: with more than a few per cent, measure again."
    return Page("Sustained", introduction, (Section("Rates", about, header, rows),), Step._fields, steps)


# A long run of our node alone: its memory, and whether its recording equals what its samples give offline.

PERIOD = 10_000
"""Ticks between two looks at the memory"""
MEMORY_WARM_UP = 50_000
"""Ticks after which memory must not grow"""
SOAK_PATIENCE = 1200.0
"""Time [s] within which the node must complete its files"""
MB = 1e6
RECORDED = OURS._replace(start=partial(node_process, [PARAMETERS]))
"""The node, whose recording must be complete here"""
SOAK_INTRODUCTION = """
The node ({about}) alone, fed at {rate:g} Hz.
Memory is resident memory, looked at every {period} ticks. At the end the recording is computed again offline, and all
bytes of its `knee_contact` messages are compared.
"""


class Moment(NamedTuple):
    """Memory, losses and latencies after a number of ticks: a row of soak.csv."""

    ticks: int
    resident_mb: float
    """Resident memory [MB] of the node's process"""
    children: str
    """Process number and memory [MB] of each of the node's child processes"""
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


def run_long(driver: Driver, work: Path, rate: float, ticks: int, advance: Advance) -> list[Moment]:
    """Run the node for a number of ticks at `rate` [Hz]; its recording stays in `work / "node"`.

    Raises:
        UsageError: the node failed.
    """
    moments: list[Moment] = []
    done = lost = 0
    with running(RECORDED, driver, work / "node", SOAK_PATIENCE) as node:
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
                    done, own.resident / MB, in_short(children), lost, run.published_rate, *figures(run.latencies),
                    between(before, after).others_percent,
                )
            )  # fmt: skip
        advance(done, ticks)
    return moments


def in_short(children: Sequence[Usage]) -> str:
    """Format the process number and memory [MB] of every child process."""
    return ", ".join(f"{child.process}: {child.resident / MB:.1f}" for child in children)


def same_answers(recording: Path, offline: Path) -> tuple[int, int, int]:
    """Compare the answers of two recordings in their order: numbers of the one's, the other's, and of different ones.

    Different are answers whose bytes or stamps differ, or that one of the two lacks.
    """
    types = {f"/{KNEE_CONTACT}": MESSAGE_TYPES[KNEE_CONTACT]}
    recorded = computed = different = 0
    with BagReader(recording, types) as one, BagReader(offline, types) as other:
        for mine, theirs in zip_longest(one.raw_messages(), other.raw_messages()):
            recorded += mine is not None
            computed += theirs is not None
            different += mine != theirs
    return recorded, computed, different


def soak_page(rate: float, moments: Sequence[Moment], compared: tuple[int, int, int]) -> Page:
    """Page of the long run; `compared` is what `same_answers` found."""
    counted = [moment for moment in moments if moment.ticks >= MEMORY_WARM_UP] or moments[-1:]
    last, first, largest = moments[-1], counted[0].resident_mb, max(moment.resident_mb for moment in counted)
    recorded, computed, different = map(str, compared)
    rows = [
        ["ticks", str(last.ticks)],
        ["lost", str(last.lost)],
        ["lowest rate published [Hz]", f"{min(moment.published_rate for moment in moments):.0f}"],
        ["largest median of latency [ms]", milliseconds(max(moment.median_ms for moment in moments))],
        ["largest p99 of latency [ms]", milliseconds(max(moment.p99_ms for moment in moments))],
        [f"node's memory after {counted[0].ticks} ticks [MB]", f"{first:.1f}"],
        ["its largest growth since then [MB]", f"{largest - first:.1f}"],
        ["node's memory at the end [MB]", f"{last.resident_mb:.1f}"],
        ["its child processes' memory at the end [MB]", last.children or "-"],
        ["others' part of the machine, at most [%]", f"{max(moment.others_percent for moment in moments):.0f}"],
        ["answers recorded", recorded],
        ["answers offline", computed],
        ["of these not identical", different],
    ]
    introduction = SOAK_INTRODUCTION.strip().format(about=OURS.about, rate=rate, period=PERIOD)
    return Page("Soak", introduction, (Section("Figures", "", ("long run", "value"), rows),), Moment._fields, moments)


# The command.


def measured(
    driver: Driver, work: Path, rate: float, duration: float, rounds: int, sustained: bool, soak: int
) -> Iterator[Page]:
    """Measure what is asked for, by default the comparison."""
    if not (sustained or soak):
        with progress("Measuring") as advance:
            parts = compare(driver, work, rate, duration, rounds, advance)
        yield latency_page(parts, rate, duration)
    if sustained:
        with progress("Searching the highest rates") as advance:
            yield sustained_page(find_rates(driver, work, rounds, advance))
    if soak:
        with progress("Running") as advance:
            moments = run_long(driver, work, rate, soak, advance)
        recording, offline = work / "node" / RECORDING, work / "offline.mcap"
        with progress("Computing the recording again") as advance:
            solve(recording, load_parameters([PARAMETERS]), offline, advance)
        yield soak_page(rate, moments, same_answers(recording, offline))


@click.command(help=__doc__)
@click.option("--output", type=click.Path(path_type=Path, file_okay=False), default="knee_contact_latency",
              show_default=True, help="Folder of the pages; those of an earlier run are replaced.")  # fmt: skip
@click.option("--rate", type=click.FloatRange(10.0, 20_000.0), default=1000.0, show_default=True, help="Samples/s.")
@click.option("--duration", type=click.FloatRange(0.5, 3600.0), default=20.0, show_default=True, help="s of a run.")
@click.option("--rounds", type=click.IntRange(1, 100), default=3, show_default=True, help="Turns of all candidates.")
@click.option("--sustained", is_flag=True, help="Search the highest rate that each candidate sustains instead.")
@click.option("--soak", type=click.IntRange(0, 1_000_000_000), default=0, metavar="TICKS",
              help="Run the node alone for so many ticks at --rate instead: memory and recording.")  # fmt: skip
def main(output: Path, rate: float, duration: float, rounds: int, sustained: bool, soak: int) -> None:
    """Measure, write a page and its data, and print its tables."""
    command = " ".join(["python -m benchmarks.latency", *sys.argv[1:]])
    with work_folder(output) as work, private_graph() as environment:
        os.environ.update(environment)
        with joined(Driver) as driver:
            pages = list(measured(driver, work, rate, duration, rounds, sustained, soak))
        files = [path for page in pages for path in write(page, work, command)]
        for path in files:
            replace(path, output / path.name)
    for page in pages:
        print(*(table(section.header, section.rows) for section in page.sections), sep="\n\n", end="\n\n")
    print(*(output / path.name for path in files), sep="\n")


if __name__ == "__main__":
    try:
        main()
    except UsageError as error:
        raise SystemExit(f"benchmarks.latency: {error}") from None
