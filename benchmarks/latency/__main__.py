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
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from functools import partial
from itertools import zip_longest
from pathlib import Path
from statistics import mean, median
from typing import Any, NamedTuple

import click
import numpy as np

from benchmarks.latency.commits import candidate, name_of
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
    figures,
    joined,
    running,
    taken,
    usage,
)
from benchmarks.latency.surroundings import (
    BESIDE,
    BUSY,
    REALTIME,
    SURROUNDINGS,
    Surroundings,
    node_in,
)
from benchmarks.report import Section, machine, save, table
from knee_contact_ros.bags.bag import Bag
from knee_contact_ros.commands.demo import RECORDING, node_process
from knee_contact_ros.offline.solve import solve
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.streams.topics import KNEE_CONTACT, MESSAGE_TYPES
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.output_files import replace, work_folder
from knee_contact_ros.system.processes import Child
from knee_contact_ros.system.progress import OnProgress, progress
from knee_contact_ros.system.ros import private_graph

"""Takes what is done and how much there is to do"""


class Page(NamedTuple):
    """One part of the measurement: its tables and its data."""

    title: str
    introduction: str
    sections: Sequence[Section]
    rows: Sequence[Any]
    """Named tuples: the data"""


def write(page: Page, folder: Path, command: str) -> list[Path]:
    """Write page and data under the page's title, and return their paths; `command` is what has made them."""
    paths = [folder / f"{page.title.lower()}{suffix}" for suffix in (".md", ".csv")]
    sections = [Section("", page.introduction.strip(), (), ()), *page.sections]
    save(paths[0], page.title, command, sections, machine(*DISTRIBUTIONS))
    with paths[1].open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(page.rows[0]._fields)
        writer.writerows(
            [f"{value:.6g}" if isinstance(value, float) else value for value in row]
            for row in page.rows
        )
    return paths


def milliseconds(time: float) -> str:
    """Format a time [ms]."""
    return "-" if math.isnan(time) else f"{time:.3f}" if time < 100.0 else f"{time:.0f}"


def turns(
    driver: Driver,
    work: Path,
    rounds: int,
    advance: OnProgress,
    candidates: Mapping[str, Candidate] = CANDIDATES,
) -> Iterator[tuple[int, str, Child]]:
    """Run all candidates round after round, each time another one first: the round's number, name and process.

    Raises:
        UsageError: a node failed.
    """
    names = list(candidates)
    for number in range(rounds):
        for place in range(len(names)):
            advance(number * len(names) + place, rounds * len(names))
            name = names[(number + place) % len(names)]
            with running(candidates[name], driver, work / "node") as node:
                yield number + 1, name, node
            shutil.rmtree(work / "node", ignore_errors=True)


# Latency at a given rate.

WARM_UP = 1.0
"""Time [s] that a node is fed before anything counts"""
LATENCY_INTRODUCTION = """
Latency is from just before a force is published to the receipt of its answer, both by the clock of the one process that
publishes angle and force and listens to `knee_contact`; it includes what this process takes, the same for all. Every
candidate is a process of its own, started anew for every round of {duration:g} s at {rate:g} Hz; the order changes from
round to round, and the first second does not count. Read the ratios: times are of this machine and this run.
"""
HOW_TO_READ = (
    "CPU time per sample is that of the node's process, and behind the plus that of its child processes. Slip: how "
    "late the measuring process was in publishing, which is not part of the latency. Others: the share of the "
    "machine's processors that other processes took; with more than a few per cent, measure again."
)


SURROUNDED = (
    "One run each. Busy processes use all processors; the measuring process waits for them, too, unless it is a "
    "real-time one, as a controller is. Further nodes get the same samples, and do the same work. The scene is served "
    "without a viewer. CPU is that of the measured node's process, per sample."
)


class Part(NamedTuple):
    """Run of one candidate in one round."""

    round: int
    candidate: str
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

    @property
    def latency(self) -> Figures:
        """Percentiles of the latency [ms]."""
        return Figures(self.median_ms, self.p99_ms, self.p999_ms, self.max_ms)


def measured(
    driver: Driver, node: Child, number: int, name: str, rate: float, duration: float
) -> Part:
    """Run a candidate that is there in a round of a number."""
    driver.run(rate, round(WARM_UP * rate))
    before = usage(node.process.pid)
    run = driver.run(rate, round(duration * rate))
    return Part(number, name, run, taken(before, usage(node.process.pid)))


