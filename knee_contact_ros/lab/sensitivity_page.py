"""`knee-contact sensitivity`: the indices of a study, in figures, a table and a page."""

from __future__ import annotations

import base64
import csv
import io
import math
import textwrap
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

import fsspec
import numpy as np
from numpy.typing import NDArray

from knee_contact_ros import __version__
from knee_contact_ros.lab.run_study import Shards, keys_of, run_study
from knee_contact_ros.lab.sensitivity import (
    AFTER,
    BOUNDS,
    LEADING,
    WIDEST,
    Analysed,
    Display,
    Index,
    SalibDesign,
    SensitivityStudy,
    analyse,
    bound_of,
    display_of,
    interval,
    not_converged,
    read_sensitivity_study,
    unit_of,
)
from knee_contact_ros.lab.study import Case, Study
from knee_contact_ros.parameters.files import known_parameters
from knee_contact_ros.system.errors import IncompleteError
from knee_contact_ros.system.terminal import progress, say

NOISY = 0.1
"""Ratio of an error bound to an outcome's standard deviation above which there is a remark"""
NOTED = ("not_converged", "implausible")
"""Columns that count ticks which a reader should know of"""
BEFORE = ("bag", "params")


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


LEADERS = 3
"""Number of parameters that the first table names"""
LEAST = 0.01
"""Ratio to the largest index from which on an index is named beside it"""


class Table(NamedTuple):
    """A table of the page."""

    head: Sequence[str]
    rows: Sequence[Sequence[str]]


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


COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
MARKERS = "osD^vP*"
"""Markers of parameters, beside the colours of Okabe and Ito, which colour-blind readers can tell apart"""
DARK, LIGHT = "#0072B2", "#A6CEE8"
PANELS, COLUMNS = 6, 2
"""The largest number of panels of a figure, and of panels side by side"""
WIDTH, HEIGHT, BAR, EDGES = 3.6, 2.7, 0.34, 1.0
"""Width and height [in] of a panel, height [in] of a parameter's bars, and of the space above and below all bars"""
LINE, LETTER = 0.2, 0.075
"""Height [in] of a line of the legend, and width [in] of a letter of a parameter's name"""
EDGE = 0.03
"""Margin of an axis, relative to the range of what is drawn"""
WRAP = 40
"""Number of letters in a line of a panel's title"""
DPI = 200
STYLE: Any = {"font.size": 10, "axes.titlesize": 10, "axes.spines.top": False, "axes.spines.right": False,
         "axes.grid": True, "grid.color": "0.92", "axes.axisbelow": True, "legend.frameon": False,
         "legend.fontsize": 8.5, "figure.dpi": DPI}  # fmt: skip


class Figure(NamedTuple):
    """A figure of the page."""

    name: str
    """Name of its file, without the suffix"""
    title: str
    caption: str
    """One sentence or a few"""
    png: bytes
    """Content of the PNG file"""


class Panel(NamedTuple):
    """An outcome of a combination, which is a panel of each figure."""

    label: str
    analysed: Analysed


def figures(design: SalibDesign, combinations: Sequence[Combination], place: int) -> list[Figure]:
    """Draw the figures of the outcome with the index `place`; none if it has no indices in any combination."""
    panels = [Panel(each.label, each.analysed[place]) for each in combinations if each.analysed[place].indices]
    parts = [panels[begin : begin + PANELS] for begin in range(0, len(panels), PANELS)]
    drawn = []
    for number, part in enumerate(parts, 1):
        suffix, which = (f"_{number}", f", part {number}") if len(parts) > 1 else ("", "")
        drawn += [
            figure._replace(name=figure.name + suffix, title=figure.title + which) for figure in _of_part(design, part)
        ]
    return drawn


