"""Work over precision on logarithmic scales, on one page: a panel per question, ours apart from the others."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.peers.measure import COMPILED, LOOP, STREAM, WHOLE, Row
from benchmarks.peers.ours import NAME
from benchmarks.peers.page import ASKED, cheapest, multiple, of
from benchmarks.peers.problems import EVENTFUL, SMOOTH

COLOURS = {"CyRK": "#0072B2", "numbalsoda": "#D55E00", "diffrax": "#009E73"}
"""Okabe and Ito's, which colour-blind readers tell apart; all others share a grey"""
GREY = "0.62"
WAYS = {
    STREAM: "each sample when it arrives",
    LOOP: "tick by tick, samples in memory",
    WHOLE: "whole series known",
}
KINDS = {"smooth": SMOOTH, "with events": EVENTFUL}
ERRORS = np.logspace(-5, -11, 25)
"""[m], quarters of a decade"""
KEY = (
    "Geometric means over problems; {problems}. Better: lower left.\n"
    "Colours: right-hand sides are compiled. Grey: they are in Python. Dashed: 10 nm, as in the tables."
)


class Curve(NamedTuple):
    """Time per tick over the error that a tool reaches."""

    errors: list[float]
    """[m], falling"""
    times: list[float]
    """[µs] per tick"""

    def at(self, error: float) -> float:
        """Time [µs] at an error [m]; nan if that is not one of the errors."""
        return next(
            (time for each, time in zip(*self, strict=True) if math.isclose(each, error)), math.nan
        )


def draw(rows: Sequence[Row], path: Path) -> None:
    """Draw all panels and write the picture to a file."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    there = {row.problem for row in rows}
    kinds = {kind: [name for name in names if name in there] for kind, names in KINDS.items()}
    kinds = {kind: names for kind, names in kinds.items() if names}
    figure = Figure(figsize=(11.0, 1.2 + 3.5 * len(kinds)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(kinds), len(WAYS), sharex=True, sharey=True, squeeze=False)
    for line, (kind, problems) in zip(axes, kinds.items(), strict=True):
        for axis, (mode, title) in zip(line, WAYS.items(), strict=True):
            panel(axis, curves(rows, problems, mode))
            axis.set_title(f"{title}\n", fontsize=10.5, fontweight="bold", loc="left")
        line[0].set_ylabel(f"{kind}: time per tick [µs]", fontweight="bold")
    for axis in axes[-1]:
        axis.set_xlabel("largest error of the depth")
    legend(figure, axes)
    listed = "; ".join(f"{kind}: {' · '.join(names)}" for kind, names in kinds.items())
    figure.supxlabel(KEY.format(problems=listed), fontsize=8, x=0.01, ha="left")
    figure.savefig(path, dpi=120)


def curves(rows: Sequence[Row], problems: Sequence[str], mode: str) -> dict[str, Curve]:
    """Curves by tool, ours last: geometric means over some problems, at the errors that all of them reach."""
    names = dict.fromkeys(row.peer for row in rows)
    by_tool = {
        name: curve([row for row in rows if row.peer == name], problems, mode) for name in names
    }
    return {
        name: by_tool[name]
        for name in sorted(by_tool, key=lambda name: name == NAME)
        if by_tool[name].errors
    }


def curve(rows: Sequence[Row], problems: Sequence[str], mode: str) -> Curve:
    """The curve of one tool's rows."""
    runs = [of(rows, problem, mode) for problem in problems]
    times = [[cheapest(each, error * (1.0 + 1e-9)) for each in runs] for error in ERRORS]
    means = [float(np.exp(np.mean(np.log(each)))) for each in times]
    reached = [i for i, mean in enumerate(means) if not math.isnan(mean)]
    return Curve([float(ERRORS[i]) for i in reached], [means[i] for i in reached])


def panel(axis: Any, by_tool: dict[str, Curve]) -> None:
    """Draw one panel: the curves of all tools."""
    from matplotlib.ticker import (
        EngFormatter,
        FixedLocator,
        FuncFormatter,
        LogLocator,
        NullFormatter,
    )

    for name, (errors, times) in by_tool.items():
        axis.plot(errors, times, label=name, **style_of(name))
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.set_xlim(ERRORS.min(), ERRORS.max())
    axis.axvline(ASKED, color="0.35", linewidth=0.8, linestyle=(0, (2, 3)), zorder=0)
    axis.xaxis.set_major_locator(FixedLocator([1e-11, 1e-9, 1e-7, 1e-5]))
    axis.xaxis.set_major_formatter(EngFormatter("m"))
    axis.xaxis.set_minor_locator(LogLocator(base=10.0, numticks=20))
    axis.xaxis.set_minor_formatter(NullFormatter())
    axis.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.grid(visible=True, which="major", color="0.92", linewidth=0.8)
    axis.set_axisbelow(True)
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)
    label_quickest_peer(axis, by_tool)


def label_quickest_peer(axis: Any, by_tool: dict[str, Curve]) -> None:
    """Write the quickest peer at `ASKED` and its time over ours above a panel."""
    ours = by_tool.get(NAME, Curve([], [])).at(ASKED)
    times = {name: each.at(ASKED) for name, each in by_tool.items() if name != NAME}
    times = {name: time for name, time in times.items() if not math.isnan(time)}
    if math.isnan(ours) or not times:
        return
    name = min(times, key=times.__getitem__)
    axis.plot([ASKED, ASKED], [ours, times[name]], color="black", linewidth=1.2, zorder=4)
    axis.text(
        0.0,
        1.02,
        f"{name}: {multiple(times[name] / ours)} our time at 10 nm",
        transform=axis.transAxes,
        fontsize=9.5,
        color=COLOURS.get(name, "0.3"),
    )


def style_of(name: str) -> dict[str, Any]:
    """Line style of a tool: ours black and bold, compiled peers in colour, SciPy grey."""
    if name == NAME:
        return {"color": "black", "linewidth": 4.0, "zorder": 6, "solid_capstyle": "round"}
    if name in COMPILED:
        return {"color": COLOURS[name], "linewidth": 1.9, "zorder": 4}
    return {"color": GREY, "linewidth": 1.2, "zorder": 2}


def legend(figure: Any, axes: Any) -> None:
    """Draw the legend above the panels, ours first."""
    labelled = [axis.get_legend_handles_labels() for axis in axes.ravel()]
    handles = {name: handle for pair in labelled for handle, name in zip(*pair, strict=True)}
    order = sorted(handles, key=lambda name: (name != NAME, name not in COMPILED))
    figure.legend(
        [handles[name] for name in order],
        order,
        loc="outside upper left",
        ncols=len(order),
        frameon=False,
        fontsize=9.5,
        columnspacing=1.2,
        handlelength=1.8,
    )