def compare(
    driver: Driver,
    work: Path,
    rate: float,
    duration: float,
    rounds: int,
    advance: OnProgress,
    candidates: Mapping[str, Candidate],
) -> list[Part]:
    """Run all candidates at `rate` [Hz] for `duration` [s] per round."""
    return [
        measured(driver, node, number, name, rate, duration)
        for number, name, node in turns(driver, work, rounds, advance, candidates)
    ]


def surround(
    driver: Driver, work: Path, duration: float, advance: OnProgress
) -> dict[Surroundings, list[Part]]:
    """Run our node and a bare one, ordinary and real-time ones, for `duration` [s] in each of the surroundings."""
    found: dict[str, list[Part]] = {}
    total = len(SURROUNDINGS) * len(BESIDE)
    for place in SURROUNDINGS:
        for name in BESIDE:
            advance(sum(map(len, found.values())), total)
            with node_in(place, name, driver, work / "node") as node:
                part = measured(driver, node, 1, name, place.rate, duration)
            found.setdefault(place.name, []).append(part)
            shutil.rmtree(work / "node", ignore_errors=True)
    return {place: found[place.name] for place in SURROUNDINGS}


def surroundings_section(found: dict[Surroundings, list[Part]]) -> tuple[Section, list[Line]]:
    """Table of the surroundings, and its rows for latency.csv."""
    lines = [
        line(parts, place.rate, part.candidate)._replace(
            candidate=f"{place.name}: {part.candidate}"
        )
        for place, parts in found.items()
        for part in parts
    ]
    rows = [
        [each.candidate, *map(milliseconds, each.latency), str(each.lost), f"{each.cpu_us:.0f}"]
        for each in lines
    ]
    header = ("latency [ms]", "median", "p99", "p99.9", "max", "lost", "CPU [us]")
    return Section("Surroundings", SURROUNDED, header, rows), lines


def line(parts: Sequence[Part], rate: float, name: str, number: int = 0) -> Line:
    """Row of latency.csv for a candidate's part in a round, or for its parts in all rounds."""
    parts = [part for part in parts if part.candidate == name and number in (0, part.round)]
    published = sum(part.run.published for part in parts)
    return Line(
        name,
        str(number or "all"),
        rate,
        published,
        sum(part.run.lost for part in parts),
        *figures([latency for part in parts for latency in part.run.latencies]),
        1e6 * sum(part.taken.cpu for part in parts) / published,
        1e6 * sum(part.taken.cpu_children for part in parts) / published,
        *figures([slip for part in parts for slip in part.run.slips]),
        mean(part.taken.others_percent for part in parts),
    )


def latency_page(
    parts: Sequence[Part],
    rate: float,
    duration: float,
    candidates: Mapping[str, Candidate],
    surrounded: dict[Surroundings, list[Part]],
) -> Page:
    """Page of the comparison; its data have a row per candidate and round, and one per candidate for all rounds."""
    rounds = sorted({part.round for part in parts})
    single = [
        line(parts, rate, name, number)
        for name in candidates
        for number in rounds
        if len(rounds) > 1
    ]
    every = {name: line(parts, rate, name) for name in candidates}
    shown = [
        [
            each.candidate,
            *map(milliseconds, each.latency),
            str(each.lost),
            f"{each.cpu_us:.0f}"
            + (f" + {each.cpu_children_us:.0f}" if each.cpu_children_us else ""),
            milliseconds(each.slip_p99_ms),
            f"{each.others_percent:.0f}",
        ]
        for each in every.values()
    ]
    header = (
        "latency [ms]",
        "median",
        "p99",
        "p99.9",
        "max",
        "lost",
        "CPU [us]",
        "slip's p99 [ms]",
        "others [%]",
    )
    sections = (
        Section(
            "Candidates",
            "",
            ("candidate", "what it does"),
            [[name, c.about] for name, c in candidates.items()],
        ),
        Section("Latency", HOW_TO_READ, header, shown),
        ratios(single, every),
    )
    table, more = surroundings_section(surrounded)
    introduction = LATENCY_INTRODUCTION.format(rate=rate, duration=duration)
    every_section = [*sections, table] if more else sections
    return Page("Latency", introduction, every_section, [*single, *every.values(), *more])