def _of_part(design: SalibDesign, panels: Sequence[Panel]) -> Iterator[Figure]:
    outcome = panels[0].analysed.outcome
    own = display_of(outcome)
    names, percent = _order(design, panels), f"{100 * design.confidence:g} %"
    tall = BAR * len(names) + EDGES
    painted = partial(_bars, own=own, names=names, morris=design.method == "morris")
    if design.method == "morris":
        caption = (
            f"µ*: mean size of the change of {own.title} over the whole range of a parameter, with its {percent} "
            "interval."
        )
    else:
        caption = (
            f"Shares of the variance of {own.title}: what a parameter makes alone (S1), and with all of its "
            f"interactions (ST); lines: {percent} intervals."
        )
    yield Figure(f"bars_{outcome}", f"What matters for {own.title}", caption, _draw(panels, tall, painted, names))
    if design.method == "morris":
        caption = (
            "Right: matters much. Up: acts otherwise from place to place, by itself or with others. Above the dashed "
            "line (σ = µ*) more so than it acts at all, below the dotted one (σ = 0.1 µ*) almost as a straight line."
        )
        plane = partial(_plane, own=own, names=names)
        yield Figure(f"plane_{outcome}", f"Morris's plane of {own.title}", caption, _draw(panels, HEIGHT, plane, names))
    kind = "µ*" if design.method == "morris" else "ST"
    if any(len({index.n for index in panel.analysed.indices}) > 1 for panel in panels):
        caption = f"{kind} and its {percent} interval for the beginnings of the design: n/8, n/4, n/2, n."
        if design.method == "sobol":
            caption += f" Grey bar at the right: {WIDEST:g}, as wide as the largest one's interval may be."
            caption += " Wide intervals leave the picture."
        course = partial(_course, own=own, names=names, design=design, limits=_limits(design, panels))
        name, title = f"convergence_{outcome}", f"Convergence for {own.title}"
        yield Figure(name, title, caption, _draw(panels, HEIGHT, course, names))


def _order(design: SalibDesign, panels: Sequence[Panel]) -> list[str]:
    """Sort the parameters by their indices, relative to the largest one, summed over all panels."""
    kind, weights = LEADING[design.method], dict.fromkeys(design.names, 0.0)
    for panel in panels:
        own = panel.analysed.final(kind)
        for index in own:
            weights[index.parameter] += index.value / max(abs(own[0].value), 1e-300)
    return sorted(design.names, key=lambda name: -weights[name])


