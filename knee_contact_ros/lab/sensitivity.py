"""Sensitivity indices of a knee's outcomes to its parameters, of Sobol and Morris, by SALib, and `sensitivity`.

SALib draws the points in the unit cube, in groups (a
base sample, a trajectory), one after another: a larger n begins with the same groups, and so needs only the other
cases. It needs whole groups: one in which a case has no value is left out. If more than `MOST_SPOILT` of the groups are
left out, there are no indices, since the rest is no sample of the ranges.

Sobol: Saltelli et al. 2010, Computer Physics Communications 181:259-270, doi:10.1016/j.cpc.2009.09.018. Morris: Morris
1991, Technometrics 33:161-174, doi:10.1080/00401706.1991.10484804.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import repeat
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, ValidationError, model_validator

from knee_contact_ros.lab.study import Design, Floats
from knee_contact_ros.lab.sweep import LATERAL, OUTCOMES, Cohort, sweep
from knee_contact_ros.offline.notebooks import Name
from knee_contact_ros.parameters.files import Source, first_error
from knee_contact_ros.results import no_such
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.files import DEFAULT_PARAMETERS

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


class Analysed(NamedTuple):
    """Analysis of an outcome."""

    outcome: str
    """Name of the outcome"""
    table: pd.DataFrame
    """Indices for the beginnings of the design, and last for all of it: `parameter` (`a x b` for a pair), `index` (S1,
    ST or S2; mu_star, mu or sigma, over the whole range of the parameter), `n` (groups), `value`, and the ends of its
    interval, `low` and `high`, in the outcome's SI unit; no rows where there is a `reason`"""
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

    def __repr__(self) -> str:
        kind = "ST" if "ST" in set(self.table["index"]) else "mu_star"
        indices = [f"{name} {index['value']:.3g}" for name, index in self.final(kind).iterrows()]
        return f"<Analysed: {self.outcome}, {self.reason or kind + ' of ' + ', '.join(indices)}>"

    def final(self, kind: str) -> pd.DataFrame:
        """Give the indices of a kind for the whole design by parameter, the largest first."""
        last = self.table[(self.table["n"] == self.table["n"].max()) & (self.table["index"] == kind)]
        return last.sort_values("value", ascending=False, kind="stable").set_index("parameter")


