"""Indices from the table of a study, for every combination of bag, parameter files and grid values."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import PurePosixPath
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.cohort.blocks import keys_of
from knee_contact_ros.cohort.shards import Shards
from knee_contact_ros.cohort.study import Case, Study
from knee_contact_ros.tools.sensitivity.analysis import Analysed, analyse, unit_of
from knee_contact_ros.tools.sensitivity.study_file import SensitivityStudy

BOUNDS = {"peak_depth": "error_bound", "peak_force": "force_error_bound"}
"""Outcomes whose numerical error is known, with the column that bounds it"""
NOISY = 0.1
"""Ratio of an error bound to an outcome's standard deviation above which there is a remark"""
NOTED = ("not_converged", "implausible")
"""Columns that count ticks which a reader should know of"""
BEFORE = ("bag", "params")
AFTER = ("outcome", "parameter", "index", "n", "value", "low", "high")
"""Columns of `as_csv`; those of the grid are between. S1, ST, S2 are parts of the variance; mu_star, mu and sigma are
in the outcome's SI unit, over the whole range of the parameter"""


class Combination(NamedTuple):
    """The indices for one combination of bag, parameter files and grid values."""

    label: str
    """Name of the combination: the values in which it differs from the others"""
    bag: str
    """The bag as the study names it"""
    params: str
    """The parameter files as the study names them, joined by plus signs"""
    grid: Mapping[str, Any]
    """Values of the grid's parameters, by name"""
    analysed: tuple[Analysed, ...]
    """Indices of each outcome, in the order of the study's outcomes"""
    failures: tuple[str, ...]
    """Reasons why cases failed, each once"""
    doubts: tuple[str, ...]
    """What a reader should know of the numerical errors and of implausible answers, a sentence each"""


def gather(study: SensitivityStudy, shards: Shards, advance: Callable[[int, int], None]) -> list[Combination]:
    """Compute the indices of all combinations, in the order of the study.

    Args:
        study: The study, all of whose cases are computed.
        shards: The folder of its results.
        advance: Called with the number of outcomes that are analysed, and the number of all.

    Raises:
        UsageError: bag, parameters or folder cannot be used.
        IncompleteError: a case is missing.
    """
    cases, size = study.cases, study.design.number
    columns = list(dict.fromkeys([*study.outcomes, *BOUNDS.values(), *NOTED, "failed"]))
    table = shards.rows(keys_of(cases), columns)
    firsts = [cases.case(number) for number in range(0, cases.number, size)]
    combinations = []
    for place, (case, label) in enumerate(zip(firsts, labels(cases, firsts), strict=True)):
        part = table.slice(place * size, size)
        rows = {name: part[name].to_numpy() for name in columns}
        analysed = []
        for i, name in enumerate(study.outcomes):
            analysed.append(analyse(study.design, name, rows[name], bound_of(name, rows)))
            advance(place * len(study.outcomes) + i + 1, len(firsts) * len(study.outcomes))
        failures = tuple(sorted({text for text in rows["failed"] if text}))
        grid = {name: case.values[name] for name in cases.grid}
        doubts = tuple(_doubts(analysed, rows))
        combinations.append(
            Combination(label, case.bag, " + ".join(case.params), grid, tuple(analysed), failures, doubts)
        )  # fmt: skip
    return combinations


def as_csv(combinations: Sequence[Combination]) -> str:
    """Make a CSV table with a row for each index; numbers have nine digits, and an unknown end of an interval none."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow((*BEFORE, *combinations[0].grid, *AFTER))
    for combination in combinations:
        where = (combination.bag, combination.params, *combination.grid.values())
        for analysed in combination.analysed:
            for index in analysed.indices:
                numbers = ("" if math.isnan(value) else f"{value:.9g}" for value in index[3:])
                writer.writerow((*where, analysed.outcome, index.parameter, index.kind, index.n, *numbers))
    return file.getvalue()


def labels(study: Study, firsts: list[Case]) -> list[str]:
    """Describe in what each combination differs, given its first case; a single one by its bag and parameter files."""
    bags = _shortest(list(study.bags))
    texts = []
    for case in firsts:
        parts = []
        if len(study.bags) > 1 or len(firsts) == 1:
            parts.append(bags[study.bags.index(case.bag)])
        if len(study.params) > 1 or len(firsts) == 1:
            parts.append(" + ".join(_shortest(list(case.params))))
        several = [name for name, values in study.grid.items() if len(values) > 1]
        parts += [f"{name} {_short(case.values[name])}" for name in several]
        texts.append(", ".join(parts))
    return texts


def _shortest(paths: list[str]) -> list[str]:
    """Shorten paths to names without folders and endings, unless two of them would be the same."""
    names = [PurePosixPath(path.rstrip("/")).stem for path in paths]
    return names if len(set(names)) == len(set(paths)) else paths


def _short(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def bound_of(outcome: str, rows: Mapping[str, NDArray[Any]]) -> float:
    """Give the median of an outcome's numerical error bounds over the cases; 0 where none is known."""
    bounds = rows[BOUNDS[outcome]] if outcome in BOUNDS else np.zeros(1)
    return float(np.nanmedian(bounds)) if np.isfinite(bounds).any() else 0.0


def _doubts(analysed: list[Analysed], rows: Mapping[str, NDArray[Any]]) -> list[str]:
    """Describe numerical errors that are not small, and cases with missed tolerances or implausible answers."""
    sentences = []
    for one in analysed:
        bound = bound_of(one.outcome, rows)
        if one.indices and bound > NOISY * one.deviation:
            unit = unit_of(one.outcome)
            sentences.append(
                f"{one.outcome} varies by {one.deviation:.2g} {unit} (one standard deviation), and its numerical error "
                f"bound is {bound:.2g} {unit}: small indices may be those of the error; a smaller fidelity.tolerance "
                "helps"
            )
    for name, meaning in zip(NOTED, ("missed a tolerance", "are implausible"), strict=True):
        affected = rows[name] > 0
        if affected.any():
            worst = float(np.nanmax(rows["error_bound"][affected]))
            sentences.append(
                f"{np.count_nonzero(affected)} of {len(affected)} cases have ticks that {meaning}; the error bound of "
                f"their depths is {1e3 * worst:.2g} mm at most"
            )
    return sentences
