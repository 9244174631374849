"""Indices as text, in readable units: tables of the page, and remarks on convergence."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from knee_contact_ros.parameters.reading import known_parameters
from knee_contact_ros.tools.sensitivity.analysis import LEADING, Analysed, Index, unit_of
from knee_contact_ros.tools.sensitivity.design import MOST, SalibDesign
from knee_contact_ros.tools.sensitivity.gather import Combination

UNITS = {"m": (1e3, "mm"), "Pa": (1e-6, "MPa"), "N/s": (1e-3, "kN/s")}
"""Factor to, and name of, the unit in which outcomes of an SI unit are shown"""
WIDEST = 0.1
"""Width of the interval of the largest share of the variance up to which the indices count as converged"""
WIDEST_EFFECT = 0.25
"""Width of the interval of the largest effect, relative to the effect, up to which the indices count as converged"""
LEADERS = 3
"""Number of parameters that the first table names"""
LEAST = 0.01
"""Ratio to the largest index from which on an index is named beside it"""


class Table(NamedTuple):
    """A table of the page."""

    head: Sequence[str]
    rows: Sequence[Sequence[str]]


class Display(NamedTuple):
    """How an outcome is shown to people."""

    title: str
    """Name of the outcome in words"""
    unit: str
    """Unit in which it is shown; empty if it has none"""
    factor: float
    """Factor from the SI unit to that unit"""

    @property
    def label(self) -> str:
        """Title with unit."""
        return f"{self.title} [{self.unit}]" if self.unit else self.title


def display_of(outcome: str) -> Display:
    """Give title, unit and factor of an outcome."""
    unit = unit_of(outcome)
    factor, name = UNITS.get(unit, (1.0, unit))
    return Display(outcome.replace("_", " "), name, factor)


def interval(index: Index, factor: float = 1.0) -> str:
    """Write an index with its interval, in a unit that is so many times smaller than the index's own."""
    digits = 2 if factor == 1.0 and index.kind.startswith("S") else None
    numbers = [factor * value for value in index[3:]]
    texts = [f"{value:.{digits}f}" if digits else f"{value:.3g}" for value in numbers]
    return texts[0] if math.isnan(index.low) else f"{texts[0]} ({texts[1]} to {texts[2]})"


def what_matters(design: SalibDesign, combinations: Sequence[Combination]) -> Table:
    """Make the table of the leading parameters, for each outcome of each combination."""
    kind = LEADING[design.method]
    rows = []
    for place, name in enumerate([analysed.outcome for analysed in combinations[0].analysed]):
        display = display_of(name)
        factor, unit = (display.factor, f" {display.unit}".rstrip()) if design.method == "morris" else (1.0, "")
        for combination in combinations:
            analysed = combination.analysed[place]
            leading = analysed.final(kind)[:LEADERS]
            parts = [
                f"{index.parameter} {interval(index, factor)}{unit}"
                for index in leading
                if index.value >= LEAST * leading[0].value
            ]
            mean, deviation = display.factor * analysed.mean, display.factor * analysed.deviation
            spread = f"{mean:.4g} ± {deviation:.2g} {display.unit}".strip()
            rows.append((display.title, combination.label, analysed.reason or "; ".join(parts), spread))
    return Table(("Outcome", "Where", "What matters, the most first", "Mean ± standard deviation"), rows)


def all_indices(design: SalibDesign, analysed: Analysed) -> Table:
    """Make the table of the indices of an outcome for the whole design, with a row for each parameter."""
    display = display_of(analysed.outcome)
    unit, factor = display.unit or "1", display.factor
    heads = {"mu_star": f"µ* [{unit}]", "mu": f"µ [{unit}]", "sigma": f"σ [{unit}]"}
    if design.method == "sobol":
        heads, factor = {"S1": "S1, alone", "ST": "ST, with all interactions"}, 1.0
    columns = [analysed.by_parameter(kind) for kind in heads]
    names = analysed.by_parameter(LEADING[design.method])
    rows = [(name, *(interval(column[name], factor) for column in columns)) for name in names]
    return Table(("Parameter", *heads.values()), rows)


