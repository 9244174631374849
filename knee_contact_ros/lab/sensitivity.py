"""Sobol and Morris indices of a knee's outcomes to its parameters, by SALib: for Python and the command.

A study file is that of a sweep, with `sensitivity` instead of `sample`:

    bags:        [walking.mcap]
    params:      [healthy, osteoarthritis]
    grid:        {load.share: [0.5, 1.0]}
    sensitivity: {method: sobol, n: 256, seed: 1, second_order: false, confidence: 0.95,
                  ranges: {contact.stiffness: [5.0e7, 1.0e8], contact.damping: {from: 1.0e3, to: 1.0e4, scale: log}}}
    outcomes:    [peak_depth, peak_pressure, bone_time]

SALib draws the points in the unit cube group by group (a base sample, or a trajectory). A larger n begins with the same
groups, so only the new cases must be computed. A group in which a case has no value is left out. If more than
`MOST_SPOILT` of the groups are left out, no indices are computed, since the rest no longer represents the ranges.

Sobol: Saltelli et al. 2010, Computer Physics Communications 181:259-270, doi:10.1016/j.cpc.2009.09.018. Morris: Morris
1991, Technometrics 33:161-174, doi:10.1080/00401706.1991.10484804.
"""

from __future__ import annotations

import io
import math
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, ValidationError, ValidationInfo, field_validator

from knee_contact_ros.lab.study import (
    Design,
    Shards,
    Spaced,
    Study,
    groups_of,
    read_study,
    run_study,
)
from knee_contact_ros.lab.sweep import LATERAL, OUTCOMES, Cohort, sweep
from knee_contact_ros.model.types import Floats
from knee_contact_ros.offline.notebooks import Name
from knee_contact_ros.parameters.files import Source, first_error
from knee_contact_ros.results import no_such
from knee_contact_ros.system.errors import IncompleteError, UsageError
from knee_contact_ros.system.files import DEFAULT_PARAMETERS
from knee_contact_ros.system.progress import progress
from knee_contact_ros.system.terminal import say

if TYPE_CHECKING:
    import pandas as pd


FEWEST, MOST = 8, 65_536
"""Smallest and largest number of groups: SALib's bootstrap holds about 2 kB per group and index"""
LEVELS = 4
"""Number of levels of a range between which Morris's trajectories step"""
RESAMPLES = 200
"""Number of resamples of the bootstrap"""
MOST_SPOILT = 0.1
"""Largest fraction of groups that may be left out"""
NOISY = 0.1
"""Ratio of an error bound to an outcome's standard deviation above which there is a remark"""
SAME = 1e-12
"""Range of an outcome, relative to its size, up to which it counts as constant"""
USUAL = ("peak_depth", "peak_pressure", "bone_time", "peak_force")
"""Outcomes that are analysed by default"""
KNOWN = (*OUTCOMES, *(LATERAL + name for name in OUTCOMES))
BOUNDS = {"peak_depth": "error_bound", "peak_force": "force_error_bound"}
"""Outcomes with a known numerical error, and the column that bounds it"""
NOTED = {
    "not_converged": "missed a tolerance",
    "implausible": "are implausible",
    "failed": "failed",
}
"""Columns of what a reader should know of, with words for it"""
INDICES = {"sobol": ("ST", "S1", "S2"), "morris": ("mu_star", "mu", "sigma")}
"""Indices of each method; parameters are sorted by the first one. S1, ST, S2 are fractions of the variance; mu_star, mu
and sigma are in the outcome's SI unit, over the whole range of the parameter"""
AFTER = ["outcome", "parameter", "index", "n", "value", "low", "high"]
"""Columns of a table of indices"""
UNITS = {"m": (1e3, "mm"), "Pa": (1e-6, "MPa"), "N/s": (1e-3, "kN/s")}
"""Factor to, and name of, the unit in which outcomes of an SI unit are shown"""
WIDEST = {"sobol": 0.1, "morris": 0.25}
"""Width of the largest index's interval up to which the indices count as converged; for Morris relative to the index"""
LEADERS, LEAST = 3, 0.01
"""Number of parameters that a line names, and the smallest ratio to the largest index for one to be named"""
CASES, TABLE, PICTURE = "cases", "indices.csv", "sensitivity_"
"""Names in the output folder: the folder with the results of all cases, the table, and how pictures begin"""
WIDTH, HEIGHT, BAR, WRAP = 6.4, 1.8, 0.34, 60
"""Width and least height [in] of a panel, height [in] of a parameter's bars, number of letters in a line of a title"""