def analyse(design: SalibDesign, outcome: str, values: Floats, bound: float = 0.0) -> Analysed:
    """Compute the indices of an outcome.

    Args:
        design: The design at whose points the outcome was computed.
        outcome: Name of the outcome.
        values: Values at the points, shape (design.number,); not a number where a case failed.
        bound: Bound of the values' numerical error; an outcome whose standard deviation is no larger has no indices.
    """
    import pandas as pd

    grouped, finite = values.reshape(design.n, design.group), np.isfinite(values)
    whole = np.asarray(finite.reshape(grouped.shape).all(axis=1))
    spoilt, cases, known = int((~whole).sum()), int((~finite).sum()), values[finite]
    mean, deviation = (float(known.mean()), float(known.std())) if known.size else (np.nan, np.nan)
    rows, reason, unit = list[tuple[Any, ...]](), "", f" {unit_of(outcome)}".rstrip()
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
        cube = design.unit().reshape(*grouped.shape, -1)
        compute = _of_morris if design.method == "morris" else _of_sobol
        for count in (design.n // part for part in BEGINNINGS):
            kept = np.flatnonzero(whole[:count])
            if len(kept) >= FEWEST and not _same(grouped[kept]):
                rows += [
                    (name, kind, len(kept), *map(float, numbers))
                    for name, kind, *numbers in compute(design, cube[kept], grouped[kept])
                ]
        reason = "" if rows else f"fewer than {FEWEST} whole groups"
    table = pd.DataFrame(rows, columns=list(AFTER[1:]))
    return Analysed(outcome, table, design.n, spoilt, cases, mean, deviation, reason)


def unit_of(outcome: str) -> str:
    """Give the SI unit of an outcome; empty for numbers of ticks and for ratios."""
    return next(one.unit for one in OUTCOMES if one.name == outcome.removeprefix(LATERAL))


def _same(values: Floats) -> bool:
    return bool(np.ptp(values) <= SAME * np.abs(values).max())


def _of_sobol(design: SalibDesign, _points: Floats, values: Floats) -> Iterator[tuple[Any, ...]]:
    """Compute Sobol's indices from values in groups, shape (n, group): parameter, kind, value, low and high of each."""
    from SALib.analyze import sobol

    result: Any = sobol.analyze(
        design.problem, values.ravel(), calc_second_order=design.second_order, num_resamples=RESAMPLES,
        conf_level=design.confidence, seed=design.seed + 1,
    )  # fmt: skip
    # SALib takes a seed of 0 for none
    for frame in result.to_df():
        for name, (value, half) in zip(frame.index, frame.to_numpy(), strict=True):
            yield (
                name if isinstance(name, str) else " x ".join(name), frame.columns[0], value, value - half, value + half
            )  # fmt: skip


def _of_morris(design: SalibDesign, points: Floats, values: Floats) -> Iterator[tuple[Any, ...]]:
    """Compute Morris's indices from trajectories: points, shape (n, group, parameters), and values, shape (n, group).

    SALib gives an interval of mu_star alone, so those of mu and sigma come from a bootstrap of our own.
    """
    from SALib.analyze import morris

    def screened(which: Any, resamples: int) -> Any:
        return morris.analyze(
            design.problem, points[which].reshape(-1, points.shape[-1]), values[which].ravel(),
            num_resamples=resamples, conf_level=design.confidence, num_levels=LEVELS, seed=design.seed + 1,
        )  # fmt: skip

    n, random, tail = len(values), np.random.default_rng(design.seed + 1), 0.5 * (1.0 - design.confidence)
    result, others = screened(slice(None), RESAMPLES), [screened(random.integers(n, size=n), 2) for _ in range(FEWER)]
    half = np.asarray(result["mu_star_conf"])
    for kind in ("mu_star", "mu", "sigma"):
        drawn = np.array([other[kind] for other in others], dtype=float)
        low, high = np.quantile(drawn, (tail, 1.0 - tail), axis=0)
        if kind == "mu_star":
            low, high = result[kind] - half, result[kind] + half
        yield from zip(design.ranges, repeat(kind), result[kind], low, high, strict=False)


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


def display_of(outcome: str) -> tuple[str, str, float]:
    """Give the title of an outcome, the unit in which it is shown, and the factor from its SI unit."""
    unit = unit_of(outcome)
    factor, name = UNITS.get(unit, (1.0, unit))
    return outcome.replace("_", " "), name, factor


def interval(index: Any, factor: float) -> str:
    """Write an index (a row of `Analysed.final`) with its interval, in a unit so many times smaller than its own."""
    form = ".2f" if factor == 1.0 and index["index"].startswith("S") else ".3g"
    value, low, high = (f"{factor * index[name]:{form}}" for name in ("value", "low", "high"))
    return f"{value} ({low} to {high})"


def not_converged(design: SalibDesign, analysed: Analysed) -> list[str]:
    """Give the reasons why the indices of an outcome have not converged; none if they have."""
    leading = analysed.final(LEADING[design.method])
    if leading.empty:
        return []
    parts, first, sobol = [], leading.iloc[0], design.method == "sobol"
    width, most = first["high"] - first["low"], WIDEST if sobol else WIDEST_EFFECT * first["value"]
    if width > most:
        factor = 1.0 if sobol else display_of(analysed.outcome)[2]
        least = math.ceil(first["n"] * (width / most) ** 2)  # an interval's width goes with the root of n
        enough = 1 << (least - 1).bit_length() if sobol else least
        parts.append(
            f"not converged: the interval of the largest index, {first['index']} of {first.name} "
            f"{interval(first, factor)}, is {factor * width:.2g} wide, more than {factor * most:.2g}; "
            + (f"n = {enough} may do" if enough <= MOST else "no n will do")
        )
    if len(leading) > 1 and leading.iloc[1]["high"] > first["low"]:
        parts.append(f"which of {first.name} and {leading.index[1]} matters more is open")
    # S1 sum to 1 at most, and ST to 1 at least (Saltelli et al. 2010).
    for kind, sign, limit in (("S1", 1.0, "more"), ("ST", -1.0, "less")):
        indices = analysed.final(kind)
        total, half = indices["value"].sum(), math.hypot(*(0.5 * (indices["high"] - indices["low"])))
        if len(indices) and sign * (total - 1.0) > half:
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

    def __repr__(self) -> str:
        doubted = sum(map(len, self.remarks.values()))
        lines = [f"{len(self.cohort.failed)} cases, {doubted} remark(s)", *map(repr, self.outcomes.values())]
        return "<Sensitivity: " + "\n  ".join(lines[:19]) + ">"

    def __getattr__(self, name: str) -> Any:
        raise no_such(self, name)

    def to_pandas(self) -> pd.DataFrame:
        """Give a data frame with a row for each index: outcome, parameter, index, n, value, low, high; SI units."""
        return tidy(self.outcomes.values())


def tidy(several: Iterable[Analysed]) -> pd.DataFrame:
    """Join the tables of several outcomes, with the name of the outcome in the first column."""
    import pandas as pd

    return pd.concat([one.table.assign(outcome=one.outcome) for one in several])[list(AFTER)]


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