def _draw(
    panels: Sequence[Panel], height: float, paint: Callable[[Any, Panel, bool], None], names: Sequence[str]
) -> bytes:
    """Draw panels as PNG; `paint` is called with axes, the panel, and whether it is at the left."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure as Canvas

    columns = min(COLUMNS, len(panels))
    rows = math.ceil(len(panels) / columns)
    with mpl.rc_context(STYLE):
        room = LETTER * max(map(len, names))
        canvas = Canvas(figsize=(columns * WIDTH + room, rows * height), layout="constrained")
        FigureCanvasAgg(canvas)
        axes = canvas.subplots(rows, columns, squeeze=False).ravel()
        for i, (axis, panel) in enumerate(zip(axes, panels, strict=False)):
            paint(axis, panel, i % columns == 0)
            axis.set_title(textwrap.fill(_plain(panel.label), WRAP))
        for axis in axes[len(panels) :]:
            axis.set_visible(False)
        _legend(canvas, axes[0])
        file = io.BytesIO()
        canvas.savefig(file, format="png", dpi=DPI, metadata={"Software": None})
    return file.getvalue()


def _legend(canvas: Any, axis: Any) -> None:
    """Add a legend below the panels, which are alike."""
    handles, labels = axis.get_legend_handles_labels()
    if not labels:
        return
    columns = max(1, min(len(labels), int(canvas.get_size_inches()[0] / (LETTER * max(map(len, labels)) + 0.6))))
    canvas.legend(handles, labels, loc="outside lower center", ncols=columns)
    width, height = canvas.get_size_inches()
    canvas.set_size_inches(width, height + LINE * -(-len(labels) // columns))


def _bars(axis: Any, panel: Panel, left: bool, own: Display, names: Sequence[str], morris: bool) -> None:
    places = range(len(names))
    factor = own.factor if morris else 1.0
    drawn = (("mu_star", "µ*", DARK, 0.0, 0.6),) if morris else (
        ("S1", "S1: alone", DARK, -0.2, 0.36), ("ST", "ST: with all interactions", LIGHT, 0.2, 0.36))  # fmt: skip
    lowest, highest = 0.0, 0.0 if morris else 1.0
    for kind, label, colour, shift, thick in drawn:
        by_parameter = panel.analysed.by_parameter(kind)
        indices = [by_parameter[name] for name in names]
        values, ends = [factor * index.value for index in indices], _ends(indices, factor)
        up = [place + shift for place in places]
        axis.barh(up, values, thick, color=colour, label=None if morris else label)
        axis.errorbar(values, up, xerr=ends, fmt="none", ecolor="0.15", elinewidth=1.2, capsize=2.5)
        lowest = min([lowest, *(value - low for value, low in zip(values, ends[0], strict=True))])
        highest = max([highest, *(value + high for value, high in zip(values, ends[1], strict=True))])
    edge = EDGE * (highest - lowest)
    axis.set_xlim(lowest - edge if lowest < -edge else 0.0, highest + edge)
    axis.set_yticks(places, names if left else [""] * len(names))
    axis.invert_yaxis()
    axis.grid(visible=False, axis="y")
    axis.set_xlabel(f"µ* of {own.label}" if morris else f"share of the variance of {own.title}")


def _limits(design: SalibDesign, panels: Sequence[Panel]) -> tuple[float, float] | None:
    """Give the limits of the vertical axis that all panels share; None for effects, which have an axis in each."""
    if design.method == "morris":
        return None
    values = [index.value for panel in panels for index in panel.analysed.indices if index.kind == "ST"]
    return -0.05, 1.05 * max(1.0, *values)


def _course(
    axis: Any, panel: Panel, left: bool, own: Display, names: Sequence[str], design: SalibDesign,
    limits: tuple[float, float] | None,
) -> None:  # fmt: skip
    kind = LEADING[design.method]
    factor = own.factor if design.method == "morris" else 1.0
    numbers = sorted({index.n for index in panel.analysed.indices})
    for i, name in enumerate(names):
        course = panel.analysed.course(kind, name)
        shift = 1.0 + 0.05 * (i - 0.5 * (len(names) - 1)) / max(len(names) / 4, 1.0)  # intervals beside each other
        across, up = [shift * index.n for index in course], [factor * index.value for index in course]
        axis.errorbar(
            across, up, yerr=_ends(course, factor), label=name, **_look(i), lw=1.2, elinewidth=1.0, capsize=2.0, ms=4.5,
        )  # fmt: skip
    axis.set_xscale("log", base=2)
    axis.set_xlim(0.8 * numbers[0], numbers[-1] * 1.35)
    axis.set_xticks(numbers, [str(number) for number in numbers])
    axis.minorticks_off()
    axis.set_ylim(*(limits or (-EDGE * axis.get_ylim()[1], None)))
    if design.method == "sobol":
        first = panel.analysed.final(kind)[0]
        axis.plot([1.25 * numbers[-1]] * 2, [first.value - WIDEST / 2, first.value + WIDEST / 2], color="0.5", lw=4,
                  solid_capstyle="butt")  # fmt: skip
    axis.set_xlabel("n, trajectories" if design.method == "morris" else "n, base samples")
    if left:
        axis.set_ylabel(f"µ* of {own.label}" if design.method == "morris" else f"ST of {own.title}")


def _plane(axis: Any, panel: Panel, left: bool, own: Display, names: Sequence[str]) -> None:
    effects, spreads = panel.analysed.by_parameter("mu_star"), panel.analysed.by_parameter("sigma")
    for i, name in enumerate(names):
        across, up = effects[name], spreads[name]
        axis.errorbar(
            [own.factor * across.value], [own.factor * up.value], xerr=_ends([across], own.factor),
            yerr=_ends([up], own.factor), label=name, **(_look(i) | {"ls": "none"}), elinewidth=1.0, capsize=2.0, ms=6,
        )  # fmt: skip
    axis.set_xlim(left=0.0)
    axis.set_ylim(bottom=0.0)
    most, high = axis.get_xlim()[1], axis.get_ylim()[1]  # below, room for marks at 0
    for slope, dashes in ((1.0, "--"), (0.1, ":")):
        end = min(most, high / slope)
        axis.plot([0.0, end], [0.0, slope * end], color="0.55", lw=1.0, ls=dashes, zorder=1)
    axis.set_xlim(-EDGE * most, most)
    axis.set_ylim(-EDGE * high, high)
    axis.set_xlabel(f"µ* of {own.label}")
    if left:
        axis.set_ylabel(f"σ of {own.label}")


def _look(place: int) -> dict[str, Any]:
    """Give the colour, the marker and the line style of a parameter."""
    number = len(COLOURS)
    return {"color": COLOURS[place % number], "marker": MARKERS[(place + place // number) % number],
            "ls": ("-", "--", ":")[place // number % 3]}  # fmt: skip


def _ends(indices: Sequence[Index], factor: float) -> list[list[float]]:
    """Give how far the intervals reach below and above the values."""
    return [[factor * max(index.value - index.low, 0.0) for index in indices],
            [factor * max(index.high - index.value, 0.0) for index in indices]]  # fmt: skip


def _plain(label: str) -> str:
    """Escape dollars in a label, which would begin formulas in matplotlib."""
    return label.replace("$", r"\$")


TEMPLATE = "sensitivity.html.jinja"
METHODS = {"sobol": "Sobol indices", "morris": "Morris screening"}


def page(study: SensitivityStudy, combinations: Sequence[Combination], figures: Sequence[Sequence[Figure]]) -> str:
    """Make the page as HTML text; `figures` are those of each outcome, in the order of the study's outcomes."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader(__package__ or "", ""), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        keep_trailing_newline=True,
    )  # fmt: skip
    environment.filters["base64"] = lambda data: base64.b64encode(data).decode("ascii")
    design = study.design
    return environment.get_template(TEMPLATE).render(
        title=f"What matters for the knee: {METHODS[design.method]}",
        lead=lead(study, combinations),
        version=__version__,
        design=design,
        remarks=remarks(design, combinations),
        matters=what_matters(design, combinations),
        ranges=ranges_table(design),
        fixed=[f"{name} = {value}" for name, value in study.cases.values.items()],
        outcomes=[
            {
                "title": display_of(name).title,
                "figures": own,
                "places": [
                    {
                        "label": combination.label,
                        "reason": combination.analysed[place].reason,
                        "indices": all_indices(design, combination.analysed[place]),
                        "together": together(combination.analysed[place]),
                    }
                    for combination in combinations
                ],
            }
            for place, (name, own) in enumerate(zip(study.outcomes, figures, strict=True))
        ],
        combinations=combinations,
    )