class SalibDesign(Design):
    """The entry `sensitivity` of a study file."""

    method: Literal["sobol", "morris"] = "sobol"
    """Sobol: shares of the variance; Morris: effects over the whole range"""
    n: int = Field(256, ge=FEWEST, le=MOST)
    """Number of groups: of base samples, or of trajectories"""
    seed: int = Field(1, ge=0, lt=2**31)
    """Seed of the random numbers of design and bootstrap"""
    second_order: bool = False
    """Whether to compute Sobol's indices of pairs of parameters too"""
    confidence: float = Field(0.95, ge=0.5, le=0.999)
    """Confidence level of the intervals"""
    ranges: Annotated[dict[str, Spaced], Field(min_length=2)]

    @field_validator("n", "second_order")
    @classmethod
    def _fits(cls, value: int, info: ValidationInfo) -> int:
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
        return {
            "num_vars": len(self.ranges),
            "names": list(self.ranges),
            "bounds": [[0.0, 1.0]] * len(self.ranges),
        }

    def unit(self) -> Floats:
        """See `Design.unit`."""
        from SALib.sample import morris, sobol

        if self.method == "morris":
            return np.asarray(
                morris.sample(self.problem, self.n, num_levels=LEVELS, seed=self.seed)
            )
        return np.asarray(
            sobol.sample(self.problem, self.n, calc_second_order=self.second_order, seed=self.seed)
        )


