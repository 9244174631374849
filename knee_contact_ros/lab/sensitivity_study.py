"""`knee-contact sensitivity`: indices for every combination of bag, knee and grid value of a study.

A study file is that of a sweep, with `sensitivity` in the place of `sample`:

    bags:        [walking.mcap]
    params:      [healthy, osteoarthritis]
    grid:        {load.share: [0.5, 1.0]}
    sensitivity: {method: sobol, n: 256, seed: 1, second_order: false, confidence: 0.95,
                  ranges: {contact.stiffness: [5.0e7, 1.0e8], contact.damping: {from: 1.0e3, to: 1.0e4, scale: log}}}
    outcomes:    [peak_depth, peak_pressure, bone_time]

They come as a table, and as a picture (PNG) for each outcome.
"""

from __future__ import annotations

import io
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

import pandas as pd
from pydantic import ValidationError

from knee_contact_ros.lab.run_study import Plan, Shards, run_study
from knee_contact_ros.lab.sensitivity import (
    BOUNDS,
    LEADING,
    USUAL,
    Analysed,
    SalibDesign,
    analyse,
    bound_of,
    checked_outcomes,
    display_of,
    first_fault,
    interval,
    not_converged,
    tidy,
    unit_of,
)
from knee_contact_ros.lab.study import Case, Study
from knee_contact_ros.system.errors import IncompleteError, UsageError
from knee_contact_ros.system.files import read_mapping
from knee_contact_ros.system.terminal import progress, say

OWN = ("sensitivity", "outcomes")
"""Names in the file that the study file of a sweep does not have"""
NOISY = 0.1
"""Ratio of an error bound to an outcome's standard deviation above which there is a remark"""
NOTED = {"not_converged": "missed a tolerance", "implausible": "are implausible"}
"""Columns that count ticks which a reader should know of, and what these ticks do"""
LEADERS, LEAST = 3, 0.01
"""Number of parameters that a line names, and ratio to the largest index from which on one is named beside it"""
CASES, TABLE, PICTURE = "cases", "indices.csv", "sensitivity_"
"""Names in the output folder: the folder with the results of all cases, the table, and how pictures begin"""
DARK, LIGHT = "#0072B2", "#A6CEE8"
WIDTH, HEIGHT, BAR, WRAP = 4.6, 2.9, 0.34, 44
"""Width and least height [in] of a panel, height [in] of a parameter's bars, number of letters in a line of a title"""
STYLE: Any = {"axes.spines.top": False, "axes.spines.right": False, "axes.axisbelow": True, "legend.frameon": False,
              "legend.fontsize": 8, "figure.dpi": 150}  # fmt: skip


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


class Combination(NamedTuple):
    """The indices for one combination of bag, parameter files and grid values."""

    label: str
    """Name of the combination: the values in which it differs from the others"""
    case: Case
    """Its first case"""
    analysed: tuple[Analysed, ...]
    """Indices of each outcome, in the order of the study's outcomes"""
    remarks: tuple[str, ...]
    """What a reader should know of failed cases, numerical errors and implausible answers, a sentence each"""


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
    keys = list(map(Plan(cases).key, map(cases.case, range(cases.number))))
    table = shards.rows(keys, list(dict.fromkeys([*study.outcomes, *BOUNDS.values(), *NOTED, "failed"])))
    firsts = [cases.case(number) for number in range(0, cases.number, size)]
    combinations: list[Combination] = []
    for case, label in zip(firsts, labels(cases, firsts), strict=True):
        rows = table.iloc[len(combinations) * size :][:size]
        analysed = []
        for name in study.outcomes:
            analysed.append(analyse(study.design, name, rows[name].to_numpy(), bound_of(name, rows)))
            advance(len(combinations) * len(study.outcomes) + len(analysed), len(firsts) * len(study.outcomes))
        told = (f"{label}: {sentence}." for sentence in _doubts(analysed, rows))
        combinations.append(Combination(label, case, tuple(analysed), tuple(told)))
    return combinations


def labels(study: Study, firsts: list[Case]) -> list[str]:
    """Describe in what each combination differs, given its first case; a single one by its bag and parameter files."""

    def shortest(paths: Sequence[str]) -> Sequence[str]:  # without folders and endings, if they differ so
        names = [PurePosixPath(path.rstrip("/")).stem for path in paths]
        return names if len(set(names)) == len(set(paths)) else paths

    bags, several = shortest(study.bags), [name for name, values in study.grid.items() if len(values) > 1]
    texts = []
    for case in firsts:
        parts = [bags[study.bags.index(case.bag)]] if len(study.bags) > 1 or len(firsts) == 1 else []
        parts += [" + ".join(shortest(case.params))] if len(study.params) > 1 or len(firsts) == 1 else []
        values = ((name, case.values[name]) for name in several)
        parts += [f"{name} {value:g}" if isinstance(value, float) else f"{name} {value}" for name, value in values]
        texts.append(", ".join(parts))
    return texts