def ratios(single: Sequence[Line], every: dict[str, Line]) -> Section:
    """Table of ratios to the bare node: round by round for ours, all rounds together for the others."""
    bare = {each.round: each.latency for each in single if each.candidate == BARE} | {
        "all": every[BARE].latency
    }
    chosen = [each for each in single if each.candidate == OURS] + [
        each for each in every.values() if each != every[BARE]
    ]
    rows = [
        [
            each.candidate if each.round == "all" else f"{each.candidate}, round {each.round}",
            *(
                f"{mine / theirs:.2f}"
                for mine, theirs in zip(each.latency[:3], bare[each.round][:3], strict=True)
            ),
        ]
        for each in chosen
    ]
    return Section("Ratios", "", (f"latency over that of {BARE}", "median", "p99", "p99.9"), rows)


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
SUSTAINED_INTRODUCTION = f"""
A rate is sustained if every sample of {STEP:g} s is answered, the last one and the median one within {1e3 * SOON:g} ms,
and at least {1e2 * PUNCTUAL:g} % of the rate was published. It rises from {FIRST:g} Hz by a factor of {FACTOR:g} until
it fails twice in a row; {BISECTIONS} bisections follow. What the limit is: `node` if answers were missing or late,
`sender` if the process that publishes and listens could do no more (one and the same for all candidates; then the node
may sustain more). A candidate is started anew for every round. Others are the other processes of this machine: with
more than a few per cent, measure again.
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

    low = 0.0
    high = FIRST
    while sustains(high):
        low = high
        high = high * FACTOR
        if high >= HIGHEST:
            return steps
    for _ in range(BISECTIONS if low else 0):
        rate = math.sqrt(low * high)
        low, high = (rate, high) if sustains(rate) else (low, rate)
    return steps


def attempt_at(driver: Driver, node: Child, name: str, number: int, rate: float) -> Step:
    """Try a rate [Hz] once with a node that is running."""
    before = usage(node.process.pid)
    run = driver.run(rate, round(STEP * rate))
    middle = figures(run.latencies).median
    soon = run.tail <= SOON and 1e-3 * middle <= SOON and not run.lost
    verdict = SENDER if run.published_rate < PUNCTUAL * rate else SUSTAINED if soon else NODE
    others = taken(before, usage(node.process.pid)).others_percent
    return Step(
        number,
        name,
        rate,
        run.published_rate,
        run.published,
        run.lost,
        middle,
        1e3 * run.tail,
        verdict,
        others,
    )


def find_rates(driver: Driver, work: Path, rounds: int, advance: OnProgress) -> list[Step]:
    """Search the rates of all candidates, round after round."""
    steps: list[Step] = []
    for number, name, node in turns(driver, work, rounds, advance):
        driver.run(FIRST, round(FIRST))
        steps += search(partial(attempt_at, driver, node, name, number))
    return steps


def highest(steps: Sequence[Step], name: str, number: int) -> tuple[float, str]:
    """Highest rate [Hz] that a candidate sustained in a round (0 if there is none), and what the limit was."""
    mine = [step for step in steps if step.candidate == name and step.round == number]
    best = max((step.rate for step in mine if step.verdict == SUSTAINED), default=0.0)
    beyond = [step for step in mine if step.rate > best]
    lowest = min((step.rate for step in beyond), default=0.0)
    return best, "/".join(sorted({step.verdict for step in beyond if step.rate == lowest})) or "-"


def sustained_page(steps: Sequence[Step]) -> Page:
    """Page of the sustained rates, with its data."""
    numbers = sorted({step.round for step in steps})
    rows = []
    bare = [highest(steps, BARE, number)[0] for number in numbers]
    for name in CANDIDATES:
        rates, limits = zip(*(highest(steps, name, number) for number in numbers), strict=True)
        to_bare = [mine / theirs for mine, theirs in zip(rates, bare, strict=True) if theirs]
        others = [step.others_percent for step in steps if step.candidate == name]
        rows.append(
            [
                name,
                f"{median(rates):.0f}",
                f"{min(rates):.0f}-{max(rates):.0f}",
                ", ".join(sorted({*limits})),
                f"{median(to_bare):.2f}" if to_bare else "-",
                f"{mean(others):.0f} %" if others else "-",
            ]
        )
    header = ("sustained [Hz]", "median", "rounds", "limit", f"/ {BARE}", "others")
    return Page("Sustained", SUSTAINED_INTRODUCTION, (Section("Rates", "", header, rows),), steps)


# A long run of our node alone: its memory, and whether its recording equals what its samples give offline.

PERIOD = 10_000
"""Ticks between two looks at the memory"""
MEMORY_WARM_UP = 50_000
"""Ticks after which memory must not grow"""
SOAK_PATIENCE = 1200.0
"""Time [s] within which the node must complete its files"""
MB = 1e6
LATE = 10.0
"""Latency [ms] of an answer that is late for a controller"""
BUSY_SOAK = "real-time, beside four busy processes and heard by a real-time process"
SOAK_INTRODUCTION = """
The node ({about}) {place}, fed at {rate:g} Hz. Memory is resident memory, looked at every {period} ticks. At the end
the recording is computed again offline, and all bytes of its `knee_contact` messages are compared.
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


