"""The statistics of the study."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np


class Figures(NamedTuple):
    """Figures of a number of times, all in [ms]; nan if there is none."""

    median: float
    p99: float
    p999: float
    largest: float


def figures(nanoseconds: Sequence[int]) -> Figures:
    """Figures of times [ns]; between two of them a percentile is interpolated linearly."""
    if not nanoseconds:
        return Figures(*[math.nan] * 4)
    median, p99, p999, largest = (np.percentile(nanoseconds, [50.0, 99.0, 99.9, 100.0]) * 1e-6).tolist()
    return Figures(median, p99, p999, largest)


def ratios(ours: Figures, theirs: Figures) -> Figures:
    """Each figure over the other one."""
    return Figures(*(mine / their if their else math.nan for mine, their in zip(ours, theirs, strict=True)))