def _doubts(analysed: Sequence[Analysed], rows: pd.DataFrame) -> Iterator[str]:
    """Describe failures, numerical errors that are not small, and missed tolerances or implausible answers."""
    if failures := sorted(set(rows["failed"]) - {""}):
        more = f" (and {len(failures) - 1} other reasons)" if len(failures) > 1 else ""
        yield f"cases failed: {failures[0]}{more}"
    for one in analysed:
        bound, unit = bound_of(one.outcome, rows), unit_of(one.outcome)
        if not one.reason and bound > NOISY * one.deviation:
            yield (
                f"{one.outcome} varies by {one.deviation:.2g} {unit} (one standard deviation), and its numerical error "
                f"bound is {bound:.2g} {unit}: small indices may be those of the error; a smaller fidelity.tolerance "
                "helps"
            )
    for name, meaning in NOTED.items():
        affected = rows[rows[name] > 0]
        if len(affected):
            yield (
                f"{len(affected)} of {len(rows)} cases have ticks that {meaning}; the error bound of "
                f"their depths is {1e3 * affected['error_bound'].max():.2g} mm at most"
            )


def as_csv(study: Study, combinations: Sequence[Combination]) -> str:
    """Make a CSV table with a row for each index; numbers have nine digits."""
    parts = []
    for each in combinations:
        part = tidy(each.analysed)
        own = {"bag": each.case.bag, "params": " + ".join(each.case.params)}
        for place, (name, value) in enumerate((own | {name: each.case.values[name] for name in study.grid}).items()):
            part.insert(place, name, str(value))
        parts.append(part)
    table: str = pd.concat(parts).to_csv(index=False, float_format="%.9g", lineterminator="\n")
    return table


def summary(design: SalibDesign, combinations: Sequence[Combination]) -> Iterator[str]:
    """Say what matters most: outcome, combination, leading parameters, mean and deviation, a line each."""
    for place, each in ((place, each) for place in range(len(combinations[0].analysed)) for each in combinations):
        analysed = each.analysed[place]
        title, unit, factor = display_of(analysed.outcome)
        leading = analysed.final(LEADING[design.method])[:LEADERS]
        own = ("", 1.0) if design.method == "sobol" else (unit, factor)
        parts = [
            f"{name} {interval(index, own[1])} {own[0]}".rstrip()
            for name, index in leading.iterrows()
            if index["value"] >= LEAST * leading["value"].iloc[0]
        ]
        spread = f"{factor * analysed.mean:.4g} ± {factor * analysed.deviation:.2g} {unit}".strip()
        found = analysed.reason or f"{'; '.join(parts)} (of {spread})"
        yield f"{title}, {each.label}: {found}"


def remarks(design: SalibDesign, combinations: Sequence[Combination]) -> Iterator[str]:
    """Describe all that makes indices doubtful, a sentence each."""
    for each in combinations:
        for analysed in each.analysed:
            where = f"{display_of(analysed.outcome)[0]}, {each.label}"
            if analysed.spoilt and not analysed.reason:
                yield (
                    f"{where}: {analysed.cases} of {design.number} cases have no value; {analysed.spoilt} of "
                    f"{analysed.groups} groups are left out with them, and the indices are those of the knees that "
                    "could be computed."
                )
            if doubts := not_converged(design, analysed):
                yield f"{where}: {'; '.join(doubts)}."
        yield from each.remarks


