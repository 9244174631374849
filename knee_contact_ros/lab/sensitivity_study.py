"""The work of `knee-contact sensitivity`: indices and pictures of all knees of a study.

A study file is that of a sweep, with `sensitivity` instead of `sample`:

    bags:        [walking.mcap]
    params:      [healthy, osteoarthritis]
    grid:        {load.share: [0.5, 1.0]}
    sensitivity: {method: sobol, n: 256, seed: 1, second_order: false, confidence: 0.95,
                  ranges: {contact.stiffness: [5.0e7, 1.0e8], contact.damping: {from: 1.0e3, to: 1.0e4, scale: log}}}
    outcomes:    [peak_depth, peak_pressure, bone_time]
"""

import io
import textwrap
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import field_validator

from ..system.errors import IncompleteError
from ..system.progress import progress
from ..system.terminal import say
from ..view.picture import UNDATED, saved_figure
from .sensitivity import (
    DEFAULT_OUTCOMES,
    ERROR_BOUNDS,
    INDEX_COLUMNS,
    INDEX_KINDS,
    Analysed,
    SalibDesign,
    analyse_table,
    check_outcomes,
    display_of,
    format_index,
    joined_table,
    not_converged,
)
from .shards import ShardFolder
from .study import run_study
from .study_cases import groups_of
from .study_file import Study, read_study

DOUBTFUL_COLUMNS = {
    "not_converged": "missed a tolerance",
    "implausible": "are implausible",
    "failed": "failed",
}
"""Columns of what a reader should know of, with words for it"""
NAMED_PARAMETERS = 3
"""Number of parameters that a line names"""
LEAST_NAMED = 0.01
"""Smallest ratio of an index to the largest one for its parameter to be named"""
PICTURE = "sensitivity_{}.{}"
"""Name of the picture of an outcome, in a format"""


