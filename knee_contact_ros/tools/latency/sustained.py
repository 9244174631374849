"""The highest rate that a node sustains: every sample answered, and the last ones soon."""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from statistics import mean, median
from typing import NamedTuple

from knee_contact_ros.system.processes import Child
from knee_contact_ros.tools.latency.candidates import BARE, CANDIDATES, Candidate, rotated, running
from knee_contact_ros.tools.latency.driver import Driver, Run
from knee_contact_ros.tools.latency.figures import figures
from knee_contact_ros.tools.latency.report import Cell, Page, Sheet, ratio
from knee_contact_ros.tools.latency.usage import between, snapshot

FIRST = 500.0
"""Rate [Hz] at which a search begins"""
FACTOR = 1.25
"""Ratio of each rate to the one before"""
BISECTIONS = 2
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
INTRODUCTION = """
A rate is sustained if every sample of {step:g} s is answered, the last one and the median one within {soon:g} ms, and
at least {punctual:g} % of the rate was published. It rises from {first:g} Hz by a factor of {factor:g} until it fails
twice in a row; {bisections} bisections follow. What the limit is: `node` if answers were missing or late, `sender` if
the process that publishes and listens could do no more (one and the same for all candidates; then the node may sustain
more). A candidate is started anew for every round.
"""


class Step(NamedTuple):
    """One attempt at a rate."""

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
    steps, low, rate = [], 0.0, FIRST
    while rate < HIGHEST:
        tried = several(attempt, rate)
        steps += tried
        if tried[-1].verdict != SUSTAINED:
            break
        low, rate = rate, rate * FACTOR
    else:
        return steps
    high = rate
    for _ in range(BISECTIONS if low else 0):
        rate = math.sqrt(low * high)
        tried = several(attempt, rate)
        steps += tried
        low, high = (rate, high) if tried[-1].verdict == SUSTAINED else (low, rate)
    return steps


def several(attempt: Callable[[float], Step], rate: float) -> list[Step]:
    """Try a rate [Hz] until it is sustained, or has failed `TRIES` times."""
    steps: list[Step] = []
    while len(steps) < TRIES and not (steps and steps[-1].verdict == SUSTAINED):
        steps.append(attempt(rate))
    return steps


def judged(run: Run, rate: float) -> str:
    """Verdict on a run at a rate [Hz]: `SUSTAINED`, or whether `NODE` or `SENDER` was the limit."""
    if run.published_rate < PUNCTUAL * rate:
        return SENDER
    keeps_up = run.tail <= SOON and 1e-3 * figures(run.latencies).median <= SOON
    return SUSTAINED if keeps_up and not run.lost else NODE


def attempt_at(driver: Driver, node: Child, candidate: Candidate, number: int, rate: float) -> Step:
    """Try a rate [Hz] once with a node that is running."""
    before = snapshot(node.process.pid)
    run = driver.run(rate, round(STEP * rate))
    taken = between(before, snapshot(node.process.pid))
    return Step(
        number, candidate.name, rate, run.published_rate, run.published, run.lost,
        figures(run.latencies).median, 1e3 * run.tail, judged(run, rate), taken.others_percent,
    )  # fmt: skip


def find_rates(driver: Driver, work: Path, rounds: int, advance: Callable[[int, int], None]) -> list[Step]:
    """Search the rates of all candidates, round after round; `advance` takes the searches done and their number.

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


def page(steps: Sequence[Step]) -> Page:
    """Page of the sustained rates, with its data."""
    numbers = sorted({step.round for step in steps})
    rows: list[list[Cell]] = []
    for candidate in CANDIDATES:
        rates = [highest(steps, candidate, number) for number in numbers]
        limits = sorted({limit(steps, candidate, number) for number in numbers})
        to_bare = [
            mine / theirs
            for number, mine in zip(numbers, rates, strict=True)
            if (theirs := highest(steps, BARE, number))
        ]
        others = [step.others_percent for step in steps if step.candidate == candidate.name]
        rows.append(
            [candidate.name, f"{median(rates):.0f}", f"{min(rates):.0f}-{max(rates):.0f}", ", ".join(limits),
             ratio(median(to_bare)) if to_bare else "-", f"{mean(others):.0f} %" if others else "-"]
        )  # fmt: skip
    introduction = INTRODUCTION.strip().format(
        step=STEP, soon=1e3 * SOON, punctual=1e2 * PUNCTUAL, first=FIRST, factor=FACTOR, bisections=BISECTIONS
    )
    header = ("sustained [Hz]", "median", "rounds", "limit", f"/ {BARE.name}", "others")
    about = "Others are the other processes of this machine: with more than a few per cent, measure again."
    return Page("Sustained", introduction, (Sheet("Rates", header, rows, about),), Step._fields, steps)