def lead(study: SensitivityStudy, combinations: Sequence[Combination]) -> str:
    """Describe the analysis in a sentence, for the head of the page."""
    design, many = study.design, len(combinations)
    groups = "trajectories" if design.method == "morris" else "base samples"
    return (
        f"{len(design.names)} parameters varied together at {design.number} points ({design.n} {groups}, seed "
        f"{design.seed}), in {many} combination{'s' * (many != 1)} of gait, knee and grid: "
        f"{study.cases.number} knees computed."
    )


CASES = "cases"
"""Name of the folder with the results of all cases, inside the command's output folder"""
PAGE, TABLE = "sensitivity.html", "indices.csv"
UNFINISHED = "_unfinished-"
FIGURES = ("bars_", "convergence_", "plane_")
"""Prefixes of the names of figures, of which those of an earlier run are removed"""


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
    study = read_sensitivity_study(study_file)
    folder = f"{output.rstrip('/') or output}/{CASES}"
    with progress("Computing") as advance:
        done = run_study(study.cases, folder, workers=workers, scheduler=scheduler, advance=advance)
    say(f"{study.cases.number} cases: {done.computed} computed, {done.there} were there, {done.failed} failed")
    with progress("Analysing") as advance:
        combinations = gather(study, Shards(folder), advance)
        advance.describe("Drawing")
        write_files(output, make_files(study, combinations))
    for outcome, where, leading, _ in what_matters(study.design, combinations).rows:
        say(f"{outcome}, {where}: {leading}", hang=2)
    for sentence in remarks(study.design, combinations):
        if ": no index: " not in sentence:  # printed above
            say(f"knee-contact: warning: {sentence}", err=True, hang=2)
    say(f"page: {output.rstrip('/')}/{PAGE}")


def make_files(study: SensitivityStudy, combinations: list[Combination]) -> dict[str, bytes]:
    """Make figures, table and page: contents of files by name, the page last."""
    drawn = [figures(study.design, combinations, place) for place in range(len(study.outcomes))]
    files = {f"{figure.name}.png": figure.png for of_outcome in drawn for figure in of_outcome}
    files[TABLE] = as_csv(combinations).encode()
    return files | {PAGE: page(study, combinations, drawn).encode()}


def write_files(output: str, files: Mapping[str, bytes]) -> None:
    """Write files into a folder, each whole or not at all, and remove other figures that an earlier run has written.

    Raises:
        UsageError: the folder cannot be written.
        IncompleteError: the disk is full.
    """
    system, folder = fsspec.core.url_to_fs(output)
    unfinished = f"{folder}/{UNFINISHED}{uuid.uuid4().hex}"
    try:
        for name, content in files.items():
            system.pipe_file(unfinished, content)
            system.mv(unfinished, f"{folder}/{name}")
        for path in system.ls(folder, detail=False):
            name = Path(path).name
            if name.startswith(FIGURES) and name.endswith(".png") and name not in files:
                system.rm_file(path)
    except BaseException as error:
        with suppress(OSError):
            system.rm_file(unfinished)
        if isinstance(error, OSError):
            raise IncompleteError(f"{error.filename or output}: {error.strerror or error}") from None
        raise
