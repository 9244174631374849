"""Indices of an outcome from a table of it at the points of a design, by SALib, with intervals of a bootstrap.

A group of points (a base sample, a trajectory) of which one has no value is left out as a whole, as SALib needs it; of
more than `MOST_SPOILT` of them spoilt there are no indices, since what is left is no sample of the ranges any more.
"""

from __future__ import annotations

from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.cohort.outcomes import OUTCOMES
from knee_contact_ros.cohort.table import LATERAL
from knee_contact_ros.tools.sensitivity.design import FEWEST, LEVELS, SalibDesign

Floats = NDArray[np.float64]
RESAMPLES = 200
"""Of the bootstrap"""
FEWER = 100
"""Where each is a call of SALib"""
BEGINNINGS = (8, 4, 2, 1)
"""Parts of the design that indices are told of, to see whether they still move: n/8, n/4, n/2, n"""
MOST_SPOILT = 0.1
"""Of the groups"""
SAME = 1e-12
"""Of an outcome, as little as it may vary and be the same"""
LEADING = {"sobol": "ST", "morris": "mu_star"}
"""The index that parameters are sorted by"""


class Index(NamedTuple):
    """An index, and where it lies at the confidence that is asked for."""

    parameter: str
    """`a x b` of two together"""
    kind: str
    """S1, ST, S2; mu_star, mu, sigma in the outcome's unit per range"""
    n: int
    """Groups that it is made of"""
    value: float
    low: float
    """Not a number where there is no interval"""
    high: float


class Analysed(NamedTuple):
    """What there is to say of an outcome."""

    outcome: str
    indices: tuple[Index, ...]
    """Of the beginnings, the whole last; none where there is a `reason`"""
    groups: int
    """That the design has"""
    spoilt: int
    """Of these, in which a case has no value"""
    cases: int
    """Cases without a value"""
    mean: float
    deviation: float
    """Standard one of the outcome over the cases that have it"""
    reason: str
    """Why there are no indices; empty if there are"""

    def final(self, kind: str) -> list[Index]:
        """The indices of a kind of the whole design, the largest first."""
        most = max((index.n for index in self.indices), default=0)
        own = [index for index in self.indices if index.n == most and index.kind == kind]
        return sorted(own, key=lambda index: -index.value)

    def course(self, kind: str, parameter: str) -> list[Index]:
        """An index over the beginnings of the design."""
        own = (index for index in self.indices if (index.kind, index.parameter) == (kind, parameter))
        return sorted(own, key=lambda index: index.n)


def analyse(design: SalibDesign, outcome: str, values: Floats, bound: float = 0.0) -> Analysed:
    """The indices of an outcome.

    Args:
        design: Whose points they are.
        outcome: Its name.
        values: At the points, shape (design.number,); not a number where a case failed.
        bound: Numerical error that they may have; an outcome that varies by less has no indices.
    """
    grouped = values.reshape(design.n, design.group)
    there = np.isfinite(values)
    whole = np.asarray(there.reshape(grouped.shape).all(axis=1))
    spoilt, own = int((~whole).sum()), values[there]
    mean, deviation = (float(own.mean()), float(own.std())) if own.size else (np.nan, np.nan)
    found = Analysed(outcome, (), design.n, spoilt, int((~there).sum()), mean, deviation, "")
    if not own.size:
        return found._replace(reason="no case has a value")
    if spoilt > MOST_SPOILT * design.n:
        reason = (
            f"{found.cases} of {len(values)} cases have no value and spoil {spoilt} of {design.n} groups; "
            f"more than {MOST_SPOILT:.0%}, so what is left is no sample of the ranges"
        )
        return found._replace(reason=reason)
    unit = f" {unit_of(outcome)}".rstrip()
    if _same(own):
        return found._replace(reason=f"it is the same in all cases, {mean:g}{unit}")
    if deviation <= bound:
        reason = (
            f"it varies by {deviation:.2g}{unit} (one standard deviation) around {mean:.6g}{unit}, and its numerical "
            f"error bound is {bound:.2g}{unit}; what matters there a smaller fidelity.tolerance would show"
        )
        return found._replace(reason=reason)
    cube = design.unit().reshape(design.n, design.group, -1)
    indices: list[Index] = []
    for part in BEGINNINGS:
        kept = whole[: design.n // part]
        outcomes, points = grouped[: len(kept)][kept], cube[: len(kept)][kept]
        if len(outcomes) >= FEWEST and not _same(outcomes):
            indices += (
                _of_morris(design, points, outcomes) if design.method == "morris" else _of_sobol(design, outcomes)
            )
    return found._replace(indices=tuple(indices), reason="" if indices else f"fewer than {FEWEST} whole groups")


def unit_of(outcome: str) -> str:
    """The SI unit of an outcome, empty for a number."""
    return next(one.unit for one in OUTCOMES if one.name == outcome.removeprefix(LATERAL))


def _same(values: Floats) -> bool:
    return bool(np.ptp(values) <= SAME * np.abs(values).max())


def _of_sobol(design: SalibDesign, values: Floats) -> list[Index]:
    """Of values in groups, shape (n, group)."""
    from SALib.analyze import sobol

    told: Any = sobol.analyze(
        design.problem, values.ravel(), calc_second_order=design.second_order, num_resamples=RESAMPLES,
        conf_level=design.confidence, seed=design.seed + 1,
    )  # fmt: skip
    # SALib takes a seed of 0 for none
    found = [
        _index(name, kind, len(values), told[kind][i], told[f"{kind}_conf"][i])
        for kind in ("S1", "ST")
        for i, name in enumerate(design.names)
    ]
    if design.second_order:
        found += [
            _index(f"{design.names[i]} x {design.names[j]}", "S2", len(values), told["S2"][i, j], told["S2_conf"][i, j])
            for i, j in combinations(range(len(design.names)), 2)
        ]
    return found


def _of_morris(design: SalibDesign, points: Floats, values: Floats) -> list[Index]:
    """Of trajectories: points, shape (n, group, names), and values, shape (n, group)."""
    told = _screened(design, points, values, RESAMPLES)
    draw = np.random.default_rng(design.seed + 1)
    resampled = []
    for _ in range(FEWER):  # SALib tells an interval of mu_star alone
        own = draw.integers(len(values), size=len(values))
        other = _screened(design, points[own], values[own], 2)
        resampled.append((other["mu"], other["sigma"]))
    tail = 0.5 * (1.0 - design.confidence)
    low, high = np.quantile(np.array(resampled, dtype=float), (tail, 1.0 - tail), axis=0)
    found = []
    for i, name in enumerate(design.names):
        found.append(_index(name, "mu_star", len(values), told["mu_star"][i], told["mu_star_conf"][i]))
        for place, kind in enumerate(("mu", "sigma")):
            ends = float(low[place, i]), float(high[place, i])
            found.append(Index(name, kind, len(values), float(told[kind][i]), *ends))
    return found


def _screened(design: SalibDesign, points: Floats, values: Floats, resamples: int) -> Any:
    from SALib.analyze import morris

    return morris.analyze(
        design.problem, points.reshape(-1, points.shape[-1]), values.ravel(), num_resamples=resamples,
        conf_level=design.confidence, num_levels=LEVELS, seed=design.seed + 1,
    )  # fmt: skip


def _index(parameter: str, kind: str, number: int, value: float, half: float) -> Index:
    return Index(parameter, kind, number, float(value), float(value - half), float(value + half))
