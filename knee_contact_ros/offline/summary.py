"""Summary of a run: counts, and the peaks of load, contact force and depth."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..bags.answers import answer_blocks, answer_topics
from ..bags.bag import Bag, opened_bag
from ..bags.recorder import REFUSED_SAMPLES
from ..model.ringing import Ringing
from ..model.types import Fidelity, Rows, Status
from ..streams.gait_events import LOAD_PEAK, GaitEvent, GaitEvents
from ..streams.topics import KNEE_CONTACT, KNEE_CONTACT_LATERAL, NANOSECONDS
from ..streams.watch import Doubts, Split
from ..system.errors import join_faults
from .solve_blocks import AnswerBlock

PEAK_FIELDS = ("load", "contact_force", "penetration_depth")
"""Fields of an answer whose largest values are kept"""
RUN_BEGINS = "each begins at rest (TIME_RESET), where stamps went back or the node was reset"
"""Explanation of the runs of a summary"""
LOOK_BACK = 3_000_000_000
"""Time [ns] for which answers are kept: a peak of the load is certain within two seconds"""


class Moment(NamedTuple):
    """The contact at a peak."""

    stamp: int
    """Stamp [ns]"""
    load: float
    """Compressive load [N]"""
    contact_force: float
    """Contact force [N]"""
    penetration_depth: float
    """Penetration depth [m]"""
    status: int
    """Bits of `Status`"""
    run: int = 1
    """Number of its run, see `Summary.runs`"""

    @classmethod
    def of(cls, answer: Any, run: int) -> Moment:
        """Return the moment of an answer, a single one of `Rows`."""
        return cls._make([*(answer[name].item() for name in cls._fields[:-1]), run])


@dataclass
class Summary:
    """Figures of a run of any length, updated block by block."""

    body_weight: float
    """Body weight [N], the unit of reported forces"""
    doubts: Doubts = field(default_factory=Doubts)
    """Doubts about parameters and answers"""
    ringing: Ringing | None = field(default=None, compare=False)
    """Ringing of the contact force; None: not known"""
    ticks: int = 0
    """Number of ticks"""
    runs: int = 1
    """Number of runs: each begins at rest (`TIME_RESET`), and stamps may go back from one to the next"""
    duration: float = 0.0
    """Time [s] from the first to the last tick of all runs"""
    flagged: Counter[str] = field(default_factory=Counter)
    """Number of ticks by the name of a status bit that they have"""
    ticks_flagged: int = 0
    """Number of ticks with any status bit"""
    refused: Counter[str] = field(default_factory=Counter)
    """Number of refused samples by reason"""
    unanswered: str = ""
    """Sentence that many forces have no answer, and why; empty otherwise"""
    differing: str = ""
    """Sentence that the bag holds other answers than those that were computed; empty if it does not"""
    publishers: list[str] = field(default_factory=list)
    """Sentences about publishers of one input that disagree"""
    damage: list[str] = field(default_factory=list)
    """Damage of the bag that was computed, as sentences"""
    levels: Counter[str] = field(default_factory=Counter)
    """Number of ticks by the name of the level that computed them"""
    evaluations: int = 0
    """Number of contact-law evaluations"""
    largest_error: float = 0.0
    """Largest estimated error of the depth [m]; infinite if one is NaN"""
    largest_force_error: float = 0.0
    """Largest estimated error of the contact force [N]; infinite if one is NaN"""
    first_stamp: int = 0
    """Stamp [ns] of the first tick"""
    last_stamp: int = 0
    """Stamp [ns] of the last tick"""
    peaks: dict[str, Moment] = field(default_factory=dict)
    """Moments of the largest values of `PEAK_FIELDS` by field"""
    split: Split | None = None
    """Share of the load on the medial compartment, if it varies"""
    lateral: Summary | None = None
    """Summary of the lateral compartment, where there are two"""
    load_peaks: list[Moment] = field(default_factory=list)
    """Local peaks of the load in stance, complete after `complete`"""

    def __post_init__(self) -> None:
        self._events = GaitEvents(self.body_weight)
        self._recent = list[Rows]()  # blocks of answers

    def add_answers(self, answers: Rows) -> None:
        """Add a block of answers, at least one, to all figures."""
        first = 0
        for reset in [
            *np.flatnonzero(answers["status"] & Status.TIME_RESET).tolist(),
            len(answers),
        ]:
            if first < reset:
                self._add_run(answers[first:reset])
            if self.ticks and reset < len(answers):
                self._finish_run()
                self.runs += 1
            first = reset

    def _add_run(self, answers: Rows) -> None:
        """Add answers of the present run."""
        stamps, status = answers["stamp"], answers["status"]
        if not self.ticks:
            self.first_stamp = int(stamps[0])
        if len(self._recent):
            self.duration += int(stamps[0] - self.last_stamp) / NANOSECONDS
        self.duration += int(stamps[-1] - stamps[0]) / NANOSECONDS
        self.last_stamp = int(stamps[-1])
        self.ticks += len(answers)
        self.evaluations += int(answers["evaluations"].sum())
        for level, count in zip(*np.unique(answers["fidelity"], return_counts=True), strict=True):
            self.levels[Fidelity(int(level)).name.lower()] += int(count)
        self.largest_error = max(self.largest_error, largest_bound(answers["error_estimate"]))
        self.largest_force_error = max(
            self.largest_force_error, largest_bound(answers["force_error_estimate"])
        )
        for name in PEAK_FIELDS:
            largest = answers[int(answers[name].argmax())]
            if name not in self.peaks or largest[name] > getattr(self.peaks[name], name):
                self.peaks[name] = Moment.of(largest, self.runs)
        self.doubts.add_answers(answers)
        if self.ringing:
            self.ringing.add_answers(answers)
        self._find_peaks(answers)
        self.ticks_flagged += int(np.count_nonzero(status))
        for bit in Status:
            if count := int(np.count_nonzero(status & bit)):
                self.flagged[bit.name or ""] += count

    def add_block(self, block: AnswerBlock) -> None:
        """Add the answers of each compartment."""
        for summary, answers in zip((self, self.lateral), block.rows, strict=False):
            if summary:
                summary.add_answers(answers)

    def complete(self) -> None:
        """Complete the figures after the last answers."""
        self._finish_run()
        if self.lateral:
            self.lateral.complete()

    def _finish_run(self) -> None:
        self._keep_peaks(self._events.finish_events())
        self._events, self._recent = GaitEvents(self.body_weight), []

    def _find_peaks(self, answers: Rows) -> None:
        self._recent.append(answers)
        self._keep_peaks(
            self._events.add_samples(answers["stamp"], np.zeros(len(answers)), answers["load"])
        )
        self._recent = [
            rows
            for rows in self._recent
            if abs(rows["stamp"][-1] - answers["stamp"][-1]) <= LOOK_BACK
        ]

    def _keep_peaks(self, events: Sequence[GaitEvent]) -> None:
        for event in events:
            if event.kind == LOAD_PEAK:
                rows = next(
                    rows for rows in reversed(self._recent) if event.stamp in rows["stamp"]
                )
                at = np.flatnonzero(rows["stamp"] == event.stamp)[-1]
                self.load_peaks.append(Moment.of(rows[at], self.runs))

    @property
    def sentences(self) -> list[str]:
        """Doubts about parameters and answers of either compartment, and their ringing, as sentences."""
        lateral = self.lateral.sentences if self.lateral else []
        own = self.ringing.sentence if self.ringing else ""
        return list(dict.fromkeys(filter(None, (*self.doubts.sentences, own, *lateral))))

    @property
    def warnings(self) -> list[str]:
        """Sentences for the user about runs, publishers, implausible figures, and a share beyond its measured range."""
        resets = [f"the answers are of {self.runs} runs: {RUN_BEGINS}"] if self.runs > 1 else []
        return [
            *resets,
            *self.publishers,
            *([self.differing] if self.differing else []),
            *self.sentences,
            *([self.split.problem] if self.split and self.split.problem else []),
        ]

    def missing_parts(self, bag: Path, is_given: bool = True) -> str:
        """Return a sentence that the bag is damaged, or that many of its forces have no answer; empty if not.

        Likewise if it holds other answers, and the user has not given the parameters (`is_given`).
        """
        damage = (
            f" is damaged, and solved as far as it can be read: {join_faults(self.damage)}"
            if self.damage
            else ""
        )
        unanswered = f": {self.unanswered}" if self.unanswered else ""
        if not damage and not unanswered and self.differing and not is_given:
            return f"bag {bag}: its answers are others, as said above"
        return f"bag {bag}{damage}{unanswered}" if damage or unanswered else ""


def largest_bound(errors: float | NDArray[np.float64]) -> float:
    """Return the largest of estimated errors, at least one; infinite if one is NaN."""
    return float(np.nan_to_num(errors, nan=np.inf, posinf=np.inf).max())


def read_summary(
    recording: Path | Bag,
    body_weight: float,
    doubts: Doubts | None = None,
    ringing: Ringing | None = None,
) -> Summary:
    """Summarise the answers of a recording, a file or a folder.

    `body_weight` is in N; `doubts` and `ringing` are those of the recording's parameters, if these are known.
    """
    summary = Summary(body_weight, doubts or Doubts(), ringing)
    summaries = {KNEE_CONTACT: summary}
    with opened_bag(recording) as bag:
        if f"/{KNEE_CONTACT_LATERAL}" in answer_topics(bag):
            summary.lateral = summaries[KNEE_CONTACT_LATERAL] = Summary(body_weight)
        for topic, compartment in summaries.items():
            for answers in answer_blocks(bag, f"/{topic}"):
                compartment.add_answers(answers)
        summary.refused = refused_samples(bag)
    summary.complete()
    return summary


def refused_samples(recording: Bag) -> Counter[str]:
    """Return the number of refused samples by reason, from the metadata of a recording."""
    counts = dict(recording.metadata).get(REFUSED_SAMPLES, {})
    return Counter({reason: int(count) for reason, count in counts.items() if reason != "total"})
