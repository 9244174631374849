"""Sobol and Morris indices of a knee's outcomes to its parameters, by SALib.

SALib draws the points in the unit cube group by group (a base sample, or a trajectory). A larger n begins with the same
groups, so only the new cases must be computed. A group in which a case has no value is left out. If more than
`MAX_LEFT_OUT` of the groups are left out, no indices are computed, since the rest no longer represents the ranges.

Sobol: Saltelli et al. 2010, Computer Physics Communications 181:259-270, doi:10.1016/j.cpc.2009.09.018. Morris: Morris
1991, Technometrics 33:161-174, doi:10.1080/00401706.1991.10484804.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, ValidationError, ValidationInfo, field_validator

from ..model.types import Floats
from ..offline.notebooks import Name
from ..parameters.files import ParameterSource
from ..parameters.sections import first_error
from ..results import missing_attribute
from ..system.arguments import checked
from ..system.errors import UsageError
from ..system.files import DEFAULT_PARAMETERS, require
from .outcomes import LATERAL_OUTCOME, OUTCOMES
from .study_file import Design, SpacedValues
from .sweep import Cohort, sweep

if TYPE_CHECKING:
    import pandas as pd


MIN_GROUPS = 8
"""Smallest number of groups"""
MAX_GROUPS = 65_536
"""Largest number of groups: SALib's bootstrap holds about 2 kB per group and index"""
MORRIS_LEVELS = 4
"""Number of levels of a range between which Morris's trajectories step: Morris's own choice, and SALib's"""
MAX_LEFT_OUT = 0.1
"""Largest fraction of groups that may be left out"""
MAX_ERROR_RATIO = 0.1
"""Ratio of an error bound to an outcome's standard deviation above which there is a remark"""
CONSTANT = 1e-12
"""Range of an outcome, relative to its size, up to which it counts as constant"""
DEFAULT_OUTCOMES = ("peak_depth", "peak_pressure", "bone_time", "peak_force")
"""Outcomes that are analysed by default"""
ALL_OUTCOMES = (*OUTCOMES, *(LATERAL_OUTCOME + name for name in OUTCOMES))
"""Outcomes that can be analysed"""
ERROR_BOUNDS = {"peak_depth": "error_bound", "peak_force": "force_error_bound"}
"""Outcomes with a known numerical error, and the column that bounds it"""
INDEX_KINDS = {"sobol": ("ST", "S1", "S2"), "morris": ("mu_star", "mu", "sigma")}
"""Indices of each method; parameters are sorted by the first one. S1, ST, S2 are fractions of the variance; mu_star, mu
and sigma are in the outcome's SI unit, over the whole range of the parameter"""
INDEX_COLUMNS = ["outcome", "parameter", "index", "n", "value", "low", "high"]
"""Columns of a table of indices"""
DISPLAY_UNITS = {"m": (1e3, "mm"), "Pa": (1e-6, "MPa"), "N/s": (1e-3, "kN/s")}
"""Factor to, and name of, the unit in which outcomes of an SI unit are shown"""
CONVERGED_WIDTH = {"sobol": 0.1, "morris": 0.25}
"""Width of the largest index's interval up to which the indices count as converged; for Morris relative to the index"""


class SalibDesign(Design):
    """The entry `sensitivity` of a study file."""

    method: Literal["sobol", "morris"] = "sobol"
    """Sobol: shares of the variance; Morris: effects over the whole range"""
    n: int = Field(256, ge=MIN_GROUPS, le=MAX_GROUPS)
    """Number of groups: of base samples, or of trajectories"""
    seed: int = Field(1, ge=0, lt=2**31)
    """Seed of the random numbers of design and bootstrap"""
    second_order: bool = False
    """Whether to compute Sobol's indices of pairs of parameters too"""
    confidence: float = Field(0.95, ge=0.5, le=0.999)
    """Confidence level of the intervals"""
    ranges: Annotated[dict[str, SpacedValues], Field(min_length=2)]

    @field_validator("n", "second_order")
    @classmethod
    def _check_method(cls, value: int, info: ValidationInfo) -> int:
        method = info.data.get("method")
        if info.field_name == "second_order" and value and method == "morris":
            raise ValueError("it is of method sobol")
        if info.field_name == "n" and method == "sobol" and value & (value - 1):
            less = 1 << (value.bit_length() - 1)
            raise ValueError(f"with method sobol a power of two, {less} or {2 * less}")
        return value

    @property
    def group(self) -> int:
        """Number of points in a group."""
        size = len(self.ranges)
        if self.method == "morris":
            return size + 1
        return 2 * size + 2 if self.second_order else size + 2

    @property
    def number(self) -> int:
        """Number of points."""
        return self.n * self.group

    @property
    def problem(self) -> dict[str, Any]:
        """SALib's description of the problem: names of the parameters, and the unit cube as their ranges."""
        size = len(self.ranges)
        return {"num_vars": size, "names": list(self.ranges), "bounds": [[0.0, 1.0]] * size}

    def unit_points(self) -> Floats:
        """See `Design.unit_points`."""
        from SALib.sample import morris, sobol

        if self.method == "morris":
            points = morris.sample(self.problem, self.n, num_levels=MORRIS_LEVELS, seed=self.seed)
        else:
            points = sobol.sample(
                self.problem, self.n, calc_second_order=self.second_order, seed=self.seed
            )
        return np.asarray(points)


