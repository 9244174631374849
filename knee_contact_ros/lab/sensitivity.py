"""Sensitivity indices of a knee's outcomes to its parameters, of Sobol and Morris, by SALib, and `sensitivity`.

A study file is that of a sweep, with `sensitivity` in the place of `sample`:

    bags:        [walking.mcap]
    params:      [healthy, osteoarthritis]
    grid:        {load.share: [0.5, 1.0]}
    sensitivity: {method: sobol, n: 256, seed: 1, second_order: false, confidence: 0.95,
                  ranges: {contact.stiffness: [5.0e7, 1.0e8], contact.damping: {from: 1.0e3, to: 1.0e4, scale: log}}}
    outcomes:    [peak_depth, peak_pressure, bone_time]

The indices are of every combination of bag, knee and grid value. SALib draws the points in the unit cube, in groups (a
base sample, a trajectory), one after another: a larger n begins with the same groups, and so needs only the other
cases. It needs whole groups: one in which a case has no value is left out. If more than `MOST_SPOILT` of the groups are
left out, there are no indices, since the rest is no sample of the ranges.

Sobol: Saltelli et al. 2010, Computer Physics Communications 181:259-270, doi:10.1016/j.cpc.2009.09.018. Morris: Morris
1991, Technometrics 33:161-174, doi:10.1080/00401706.1991.10484804.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, ValidationError, model_validator

from knee_contact_ros.lab.study import Design, Floats, Study
from knee_contact_ros.lab.sweep import LATERAL, OUTCOMES, Cohort, sweep
from knee_contact_ros.offline.notebooks import Name
from knee_contact_ros.parameters.files import Source, first_error
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.files import DEFAULT_PARAMETERS, read_mapping

if TYPE_CHECKING:
    import pandas as pd

FEWEST = 8
"""The least number of groups from which indices are computed"""
MOST = 65_536
"""The largest number of groups: SALib's bootstrap holds some 2 kB of each, for each index"""
LEVELS = 4
"""Number of levels of a range between which Morris's trajectories step"""
RESAMPLES, FEWER = 200, 100
"""Number of resamples of the bootstrap, and where each is a call of SALib"""
BEGINNINGS = (8, 4, 2, 1)
"""Divisors of n: indices are computed from the first n/8, n/4, n/2 and n groups, to see whether they have converged"""
MOST_SPOILT = 0.1
"""The largest part of the groups that may be left out"""
SAME = 1e-12
"""Range of an outcome, relative to its size, up to which it counts as constant"""
LEADING = {"sobol": "ST", "morris": "mu_star"}
"""The index of each method by which parameters are sorted"""
USUAL = ("peak_depth", "peak_pressure", "bone_time", "peak_force")
"""Outcomes that are analysed unless others are named"""
OWN = ("sensitivity", "outcomes")
"""Names in the file that the study file of a sweep does not have"""
BOUNDS = {"peak_depth": "error_bound", "peak_force": "force_error_bound"}
"""Outcomes whose numerical error is known, with the column that bounds it"""
AFTER = ("outcome", "parameter", "index", "n", "value", "low", "high")
"""Columns of a table of indices. S1, ST, S2 are parts of the variance; mu_star, mu and sigma are in the outcome's SI
unit, over the whole range of the parameter"""
UNITS = {"m": (1e3, "mm"), "Pa": (1e-6, "MPa"), "N/s": (1e-3, "kN/s")}
"""Factor to, and name of, the unit in which outcomes of an SI unit are shown"""
WIDEST = 0.1
"""Width of the interval of the largest share of the variance up to which the indices count as converged"""
WIDEST_EFFECT = 0.25
"""Width of the interval of the largest effect, relative to the effect, up to which the indices count as converged"""


