"""Indices in words and in units that are read: tables of the page, and whether they have converged."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from knee_contact_ros.parameters.reading import known_parameters
from knee_contact_ros.tools.sensitivity.analysis import LEADING, Analysed, Index, unit_of
from knee_contact_ros.tools.sensitivity.design import MOST, SalibDesign
from knee_contact_ros.tools.sensitivity.gather import Combination

UNITS = {"m": (1e3, "mm"), "Pa": (1e-6, "MPa"), "N/s": (1e-3, "kN/s")}
"""Factor and unit that an outcome is shown in"""
WIDEST = 0.1
"""Of the interval of the largest share of the variance, to be called converged"""
WIDEST_EFFECT = 0.25
"""Of the interval of the largest effect, over the effect"""
TOLD = 3
"""Parameters that the first table names"""
LEAST = 0.01
"""Of the largest index, for one to be named beside it"""


class Table(NamedTuple):
    """A table of the page."""

    head: Sequence[str]
    rows: Sequence[Sequence[str]]


class Shown(NamedTuple):
    """An outcome as it is read."""

    title: str
    unit: str
    factor: float

    @property
    def label(self) -> str:
        """With its unit."""
        return f"{self.title} [{self.unit}]" if self.unit else self.title


def shown(outcome: str) -> Shown:
    """Title, unit and factor of an outcome."""
    unit = unit_of(outcome)
    factor, name = UNITS.get(unit, (1.0, unit))
    return Shown(outcome.replace("_", " "), name, factor)


def interval(index: Index, factor: float = 1.0) -> str:
    """Its value and its interval."""
    digits = 2 if factor == 1.0 and index.kind.startswith("S") else None
    numbers = [factor * value for value in index[3:]]
    texts = [f"{value:.{digits}f}" if digits else f"{value:.3g}" for value in numbers]
    return texts[0] if math.isnan(index.low) else f"{texts[0]} ({texts[1]} to {texts[2]})"


def what_matters(design: SalibDesign, combinations: Sequence[Combination]) -> Table:
    """Who leads, for each outcome of each combination."""
    kind = LEADING[design.method]
    rows = []
    for place, name in enumerate([one.outcome for one in combinations[0].analysed]):
        own = shown(name)
        factor = own.factor if design.method == "morris" else 1.0
        for each in combinations:
            found = each.analysed[place]
            unit = f" {own.unit}".rstrip() if design.method == "morris" else ""
            leading = found.final(kind)[:TOLD]
            first = [
                f"{index.parameter} {interval(index, factor)}{unit}"
                for index in leading
                if index.value >= LEAST * leading[0].value
            ]
            rows.append(
                (own.title, each.label, found.reason or "; ".join(first),
                 f"{own.factor * found.mean:.4g} ± {own.factor * found.deviation:.2g} {own.unit}".strip())
            )  # fmt: skip
    return Table(("Outcome", "Where", "What matters, the most first", "Mean ± standard deviation"), rows)


def all_indices(design: SalibDesign, found: Analysed) -> Table:
    """The indices of the whole design, a parameter in a row."""
    kinds = ("S1", "ST") if design.method == "sobol" else ("mu_star", "mu", "sigma")
    own = shown(found.outcome)
    factor = own.factor if design.method == "morris" else 1.0
    by = {kind: {index.parameter: index for index in found.final(kind)} for kind in kinds}
    names = [index.parameter for index in found.final(LEADING[design.method])]
    rows = [(name, *(interval(by[kind][name], factor) for kind in kinds)) for name in names]
    heads = {"S1": "S1, alone", "ST": "ST, with all interactions", "mu_star": f"µ* [{own.unit or '1'}]",
             "mu": f"µ [{own.unit or '1'}]", "sigma": f"σ [{own.unit or '1'}]"}  # fmt: skip
    return Table(("Parameter", *(heads[kind] for kind in kinds)), rows)


def together(found: Analysed) -> Table:
    """Pairs, the strongest interaction first."""
    return Table(("Together", "S2"), [(index.parameter, interval(index)) for index in found.final("S2")])


def ranges_table(design: SalibDesign) -> Table:
    """What was varied."""
    known = known_parameters()
    rows = [
        (name, f"{axis.start:g}", f"{axis.stop:g}", "evenly in the logarithm" if axis.scale == "log" else "evenly",
         known[name].description)
        for name, axis in zip(design.names, design.axes, strict=True)
    ]  # fmt: skip
    return Table(("Parameter", "From", "To", "Drawn", "Meaning"), rows)


def remarks(design: SalibDesign, combinations: Sequence[Combination]) -> list[str]:
    """What a reader must know before believing an index, a sentence each."""
    found = []
    for each in combinations:
        for one in each.analysed:
            where = f"{shown(one.outcome).title}, {each.label}"
            if one.reason:
                found.append(f"{where}: no index: {one.reason}.")
                continue
            if one.spoilt:
                found.append(
                    f"{where}: {one.cases} of {design.number} cases have no value; {one.spoilt} of {one.groups} groups "
                    "are left out with them, and the indices are those of the knees that could be computed."
                )
            doubts = not_converged(design, one)
            if doubts:
                found.append(f"{where}: {'; '.join(doubts)}.")
        if each.failures:
            more = f" (and {len(each.failures) - 1} other reasons)" if len(each.failures) > 1 else ""
            found.append(f"{each.label}: cases failed: {each.failures[0]}{more}.")
        found += [f"{each.label}: {sentence}." for sentence in each.doubts]
    return found


def not_converged(design: SalibDesign, found: Analysed) -> list[str]:
    """Why the indices of an outcome should not be believed to the second digit; nothing if they may be."""
    leading = found.final(LEADING[design.method])
    if not leading:
        return []
    parts = []
    first = leading[0]
    width, most = first.high - first.low, WIDEST if design.method == "sobol" else WIDEST_EFFECT * first.value
    if width > most:
        factor = shown(found.outcome).factor if design.method == "morris" else 1.0
        parts.append(
            f"not converged: the interval of the largest index, {first.kind} of {first.parameter} "
            f"{interval(first, factor)}, is {factor * width:.2g} wide, more than {factor * most:.2g}; "
            f"{_enough(design, first.n, width / most)}"
        )
    if len(leading) > 1 and leading[1].high > first.low:
        parts.append(f"which of {first.parameter} and {leading[1].parameter} matters more is open")
    return parts + (_sums(found) if design.method == "sobol" else [])


def _enough(design: SalibDesign, number: int, ratio: float) -> str:
    """Groups at which an interval is narrower by a ratio: it goes with the root of the number."""
    least = math.ceil(number * ratio**2)
    enough = 1 << (least - 1).bit_length() if design.method == "sobol" else least
    return f"n = {enough} may do" if enough <= MOST else "no n will do"


def _sums(found: Analysed) -> list[str]:
    """First-order indices are at most 1 together, total ones at least 1 (Saltelli et al. 2010)."""
    parts = []
    for kind, sign, limit in (("S1", 1.0, "more"), ("ST", -1.0, "less")):
        own = found.final(kind)
        total, half = sum(index.value for index in own), math.hypot(*(0.5 * (index.high - index.low) for index in own))
        if sign * (total - 1.0) > half:
            parts.append(
                f"not converged: the {kind} of all parameters sum to {total:.2f}, {limit} than 1 by more than the "
                f"interval of the sum, ± {half:.2f}"
            )
    return parts
