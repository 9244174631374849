"""What a run amounts to: counts, and the peaks of load, contact force and depth."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.bags.mcap_metadata import metadata_records
from knee_contact_ros.bags.recorded_answers import answer_blocks, answer_topics
from knee_contact_ros.bags.writer import REFUSED_SAMPLES
from knee_contact_ros.core.types import Fidelity, Rows, Status
from knee_contact_ros.messages.ros_types import NANOSECONDS
from knee_contact_ros.messages.topics import KNEE_CONTACT, KNEE_CONTACT_LATERAL
from knee_contact_ros.parameters.compartments import Split
from knee_contact_ros.parameters.plausibility import Doubts
from knee_contact_ros.pipeline.gait.events import LOAD_PEAK, GaitEvent, GaitEvents

PEAKS = ("load", "contact_force", "penetration_depth")
"""Fields whose largest values are kept"""
LOOK_BACK = 3_000_000_000
"""[ns] A peak of the load is certain within two seconds"""


class Peak(NamedTuple):
    """A value and its stamp."""

    value: float
    """In the field's SI unit"""
    stamp: int
    """[ns]"""


class LoadPeak(NamedTuple):
    """The contact where the load has a local peak."""

    stamp: int
    """[ns]"""
    load: float
    """[N]"""
    contact_force: float
    """[N]"""
    penetration_depth: float
    """[m]"""


@dataclass
class Summary:
    """Running figures of a run of any length."""

    body_weight: float
    """[N]"""
    doubts: Doubts = field(default_factory=Doubts)
    """What makes no sense"""
    ticks: int = 0
    flagged: Counter[str] = field(default_factory=Counter)
    """Ticks per status bit"""
    refused: Counter[str] = field(default_factory=Counter)
    """Refused samples per reason"""
    damage: list[str] = field(default_factory=list)
    """What is wrong with the bag that was computed, as sentences"""
    levels: Counter[str] = field(default_factory=Counter)
    """Ticks by the level that computed them"""
    evaluations: int = 0
    largest_error: float = 0.0
    """[m] of the depth; infinite if one is not a number"""
    largest_force_error: float = 0.0
    """[N] of the contact force; infinite if one is not a number"""
    first_stamp: int = 0
    last_stamp: int = 0
    peaks: dict[str, Peak] = field(default_factory=dict)
    """Largest value of a field"""
    split: Split | None = None
    """Where the share that the medial compartment gets varies"""
    lateral: Summary | None = None
    """Of the lateral compartment, where there are two"""
    load_peaks: list[LoadPeak] = field(default_factory=list)
    """Where the load has a peak of stance; see `GaitEvents`. Complete after `finish`"""

    def __post_init__(self) -> None:
        self._events = GaitEvents(self.body_weight)
        self._recent = np.empty(0, [(name, np.int64 if name == "stamp" else np.float64) for name in LoadPeak._fields])

    def add(self, answers: Rows) -> None:
        """Take answers into account, at least one."""
        stamps, status = answers["stamp"], answers["status"]
        if not self.ticks:
            self.first_stamp = int(stamps[0])
        self.last_stamp = int(stamps[-1])
        self.ticks += len(answers)
        self.evaluations += int(answers["evaluations"].sum())
        for level, count in zip(*np.unique(answers["fidelity"], return_counts=True), strict=True):
            self.levels[Fidelity(int(level)).name.lower()] += int(count)
        self.largest_error = max(self.largest_error, bound(answers["error_estimate"]))
        self.largest_force_error = max(self.largest_force_error, bound(answers["force_error_estimate"]))
        for name in PEAKS:
            index = int(answers[name].argmax())
            value = float(answers[name][index])
            if name not in self.peaks or value > self.peaks[name].value:
                self.peaks[name] = Peak(value, int(stamps[index]))
        self.doubts.add_all(stamps, answers["load"], answers["penetration_depth"], status)
        self._find_peaks(answers)
        for bit in Status:
            if count := int(np.count_nonzero(status & bit)):
                self.flagged[bit.name or ""] += count

    def add_each(self, rows: Sequence[Rows]) -> None:
        """Take the answers of each compartment into account, the lateral one's in `lateral`."""
        for summary, answers in zip((self, self.lateral), rows, strict=False):
            if summary:
                summary.add(answers)

    def finish(self) -> None:
        """Nothing more comes."""
        self._keep(self._events.finish())
        if self.lateral:
            self.lateral.finish()

    def _find_peaks(self, answers: Rows) -> None:
        added = np.empty(len(answers), self._recent.dtype)
        for name in LoadPeak._fields:
            added[name] = answers[name]
        self._recent = np.concatenate((self._recent, added))
        self._keep(self._events.add(added["stamp"], np.zeros(len(added)), added["load"]))
        self._recent = self._recent[np.abs(self._recent["stamp"] - added["stamp"][-1]) <= LOOK_BACK]

    def _keep(self, events: Sequence[GaitEvent]) -> None:
        for event in events:
            if event.kind == LOAD_PEAK:
                at = np.flatnonzero(self._recent["stamp"] == event.stamp)[-1]
                self.load_peaks.append(LoadPeak(*self._recent[at].item()))

    @property
    def sentences(self) -> list[str]:
        """What makes no sense, in either compartment."""
        of_lateral = self.lateral.doubts.sentences if self.lateral else []
        return list(dict.fromkeys((*self.doubts.sentences, *of_lateral)))

    @property
    def warnings(self) -> list[str]:
        """Sentences for the user: what is implausible, and whether the share left the range that it was measured in."""
        return [*self.sentences, *([self.split.problem] if self.split and self.split.problem else [])]

    @property
    def duration(self) -> float:
        """From the first to the last tick [s]."""
        return (self.last_stamp - self.first_stamp) / NANOSECONDS


def bound(errors: float | NDArray[np.float64]) -> float:
    """The largest of some errors, at least one; what is not a number bounds nothing."""
    return float(np.nan_to_num(errors, nan=np.inf, posinf=np.inf).max())


def read_summary(recording: Path, body_weight: float, doubts: Doubts | None = None) -> Summary:
    """Summarise a recording, a file or a folder. `body_weight` is in N.

    `doubts` are those about its parameters, if they are known.
    """
    summary = Summary(body_weight, doubts or Doubts())
    if f"/{KNEE_CONTACT_LATERAL}" in answer_topics(recording):
        summary.lateral = Summary(body_weight)
    for topic, one in ((KNEE_CONTACT, summary), (KNEE_CONTACT_LATERAL, summary.lateral)):
        for answers in answer_blocks(recording, f"/{topic}") if one else ():
            one.add(answers)
    summary.finish()
    summary.refused = read_refused(recording)
    return summary


def read_refused(recording: Path) -> Counter[str]:
    """Refused samples by reason, as the recording, a file or a folder of several, tells."""
    records: dict[str, dict[str, str]] = {}
    for path in recording.glob("*.mcap") if recording.is_dir() else (recording,):
        records |= {record.name: record.metadata for record in metadata_records(path)}
    counts = records.get(REFUSED_SAMPLES, {})
    return Counter({reason: int(count) for reason, count in counts.items() if reason != "total"})