class SalibDesign(Design):
    """The entry `sensitivity` of a study file."""

    method: Literal["sobol", "morris"] = "sobol"
    """Sobol: shares of the variance; Morris: effects over the whole range"""
    n: int = Field(256, ge=FEWEST, le=MOST)
    """Number of groups: of base samples, or of trajectories"""
    seed: int = Field(1, ge=0, lt=2**31)
    """Seed of the random numbers of design and bootstrap"""
    second_order: bool = False
    """Whether Sobol's indices of pairs of parameters are computed, too"""
    confidence: float = Field(0.95, ge=0.5, le=0.999)
    """Confidence level of the intervals"""
    ranges: Annotated[dict[str, Any], Field(min_length=2)]

    @model_validator(mode="after")
    def _fits(self) -> SalibDesign:
        if self.method == "sobol" and self.n & (self.n - 1):
            less = 1 << (self.n.bit_length() - 1)
            raise ValueError(f"n: {self.n} is not allowed with method sobol; a power of two, {less} or {2 * less}")
        if self.method == "morris" and self.second_order:
            raise ValueError("second_order: True is not allowed with method morris; it is of method sobol")
        return self

    @property
    def group(self) -> int:
        """Number of points in a group; indices need all of them."""
        size = len(self.ranges)
        if self.method == "morris":
            return size + 1
        return 2 * size + 2 if self.second_order else size + 2

    @property
    def problem(self) -> dict[str, Any]:
        """SALib's description of the problem: names of the parameters, and the unit cube as their ranges."""
        size = len(self.ranges)
        return {"num_vars": size, "names": list(self.ranges), "bounds": [[0.0, 1.0]] * size}

    def unit(self) -> Floats:
        """See `Design.unit`."""
        from SALib.sample import morris, sobol

        if self.method == "morris":
            return np.asarray(morris.sample(self.problem, self.n, num_levels=LEVELS, seed=self.seed))
        drawn = sobol.sample(self.problem, self.n, calc_second_order=self.second_order, seed=self.seed)
        return np.asarray(drawn)


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
    grouped, finite = values.reshape(design.n, design.group), np.isfinite(values)
    whole = np.asarray(finite.reshape(grouped.shape).all(axis=1))
    spoilt, cases, known = int((~whole).sum()), int((~finite).sum()), values[finite]
    mean, deviation = (float(known.mean()), float(known.std())) if known.size else (np.nan, np.nan)
    indices, reason, unit = list[Index](), "", f" {unit_of(outcome)}".rstrip()
    if not known.size:
        reason = "no case has a value"
    elif spoilt > MOST_SPOILT * design.n:
        reason = (
            f"{cases} of {len(values)} cases have no value and spoil {spoilt} of {design.n} groups; "
            f"more than {MOST_SPOILT:.0%}, so what is left is no sample of the ranges"
        )
    elif _same(known):
        reason = f"it is the same in all cases, {mean:g}{unit}"
    elif deviation <= bound:
        reason = (
            f"it varies by {deviation:.2g}{unit} (one standard deviation) around {mean:.6g}{unit}, and its numerical "
            f"error bound is {bound:.2g}{unit}; what matters there a smaller fidelity.tolerance would show"
        )
    else:
        cube, compute = (
            design.unit().reshape(*grouped.shape, -1),
            _of_morris if design.method == "morris" else _of_sobol,
        )
        for count in (design.n // part for part in BEGINNINGS):
            kept = np.flatnonzero(whole[:count])
            if len(kept) >= FEWEST and not _same(grouped[kept]):
                indices += compute(design, cube[kept], grouped[kept])
        reason = "" if indices else f"fewer than {FEWEST} whole groups"
    return Analysed(outcome, tuple(indices), design.n, spoilt, cases, mean, deviation, reason)


def unit_of(outcome: str) -> str:
    """Give the SI unit of an outcome; empty for numbers of ticks and for ratios."""
    return next(one.unit for one in OUTCOMES if one.name == outcome.removeprefix(LATERAL))


def _same(values: Floats) -> bool:
    return bool(np.ptp(values) <= SAME * np.abs(values).max())


def _of_sobol(design: SalibDesign, _points: Floats, values: Floats) -> list[Index]:
    """Compute Sobol's indices from values in groups, shape (n, group)."""
    from SALib.analyze import sobol

    result: Any = sobol.analyze(
        design.problem, values.ravel(), calc_second_order=design.second_order, num_resamples=RESAMPLES,
        conf_level=design.confidence, seed=design.seed + 1,
    )  # fmt: skip
    # SALib takes a seed of 0 for none
    names, places = list(design.ranges), range(len(design.ranges))
    wanted: list[tuple[str, str, tuple[int, ...]]] = [(names[i], kind, (i,)) for kind in ("S1", "ST") for i in places]
    if design.second_order:
        wanted += [(f"{names[i]} x {names[j]}", "S2", (i, j)) for i, j in combinations(places, 2)]
    return [
        _index(name, kind, len(values), result[kind][place], result[f"{kind}_conf"][place])
        for name, kind, place in wanted
    ]


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
    for i, name in enumerate(design.ranges):
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


class SensitivityStudy(NamedTuple):
    """A sensitivity analysis: cases at the points of a design, and the outcomes to be analysed."""

    cases: Study
    """The study whose cases are the points"""
    design: SalibDesign
    """The design of the points"""
    outcomes: tuple[str, ...]
    """Names of columns of the study's table"""


def read_sensitivity_study(path: Path) -> SensitivityStudy:
    """Read a study file.

    Raises:
        UsageError: the file cannot be read, a name is unknown, a value is not allowed, or ranges are missing.
    """
    content = read_mapping(path, "study", "bags, params, grid, sensitivity or outcomes")
    if "sample" in content:
        raise UsageError(f"{path}: sample is not allowed; the method under sensitivity draws its own")
    given = content.get("sensitivity")
    if not isinstance(given, Mapping):
        raise UsageError(f"{path}: sensitivity: {given!r} is not allowed; method, n and ranges")
    try:
        design = SalibDesign.model_validate(dict(given))
        outcomes = checked_outcomes(content.get("outcomes", USUAL))
    except ValidationError as error:
        raise UsageError(f"{path}: sensitivity.{first_fault(error)}") from None
    except UsageError as error:
        raise UsageError(f"{path}: {error}") from None
    study = Study({name: value for name, value in content.items() if name not in OWN}, str(path), design)
    study.content |= {name: content[name] for name in OWN if name in content}
    return SensitivityStudy(study, design, outcomes)


def first_fault(error: ValidationError) -> str:
    """Describe the first fault; a message about several fields together names them itself."""
    first = error.errors()[0]
    return first["msg"].removeprefix("Value error, ") if not first["loc"] else first_error(error)


def checked_outcomes(names: Any) -> tuple[str, ...]:
    """Check the names of the outcomes to be analysed.

    Raises:
        UsageError: it is no list of names, or a name is unknown or given twice.
    """
    known = [prefix + outcome.name for prefix in ("", LATERAL) for outcome in OUTCOMES]
    if not isinstance(names, list | tuple) or not names:
        raise UsageError(f"outcomes: {names!r} is not allowed; a list of some of {', '.join(known)}")
    for name in names:
        if name not in known or names.count(name) > 1:
            fault = "is given twice" if name in known else f"is not allowed; one of {', '.join(known)}"
            raise UsageError(f"outcomes: {name} {fault}")
    return tuple(names)


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
    form = ".2f" if factor == 1.0 and index.kind.startswith("S") else ".3g"
    value, low, high = (f"{factor * number:{form}}" for number in index[3:])
    return value if math.isnan(index.low) else f"{value} ({low} to {high})"


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


def bound_of(outcome: str, rows: Mapping[str, Any]) -> float:
    """Give the median of an outcome's numerical error bounds over the cases; 0 where none is known."""
    bounds = np.asarray(rows[BOUNDS[outcome]]) if outcome in BOUNDS else np.zeros(1)
    return float(np.nanmedian(bounds)) if np.isfinite(bounds).any() else 0.0


@dataclass(frozen=True)
class Sensitivity:
    """Results of `sensitivity`."""

    outcomes: dict[str, Analysed]
    """Analysis of each outcome, by name: indices for n/8, n/4, n/2 and n; or the reason why there are none"""
    remarks: dict[str, list[str]]
    """What has not converged of each outcome, a sentence each, by the outcome's name"""
    cohort: Cohort
    """The knees that were computed, in the order of the design"""

    def to_pandas(self) -> pd.DataFrame:
        """Give a data frame with a row for each index: outcome, parameter, index, n, value, low, high; SI units."""
        import pandas as pd

        rows = [(name, *index) for name, analysed in self.outcomes.items() for index in analysed.indices]
        return pd.DataFrame(rows, columns=list(AFTER))


def sensitivity(
    gait: Name | Mapping[str, ArrayLike], ranges: Mapping[str, Any], params: Source = DEFAULT_PARAMETERS, *,
    method: Literal["sobol", "morris"] = "sobol", n: int = 256, seed: int = 1, second_order: bool = False,
    confidence: float = 0.95, outcomes: Sequence[str] = USUAL, remap: Mapping[str, str] | None = None,
    namespace: str = "", threads: int = 0,
) -> Sensitivity:  # fmt: skip
    """Compute a knee at the points of a design by SALib, and find out which of its parameters matter.

    Args:
        gait: A bag or arrays, as for `sweep`.
        ranges: Ranges of two or more parameters, by name: two numbers, or a mapping of `from`, `to` and `scale`
            (linear or log).
        params: The knee, as for `load_model`.
        method: Sobol (shares of the variance) or Morris (effects over the whole range).
        n: Number of base samples, a power of two, or of trajectories; 8 to 65536.
        seed: Seed of the random numbers of design and bootstrap.
        second_order: Whether to compute Sobol's indices of pairs of parameters, too, from twice the cases.
        confidence: Confidence level of the intervals.
        outcomes: Outcomes to analyse, named as in the table of a sweep.
        remap: Other names of the input topics in a bag.
        namespace: Namespace of the input topics in a bag.
        threads: Number of threads; 0: one for each processor.

    Raises:
        UsageError: a range, outcome, parameter or gait is not allowed. Cases that fail are no error: see `spoilt` and
            `reason` of the outcomes.
    """
    options = {"method": method, "n": n, "seed": seed, "second_order": second_order, "confidence": confidence}
    try:
        design = SalibDesign.model_validate(options | {"ranges": dict(ranges)})
    except ValidationError as error:
        raise UsageError(first_fault(error)) from None
    names = checked_outcomes(list(outcomes))
    values = dict(zip(design.ranges, design.points().T, strict=True))
    cohort = sweep(gait, values, params, remap=remap, namespace=namespace, threads=threads)
    analysed = {}
    for name in names:
        rows = {one: _column(cohort, one) for one in {name, BOUNDS.get(name, name)}}
        analysed[name] = analyse(design, name, rows[name], bound_of(name, rows))
    return Sensitivity(analysed, {name: not_converged(design, one) for name, one in analysed.items()}, cohort)


def _column(cohort: Cohort, name: str) -> Any:
    """Give an outcome of all cases, shape (k,); refuse one of a compartment that is not modelled."""
    own = name.removeprefix(LATERAL)
    rows = cohort.outcomes if own == name else cohort.lateral
    if rows is None:
        raise UsageError(f"outcomes: {name} is not allowed; load.compartment is not both")
    return rows[own]
