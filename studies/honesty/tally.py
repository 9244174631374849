"""Counts of many runs, which add up."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.model.types import Fidelity
from studies.honesty.judging import Judged, Verdict

Counts = NDArray[np.int64]
LOWEST, WIDTH, BINS = -4.0, 0.02, 1200
"""Ratios are counted by their decimal logarithm"""


def _histogram() -> Counts:
    return np.zeros(BINS, dtype=np.int64)


@dataclass
class Quantity:
    """Counts of one quantity."""

    known: int = 0
    large: int = 0
    covered: int = 0
    covered_large: int = 0
    wrong: int = 0
    wrong_runs: int = 0
    """Number of runs with a wrong tick"""
    contact: Counts = field(default_factory=_histogram)
    """Histogram of the ratios of estimate to error in contact"""
    apart: Counts = field(default_factory=_histogram)
    """Histogram of the ratios while apart"""
    right: Counts = field(default_factory=_histogram)
    """Histogram of the ratios of ticks that are said right, in contact or apart"""

    def count(self, verdict: Verdict, apart: NDArray[np.bool_], said_right: NDArray[np.bool_]) -> None:
        """Count a run."""
        self.known += int(verdict.known.sum())
        self.large += int(verdict.large.sum())
        self.covered += int(verdict.covered.sum())
        self.covered_large += int((verdict.covered & verdict.large).sum())
        self.wrong += int(verdict.wrong.sum())
        self.wrong_runs += int(verdict.wrong.any())
        self.contact += _binned(verdict.ratio[verdict.large & ~apart])
        self.apart += _binned(verdict.ratio[verdict.large & apart])
        self.right += _binned(verdict.ratio[verdict.large & said_right])

    def add(self, other: Quantity) -> None:
        """Add the counts of other runs."""
        _add(self, other)


@dataclass
class Tally:
    """Counts of many runs."""

    runs: int = 0
    ticks: int = 0
    flagged: int = 0
    claimed: int = 0
    evaluations: int = 0
    static: int = 0
    """Number of ticks answered with the static contact"""
    depth: Quantity = field(default_factory=Quantity)
    force: Quantity = field(default_factory=Quantity)

    def count(self, judged: Judged) -> None:
        """Count a run."""
        self.runs += 1
        self.ticks += len(judged.apart)
        self.flagged += int((~judged.said_right).sum())
        self.claimed += int(judged.claimed.sum())
        self.evaluations += int(judged.evaluations.sum())
        self.static += int(np.sum(judged.fidelity == Fidelity.QUASI_STATIC))
        self.depth.count(judged.depth, judged.apart, judged.said_right)
        if judged.force is not None:
            self.force.count(judged.force, judged.apart, judged.said_right)

    def add(self, other: Tally) -> None:
        """Add the counts of other runs."""
        _add(self, other)


def _add(counts: Tally | Quantity, others: Tally | Quantity) -> None:
    for one in fields(counts):
        mine, theirs = getattr(counts, one.name), getattr(others, one.name)
        if isinstance(mine, Quantity):
            mine.add(theirs)
        else:
            setattr(counts, one.name, mine + theirs)


def _binned(ratios: NDArray[np.float64]) -> Counts:
    """Histogram of ratios; what is not finite counts as the largest, 0 as the smallest."""
    with np.errstate(divide="ignore", invalid="ignore"):
        place = (np.log10(np.where(np.isnan(ratios), np.inf, ratios)) - LOWEST) / WIDTH
    return np.bincount(np.clip(np.nan_to_num(place, posinf=BINS), 0, BINS - 1).astype(int), minlength=BINS)


def not_finite(series: np.recarray[Any, Any]) -> int:
    """Count the ticks with a number that is not finite."""
    fields = ("penetration_depth", "gap", "contact_force", "femoral_height", "error_estimate", "force_error_estimate")
    return int(np.sum(~np.all([np.isfinite(series[field]) for field in fields], axis=0)))


def percentile(histogram: Counts, percent: float) -> float:
    """Percentile of the ratios of a histogram, to 5 %; nan if it is empty."""
    total = int(histogram.sum())
    if total == 0:
        return float("nan")
    place = int(np.searchsorted(np.cumsum(histogram), 0.01 * percent * total))
    return float(10 ** (LOWEST + WIDTH * (place + 0.5)))