def run_long(
    start: Callable[[], AbstractContextManager[Child]],
    driver: Driver,
    rate: float,
    ticks: int,
    advance: OnProgress,
) -> tuple[list[Moment], list[int]]:
    """Run a node for a number of ticks at `rate` [Hz], and return its moments and all latencies [ns].

    Raises:
        UsageError: the node failed.
    """
    moments: list[Moment] = []
    latencies: list[int] = []
    done = lost = 0
    with start() as node:
        while done < ticks:
            advance(done, ticks)
            before = usage(node.process.pid)
            run = driver.run(rate, min(PERIOD, ticks - done))
            after = usage(node.process.pid)
            node.check()
            done = done + run.published
            lost = lost + run.lost
            latencies += run.latencies
            (_, own), *others = after.resident.items()
            children = ", ".join(f"{number}: {resident / MB:.1f}" for number, resident in others)
            moments.append(
                Moment(
                    done,
                    own / MB,
                    children,
                    lost,
                    run.published_rate,
                    *figures(run.latencies),
                    taken(before, after).others_percent,
                )
            )
        advance(done, ticks)
    return moments, latencies


def same_answers(recording: Path, offline: Path) -> tuple[int, int, int]:
    """Compare the answers of two recordings in their order: numbers of the one's, the other's, and of different ones.

    Different are answers whose bytes or stamps differ, or that one of the two lacks.
    """
    types = {f"/{KNEE_CONTACT}": MESSAGE_TYPES[KNEE_CONTACT]}
    recorded = computed = different = 0
    with Bag(recording) as one, Bag(offline) as other:
        each = (bag.select(types).raw_messages() for bag in (one, other))
        for mine, theirs in zip_longest(*each):
            recorded += mine is not None
            computed += theirs is not None
            different += mine != theirs
    return recorded, computed, different


def soak_page(
    rate: float,
    place: str,
    moments: Sequence[Moment],
    latencies: Sequence[int],
    compared: tuple[int, int, int],
) -> Page:
    """Page of the long run with all its latencies [ns]; `compared` is what `same_answers` found."""
    counted = [moment for moment in moments if moment.ticks >= MEMORY_WARM_UP] or moments[-1:]
    last = moments[-1]
    first = counted[0].resident_mb
    largest = max(moment.resident_mb for moment in counted)
    recorded, computed, different = map(str, compared)
    every = figures(latencies)
    rows = [
        ["ticks", str(last.ticks)],
        ["lost", str(last.lost)],
        ["lowest rate published [Hz]", f"{min(moment.published_rate for moment in moments):.0f}"],
        ["median of latency [ms]", milliseconds(every.median)],
        ["p99 of latency [ms]", milliseconds(every.p99)],
        ["p99.9 of latency [ms]", milliseconds(every.p999)],
        ["largest latency [ms]", milliseconds(every.largest)],
        [
            f"answers later than {LATE:g} ms",
            str(sum(latency > LATE * 1e6 for latency in latencies)),
        ],
        [
            f"largest median of {PERIOD} ticks [ms]",
            milliseconds(max(moment.median_ms for moment in moments)),
        ],
        [
            f"largest p99 of {PERIOD} ticks [ms]",
            milliseconds(max(moment.p99_ms for moment in moments)),
        ],
        [f"node's memory after {counted[0].ticks} ticks [MB]", f"{first:.1f}"],
        ["its largest growth since then [MB]", f"{largest - first:.1f}"],
        ["node's memory at the end [MB]", f"{last.resident_mb:.1f}"],
        ["its child processes' memory at the end [MB]", last.children or "-"],
        [
            "others' part of the machine, at most [%]",
            f"{max(moment.others_percent for moment in moments):.0f}",
        ],
        ["answers recorded", recorded],
        ["answers offline", computed],
        ["of these not identical", different],
    ]
    introduction = SOAK_INTRODUCTION.format(
        about=CANDIDATES[OURS].about, place=place, rate=rate, period=PERIOD
    )
    return Page(
        "Soak", introduction, (Section("Figures", "", ("long run", "value"), rows),), moments
    )


