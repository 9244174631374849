"""`knee-contact sensitivity`: the indices of a study for every combination of bag, parameter files and grid values.

They come as a table, as figures (PNG), and as one HTML page that needs no other file.
"""

from __future__ import annotations

import base64
import io
import itertools
import math
import textwrap
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

import fsspec
import numpy as np
import pandas as pd

from knee_contact_ros import __version__
from knee_contact_ros.lab import sensitivity as analysis
from knee_contact_ros.lab.run_study import Plan, Shards, run_study
from knee_contact_ros.lab.sensitivity import BOUNDS, LEADING, WIDEST, Analysed, SalibDesign, SensitivityStudy
from knee_contact_ros.lab.study import Case, Study
from knee_contact_ros.parameters.files import known_parameters
from knee_contact_ros.system.errors import IncompleteError
from knee_contact_ros.system.terminal import progress, say

NOISY = 0.1
"""Ratio of an error bound to an outcome's standard deviation above which there is a remark"""
NOTED = {"not_converged": "missed a tolerance", "implausible": "are implausible"}
"""Columns that count ticks which a reader should know of, and what these ticks do"""
LEADERS = 3
"""Number of parameters that the first table names"""
LEAST = 0.01
"""Ratio to the largest index from which on an index is named beside it"""
CASES, PAGE, TABLE = "cases", "sensitivity.html", "indices.csv"
"""Names in the command's output folder: the folder with the results of all cases, the page and the table"""
KINDS = {"bars": "What matters for", "plane": "Morris's plane of", "convergence": "Convergence for"}
"""Kinds of figures, which begin their files' names, and their titles; those of an earlier run are removed"""
COLOURS = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000"]
"""Of Okabe and Ito, which colour-blind readers can tell apart"""
MARKERS = "osD^vP*"
DARK, LIGHT = "#0072B2", "#A6CEE8"
PANELS, COLUMNS = 6, 2
"""The largest number of panels of a figure, and of panels side by side"""
WIDTH, HEIGHT, BAR, EDGES = 3.6, 2.7, 0.34, 1.0
"""Width and height [in] of a panel, height [in] of a parameter's bars, and of the space above and below all bars"""
LINE, LETTER, WRAP = 0.2, 0.075, 40
"""Height [in] of a line of the legend, width [in] of a letter, and number of letters in a line of a panel's title"""
STYLE: Any = {"font.size": 10, "axes.titlesize": 10, "axes.spines.top": False, "axes.spines.right": False,
         "axes.grid": True, "grid.color": "0.92", "axes.axisbelow": True, "legend.frameon": False,
         "legend.fontsize": 8.5, "figure.dpi": 200}  # fmt: skip


class Combination(NamedTuple):
    """The indices for one combination of bag, parameter files and grid values."""

    label: str
    """Name of the combination: the values in which it differs from the others"""
    case: Case
    """Its first case"""
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
    keys = list(map(Plan(cases).key, map(cases.case, range(cases.number))))
    table = shards.rows(keys, list(dict.fromkeys([*study.outcomes, *BOUNDS.values(), *NOTED, "failed"])))
    firsts = [cases.case(number) for number in range(0, cases.number, size)]
    combinations: list[Combination] = []
    for case, label in zip(firsts, labels(cases, firsts), strict=True):
        rows = table.iloc[len(combinations) * size :][:size]
        analysed = []
        for name in study.outcomes:
            values, bound = rows[name].to_numpy(), analysis.bound_of(name, rows)
            analysed.append(analysis.analyse(study.design, name, values, bound))
            advance(len(combinations) * len(study.outcomes) + len(analysed), len(firsts) * len(study.outcomes))
        grid = {name: case.values[name] for name in cases.grid}
        failures = tuple(sorted(set(rows["failed"]) - {""}))
        combinations.append(Combination(label, case, grid, tuple(analysed), failures, tuple(_doubts(analysed, rows))))
    return combinations


def labels(study: Study, firsts: list[Case]) -> list[str]:
    """Describe in what each combination differs, given its first case; a single one by its bag and parameter files."""
    bags, several = _shortest(study.bags), [name for name, values in study.grid.items() if len(values) > 1]
    texts = []
    for case in firsts:
        parts = []
        if len(study.bags) > 1 or len(firsts) == 1:
            parts.append(bags[study.bags.index(case.bag)])
        if len(study.params) > 1 or len(firsts) == 1:
            parts.append(" + ".join(_shortest(case.params)))
        values = ((name, case.values[name]) for name in several)
        parts += [f"{name} {value:g}" if isinstance(value, float) else f"{name} {value}" for name, value in values]
        texts.append(", ".join(parts))
    return texts