class SensitivityStudy(Study):
    """Content of a study file with `sensitivity`."""

    sensitivity: SalibDesign
    outcomes: tuple[str, ...] = USUAL

    @property
    def design(self) -> SalibDesign:
        """The design of the points."""
        return self.sensitivity

    @field_validator("outcomes")
    @classmethod
    def _known(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        return checked_outcomes(names)

    @field_validator("sample", mode="before")
    @classmethod
    def _none(cls, _sample: Any) -> None:
        raise ValueError("sensitivity draws its own points")


def checked_outcomes(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the outcomes to be analysed.

    Raises:
        ValueError: the list is empty, or a name is unknown or given twice.
    """
    if not names or not set(names) <= set(KNOWN) or len(set(names)) < len(names):
        raise ValueError(f"some of {', '.join(KNOWN)}, each once")
    return tuple(names)


class Analysed(NamedTuple):
    """Analysis of an outcome."""

    outcome: str
    """Name of the outcome"""
    table: pd.DataFrame
    """Indices: `parameter` (`a x b` for a pair), `index` (see `INDICES`), `n` (groups), `value`, and the ends of its
    interval, `low` and `high` (NaN for mu and sigma); no rows where there is a `reason`"""
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

    grouped, finite = values.reshape(design.n, design.group), np.isfinite(values)
    whole = np.isfinite(grouped).all(axis=1)
    spoilt, cases, known = int((~whole).sum()), int((~finite).sum()), values[finite]
    mean, deviation = (float(known.mean()), float(known.std())) if known.size else (np.nan, np.nan)
    rows, reason, unit = (
        list[tuple[Any, ...]](),
        "",
        f" {OUTCOMES[outcome.removeprefix(LATERAL)]}".rstrip(),
    )
    if not known.size:
        reason = "no case has a value"
    elif spoilt > MOST_SPOILT * design.n or design.n - spoilt < FEWEST:
        reason = (
            f"{cases} of {len(values)} cases have no value and spoil {spoilt} of {design.n} groups; "
            f"more than {MOST_SPOILT:.0%}, so the rest is not a sample of the ranges"
        )
    elif np.ptp(known) <= SAME * np.abs(known).max():
        reason = f"it is the same in all cases, {mean:g}{unit}"
    elif deviation <= bound:
        reason = (
            f"it varies by {deviation:.2g}{unit} (one standard deviation) around {mean:.6g}{unit}, and its numerical "
            f"error bound is {bound:.2g}{unit}; use a smaller fidelity.tolerance to find what matters"
        )
    else:
        rows = list(_indices(design, whole, grouped[whole]))
    return Analysed(
        outcome,
        pd.DataFrame(rows, columns=AFTER[1:]),
        spoilt,
        cases,
        mean,
        deviation,
        reason,
        bound,
    )


def _indices(design: SalibDesign, whole: Any, values: Floats) -> Iterator[tuple[Any, ...]]:
    """Compute the indices from `values`, shape (n, group), of the `whole` groups of a design."""
    from SALib.analyze import morris, sobol

    # SALib takes a seed of 0 for none
    options: Any = {
        "num_resamples": RESAMPLES,
        "conf_level": design.confidence,
        "seed": design.seed + 1,
    }
    if design.method == "sobol":
        result = sobol.analyze(
            design.problem, values.ravel(), calc_second_order=design.second_order, **options
        )
        for frame in result.to_df():
            for name, (value, half) in zip(frame.index, frame.to_numpy(), strict=True):
                both = name if isinstance(name, str) else " x ".join(name)
                yield both, frame.columns[0], len(values), value, value - half, value + half
        return
    points = design.unit().reshape(design.n, design.group, -1)[whole].reshape(values.size, -1)
    result = morris.analyze(design.problem, points, values.ravel(), num_levels=LEVELS, **options)
    for kind in INDICES["morris"]:
        for name, value, half in zip(
            design.ranges, result[kind], result["mu_star_conf"], strict=True
        ):
            reach = float(half) if kind == "mu_star" else np.nan
            yield name, kind, len(values), float(value), value - reach, value + reach


def analysed_in(
    design: SalibDesign, rows: pd.DataFrame, outcomes: Sequence[str]
) -> dict[str, Analysed]:
    """Analyse outcomes, columns of a table with a row for each point."""
    found = {}
    for name in outcomes:
        bounds = rows[BOUNDS[name]].to_numpy(float) if name in BOUNDS else np.zeros(1)
        bound = float(np.nanmedian(bounds)) if np.isfinite(bounds).any() else 0.0
        found[name] = analyse(design, name, rows[name].to_numpy(float), bound)
    return found


def display_of(outcome: str) -> tuple[str, str, float]:
    """Return the title of an outcome, the unit in which it is shown, and the factor from its SI unit."""
    unit = OUTCOMES[outcome.removeprefix(LATERAL)]
    factor, name = UNITS.get(unit, (1.0, unit))
    return outcome.replace("_", " "), name, factor


def interval(index: Any, factor: float) -> str:
    """Write an index (a row of `Analysed.final`) with its interval, both multiplied by a factor to another unit."""
    form = ".2f" if index["index"].startswith("S") else ".3g"
    value, low, high = (f"{factor * index[name]:{form}}" for name in ("value", "low", "high"))
    return f"{value} ({low} to {high})"


def not_converged(design: SalibDesign, analysed: Analysed) -> list[str]:
    """Return why the indices of an outcome are in doubt; none if they have converged and errors are small."""
    leading, sobol = analysed.final(INDICES[design.method][0]), design.method == "sobol"
    if leading.empty:
        return []
    parts, first, factor = [], leading.iloc[0], 1.0 if sobol else display_of(analysed.outcome)[2]
    width, most = (
        first["high"] - first["low"],
        WIDEST[design.method] * (1.0 if sobol else first["value"]),
    )
    if width > most:
        least = math.ceil(
            first["n"] * (width / most) ** 2
        )  # an interval's width goes with the root of n
        enough = 1 << (least - 1).bit_length() if sobol else least
        parts.append(
            f"not converged: the interval of the largest index, {first['index']} of {first.name} "
            f"{interval(first, factor)}, is {factor * width:.2g} wide, more than {factor * most:.2g}; "
            + (f"n = {enough} may do" if enough <= MOST else "no n will do")
        )
    if len(leading) > 1 and leading.iloc[1]["high"] > first["low"]:
        parts.append(f"it is not clear which of {first.name} and {leading.index[1]} matters more")
    if analysed.bound > NOISY * analysed.deviation:
        what = f"the numerical error bound is {analysed.bound / analysed.deviation:.0%} of the standard deviation"
        parts.append(
            f"{what}: small indices may be those of the error; a smaller fidelity.tolerance helps"
        )
    return parts


@dataclass(frozen=True)
class Sensitivity:
    """Results of `sensitivity`."""

    outcomes: dict[str, Analysed]
    """Analysis of each outcome, by name: indices, or the reason why there are none"""
    remarks: dict[str, list[str]]
    """What has not converged, as sentences, by the outcome's name"""
    cohort: Cohort
    """The knees that were computed, in the order of the design"""

    def __repr__(self) -> str:
        doubted = sum(map(len, self.remarks.values()))
        lines = [
            f"{len(self.cohort.failed)} cases, {doubted} remark(s)",
            *map(repr, self.outcomes.values()),
        ]
        return "<Sensitivity: " + "\n  ".join(lines[:19]) + ">"

    def __getattr__(self, name: str) -> Any:
        raise no_such(self, name)

    def to_pandas(self) -> pd.DataFrame:
        """Return a data frame with a row for each index: outcome, parameter, index, n, value, low, high; SI units."""
        return tidy(self.outcomes)


def tidy(several: Mapping[str, Analysed]) -> pd.DataFrame:
    """Join the tables of several outcomes; the first column names the outcome."""
    import pandas as pd

    return pd.concat([one.table.assign(outcome=name) for name, one in several.items()])[AFTER]


def sensitivity(
    gait: Name | Mapping[str, ArrayLike],
    ranges: Mapping[str, Any],
    params: Source = DEFAULT_PARAMETERS,
    *,
    method: Literal["sobol", "morris"] = "sobol",
    n: int = 256,
    seed: int = 1,
    second_order: bool = False,
    confidence: float = 0.95,
    outcomes: Sequence[str] = USUAL,
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
        UsageError: a range, outcome, parameter or gait is not allowed. Failed cases raise nothing: see `spoilt` and
            `reason` of the outcomes.
    """
    options = {
        "method": method,
        "n": n,
        "seed": seed,
        "second_order": second_order,
        "confidence": confidence,
    }
    try:
        design = SalibDesign.model_validate(options | {"ranges": dict(ranges)})
        names = checked_outcomes(outcomes)
    except ValidationError as error:
        raise UsageError(first_error(error)) from None
    except ValueError as error:
        raise UsageError(f"outcomes: {outcomes!r} is not allowed; {error}") from None
    values = dict(zip(design.ranges, design.points().T, strict=True))
    cohort = sweep(gait, values, params, remap=remap, namespace=namespace, threads=threads)
    if cohort.lateral is None and (wrong := [name for name in names if name.startswith(LATERAL)]):
        raise UsageError(f"outcomes: {wrong[0]} is not allowed; load.compartment is not both")
    analysed = analysed_in(design, cohort.to_pandas(), names)
    return Sensitivity(
        analysed, {name: not_converged(design, one) for name, one in analysed.items()}, cohort
    )


class Combination(NamedTuple):
    """The indices for one combination of bag, parameter files and grid values."""

    columns: dict[str, str]
    """Bag, parameter files and grid values, by name"""
    label: str
    """What distinguishes it: the entries of `columns` that vary"""
    analysed: dict[str, Analysed]
    remark: str
    """Sentence on failed cases, missed tolerances and implausible answers; empty if there are none"""


def gather(study: SensitivityStudy, shards: Shards) -> list[Combination]:
    """Compute the indices of every combination whose cases are all computed, in the order of the study.

    Raises:
        UsageError: bag, parameters or folder cannot be used.
    """
    table = shards.read(*dict.fromkeys([*study.outcomes, *BOUNDS.values(), *NOTED]))
    choices: dict[str, Sequence[Any]] = {"bag": study.bags, "params": study.params, **study.grid}
    found = list[Combination]()
    several = [name for name, own in choices.items() if len(own) > 1] or ["bag", "params"]
    for group in groups_of(study):
        variants = study.variants()
        while cases := list(islice(variants, study.design.number)):
            rows = table.loc[[group.key(values) for values in cases]]
            columns = {"bag": group.bag, "params": " + ".join(group.params)} | {
                name: str(cases[0][name]) for name in study.grid
            }
            parts = [
                f"{name if name in study.grid else ''} {columns[name]}".strip() for name in several
            ]
            doubtful = [
                f"{count} {text}"
                for name, text in NOTED.items()
                if (count := int(rows[name].astype(bool).sum()))
            ]
            why = min(set(rows["failed"]) - {""}, default="")
            remark = (
                f"of {len(rows)} cases {', '.join(doubtful)}{why and ': ' + why}"
                if doubtful
                else ""
            )
            analysed = analysed_in(study.design, rows, study.outcomes)
            found.append(Combination(columns, ", ".join(parts), analysed, remark))
    return found


def sentences(
    study: SensitivityStudy, combinations: Sequence[Combination]
) -> Iterator[tuple[str, str]]:
    """Write which parameters matter most, a line for each outcome and combination, with what makes it doubtful."""
    kind, own = INDICES[study.design.method][0], study.design.method == "sobol"
    for outcome in study.outcomes:
        title, unit, factor = display_of(outcome)
        for each in combinations:
            one = each.analysed[outcome]
            leading = one.final(kind)[:LEADERS]
            parts = [
                f"{name} {interval(index, 1.0 if own else factor)} {'' if own else unit}".rstrip()
                for name, index in leading.iterrows()
                if index["value"] >= LEAST * leading["value"].iloc[0]
            ]
            spread = f"{factor * one.mean:.4g} ± {factor * one.deviation:.2g} {unit}".strip()
            doubts = not_converged(study.design, one)
            if one.spoilt and not one.reason:
                doubts.insert(
                    0,
                    f"{one.cases} cases have no value; {one.spoilt} groups are left out with them",
                )
            yield (
                f"{title}, {each.label}: {one.reason or '; '.join(parts) + f' (of {spread})'}",
                "; ".join(doubts),
            )


def draw(design: SalibDesign, panels: Sequence[tuple[str, Analysed]]) -> bytes:
    """Draw an outcome as PNG: for each combination the bars of its indices."""
    from matplotlib.figure import Figure

    title, unit, factor = display_of(panels[0][1].outcome)
    kinds, text = ["mu_star", "sigma"], f"{title} [{unit}]" if unit else title
    if design.method == "sobol":
        kinds, text, factor = ["S1", "ST"], f"share of the variance of {title}", 1.0
    names = sum(one.final(kinds[0])["value"] for _, one in panels).sort_values().index
    figure = Figure(
        figsize=(WIDTH, (HEIGHT + BAR * len(names)) * len(panels)), dpi=150, layout="constrained"
    )
    for (label, one), axis in zip(
        panels, figure.subplots(len(panels), squeeze=False).ravel(), strict=True
    ):
        table = one.table.pivot(index="parameter", columns="index")
        reach = (table["high"] - table["value"]).loc[names, kinds].clip(lower=0.0)
        (factor * table["value"].loc[names, kinds]).plot.barh(
            ax=axis,
            xerr=factor * reach.T.to_numpy(),
            color=["#0072B2", "#A6CEE8"],
            width=0.75,
            ylabel="",
            xlabel=text,
            title=textwrap.fill(label.replace("$", r"\$"), WRAP),
        )
        axis.legend(loc="lower right", fontsize=8, frameon=False)
        axis.spines[["top", "right"]].set_visible(False)
    file = io.BytesIO()
    figure.savefig(file, format="png", metadata={"Software": None})
    return file.getvalue()


def run_sensitivity(study_file: Path, output: str, workers: int, scheduler: str) -> None:
    """Compute the missing cases of a study's design, and write its indices and pictures.

    Args:
        study_file: Study file (YAML).
        output: Folder of the results, local or as fsspec spells it.
        workers: Processes on this machine; 0: one for each processor.
        scheduler: Address of a Dask scheduler whose workers compute instead; empty for this machine.

    Raises:
        UsageError: study, bags, parameters, folder or scheduler cannot be used.
        IncompleteError: a disk is full, or workers died again and again; or, when all is written, a bag is damaged or a
            case failed.
    """
    import pandas as pd

    study, folder = read_study(study_file, SensitivityStudy), output.rstrip("/") or output
    *_, missing = run_study(study, f"{folder}/{CASES}", workers, scheduler)
    with progress("Analysing"):
        combinations, shards = gather(study, Shards(f"{folder}/{CASES}")), Shards(folder)
        tables = [
            tidy(each.analysed).assign(**each.columns)[[*each.columns, *AFTER]]
            for each in combinations
        ]
        text = pd.concat(tables).to_csv(index=False, float_format="%.9g", lineterminator="\n")
        shards.put(TABLE, text.encode())
        written = set()
        for outcome in study.outcomes:
            panels = [(each.label, each.analysed[outcome]) for each in combinations]
            if panels := [(label, one) for label, one in panels if not one.reason]:
                written.add(f"{PICTURE}{outcome}.png")
                shards.put(f"{PICTURE}{outcome}.png", draw(study.design, panels))
        for path in shards.files.glob(f"{shards.folder}/{PICTURE}*.png"):  # of an earlier run
            if Path(path).name not in written:
                shards.files.rm_file(path)
    for line, doubts in sentences(study, combinations):
        say(line, hang=2)
        if doubts:
            say(f"knee-contact: warning: {line.partition(':')[0]}: {doubts}.", err=True, hang=2)
    for each in combinations:
        if each.remark:
            say(f"knee-contact: warning: {each.label}: {each.remark}.", err=True, hang=2)
    say(f"table: {folder}/{TABLE}")
    if missing:
        raise IncompleteError(missing)
