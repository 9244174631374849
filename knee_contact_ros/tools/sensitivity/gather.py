"""From a study's table to indices: of every combination of bag, knee and grid value."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import PurePosixPath
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.cohort.blocks import keys_of
from knee_contact_ros.cohort.shards import Shards
from knee_contact_ros.cohort.study import Case, Study
from knee_contact_ros.tools.sensitivity.analysis import Analysed, analyse, unit_of
from knee_contact_ros.tools.sensitivity.asked import Asked

BOUNDS = {"peak_depth": "error_bound", "peak_force": "force_error_bound"}
"""Outcomes whose numerical error a table tells, and the column that does"""
NOISY = 0.1
"""Of an outcome's standard deviation, as large as a bound may be without a remark"""
NOTED = ("not_converged", "implausible")
"""Ticks that a table counts and a reader should know of"""


class Combination(NamedTuple):
    """A bag, a knee and grid values: the indices there."""

    label: str
    """What it differs in from the others"""
    bag: str
    params: str
    grid: Mapping[str, Any]
    analysed: tuple[Analysed, ...]
    """In the order of the outcomes"""
    failures: tuple[str, ...]
    """What failed cases say, each once"""
    doubts: tuple[str, ...]
    """What a reader should know of the cases, a sentence each"""


def gather(asked: Asked, shards: Shards, advance: Callable[[int, int], None]) -> list[Combination]:
    """The indices of all combinations, in the order of the study.

    Raises:
        UsageError: bag, parameters or folder cannot be used.
        IncompleteError: a case is not there.
    """
    study, design = asked.study, asked.design
    keys = keys_of(study)
    columns = list(dict.fromkeys([*asked.outcomes, *BOUNDS.values(), *NOTED, "failed"]))
    table = shards.rows(keys, columns)
    firsts = [study.case(number) for number in range(0, study.number, design.number)]
    found = []
    for place, (case, label) in enumerate(zip(firsts, labels(study, firsts), strict=True)):
        part = table.slice(place * design.number, design.number)
        rows = {name: part[name].to_numpy() for name in columns}
        analysed = []
        for i, name in enumerate(asked.outcomes):
            analysed.append(analyse(design, name, rows[name], bound_of(name, rows)))
            advance(place * len(asked.outcomes) + i + 1, len(firsts) * len(asked.outcomes))
        failures = tuple(sorted({text for text in rows["failed"] if text}))
        grid = {name: case.values[name] for name in study.grid}
        doubts = tuple(_doubts(analysed, rows))
        found.append(
            Combination(label, case.bag, " + ".join(case.params), grid, tuple(analysed), failures, doubts)
        )  # fmt: skip
    return found


def labels(study: Study, firsts: list[Case]) -> list[str]:
    """What each combination differs in; of a single one, its bag and knee."""
    bags = _shortest(list(study.bags))
    found = []
    for case in firsts:
        parts = []
        if len(study.bags) > 1 or len(firsts) == 1:
            parts.append(bags[study.bags.index(case.bag)])
        if len(study.params) > 1 or len(firsts) == 1:
            parts.append(" + ".join(_shortest(list(case.params))))
        several = [name for name, values in study.grid.items() if len(values) > 1]
        parts += [f"{name} {_short(case.values[name])}" for name in several]
        found.append(", ".join(parts))
    return found


def _shortest(paths: list[str]) -> list[str]:
    """Names without folders and endings, if they can be told apart so."""
    names = [PurePosixPath(path.rstrip("/")).stem for path in paths]
    return names if len(set(names)) == len(set(paths)) else paths


def _short(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def bound_of(outcome: str, rows: Mapping[str, NDArray[Any]]) -> float:
    """The numerical error bound that half of the cases keep, where a table tells one; else 0."""
    own = rows[BOUNDS[outcome]] if outcome in BOUNDS else np.zeros(1)
    return float(np.nanmedian(own)) if np.isfinite(own).any() else 0.0


def _doubts(analysed: list[Analysed], rows: Mapping[str, NDArray[Any]]) -> list[str]:
    """What numerical errors and implausible answers make of it."""
    found = []
    for one in analysed:
        bound = bound_of(one.outcome, rows)
        if one.indices and bound > NOISY * one.deviation:
            unit = unit_of(one.outcome)
            found.append(
                f"{one.outcome} varies by {one.deviation:.2g} {unit} (one standard deviation), and its numerical error "
                f"bound is {bound:.2g} {unit}: small indices may be those of the error; a smaller fidelity.tolerance "
                "helps"
            )
    for name, meaning in zip(NOTED, ("missed a tolerance", "are implausible"), strict=True):
        own = rows[name] > 0
        if own.any():
            worst = float(np.nanmax(rows["error_bound"][own]))
            found.append(
                f"{np.count_nonzero(own)} of {len(own)} cases have ticks that {meaning}; the error bound of their "
                f"depths is {1e3 * worst:.2g} mm at most"
            )
    return found
