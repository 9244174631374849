"""The figures, as PNG: bars with intervals, the course over n, and Morris's plane; combinations side by side."""

from __future__ import annotations

import io
import math
import textwrap
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import islice
from typing import Any, NamedTuple

from knee_contact_ros.tools.sensitivity.analysis import LEADING, Analysed, Index
from knee_contact_ros.tools.sensitivity.design import SalibDesign
from knee_contact_ros.tools.sensitivity.gather import Combination
from knee_contact_ros.tools.sensitivity.words import WIDEST, Shown, shown

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
MARKERS = "osD^vP*"
"""Of parameters; colours are Okabe and Ito's, which colour-blind readers can tell apart"""
DARK, LIGHT = "#0072B2", "#A6CEE8"
PANELS, COLUMNS = 6, 2
"""Of a figure"""
WIDTH, HEIGHT, BAR, EDGES = 3.6, 2.7, 0.34, 1.0
"""[in] of a panel; of a parameter's bars, and of what is above and below them"""
LINE, WIDE, LETTERS = 0.2, 24, 0.075
"""[in] of a legend's line and of a letter of a parameter's name; letters that two columns of a legend have room for"""
EDGE = 0.03
"""Of an axis, beyond what is drawn"""
WRAP = 40
"""Letters in a panel's title's line"""
DPI = 200
STYLE: Any = {"font.size": 10, "axes.titlesize": 10, "axes.spines.top": False, "axes.spines.right": False,
         "axes.grid": True, "grid.color": "0.92", "axes.axisbelow": True, "legend.frameon": False,
         "legend.fontsize": 8.5, "figure.dpi": DPI}  # fmt: skip


class Figure(NamedTuple):
    """A picture with what belongs to it."""

    name: str
    """Of its file, without the suffix"""
    title: str
    caption: str
    """One or two sentences"""
    png: bytes


class Panel(NamedTuple):
    """What is drawn of an outcome where."""

    label: str
    found: Analysed


def figures(design: SalibDesign, combinations: Sequence[Combination], place: int) -> list[Figure]:
    """Those of the outcome at a place; none if it has no indices anywhere."""
    panels = [Panel(each.label, each.analysed[place]) for each in combinations if each.analysed[place].indices]
    found = []
    parts = list(_parts(panels))
    for number, part in enumerate(parts, 1):
        behind, which = (f"_{number}", f", part {number}") if len(parts) > 1 else ("", "")
        found += [
            each._replace(name=each.name + behind, title=each.title + which) for each in _of_part(design, part)
        ]  # fmt: skip
    return found


def _parts(panels: Sequence[Panel]) -> Iterator[list[Panel]]:
    rest = iter(panels)
    while part := list(islice(rest, PANELS)):
        yield part


def _of_part(design: SalibDesign, panels: Sequence[Panel]) -> Iterator[Figure]:
    outcome = panels[0].found.outcome
    own = shown(outcome)
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
    if any(len({index.n for index in panel.found.indices}) > 1 for panel in panels):
        caption = f"{kind} and its {percent} interval for the beginnings of the design: n/8, n/4, n/2, n."
        if design.method == "sobol":
            caption += f" Grey bar at the right: {WIDEST:g}, as wide as the largest one's interval may be."
            caption += " Wide intervals leave the picture."
        course = partial(_course, own=own, names=names, design=design, limits=_limits(design, panels))
        name, title = f"convergence_{outcome}", f"Convergence for {own.title}"
        yield Figure(name, title, caption, _draw(panels, HEIGHT, course, names))


def _order(design: SalibDesign, panels: Sequence[Panel]) -> list[str]:
    """Parameters, those first that matter most over all panels."""
    kind, weights = LEADING[design.method], dict.fromkeys(design.names, 0.0)
    for panel in panels:
        own = panel.found.final(kind)
        for index in own:
            weights[index.parameter] += index.value / max(abs(own[0].value), 1e-300)
    return sorted(design.names, key=lambda name: -weights[name])


