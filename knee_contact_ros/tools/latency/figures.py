"""Statistics of times."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np


class Figures(NamedTuple):
    """Percentiles of a number of times, all in [ms]; nan if there is none."""

    median: float
    p99: float
    p999: float
    largest: float


def figures(nanoseconds: Sequence[int]) -> Figures:
    """Compute the percentiles of times [ns]; between two times a percentile is interpolated linearly."""
    if not nanoseconds:
        return Figures(*[math.nan] * 4)
    median, p99, p999, largest = (np.percentile(nanoseconds, [50.0, 99.0, 99.9, 100.0]) * 1e-6).tolist()
    return Figures(median, p99, p999, largest)


def ratios(ours: Figures, theirs: Figures) -> Figures:
    """Divide each figure by the other one; nan where the other one is 0."""
    return Figures(*(mine / their if their else math.nan for mine, their in zip(ours, theirs, strict=True)))