def check_outcomes(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the outcomes to be analysed.

    Raises:
        ValueError: the list is empty, or a name is unknown or given twice.
    """
    known = all(name in [*ALL_OUTCOMES] for name in names)
    if not names or not known or len(set(names)) < len(names):
        raise ValueError(f"some of {', '.join(ALL_OUTCOMES)}, each once")
    return tuple(names)


class Analysed(NamedTuple):
    """Analysis of an outcome."""

    outcome: str
    """Name of the outcome"""
    table: pd.DataFrame
    """Indices: `parameter` (`a x b` for a pair), `index` (see `INDEX_KINDS`), `n` (groups), `value`, and the ends of
    its interval, `low` and `high` (NaN for mu and sigma); no rows where there is a `reason`"""
    spoilt: int
    """Number of groups with a case without a value"""
    cases: int
    """Number of cases without a value"""
    mean: float
    """Mean of the outcome over the cases that have a value"""
    deviation: float
    """Standard deviation of the outcome over the cases that have a value"""
    reason: str
    """Why there are no indices; empty if there are"""
    bound: float
    """Bound of the numerical error of the values"""

    def __repr__(self) -> str:
        kind = "ST" if "ST" in set(self.table["index"]) else "mu_star"
        indices = [f"{name} {index['value']:.3g}" for name, index in self.final(kind).iterrows()]
        return f"<Analysed: {self.outcome}, {self.reason or kind + ' of ' + ', '.join(indices)}>"

    def final(self, kind: str) -> pd.DataFrame:
        """Return the indices of a kind by parameter, the largest first."""
        own = self.table[self.table["index"] == kind]
        return own.sort_values("value", ascending=False, kind="stable").set_index("parameter")


def analyse(design: SalibDesign, outcome: str, values: Floats, bound: float = 0.0) -> Analysed:
    """Compute the indices of an outcome.

    Args:
        design: The design at whose points the outcome was computed.
        outcome: Name of the outcome.
        values: Values at the points, shape (design.number,); NaN where a case failed.
        bound: Bound of the values' numerical error; an outcome whose standard deviation is no larger has no indices.
    """
    import pandas as pd

    groups = values.reshape(design.n, design.group)
    whole = np.isfinite(groups).all(axis=1)
    spoilt = int(np.count_nonzero(~whole))
    known = values[np.isfinite(values)]
    cases = len(values) - len(known)
    mean, deviation = (float(known.mean()), float(known.std())) if known.size else (np.nan, np.nan)
    unit = f" {OUTCOMES[outcome.removeprefix(LATERAL_OUTCOME)]}".rstrip()
    reason = ""
    if not known.size:
        reason = "no case has a value"
    elif spoilt > MAX_LEFT_OUT * design.n or design.n - spoilt < MIN_GROUPS:
        reason = (
            f"{cases} of {len(values)} cases have no value and spoil {spoilt} of {design.n} groups; "
            f"more than {MAX_LEFT_OUT:.0%}, so the rest is not a sample of the ranges"
        )
    elif np.ptp(known) <= CONSTANT * np.abs(known).max():
        reason = f"it is the same in all cases, {mean:g}{unit}"
    elif deviation <= bound:
        reason = (
            f"it varies by {deviation:.2g}{unit} (one standard deviation) around {mean:.6g}{unit}, and its numerical "
            f"error bound is {bound:.2g}{unit}; use a smaller fidelity.tolerance to find what matters"
        )
    rows = [] if reason else list(_indices(design, whole, groups[whole]))
    table = pd.DataFrame(rows, columns=INDEX_COLUMNS[1:])
    return Analysed(outcome, table, spoilt, cases, mean, deviation, reason, bound)


def _indices(design: SalibDesign, whole: Any, values: Floats) -> Iterator[tuple[Any, ...]]:
    """Compute the indices from `values`, shape (n, group), of the `whole` groups of a design."""
    from SALib.analyze import morris, sobol

    options: Any = {
        "num_resamples": 200,  # of the bootstrap, which gives the intervals
        "conf_level": design.confidence,
        "seed": design.seed + 1,  # SALib takes 0 for no seed
    }
    if design.method == "sobol":
        result = sobol.analyze(
            design.problem, values.ravel(), calc_second_order=design.second_order, **options
        )
        for frame in result.to_df():
            for name, (value, half) in zip(frame.index, frame.to_numpy(), strict=True):
                label = name if isinstance(name, str) else " x ".join(name)
                yield label, frame.columns[0], len(values), value, value - half, value + half
        return
    points = design.unit_points().reshape(design.n, design.group, -1)[whole]
    points = points.reshape(values.size, -1)
    result = morris.analyze(
        design.problem, points, values.ravel(), num_levels=MORRIS_LEVELS, **options
    )
    for kind in INDEX_KINDS["morris"]:
        for name, value, half in zip(
            design.ranges, result[kind], result["mu_star_conf"], strict=True
        ):
            reach = float(half) if kind == "mu_star" else np.nan
            yield name, kind, len(values), float(value), value - reach, value + reach


def analyse_table(
    design: SalibDesign, rows: pd.DataFrame, outcomes: Sequence[str]
) -> dict[str, Analysed]:
    """Analyse outcomes, columns of a table with a row for each point."""
    found = {}
    for name in outcomes:
        bounds = rows[ERROR_BOUNDS[name]].to_numpy(float) if name in ERROR_BOUNDS else np.zeros(1)
        bound = float(np.nanmedian(bounds)) if np.isfinite(bounds).any() else 0.0
        found[name] = analyse(design, name, rows[name].to_numpy(float), bound)
    return found


def display_of(outcome: str) -> tuple[str, str, float]:
    """Return the title of an outcome, the unit in which it is shown, and the factor from its SI unit."""
    unit = OUTCOMES[outcome.removeprefix(LATERAL_OUTCOME)]
    factor, name = DISPLAY_UNITS.get(unit, (1.0, unit))
    return outcome.replace("_", " "), name, factor


def format_index(index: Any, factor: float) -> str:
    """Write an index (a row of `Analysed.final`) with its interval, both multiplied by a factor to another unit."""
    form = ".2f" if index["index"].startswith("S") else ".3g"
    value, low, high = (f"{factor * index[name]:{form}}" for name in ("value", "low", "high"))
    return f"{value} ({low} to {high})"


def not_converged(design: SalibDesign, analysed: Analysed) -> list[str]:
    """Return why the indices of an outcome are in doubt; none if they have converged and errors are small."""
    leading = analysed.final(INDEX_KINDS[design.method][0])
    if leading.empty:
        return []
    first = leading.iloc[0]
    sobol = design.method == "sobol"
    factor = 1.0 if sobol else display_of(analysed.outcome)[2]
    width = first["high"] - first["low"]
    allowed = CONVERGED_WIDTH[design.method] * (1.0 if sobol else first["value"])
    parts = []
    if width > allowed:
        # The width of an interval falls with the root of n.
        enough = math.ceil(first["n"] * (width / allowed) ** 2)
        if sobol:
            enough = 1 << (enough - 1).bit_length()
        cure = f"n = {enough} may do" if enough <= MAX_GROUPS else "no n will do"
        parts.append(
            f"not converged: the interval of the largest index, {first['index']} of {first.name} "
            f"{format_index(first, factor)}, is {factor * width:.2g} wide, more than {factor * allowed:.2g}; {cure}"
        )
    if len(leading) > 1 and leading.iloc[1]["high"] > first["low"]:
        parts.append(f"it is not clear which of {first.name} and {leading.index[1]} matters more")
    if analysed.bound > MAX_ERROR_RATIO * analysed.deviation:
        parts.append(
            f"the numerical error bound is {analysed.bound / analysed.deviation:.0%} of the standard deviation: "
            "small indices may be those of the error; a smaller fidelity.tolerance helps"
        )
    return parts


@dataclass(frozen=True)
class Sensitivity:
    """Results of `sensitivity`.

    Example:
        >>> from knee_contact_ros import sensitivity
        >>> ranges = {"contact.stiffness": (5e7, 1e8), "contact.damping": (2e3, 8e3)}
        >>> found = sensitivity("bags/gait2354_right", ranges, method="morris", n=8)
        >>> sorted(found.outcomes)
        ['bone_time', 'peak_depth', 'peak_force', 'peak_pressure']
    """

    outcomes: dict[str, Analysed]
    """Analysis of each outcome, by name: indices, or the reason why there are none"""
    remarks: dict[str, list[str]]
    """What has not converged, as sentences, by the outcome's name"""
    cohort: Cohort
    """The knees that were computed, in the order of the design"""

    def __repr__(self) -> str:
        count = sum(map(len, self.remarks.values()))
        lines = [f"{len(self.cohort.failed)} cases, {count} remark(s)"]
        lines += map(repr, self.outcomes.values())
        return "<Sensitivity: " + "\n  ".join(lines[:19]) + ">"

    def __getattr__(self, name: str) -> Any:
        raise missing_attribute(self, name)

    def to_pandas(self) -> pd.DataFrame:
        """Return a data frame with a row for each index: outcome, parameter, index, n, value, low, high; SI units.

        Example:
            >>> from knee_contact_ros import sensitivity
            >>> ranges = {"contact.stiffness": (5e7, 1e8), "contact.damping": (2e3, 8e3)}
            >>> table = sensitivity("bags/gait2354_right", ranges, method="morris", n=8).to_pandas()
            >>> list(table.columns)
            ['outcome', 'parameter', 'index', 'n', 'value', 'low', 'high']
        """
        return joined_table(self.outcomes)


def joined_table(analysed: Mapping[str, Analysed]) -> pd.DataFrame:
    """Join the tables of several outcomes; the first column names the outcome."""
    import pandas as pd

    tables = [one.table.assign(outcome=name) for name, one in analysed.items()]
    return pd.concat(tables)[INDEX_COLUMNS]


@checked
def sensitivity(
    gait: Name | Mapping[str, ArrayLike],
    ranges: Mapping[str, Any],
    params: ParameterSource = DEFAULT_PARAMETERS,
    *,
    method: Literal["sobol", "morris"] = "sobol",
    n: int = 256,
    seed: int = 1,
    second_order: bool = False,
    confidence: float = 0.95,
    outcomes: Sequence[str] = DEFAULT_OUTCOMES,
    remap: Mapping[str, str] | None = None,
    namespace: str = "",
    threads: int = 0,
) -> Sensitivity:
    """Compute a knee at the points of a design by SALib, and find out which of its parameters matter.

    Args:
        gait: A bag or arrays, as for `sweep`.
        ranges: Ranges of two or more parameters, by name: two numbers, or a mapping of `from`, `to` and `scale`
            (linear or log).
        params: The knee, as for `load_model`.
        method: Sobol (shares of the variance) or Morris (effects over the whole range).
        n: Number of base samples, a power of two, or of trajectories; 8 to 65536.
        seed: Seed of the random numbers of design and bootstrap.
        second_order: Whether to compute Sobol's indices of pairs of parameters too, which takes twice the cases.
        confidence: Confidence level of the intervals.
        outcomes: Outcomes to analyse, named as in the table of a sweep.
        remap: Other names of the input topics in a bag.
        namespace: Namespace of the input topics in a bag.
        threads: Number of threads; 0: one for each processor.

    An implausible or damaged bag causes warnings.

    Raises:
        UsageError: a range, outcome, parameter or gait is not allowed, or the extra sweep is not installed. Failed
            cases raise nothing: see `spoilt` and `reason` of the outcomes.

    Example:
        >>> import numpy as np
        >>> from knee_contact_ros import sensitivity
        >>> time = np.linspace(0.0, 1.0, 101)
        >>> gait = {
        ...     "time": time,
        ...     "flexion_angle": 0.3 + 0.2 * np.sin(6.3 * time),
        ...     "axial_load": 1400.0 + 800.0 * np.sin(12.6 * time),
        ... }
        >>> ranges = {"contact.stiffness": (5e7, 1e8), "contact.damping": (2e3, 8e3)}
        >>> found = sensitivity(gait, ranges, method="morris", n=8)
        >>> indices = found.to_pandas().query("outcome == 'peak_depth' and index == 'mu_star'")
        >>> indices.set_index("parameter").value.astype(float).idxmax()
        'contact.stiffness'
    """
    require("sweep", "SALib", "pandas")
    content = {
        "method": method,
        "n": n,
        "seed": seed,
        "second_order": second_order,
        "confidence": confidence,
        "ranges": dict(ranges),
    }
    try:
        design = SalibDesign.model_validate(content)
        names = check_outcomes(outcomes)
    except ValidationError as error:
        raise UsageError(first_error(error)) from None
    except ValueError as error:
        raise UsageError(f"outcomes: {outcomes!r} is not allowed; {error}") from None
    values = dict(zip(design.ranges, design.points().T, strict=True))
    cohort = sweep(gait, values, params, remap=remap, namespace=namespace, threads=threads)
    lateral = [name for name in names if name.startswith(LATERAL_OUTCOME)]
    if lateral and cohort.lateral is None:
        raise UsageError(f"outcomes: {lateral[0]} is not allowed; load.compartment is not both")
    analysed = analyse_table(design, cohort.to_pandas(), names)
    remarks = {name: not_converged(design, one) for name, one in analysed.items()}
    return Sensitivity(analysed, remarks, cohort)