def _draw(
    panels: Sequence[Panel], height: float, paint: Callable[[Any, Panel, bool], None], names: Sequence[str]
) -> bytes:
    """Panels as PNG; `paint` gets axes, the panel, and whether it stands at the left."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure as Canvas

    columns = min(COLUMNS, len(panels))
    rows = math.ceil(len(panels) / columns)
    with mpl.rc_context(STYLE):
        room = LETTERS * max(map(len, names))
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
    """Below the panels, which are alike."""
    handles, labels = axis.get_legend_handles_labels()
    if not labels:
        return
    columns = max(1, min(len(labels), int(canvas.get_size_inches()[0] / (LETTERS * max(map(len, labels)) + 0.6))))
    canvas.legend(handles, labels, loc="outside lower center", ncols=columns)
    width, height = canvas.get_size_inches()
    canvas.set_size_inches(width, height + LINE * -(-len(labels) // columns))


def _bars(axis: Any, panel: Panel, left: bool, own: Shown, names: Sequence[str], morris: bool) -> None:
    places = range(len(names))
    factor = own.factor if morris else 1.0
    drawn = (("mu_star", "µ*", DARK, 0.0, 0.6),) if morris else (
        ("S1", "S1: alone", DARK, -0.2, 0.36), ("ST", "ST: with all interactions", LIGHT, 0.2, 0.36))  # fmt: skip
    lowest, highest = 0.0, 0.0 if morris else 1.0
    for kind, label, colour, shift, thick in drawn:
        by = {index.parameter: index for index in panel.found.final(kind)}
        values, ends = [factor * by[name].value for name in names], _ends([by[name] for name in names], factor)
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
    """From below 0 to above all values of shares, in all panels; effects have a scale in each: None."""
    if design.method == "morris":
        return None
    values = [index.value for panel in panels for index in panel.found.indices if index.kind == "ST"]
    return -0.05, 1.05 * max(1.0, *values)


def _course(
    axis: Any, panel: Panel, left: bool, own: Shown, names: Sequence[str], design: SalibDesign,
    limits: tuple[float, float] | None,
) -> None:  # fmt: skip
    kind = LEADING[design.method]
    factor = own.factor if design.method == "morris" else 1.0
    numbers = sorted({index.n for index in panel.found.indices})
    for i, name in enumerate(names):
        course = panel.found.course(kind, name)
        aside = 1.0 + 0.05 * (i - 0.5 * (len(names) - 1)) / max(len(names) / 4, 1.0)  # intervals beside each other
        across, up = [aside * index.n for index in course], [factor * index.value for index in course]
        axis.errorbar(
            across, up, yerr=_ends(course, factor), label=name, **_look(i), lw=1.2, elinewidth=1.0, capsize=2.0, ms=4.5,
        )  # fmt: skip
    axis.set_xscale("log", base=2)
    axis.set_xlim(0.8 * numbers[0], numbers[-1] * 1.35)
    axis.set_xticks(numbers, [str(number) for number in numbers])
    axis.minorticks_off()
    axis.set_ylim(*(limits or (-EDGE * axis.get_ylim()[1], None)))
    if design.method == "sobol":
        first = panel.found.final(kind)[0]
        axis.plot([1.25 * numbers[-1]] * 2, [first.value - WIDEST / 2, first.value + WIDEST / 2], color="0.5", lw=4,
                  solid_capstyle="butt")  # fmt: skip
    axis.set_xlabel("n, trajectories" if design.method == "morris" else "n, base samples")
    if left:
        axis.set_ylabel(f"µ* of {own.label}" if design.method == "morris" else f"ST of {own.title}")


def _plane(axis: Any, panel: Panel, left: bool, own: Shown, names: Sequence[str]) -> None:
    by = {kind: {index.parameter: index for index in panel.found.final(kind)} for kind in ("mu_star", "sigma")}
    for i, name in enumerate(names):
        across, up = by["mu_star"][name], by["sigma"][name]
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
    """Of a parameter: its colour, its marker, and its line."""
    number = len(COLOURS)
    return {"color": COLOURS[place % number], "marker": MARKERS[(place + place // number) % number],
            "ls": ("-", "--", ":")[place // number % 3]}  # fmt: skip


def _ends(indices: Sequence[Index], factor: float) -> list[list[float]]:
    """How far intervals reach below and above."""
    return [[factor * max(index.value - index.low, 0.0) for index in indices],
            [factor * max(index.high - index.value, 0.0) for index in indices]]  # fmt: skip


def _plain(label: str) -> str:
    """A label as matplotlib shows it: dollars are formulas to it."""
    return label.replace("$", r"\$")
