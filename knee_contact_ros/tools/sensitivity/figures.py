"""Figures of the indices, as PNG: bars, convergence over n, and Morris's plane, with a panel for each combination."""

from __future__ import annotations

import io
import math
import textwrap
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, NamedTuple

from knee_contact_ros.tools.sensitivity.analysis import LEADING, Analysed, Index
from knee_contact_ros.tools.sensitivity.design import SalibDesign
from knee_contact_ros.tools.sensitivity.gather import Combination
from knee_contact_ros.tools.sensitivity.words import WIDEST, Display, display_of

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