def draw(design: SalibDesign, panels: Sequence[tuple[str, Analysed]]) -> bytes:
    """Draw an outcome as PNG: for each combination its indices, Morris's plane, and the course of the leading ones."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    kind, (title, unit, factor) = LEADING[design.method], display_of(panels[0][1].outcome)
    if sobol := design.method == "sobol":
        title, unit, factor = f"share of the variance of {title}", "", 1.0
    leading = [analysed.final(kind)["value"] for _, analysed in panels]
    names = sum((one / abs(one.iloc[0]) for one in leading), 0.0 * leading[0]).sort_values().index
    course = any(analysed.table["n"].nunique() > 1 for _, analysed in panels)
    with mpl.rc_context(STYLE):
        columns, height = 1 + (not sobol) + course, max(HEIGHT, 1.0 + BAR * len(names))
        figure = Figure(figsize=(WIDTH * columns, height * len(panels) + 0.5), layout="constrained")
        grid = figure.subplots(len(panels), columns, squeeze=False)
        for (label, analysed), axes in zip(panels, grid, strict=True):
            table = analysed.table.assign(**{name: factor * analysed.table[name] for name in ("value", "high")})
            last = table[table["n"] == table["n"].max()].pivot(index="parameter", columns="index")
            values, ends = last["value"].loc[names], (last["high"] - last["value"]).loc[names].clip(lower=0.0)
            kinds = ["S1", "ST"] if sobol else [kind]
            values[kinds].plot.barh(
                ax=axes[0], xerr=ends[kinds].T.to_numpy(), color=[DARK, LIGHT], width=0.75, ylabel="", legend=False,
                xlabel=f"{title} [{unit}]" if unit else title, title=textwrap.fill(label.replace("$", r"\$"), WRAP),
            )  # fmt: skip
            if not sobol:
                across, up = values[kind], values["sigma"]
                axes[1].errorbar(across, up, ends["sigma"], ends[kind], fmt="o", color=DARK, ecolor="0.6")
                for name in names[across > 0.05 * across.max()]:
                    axes[1].annotate(name, (across[name], up[name]), (4, 3), textcoords="offset points", fontsize=8)
                axes[1].set(xlabel="mu_star: matters much", ylabel="sigma: bends, or hangs on others")
            if course:
                own = table[table["index"] == kind].pivot(index="n", columns="parameter")
                own["value"][names[::-1]].plot(
                    ax=axes[-1], yerr=(own["high"] - own["value"])[names[::-1]], marker="o", logx=True, legend=False,
                    xlabel="n", ylabel=kind, colormap="tab10",
                )  # fmt: skip
                axes[-1].set_xticks(own.index, own.index.astype(str), minor=False)
                axes[-1].minorticks_off()
        known = dict(
            pair[::-1] for axis in grid[0][::-1] for pair in zip(*axis.get_legend_handles_labels(), strict=True)
        )
        figure.legend(known.values(), known.keys(), loc="outside lower center", ncols=2 * columns)
        file = io.BytesIO()
        figure.savefig(file, format="png", metadata={"Software": None})
    return file.getvalue()


def write_files(shards: Shards, files: Mapping[str, bytes]) -> None:
    """Write files into a folder, each whole or not at all, and remove other pictures that an earlier run has written.

    Raises:
        IncompleteError: the folder cannot be written.
    """
    try:
        for name, content in files.items():
            shards.put(name, content)
        for path in shards.files.glob(f"{shards.folder}/{PICTURE}*.png"):
            if PurePosixPath(path).name not in files:
                shards.files.rm_file(path)
    except OSError as error:
        raise IncompleteError(f"{error.filename or shards.url}: {error.strerror or error}") from None


def run_sensitivity(study_file: Path, output: str, workers: int, scheduler: str) -> None:
    """Compute the missing cases of a study's design, and write its indices and pictures.

    Args:
        study_file: Study file (YAML).
        output: Folder of the results, local or as fsspec spells it.
        workers: Processes on this machine; 0: one for each processor.
        scheduler: Address of a Dask scheduler whose workers compute instead; empty for this machine.

    Raises:
        UsageError: study, bags, parameters, folder or scheduler cannot be used.
        IncompleteError: a disk is full, or workers died again and again.
    """
    study, folder = read_sensitivity_study(study_file), output.rstrip("/") or output
    with progress("Computing") as advance:
        done = run_study(study.cases, f"{folder}/{CASES}", workers=workers, scheduler=scheduler, advance=advance)
    say(f"{study.cases.number} cases: {done.computed} computed, {done.there} were there, {done.failed} failed")
    with progress("Analysing") as advance:
        combinations = gather(study, Shards(f"{folder}/{CASES}"), advance)
        advance.describe("Drawing")
        files = {TABLE: as_csv(study.cases, combinations).encode()}
        for place, outcome in enumerate(study.outcomes):
            panels = [(each.label, each.analysed[place]) for each in combinations if not each.analysed[place].reason]
            files |= {f"{PICTURE}{outcome}.png": draw(study.design, panels)} if panels else {}
        write_files(Shards(folder), files)
    for line in summary(study.design, combinations):
        say(line, hang=2)
    for sentence in remarks(study.design, combinations):
        say(f"knee-contact: warning: {sentence}", err=True, hang=2)
    say(f"table: {folder}/{TABLE}")
