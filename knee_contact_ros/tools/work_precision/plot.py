"""Work over precision on logarithmic scales: a panel per problem, above for whole runs, below tick by tick."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from knee_contact_ros.tools.work_precision.frontier import envelope, is_ours, line_name, line_names, of
from knee_contact_ros.tools.work_precision.solver import STREAM, WHOLE
from knee_contact_ros.tools.work_precision.study import Row

COLOURS = {
    "SciPy": "#0072B2", "CVODE": "#56B4E9", "MuJoCo": "#D55E00", "Exudyn": "#009E73", "Drake": "#CC79A7",
    "OpenSim": "#E69F00",
}  # fmt: skip
"""Okabe and Ito's: told apart by colour-blind readers"""
MARKERS = {"SciPy": "o", "CVODE": "s", "MuJoCo": "^", "Exudyn": "v", "Drake": "D", "OpenSim": "P"}
OUR_STYLES = ("-", "--", ":", "-.")
OUR_MARKERS = ("o", "s", "X", "*")
OUR_WIDTHS, OUR_SIZES, OUR_FACES = (4.0, 1.8, 1.8, 1.2), (11, 7, 8, 7), ("black", "white", "white", "#F0E442")
"""What is drawn later is smaller and lighter, so that levels that cost the same are all seen"""
ASKED = 1e-8
"""Error [m] that the tables go by"""
MODES = {WHOLE: "whole run", STREAM: "every tick when its sample arrives"}
KEY = (
    "Line: the cheapest runs of a solver\nDot: any of its runs\nTriangle at an edge: its error lies beyond\n"
    "Upright, dashed: 10 nm, as in the tables\nBetter: lower left"
)
ERRORS = (3e-13, 0.1)
"""Ends of the error axis [m]: rounding, and more than any knee that lands again is wrong by"""
COLUMNS = 4


def draw(rows: Sequence[Row], path: Path) -> None:
    """Write the picture."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    problems, names = list(dict.fromkeys(row.problem for row in rows)), line_names(rows)
    panels = len(problems) + 1
    lines = -(-panels // COLUMNS)
    columns = min(panels, COLUMNS)
    figure = Figure(figsize=(4.1 * columns, 7.0 * lines), layout="constrained")
    FigureCanvasAgg(figure)
    parts: Any = figure.subfigures(2, 1)
    for part, (mode, heading) in zip(parts, MODES.items(), strict=True):
        part.suptitle(heading, fontsize=15, fontweight="bold")
        axes = part.subplots(lines, columns, sharex=True, sharey=True, squeeze=False).ravel()
        for axis, problem in zip(axes, problems, strict=False):
            panel(axis, of(rows, problem, mode), names)
            axis.set_title(problem, fontsize=12)
        for axis in axes[len(problems) :]:
            axis.set_axis_off()
        label(axes, columns, len(problems))
        key(axes[len(problems)], axes[: len(problems)], names)
    figure.savefig(path, dpi=110)


def panel(axis: Any, rows: Sequence[Row], names: Sequence[str]) -> None:
    """One problem: every run a dot, and for each name the line of those that nothing of the same name beats."""
    for name in names:
        mine = [row for row in rows if line_name(row) == name]
        if not mine:
            continue
        style = style_of(name, names)
        errors, costs = zip(*[(within(error), cost) for error, cost in envelope(mine)], strict=True)
        axis.plot(errors, costs, label=name, **style)
        scatter(axis, mine, style["color"])
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.set_xlim(*ERRORS)
    named_lengths(axis)
    axis.axvline(ASKED, color="0.6", linewidth=1.0, linestyle=(0, (2, 3)), zorder=0)
    axis.grid(visible=True, which="major", color="0.92", linewidth=0.8)
    axis.set_axisbelow(True)
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)


def named_lengths(axis: Any) -> None:
    """Ticks of the errors with their unit: pm, nm, µm, mm."""
    from matplotlib.ticker import EngFormatter, FixedLocator, LogLocator, NullFormatter

    axis.xaxis.set_major_locator(FixedLocator([1e-12, 1e-9, 1e-6, 1e-3]))
    axis.xaxis.set_major_formatter(EngFormatter("m"))
    axis.xaxis.set_minor_locator(LogLocator(base=10.0, numticks=20))
    axis.xaxis.set_minor_formatter(NullFormatter())


def scatter(axis: Any, rows: Sequence[Row], colour: str) -> None:
    """All runs: dots, and triangles at the edges for errors beyond them."""
    for marker in (".", "<", ">"):
        dots = [(within(row.error), row.microseconds_per_tick) for row in rows if marker_of(row.error) == marker]
        if dots:
            size, alpha = (3, 0.4) if marker == "." else (7, 0.8)
            axis.plot(*zip(*dots, strict=True), marker, markersize=size, alpha=alpha, color=colour, zorder=1,
                      clip_on=marker == ".")  # fmt: skip


def marker_of(error: float) -> str:
    """A dot, or a triangle that points to where an error [m] beyond the axis lies."""
    return "<" if error < ERRORS[0] else ">" if error > ERRORS[1] else "."


def within(error: float) -> float:
    """An error [m] moved to the edge of the axis if it lies beyond."""
    return min(max(error, ERRORS[0]), ERRORS[1])


def key(place: Any, axes: Any, names: Sequence[str]) -> None:
    """The legend in a panel of its own."""
    labelled = [axis.get_legend_handles_labels() for axis in axes]
    handles = {name: handle for pair in labelled for handle, name in zip(*pair, strict=True)}
    shown = [name for name in names if name in handles]
    place.legend([handles[name] for name in shown], shown, loc="upper left", bbox_to_anchor=(0.0, 1.12), fontsize=11,
                 frameon=False, title=KEY, title_fontsize=11, alignment="left", labelspacing=0.35)  # fmt: skip


def style_of(name: str, names: Sequence[str]) -> dict[str, Any]:
    """Ours black and bold."""
    if is_ours(name):
        number = [each for each in names if is_ours(each)].index(name) % len(OUR_STYLES)
        return {"color": "black", "linewidth": OUR_WIDTHS[number], "linestyle": OUR_STYLES[number],
                "marker": OUR_MARKERS[number], "markersize": OUR_SIZES[number],
                "markerfacecolor": OUR_FACES[number], "zorder": 5 + 0.1 * number}  # fmt: skip
    return {"color": COLOURS.get(name, "0.5"), "linewidth": 1.5, "marker": MARKERS.get(name, "x"), "markersize": 5,
            "zorder": 3}  # fmt: skip


def label(axes: Any, columns: int, problems: int) -> None:
    """Axes' names at the edge; ticks below the last panel of every column."""
    for index, axis in enumerate(axes[:problems]):
        if index % columns == 0:
            axis.set_ylabel("time per tick [µs]", fontsize=11)
        if index + columns >= problems:
            axis.set_xlabel("largest error of the depth", fontsize=11)
            axis.tick_params(labelbottom=True)
