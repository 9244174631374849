"""One picture: error over cost, a column per scene and a row per output, beside what geometry and inputs leave open."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

from studies.choosing.geometries import CIRCLE, MRI_FEMUR, MRI_KNEE
from studies.choosing.inputs import Effect
from studies.choosing.study import Row, Study

COLOURS = {"quasi_static": "#D55E00", "first_order": "#E69F00", "dynamic": "#0072B2", "auto": "#000000"}
"""Of levels: Okabe and Ito's, told apart by colour-blind readers"""
MARKERS = {CIRCLE: "o", MRI_FEMUR: "s", MRI_KNEE: "^"}
LINES = {CIRCLE: (0, (5, 2)), MRI_FEMUR: (0, (1, 1.5))}
OUTPUTS = (("error of the depth [m]", (1e-12, 1e-1)), ("error of the force [N]", (1e-6, 1e5)),
           ("error of the contact\npoint on the plateau [m]", (1e-14, 1e-1)))  # fmt: skip
"""What is drawn, and its axis; what is smaller is drawn at its lower end"""
BAND, BAND_SHARE = "#CFCFCF", 0.1
"""The band of the inputs holds those that do at least this part of what the most effective one does"""
DEFAULT_TOLERANCE = 1e-6
DPI = 150


def draw(study: Study, path: Path) -> None:
    """Write the picture."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 9.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes: Any = figure.subplots(len(OUTPUTS), len(study.scenes), sharex=True, sharey="row", squeeze=False)
    for column, scene in enumerate(study.scenes):
        axes[0, column].set_title(scene.name, fontsize=11, fontweight="bold")
        axes[-1, column].set_xlabel("time per tick [µs]")
        for output, (_, ends) in enumerate(OUTPUTS):
            axis = axes[output, column]
            levels(axis, [row for row in study.rows if row.scene == scene.name], output, ends)
            references(axis, study, scene.name, output)
            dress(axis, ends)
    for output, (label, _) in enumerate(OUTPUTS):
        axes[output, 0].set_ylabel(label, fontsize=11)
    key(figure)
    figure.savefig(path, dpi=DPI)


def levels(axis: Any, rows: Sequence[Row], output: int, ends: tuple[float, float]) -> None:
    """A line per geometry and level through its tolerances; the default one is larger."""
    for (geometry, level), group in groupby(rows, key=lambda row: row[:2]):
        chosen = list(group)
        costs = [row.microseconds for row in chosen]
        errors = [min(max(row.error[output], ends[0]), ends[1]) for row in chosen]
        sizes = [58 if row.tolerance == DEFAULT_TOLERANCE else 20 for row in chosen]
        axis.plot(costs, errors, color=COLOURS[level], linewidth=1.0, alpha=0.7, zorder=3)
        axis.scatter(costs, errors, s=sizes, color=COLOURS[level], marker=MARKERS[geometry], zorder=4, clip_on=False,
                     linewidths=0.5, edgecolors="white")  # fmt: skip


def references(axis: Any, study: Study, scene: str, output: int) -> None:
    """What simpler geometries leave out, and what uncertain inputs do."""
    low, high = band([each for each in study.effects if each.scene == scene], output)
    axis.axhspan(low, high, color=BAND, zorder=0, linewidth=0)
    for left in study.left:
        if left.scene == scene and left.geometry in LINES:
            axis.axhline(left.error[output], color="0.25", linewidth=1.3, linestyle=LINES[left.geometry], zorder=2)


def band(effects: Sequence[Effect], output: int) -> tuple[float, float]:
    """From the least to the largest effect of the inputs that matter for an output."""
    sizes = [each.worst[output] for each in effects]
    return min(size for size in sizes if size >= BAND_SHARE * max(sizes)), max(sizes)


def dress(axis: Any, ends: tuple[float, float]) -> None:
    """Axes and grid."""
    from matplotlib.ticker import LogLocator, NullFormatter

    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.set_ylim(*ends)
    axis.yaxis.set_major_locator(LogLocator(base=100.0, numticks=12))
    axis.yaxis.set_minor_locator(LogLocator(base=10.0, numticks=20))
    axis.yaxis.set_minor_formatter(NullFormatter())
    axis.grid(visible=True, which="major", color="0.9", linewidth=0.8)
    axis.set_axisbelow(True)
    axis.tick_params(labelsize=9)
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)


def key(figure: Any) -> None:
    """The legend below."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    level_keys = [Line2D([], [], color=colour, linewidth=2.5, label=level) for level, colour in COLOURS.items()]
    geometry_keys = [Line2D([], [], color="0.4", marker=marker, linestyle="", markersize=7, label=geometry)
                     for geometry, marker in MARKERS.items()]  # fmt: skip
    others = [
        Line2D([], [], color="0.25", linestyle=LINES[CIRCLE], label="what the circle leaves out"),
        Line2D([], [], color="0.25", linestyle=LINES[MRI_FEMUR], label="what the flat plateau leaves out"),
        Patch(color=BAND, label="what uncertain inputs do"),
        Line2D([], [], color="0.4", marker="o", linestyle="", markersize=7, label="tolerance 1e-6 m (default)"),
        Line2D([], [], color="0.4", marker="o", linestyle="", markersize=4, label="1e-4, 1e-5, 1e-8 m"),
    ]  # fmt: skip
    figure.legend(handles=[*level_keys, *geometry_keys, *others], loc="outside lower center", ncols=4, frameon=False,
                  fontsize=10)  # fmt: skip
