"""Sensitivity indices of an outcome from its values at the points of a design, by SALib, with bootstrap intervals.

SALib needs whole groups of points (a base sample, a trajectory): a group in which a case has no value is left out. If
more than `MOST_SPOILT` of the groups are left out, there are no indices, since the rest is no sample of the ranges.
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
"""Number of resamples of the bootstrap"""
FEWER = 100
"""Number of resamples where each is a call of SALib"""
BEGINNINGS = (8, 4, 2, 1)
"""Divisors of n: indices are computed from the first n/8, n/4, n/2 and n groups, to see whether they have converged"""
MOST_SPOILT = 0.1
"""The largest part of the groups that may be left out"""
SAME = 1e-12
"""Range of an outcome, relative to its size, up to which it counts as constant"""
LEADING = {"sobol": "ST", "morris": "mu_star"}
"""The index of each method by which parameters are sorted"""


class Index(NamedTuple):
    """A sensitivity index, with its interval at the design's level of confidence."""

    parameter: str
    """Name of the parameter; `a x b` for the index of a pair"""
    kind: str
    """S1, ST or S2; mu_star, mu or sigma, in the outcome's unit over the whole range of the parameter"""
    n: int
    """Number of groups from which the index is computed"""
    value: float
    """Value of the index"""
    low: float
    """Lower end of the interval; not a number where there is none"""
    high: float
    """Upper end of the interval; not a number where there is none"""


class Analysed(NamedTuple):
    """Analysis of an outcome."""

    outcome: str
    """Name of the outcome"""
    indices: tuple[Index, ...]
    """Indices for the beginnings of the design, and last for all of it; none where there is a `reason`"""
    groups: int
    """Number of groups of the design"""
    spoilt: int
    """Number of groups in which a case has no value"""
    cases: int
    """Number of cases without a value"""
    mean: float
    """Mean of the outcome over the cases that have a value"""
    deviation: float
    """Standard deviation of the outcome over the cases that have a value"""
    reason: str
    """Why there are no indices; empty if there are"""

    def final(self, kind: str) -> list[Index]:
        """Give the indices of a kind for the whole design, the largest first."""
        most = max((index.n for index in self.indices), default=0)
        indices = [index for index in self.indices if index.n == most and index.kind == kind]
        return sorted(indices, key=lambda index: -index.value)

    def by_parameter(self, kind: str) -> dict[str, Index]:
        """Give the indices of a kind for the whole design by parameter, the largest first."""
        return {index.parameter: index for index in self.final(kind)}

    def course(self, kind: str, parameter: str) -> list[Index]:
        """Give an index for the beginnings of the design, the shortest first."""
        indices = (index for index in self.indices if (index.kind, index.parameter) == (kind, parameter))
        return sorted(indices, key=lambda index: index.n)