def soaked(
    driver: Driver, work: Path, rate: float, ticks: int, realtime: bool, advance: OnProgress
) -> Page:
    """Make the long run, and compute its recording again."""
    folder = work / "node"
    if realtime:
        place = Surroundings(BUSY_SOAK, rate, beside=(BUSY,) * 4, listens_first=True)
        start = partial(node_in, place, REALTIME, driver, folder, SOAK_PATIENCE)
        recording = folder / "0" / "knee.mcap"
    else:
        candidate = CANDIDATES[OURS]._replace(start=partial(node_process, [PARAMETERS]))
        start = partial(running, candidate, driver, folder, SOAK_PATIENCE)
        recording = folder / RECORDING
    moments, latencies = run_long(start, driver, rate, ticks, advance)
    offline = work / "offline.mcap"
    with Bag(recording) as bag:
        solve(bag, load_parameters([PARAMETERS]), offline, advance)
    compared = same_answers(recording, offline)
    return soak_page(rate, BUSY_SOAK if realtime else "alone", moments, latencies, compared)


@click.command(help=__doc__)
@click.option(
    "--output",
    type=click.Path(path_type=Path, file_okay=False),
    default="knee_contact_latency",
    show_default=True,
    help="Folder of the page, which replaces an earlier one.",
)
@click.option(
    "--rate",
    type=click.FloatRange(10.0, 20_000.0),
    default=1000.0,
    show_default=True,
    help="Samples/s.",
)
@click.option(
    "--duration",
    type=click.FloatRange(0.5, 3600.0),
    default=20.0,
    show_default=True,
    help="s of a run.",
)
@click.option(
    "--rounds",
    type=click.IntRange(1, 100),
    default=3,
    show_default=True,
    help="Turns of all candidates.",
)
@click.option(
    "--against",
    multiple=True,
    metavar="COMMIT",
    help="Also measure the node of another commit, in turns; its environment is made once, in build/commits.",
)
@click.option(
    "--surroundings",
    is_flag=True,
    help="Also measure other rates, several nodes, a busy machine, a busy disk, a served scene, and --realtime.",
)
@click.option(
    "--raw",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Also write all latencies [ns] to a file of NumPy (npz).",
)
@click.option(
    "--sustained",
    is_flag=True,
    help="Search the highest rate that each candidate sustains instead.",
)
@click.option(
    "--soak",
    type=click.IntRange(0, 1_000_000_000),
    default=0,
    metavar="TICKS",
    help="Run the node alone for so many ticks at --rate instead: memory and recording.",
)
@click.option(
    "--realtime",
    is_flag=True,
    help="With --soak: the node and who listens are real-time ones, beside four busy processes.",
)
def main(
    output: Path,
    rate: float,
    duration: float,
    rounds: int,
    against: tuple[str, ...],
    surroundings: bool,
    raw: Path | None,
    sustained: bool,
    soak: int,
    realtime: bool,
) -> None:
    """Measure, write a page and its data, and print its tables."""
    command = " ".join(["python -m benchmarks.latency", *sys.argv[1:]])
    command += f"` at commit `{name_of('HEAD')}"
    candidates = CANDIDATES | {f"this node, {commit}": candidate(commit) for commit in against}
    with work_folder(output) as work, private_graph() as environment:
        os.environ.update(environment)
        with joined(Driver) as driver, progress("Measuring") as advance:
            if soak:
                page = soaked(driver, work, rate, soak, realtime, advance)
            elif sustained:
                page = sustained_page(find_rates(driver, work, rounds, advance))
            else:
                parts = compare(driver, work, rate, duration, rounds, advance, candidates)
                found = surround(driver, work, duration, advance) if surroundings else {}
                page = latency_page(parts, rate, duration, candidates, found)
                if raw:
                    every = {f"{each.candidate}, round {each.round}": each for each in parts}
                    for place, others in found.items():
                        every |= {f"{place.name}: {each.candidate}": each for each in others}
                    names = {name: each.run.latencies for name, each in every.items()}
                    np.savez_compressed(raw, **names)  # type: ignore[arg-type]
        for path in write(page, work, command):
            replace(path, output / path.name)
            print(output / path.name)
    print(*(table(section.header, section.rows) for section in page.sections), sep="\n\n")


if __name__ == "__main__":
    try:
        main()
    except UsageError as error:
        raise SystemExit(f"benchmarks.latency: {error}") from None
