"""Whether the data can tell the parameters apart: correlations of the estimates, and directions that change nothing."""

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
"""Correlation from which on two parameters trade off"""
PART = 0.3
"""Of a direction that a parameter must have to take part in it"""
WIDE = 2.0
"""High end over low end of an interval from which on a value is not known"""
SHOWN = 0.1
"""Change of the first parameter that a trade is told by: ten percent"""


def correlation(minimum: Minimum) -> Floats:
    """Of the estimates along straight lines, shape (p, p)."""
    spread = covariance(minimum)
    deviations = np.sqrt(np.maximum(np.diag(spread), np.finfo(float).tiny))
    found: Floats = np.clip(spread / np.outer(deviations, deviations), -1.0, 1.0)
    return found


def trades(minimum: Minimum, found: Sequence[Interval] | None) -> list[str]:
    """A sentence for each pair, or larger group, of parameters that trade off, and how."""
    unknowns = minimum.problem.unknowns
    matrix, spread = correlation(minimum), covariance(minimum)
    told, paired = [], set()
    for one, other in itertools.combinations(range(len(unknowns)), 2):
        r = float(matrix[one, other])
        if abs(r) > HIGH:
            paired |= {one, other}
            slope = float(spread[one, other] / spread[one, one])
            told.append(_pair(unknowns[one], unknowns[other], r, slope, _wide(found, (one, other))))
    slopes = minimum.problem.jacobian(minimum.place, minimum.noise)
    sizes = np.linalg.norm(slopes, axis=0)
    _, singular, directions = np.linalg.svd(slopes / np.where(sizes > 0.0, sizes, 1.0), full_matrices=False)
    nothing = directions[singular < math.sqrt(1.0 - HIGH)]
    group = {int(index) for index in np.flatnonzero(np.linalg.norm(nothing, axis=0) > PART)}
    if len(group) > 2 and not group <= paired:
        names = [unknowns[index].name for index in sorted(group)]
        told.append(f"{', '.join(names[:-1])} and {names[-1]} trade off: changed together, they leave nearly the "
                    f"same answers; {_what_to_do(_wide(found, sorted(group)))}")  # fmt: skip
    return told


def _pair(one: Unknown, other: Unknown, r: float, slope: float, wide: bool) -> str:
    size = SHOWN if not one.scale else SHOWN * one.scale
    first = (
        f"{one.name} {100.0 * SHOWN:.0f} % up"
        if not one.scale
        else f"{one.name} {size:.3g} {one.unit} up".replace("  ", " ")
    )
    step = slope * (math.log1p(SHOWN) if not one.scale else SHOWN)
    if other.scale:
        second = f"{other.name} {abs(step * other.scale):.3g} {other.unit}".strip()
    else:
        second = f"{other.name} {abs(100.0 * math.expm1(step)):.3g} %"
    way = "up" if step > 0.0 else "down"
    return (f"{one.name} and {other.name} trade off (correlation {r:.4f}): {first} with {second} {way} leaves nearly "
            f"the same answers; {_what_to_do(wide)}")  # fmt: skip


def _what_to_do(wide: bool) -> str:
    if wide:
        return "these data cannot tell them apart: hold one of them, or measure over a wider range"
    return "take them from one fit, never one of them alone"


def _wide(found: Sequence[Interval] | None, which: Sequence[int]) -> bool:
    """Whether one of these parameters is hardly known; where no intervals were asked for, they count as wide."""
    if found is None:
        return True
    for index in which:
        low, high, low_open, high_open = found[index]
        if (
            low_open
            or high_open
            or not (low * high > 0.0 and max(abs(low), abs(high)) < WIDE * min(abs(low), abs(high)))
        ):
            return True
    return False