def _shortest(paths: Sequence[str]) -> Sequence[str]:
    """Shorten paths to names without folders and endings, unless two of them would be the same."""
    names = [PurePosixPath(path.rstrip("/")).stem for path in paths]
    return names if len(set(names)) == len(set(paths)) else paths


def _doubts(analysed: Sequence[Analysed], rows: pd.DataFrame) -> Iterator[str]:
    """Describe numerical errors that are not small, and cases with missed tolerances or implausible answers."""
    for one in analysed:
        bound, unit = analysis.bound_of(one.outcome, rows), analysis.unit_of(one.outcome)
        if one.indices and bound > NOISY * one.deviation:
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


def as_csv(combinations: Sequence[Combination]) -> str:
    """Make a CSV table with a row for each index; numbers have nine digits, and an unknown end of an interval none."""
    rows = [
        (each.case.bag, " + ".join(each.case.params), *map(str, each.grid.values()), analysed.outcome, *index)
        for each in combinations
        for analysed in each.analysed
        for index in analysed.indices
    ]
    columns = ["bag", "params", *combinations[0].grid, *analysis.AFTER]
    table: str = pd.DataFrame(rows, columns=columns).to_csv(index=False, float_format="%.9g", lineterminator="\n")
    return table


def what_matters(design: SalibDesign, combinations: Sequence[Combination]) -> list[tuple[str, str, str, str]]:
    """Give outcome, combination, leading parameters, and mean and deviation, for each outcome of each combination."""
    rows = []
    for of_outcome in zip(*(each.analysed for each in combinations), strict=True):
        for analysed, each in zip(of_outcome, combinations, strict=True):
            title, unit, factor = own = analysis.display_of(analysed.outcome)
            if design.method == "sobol":
                unit, factor = "", 1.0
            leading = analysed.final(LEADING[design.method])[:LEADERS]
            parts = [
                f"{index.parameter} {analysis.interval(index, factor)} {unit}".rstrip()
                for index in leading
                if index.value >= LEAST * leading[0].value
            ]
            spread = f"{own.factor * analysed.mean:.4g} ± {own.factor * analysed.deviation:.2g} {own.unit}".strip()
            rows.append((title, each.label, analysed.reason or "; ".join(parts), spread))
    return rows


def remarks(design: SalibDesign, combinations: Sequence[Combination]) -> Iterator[str]:
    """Describe all that makes indices doubtful, a sentence each."""
    for each in combinations:
        for analysed in each.analysed:
            where = f"{analysis.display_of(analysed.outcome).title}, {each.label}"
            if analysed.reason:
                yield f"{where}: no index: {analysed.reason}."
                continue
            if analysed.spoilt:
                yield (
                    f"{where}: {analysed.cases} of {design.number} cases have no value; {analysed.spoilt} of "
                    f"{analysed.groups} groups are left out with them, and the indices are those of the knees that "
                    "could be computed."
                )
            doubts = analysis.not_converged(design, analysed)
            if doubts:
                yield f"{where}: {'; '.join(doubts)}."
        if each.failures:
            more = f" (and {len(each.failures) - 1} other reasons)" if len(each.failures) > 1 else ""
            yield f"{each.label}: cases failed: {each.failures[0]}{more}."
        yield from (f"{each.label}: {sentence}." for sentence in each.doubts)


class Figure(NamedTuple):
    """A figure of the page."""

    kind: str
    """One of `KINDS`"""
    name: str
    """Name of its file"""
    title: str
    png: bytes
    """Content of the PNG file"""