def together(analysed: Analysed) -> Table:
    """Make the table of Sobol's indices of pairs of parameters, the largest first."""
    return Table(("Together", "S2"), [(index.parameter, interval(index)) for index in analysed.final("S2")])


def ranges_table(design: SalibDesign) -> Table:
    """Make the table of the varied parameters and their ranges."""
    known = known_parameters()
    rows = [
        (name, f"{axis.start:g}", f"{axis.stop:g}", "evenly in the logarithm" if axis.scale == "log" else "evenly",
         known[name].description)
        for name, axis in design.axes.items()
    ]  # fmt: skip
    return Table(("Parameter", "From", "To", "Drawn", "Meaning"), rows)


def remarks(design: SalibDesign, combinations: Sequence[Combination]) -> list[str]:
    """Describe all that makes indices doubtful, a sentence each."""
    sentences = []
    for combination in combinations:
        for analysed in combination.analysed:
            where = f"{display_of(analysed.outcome).title}, {combination.label}"
            if analysed.reason:
                sentences.append(f"{where}: no index: {analysed.reason}.")
                continue
            if analysed.spoilt:
                sentences.append(
                    f"{where}: {analysed.cases} of {design.number} cases have no value; {analysed.spoilt} of "
                    f"{analysed.groups} groups are left out with them, and the indices are those of the knees that "
                    "could be computed."
                )
            doubts = not_converged(design, analysed)
            if doubts:
                sentences.append(f"{where}: {'; '.join(doubts)}.")
        if combination.failures:
            more = f" (and {len(combination.failures) - 1} other reasons)" if len(combination.failures) > 1 else ""
            sentences.append(f"{combination.label}: cases failed: {combination.failures[0]}{more}.")
        sentences += [f"{combination.label}: {sentence}." for sentence in combination.doubts]
    return sentences


def not_converged(design: SalibDesign, analysed: Analysed) -> list[str]:
    """Give the reasons why the indices of an outcome have not converged; none if they have."""
    leading = analysed.final(LEADING[design.method])
    if not leading:
        return []
    parts = []
    first = leading[0]
    width, most = first.high - first.low, WIDEST if design.method == "sobol" else WIDEST_EFFECT * first.value
    if width > most:
        factor = display_of(analysed.outcome).factor if design.method == "morris" else 1.0
        parts.append(
            f"not converged: the interval of the largest index, {first.kind} of {first.parameter} "
            f"{interval(first, factor)}, is {factor * width:.2g} wide, more than {factor * most:.2g}; "
            f"{_enough(design, first.n, width / most)}"
        )
    if len(leading) > 1 and leading[1].high > first.low:
        parts.append(f"which of {first.parameter} and {leading[1].parameter} matters more is open")
    return parts + (_sums(analysed) if design.method == "sobol" else [])


def _enough(design: SalibDesign, number: int, ratio: float) -> str:
    """Say with how many groups an interval is narrower by a ratio; its width goes with the root of their number."""
    least = math.ceil(number * ratio**2)
    enough = 1 << (least - 1).bit_length() if design.method == "sobol" else least
    return f"n = {enough} may do" if enough <= MOST else "no n will do"


def _sums(analysed: Analysed) -> list[str]:
    """Check that the first-order indices sum to 1 at most, and the total ones to 1 at least (Saltelli et al. 2010)."""
    parts = []
    for kind, sign, limit in (("S1", 1.0, "more"), ("ST", -1.0, "less")):
        indices = analysed.final(kind)
        total = sum(index.value for index in indices)
        half = math.hypot(*(0.5 * (index.high - index.low) for index in indices))
        if sign * (total - 1.0) > half:
            parts.append(
                f"not converged: the {kind} of all parameters sum to {total:.2f}, {limit} than 1 by more than the "
                f"interval of the sum, ± {half:.2f}"
            )
    return parts
