"""Identifiability: correlations of the estimates, and directions in which parameters change no answer."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.tools.calibration.fit import Minimum
from knee_contact_ros.tools.calibration.profile import Interval, covariance
from knee_contact_ros.tools.calibration.unknowns import Unknown

Floats = NDArray[np.float64]
HIGH = 0.95
"""Correlation above which two parameters trade off"""
PART = 0.3
"""The least component that a parameter has in a direction to belong to it"""
WIDE = 2.0
"""Ratio of the ends of an interval from which on a value counts as not known"""
SHOWN = 0.1
"""Relative change of the first parameter in the description of a trade-off"""


def correlation(minimum: Minimum) -> Floats:
    """Compute the correlation matrix of the estimates in the linear approximation, shape (p, p)."""
    spread = covariance(minimum)
    deviations = np.sqrt(np.maximum(np.diag(spread), np.finfo(float).tiny))
    matrix: Floats = np.clip(spread / np.outer(deviations, deviations), -1.0, 1.0)
    return matrix


def trades(minimum: Minimum, intervals: Sequence[Interval] | None) -> list[str]:
    """Describe each pair, or larger group, of parameters that trade off, in a sentence.

    Args:
        minimum: The fit.
        intervals: Intervals of the parameters; None if they were not computed.
    """
    unknowns = minimum.problem.unknowns
    matrix, spread = correlation(minimum), covariance(minimum)
    sentences, paired = [], set()
    for one, other in itertools.combinations(range(len(unknowns)), 2):
        r = float(matrix[one, other])
        if abs(r) > HIGH:
            paired |= {one, other}
            slope = float(spread[one, other] / spread[one, one])
            sentences.append(_pair(unknowns[one], unknowns[other], r, slope, _wide(intervals, (one, other))))
    slopes = minimum.problem.jacobian(minimum.place, minimum.noise)
    sizes = np.linalg.norm(slopes, axis=0)
    _, singular, directions = np.linalg.svd(slopes / np.where(sizes > 0.0, sizes, 1.0), full_matrices=False)
    null_directions = directions[singular < math.sqrt(1.0 - HIGH)]
    group = {int(index) for index in np.flatnonzero(np.linalg.norm(null_directions, axis=0) > PART)}
    if len(group) > 2 and not group <= paired:
        names = [unknowns[index].name for index in sorted(group)]
        sentences.append(
            f"{', '.join(names[:-1])} and {names[-1]} trade off: changed together, they leave nearly the same answers; "
            f"{_what_to_do(_wide(intervals, sorted(group)))}"
        )
    return sentences


def _pair(one: Unknown, other: Unknown, r: float, slope: float, wide: bool) -> str:
    if one.scale:
        step, first = SHOWN, f"{one.name} {SHOWN * one.scale:.3g} {one.unit} up".replace("  ", " ")
    else:
        step, first = math.log1p(SHOWN), f"{one.name} {100.0 * SHOWN:.0f} % up"
    other_step = slope * step
    if other.scale:
        second = f"{other.name} {abs(other_step * other.scale):.3g} {other.unit}".strip()
    else:
        second = f"{other.name} {abs(100.0 * math.expm1(other_step)):.3g} %"
    way = "up" if other_step > 0.0 else "down"
    return (f"{one.name} and {other.name} trade off (correlation {r:.4f}): {first} with {second} {way} leaves nearly "
            f"the same answers; {_what_to_do(wide)}")  # fmt: skip


def _what_to_do(wide: bool) -> str:
    if wide:
        return "these data cannot tell them apart: hold one of them, or measure over a wider range"
    return "take them from one fit, never one of them alone"


def _wide(intervals: Sequence[Interval] | None, indices: Sequence[int]) -> bool:
    """Whether one of these parameters is hardly known; without intervals all count so."""
    return intervals is None or not all(_is_known(intervals[index]) for index in indices)


def _is_known(interval: Interval) -> bool:
    low, high, low_open, high_open = interval
    near = low * high > 0.0 and max(abs(low), abs(high)) < WIDE * min(abs(low), abs(high))
    return near and not low_open and not high_open