class Drawing:
    """Figures of an outcome; a panel for each combination that has indices."""

    def __init__(self, design: SalibDesign, panels: Sequence[tuple[str, Analysed]]) -> None:
        """Take the labels of combinations and the outcome of each."""
        self.panels, self.kind, self.morris = panels, LEADING[design.method], design.method == "morris"
        self.own = analysis.display_of(panels[0][1].outcome)
        self.factor, self.what = (self.own.factor, self.own.label) if self.morris else (1.0, self.own.title)
        weights = dict.fromkeys(design.ranges, 0.0)
        for _, analysed in panels:
            final = analysed.final(self.kind)
            for index in final:
                weights[index.parameter] += index.value / max(abs(final[0].value), 1e-300)
        self.names = sorted(weights, key=lambda name: -weights[name])
        """Parameters by their indices, relative to the largest one, summed over all panels"""

    def figures(self) -> Iterator[tuple[str, bytes]]:
        """Draw all figures; yields kinds and contents of PNG files."""
        yield "bars", self._draw(BAR * len(self.names) + EDGES, self._bars)
        if self.morris:
            yield "plane", self._draw(HEIGHT, self._plane)
        if any(len({index.n for index in analysed.indices}) > 1 for _, analysed in self.panels):
            yield "convergence", self._draw(HEIGHT, self._course)

    def _draw(self, height: float, paint: Callable[[Any, Analysed], None]) -> bytes:
        import matplotlib as mpl
        from matplotlib.figure import Figure as Canvas

        columns = min(COLUMNS, len(self.panels))
        rows = math.ceil(len(self.panels) / columns)
        with mpl.rc_context(STYLE):
            width, height = columns * WIDTH + LETTER * max(map(len, self.names)), rows * height
            canvas = Canvas(figsize=(width, height), layout="constrained")
            axes = canvas.subplots(rows, columns, squeeze=False, sharey=not self.morris or paint == self._bars).ravel()
            for axis, (label, analysed) in zip(axes, self.panels, strict=False):
                paint(axis, analysed)
                axis.set_title(textwrap.fill(label.replace("$", r"\$"), WRAP))
            for axis in axes[len(self.panels) :]:
                axis.set_visible(False)
            handles, texts = axes[0].get_legend_handles_labels()
            if len(texts) > 1:  # below the panels, which are alike
                across = max(1, min(len(texts), int(width / (LETTER * max(map(len, texts)) + 0.6))))
                canvas.legend(handles, texts, loc="outside lower center", ncols=across)
                canvas.set_size_inches(width, height + LINE * -(-len(texts) // across))
            file = io.BytesIO()
            canvas.savefig(file, format="png", metadata={"Software": None})
        return file.getvalue()

    def _table(self, analysed: Analysed, rows: str, columns: str) -> tuple[pd.DataFrame, pd.DataFrame]:
        """Give values, and how far their intervals reach above them, as tables of two fields of `Index`."""
        indices = pd.DataFrame(analysed.indices)
        indices = indices[indices["kind"] == self.kind if rows == "n" else indices["n"] == indices["n"].max()]
        table = self.factor * indices.pivot(index=rows, columns=columns, values=["value", "high"])
        return table["value"], table["high"] - table["value"]

    def _bars(self, axis: Any, analysed: Analysed) -> None:
        kinds = {"mu_star": "µ*"} if self.morris else {"S1": "S1: alone", "ST": "ST: with all interactions"}
        values, ends = (one.loc[self.names, list(kinds)] for one in self._table(analysed, "parameter", "kind"))
        values.rename(columns=kinds).plot.barh(
            ax=axis, xerr=ends.T.to_numpy(), color=[DARK, LIGHT], width=0.75, legend=False, xlabel="", ylabel="",
            error_kw={"ecolor": "0.15", "elinewidth": 1.2, "capsize": 2.5},
        )  # fmt: skip
        if not axis.yaxis_inverted():
            axis.invert_yaxis()
        axis.grid(visible=False, axis="y")
        axis.set_xlabel(f"µ* of {self.what}" if self.morris else f"share of the variance of {self.what}")

    def _course(self, axis: Any, analysed: Analysed) -> None:
        values, ends = self._table(analysed, "n", "parameter")
        for look, name in zip(_looks(), self.names, strict=False):
            axis.errorbar(values.index, values[name], ends[name], label=name, **look, lw=1.2, capsize=2.0, ms=4.5)
        last = values.index[-1]
        axis.set_xscale("log", base=2)
        axis.set_xlim(0.8 * values.index[0], last * 1.35)
        axis.set_xticks(values.index, values.index.astype(str))
        if not self.morris:
            first = analysed.final("ST")[0].value
            axis.plot([1.25 * last] * 2, [first - WIDEST / 2, first + WIDEST / 2], "0.5", lw=4, solid_capstyle="butt")
            most = max(index.value for _, one in self.panels for index in one.indices if index.kind == "ST")
            axis.set_ylim(-0.05, 1.05 * max(1.0, most))
        axis.set_xlabel("n, trajectories" if self.morris else "n, base samples")
        axis.set_ylabel(f"{'µ*' if self.morris else 'ST'} of {self.what}")
        axis.label_outer()

    def _plane(self, axis: Any, analysed: Analysed) -> None:
        effects, spreads = analysed.by_parameter("mu_star"), analysed.by_parameter("sigma")
        for look, name in zip(_looks(), self.names, strict=False):
            across, up = (self.factor * np.array(one[name][3:]) for one in (effects, spreads))
            ends = (np.maximum([[one[0] - one[1]], [one[2] - one[0]]], 0.0) for one in (up, across))
            axis.errorbar(across[0], up[0], *ends, label=name, **(look | {"ls": "none"}), capsize=2.0, ms=6)
        for slope, dashes in ((1.0, "--"), (0.1, ":")):
            axis.axline((0.0, 0.0), slope=slope, color="0.55", lw=1.0, ls=dashes, zorder=1)
        axis.set_xlabel(f"µ* of {self.what}")
        axis.set_ylabel(f"σ of {self.what}")


def _looks() -> Iterator[dict[str, Any]]:
    """Give colour, marker and line style of one parameter after another."""
    number = len(COLOURS)
    for i in itertools.count():
        marker = MARKERS[(i + i // number) % number]
        yield {"color": COLOURS[i % number], "marker": marker, "ls": ("-", "--", ":")[i // number % 3]}


def figures(design: SalibDesign, combinations: Sequence[Combination], place: int) -> Iterator[Figure]:
    """Draw the figures of the outcome with the index `place`; none if it has no indices in any combination."""
    panels = [(each.label, each.analysed[place]) for each in combinations if each.analysed[place].indices]
    for number, begin in enumerate(range(0, len(panels), PANELS), 1):
        suffix, which = (f"_{number}", f", part {number}") if len(panels) > PANELS else ("", "")
        drawing = Drawing(design, panels[begin : begin + PANELS])
        for kind, png in drawing.figures():
            name = f"{kind}_{panels[0][1].outcome}{suffix}.png"
            yield Figure(kind, name, f"{KINDS[kind]} {drawing.own.title}{which}", png)


def make_files(study: SensitivityStudy, combinations: list[Combination]) -> dict[str, bytes]:
    """Make figures, table and page: contents of files by name, the page last."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    drawn = [list(figures(study.design, combinations, place)) for place in range(len(study.outcomes))]
    environment = Environment(
        loader=PackageLoader(__package__ or "", ""), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        keep_trailing_newline=True,
    )  # fmt: skip
    environment.filters["base64"] = lambda data: base64.b64encode(data).decode("ascii")
    page = environment.get_template("sensitivity.html.jinja").render(
        version=__version__, design=study.design, cases=study.cases, combinations=combinations, widest=WIDEST,
        remarks=list(remarks(study.design, combinations)), matters=what_matters(study.design, combinations),
        parameters=known_parameters(), interval=analysis.interval, leading=LEADING[study.design.method],
        outcomes=list(zip(map(analysis.display_of, study.outcomes), drawn, strict=True)),
    )  # fmt: skip
    files = {figure.name: figure.png for of_outcome in drawn for figure in of_outcome}
    return files | {TABLE: as_csv(combinations).encode(), PAGE: page.encode()}


def write_files(output: str, files: Mapping[str, bytes]) -> None:
    """Write files into a folder, each whole or not at all, and remove other figures that an earlier run has written.

    Raises:
        IncompleteError: the folder cannot be written.
    """
    folder, (system, place) = Shards(output, uuid.uuid4().hex[:12]), fsspec.core.url_to_fs(output)
    try:
        for name, content in files.items():
            folder.put(name, content)
        for path in system.ls(place, detail=False):
            name = PurePosixPath(path).name
            if name.startswith(tuple(f"{kind}_" for kind in KINDS)) and name.endswith(".png") and name not in files:
                system.rm_file(path)
    except OSError as error:
        raise IncompleteError(f"{error.filename or output}: {error.strerror or error}") from None


def run_sensitivity(study_file: Path, output: str, workers: int, scheduler: str) -> None:
    """Compute the missing cases of a study's design, and write its indices, figures and page.

    Args:
        study_file: Study file (YAML).
        output: Folder of the results, local or as fsspec spells it.
        workers: Processes on this machine; 0: one for each processor.
        scheduler: Address of a Dask scheduler whose workers compute instead; empty for this machine.

    Raises:
        UsageError: study, bags, parameters, folder or scheduler cannot be used.
        IncompleteError: a disk is full, or workers died again and again.
    """
    study = analysis.read_sensitivity_study(study_file)
    folder = f"{output.rstrip('/') or output}/{CASES}"
    with progress("Computing") as advance:
        done = run_study(study.cases, folder, workers=workers, scheduler=scheduler, advance=advance)
    say(f"{study.cases.number} cases: {done.computed} computed, {done.there} were there, {done.failed} failed")
    with progress("Analysing") as advance:
        combinations = gather(study, Shards(folder), advance)
        advance.describe("Drawing")
        write_files(output, make_files(study, combinations))
    for outcome, where, leading, _ in what_matters(study.design, combinations):
        say(f"{outcome}, {where}: {leading}", hang=2)
    for sentence in remarks(study.design, combinations):
        if ": no index: " not in sentence:  # printed above
            say(f"knee-contact: warning: {sentence}", err=True, hang=2)
    say(f"page: {output.rstrip('/')}/{PAGE}")