class SensitivityStudy(Study):
    """Content of a study file with `sensitivity`."""

    sensitivity: SalibDesign
    outcomes: tuple[str, ...] = DEFAULT_OUTCOMES

    @property
    def design(self) -> SalibDesign:
        """The design of the points."""
        return self.sensitivity

    @field_validator("outcomes")
    @classmethod
    def _check_outcomes(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        return check_outcomes(names)

    @field_validator("sample", mode="before")
    @classmethod
    def _refuse_sample(cls, _sample: Any) -> None:
        raise ValueError("sensitivity draws its own points")


class Combination(NamedTuple):
    """The indices for one combination of bag, parameter files and grid values."""

    columns: dict[str, str]
    """Bag, parameter files and grid values, by name"""
    label: str
    """What distinguishes it: the entries of `columns` that vary"""
    analysed: dict[str, Analysed]
    remark: str
    """Sentence on failed cases, missed tolerances and implausible answers; empty if there are none"""


def analyse_study(study: SensitivityStudy, shards: ShardFolder) -> list[Combination]:
    """Compute the indices of every combination whose cases are all computed, in the order of the study.

    Raises:
        UsageError: bag, parameters or folder cannot be used.
    """
    wanted = [*study.outcomes, *ERROR_BOUNDS.values(), *DOUBTFUL_COLUMNS]
    table = shards.read_columns(*dict.fromkeys(wanted))
    choices: dict[str, Sequence[Any]] = {"bag": study.bags, "params": study.params, **study.grid}
    varied = [name for name, own in choices.items() if len(own) > 1] or ["bag", "params"]
    found = []
    for group in groups_of(study):
        variants = study.variants()
        while cases := list(islice(variants, study.design.number)):
            rows = table.loc[[group.key(values) for values in cases]]
            columns = {"bag": group.bag, "params": " + ".join(group.params)}
            columns |= {name: str(cases[0][name]) for name in study.grid}
            # A bag and a parameter file need no name before them.
            parts = [
                f"{name} {columns[name]}" if name in study.grid else columns[name]
                for name in varied
            ]
            analysed = analyse_table(study.design, rows, study.outcomes)
            found.append(Combination(columns, ", ".join(parts), analysed, _remark(rows)))
    return found


def _remark(rows: Any) -> str:
    """Say how many cases are doubtful, and why one failed."""
    counts = {name: int(rows[name].astype(bool).sum()) for name in DOUBTFUL_COLUMNS}
    doubtful = [
        f"{counts[name]} {text}" for name, text in DOUBTFUL_COLUMNS.items() if counts[name]
    ]
    if not doubtful:
        return ""
    remark = f"of {len(rows)} cases {', '.join(doubtful)}"
    why = min(set(rows["failed"]) - {""}, default="")
    return f"{remark}: {why}" if why else remark


def sentences(
    study: SensitivityStudy, combinations: Sequence[Combination]
) -> Iterator[tuple[str, str]]:
    """Write which parameters matter most, a line for each outcome and combination, with what makes it doubtful."""
    method = study.design.method
    for outcome in study.outcomes:
        title, unit, factor = display_of(outcome)
        index_factor, index_unit = (1.0, "") if method == "sobol" else (factor, unit)
        for each in combinations:
            one = each.analysed[outcome]
            leading = one.final(INDEX_KINDS[method][0])[:NAMED_PARAMETERS]
            parts = [
                f"{name} {format_index(index, index_factor)} {index_unit}".rstrip()
                for name, index in leading.iterrows()
                if index["value"] >= LEAST_NAMED * leading["value"].iloc[0]
            ]
            spread = f"{factor * one.mean:.4g} ± {factor * one.deviation:.2g} {unit}".strip()
            doubts = not_converged(study.design, one)
            if one.spoilt and not one.reason:
                lost = (
                    f"{one.cases} cases have no value; {one.spoilt} groups are left out with them"
                )
                doubts.insert(0, lost)
            text = one.reason or f"{'; '.join(parts)} (of {spread})"
            yield f"{title}, {each.label}: {text}", "; ".join(doubts)


def draw_indices(design: SalibDesign, panels: Sequence[tuple[str, Analysed]], kind: str) -> bytes:
    """Draw an outcome in a format: for each combination the bars of its indices."""
    title, unit, factor = display_of(panels[0][1].outcome)
    kinds = ["mu_star", "sigma"]
    text = f"{title} [{unit}]" if unit else title
    if design.method == "sobol":
        kinds = ["S1", "ST"]
        text = f"share of the variance of {title}"
        factor = 1.0
    names = sum(one.final(kinds[0])["value"] for _, one in panels).sort_values().index
    height = (1.8 + 0.34 * len(names)) * len(panels)  # [in], a bar takes 0.34
    file = io.BytesIO()
    with saved_figure({kind: file}, (6.4, height), 150) as figure:
        axes = figure.subplots(len(panels), squeeze=False).ravel()
        for (label, one), axis in zip(panels, axes, strict=True):
            table = one.table.pivot(index="parameter", columns="index")
            reach = (table["high"] - table["value"]).loc[names, kinds].clip(lower=0.0)
            (factor * table["value"].loc[names, kinds]).plot.barh(
                ax=axis,
                xerr=factor * reach.T.to_numpy(),
                color=["#0072B2", "#A6CEE8"],
                width=0.75,
                ylabel="",
                xlabel=text,
                title=textwrap.fill(label.replace("$", r"\$"), 60),
            )
            axis.legend(loc="lower right", fontsize=8, frameon=False)
            axis.spines[["top", "right"]].set_visible(False)
    return file.getvalue()


def run_sensitivity(
    study_file: Path, output: str, workers: int, scheduler: str, kind: str
) -> None:
    """Compute the missing cases of a study's design, and write its indices and pictures.

    Args:
        study_file: Study file (YAML).
        output: Folder of the results, local or as fsspec spells it.
        workers: Processes on this machine; 0: one for each processor.
        scheduler: Address of a Dask scheduler whose workers compute instead; empty for this machine.
        kind: Format of the pictures: png, svg or pdf.

    Raises:
        UsageError: study, bags, parameters, folder or scheduler cannot be used.
        IncompleteError: a disk is full, or workers died again and again; or, when all is written, a bag is damaged or a
            case failed.
    """
    import pandas as pd

    study = read_study(study_file, SensitivityStudy)
    folder = output.rstrip("/") or output
    run = run_study(study, f"{folder}/cases", workers, scheduler)
    with progress("Analysing"):
        combinations = analyse_study(study, ShardFolder(f"{folder}/cases"))
        shards = ShardFolder(folder)
        tables = [
            joined_table(each.analysed).assign(**each.columns)[[*each.columns, *INDEX_COLUMNS]]
            for each in combinations
        ]
        text = pd.concat(tables).to_csv(index=False, float_format="%.9g", lineterminator="\n")
        shards.write_file("indices.csv", text.encode())
        earlier = {name for each in UNDATED for name in shards.matching(PICTURE.format("*", each))}
        for outcome in study.outcomes:
            panels = [
                (each.label, each.analysed[outcome])
                for each in combinations
                if not each.analysed[outcome].reason
            ]
            if panels:
                name = PICTURE.format(outcome, kind)
                shards.write_file(name, draw_indices(study.design, panels, kind))
                earlier.discard(name)
        for name in earlier:
            shards.remove_file(name)
    for line, doubts in sentences(study, combinations):
        say(line, hang=2)
        if doubts:
            say(f"knee-contact: warning: {line.partition(':')[0]}: {doubts}.", err=True, hang=2)
    for each in combinations:
        if each.remark:
            say(f"knee-contact: warning: {each.label}: {each.remark}.", err=True, hang=2)
    say(f"table: {folder}/indices.csv")
    if run.missing:
        raise IncompleteError(run.missing)