def analyse(design: SalibDesign, outcome: str, values: Floats, bound: float = 0.0) -> Analysed:
    """Compute the indices of an outcome.

    Args:
        design: The design at whose points the outcome was computed.
        outcome: Name of the outcome.
        values: Values at the points, shape (design.number,); not a number where a case failed.
        bound: Bound of the values' numerical error; an outcome whose standard deviation is no larger has no indices.
    """
    grouped = values.reshape(design.n, design.group)
    finite = np.isfinite(values)
    whole = np.asarray(finite.reshape(grouped.shape).all(axis=1))
    spoilt, known = int((~whole).sum()), values[finite]
    mean, deviation = (float(known.mean()), float(known.std())) if known.size else (np.nan, np.nan)
    analysed = Analysed(outcome, (), design.n, spoilt, int((~finite).sum()), mean, deviation, "")
    if not known.size:
        return analysed._replace(reason="no case has a value")
    if spoilt > MOST_SPOILT * design.n:
        reason = (
            f"{analysed.cases} of {len(values)} cases have no value and spoil {spoilt} of {design.n} groups; "
            f"more than {MOST_SPOILT:.0%}, so what is left is no sample of the ranges"
        )
        return analysed._replace(reason=reason)
    unit = f" {unit_of(outcome)}".rstrip()
    if _same(known):
        return analysed._replace(reason=f"it is the same in all cases, {mean:g}{unit}")
    if deviation <= bound:
        reason = (
            f"it varies by {deviation:.2g}{unit} (one standard deviation) around {mean:.6g}{unit}, and its numerical "
            f"error bound is {bound:.2g}{unit}; what matters there a smaller fidelity.tolerance would show"
        )
        return analysed._replace(reason=reason)
    cube = design.unit().reshape(design.n, design.group, -1)
    indices: list[Index] = []
    for part in BEGINNINGS:
        kept = whole[: design.n // part]
        outcomes, points = grouped[: len(kept)][kept], cube[: len(kept)][kept]
        if len(outcomes) >= FEWEST and not _same(outcomes):
            indices += (
                _of_morris(design, points, outcomes) if design.method == "morris" else _of_sobol(design, outcomes)
            )
    return analysed._replace(indices=tuple(indices), reason="" if indices else f"fewer than {FEWEST} whole groups")


def unit_of(outcome: str) -> str:
    """Give the SI unit of an outcome; empty for numbers of ticks and for ratios."""
    return next(one.unit for one in OUTCOMES if one.name == outcome.removeprefix(LATERAL))


def _same(values: Floats) -> bool:
    return bool(np.ptp(values) <= SAME * np.abs(values).max())


def _of_sobol(design: SalibDesign, values: Floats) -> list[Index]:
    """Compute Sobol's indices from values in groups, shape (n, group)."""
    from SALib.analyze import sobol

    result: Any = sobol.analyze(
        design.problem, values.ravel(), calc_second_order=design.second_order, num_resamples=RESAMPLES,
        conf_level=design.confidence, seed=design.seed + 1,
    )  # fmt: skip
    # SALib takes a seed of 0 for none
    names, n = design.names, len(values)
    indices = [
        _index(name, kind, n, result[kind][i], result[f"{kind}_conf"][i])
        for kind in ("S1", "ST")
        for i, name in enumerate(names)
    ]
    if design.second_order:
        indices += [
            _index(f"{names[i]} x {names[j]}", "S2", n, result["S2"][i, j], result["S2_conf"][i, j])
            for i, j in combinations(range(len(names)), 2)
        ]
    return indices


def _of_morris(design: SalibDesign, points: Floats, values: Floats) -> list[Index]:
    """Compute Morris's indices from trajectories: points, shape (n, group, parameters), and values, shape (n, group).

    SALib gives an interval of mu_star alone, so those of mu and sigma come from a bootstrap of our own.
    """
    result, n = _screened(design, points, values, RESAMPLES), len(values)
    random = np.random.default_rng(design.seed + 1)
    resampled = []
    for _ in range(FEWER):
        drawn = random.integers(n, size=n)
        other = _screened(design, points[drawn], values[drawn], 2)
        resampled.append((other["mu"], other["sigma"]))
    tail = 0.5 * (1.0 - design.confidence)
    low, high = np.quantile(np.array(resampled, dtype=float), (tail, 1.0 - tail), axis=0)
    indices = []
    for i, name in enumerate(design.names):
        indices.append(_index(name, "mu_star", n, result["mu_star"][i], result["mu_star_conf"][i]))
        for row, kind in enumerate(("mu", "sigma")):
            indices.append(Index(name, kind, n, float(result[kind][i]), float(low[row, i]), float(high[row, i])))
    return indices


def _screened(design: SalibDesign, points: Floats, values: Floats, resamples: int) -> Any:
    from SALib.analyze import morris

    return morris.analyze(
        design.problem, points.reshape(-1, points.shape[-1]), values.ravel(), num_resamples=resamples,
        conf_level=design.confidence, num_levels=LEVELS, seed=design.seed + 1,
    )  # fmt: skip


def _index(parameter: str, kind: str, n: int, value: float, half_width: float) -> Index:
    return Index(parameter, kind, n, float(value), float(value - half_width), float(value + half_width))
