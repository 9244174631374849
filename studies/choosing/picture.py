"""One picture: error over cost, a column per scene and a row per output, beside what geometry and inputs leave open."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

from studies.choosing.geometries import CIRCLE, MRI_FEMUR, MRI_KNEE
from studies.choosing.inputs import Effect
from studies.choosing.study import Row, Study

COLOURS = {"quasi_static": "#D55E00", "dynamic": "#0072B2"}
"""Colours of the levels: Okabe and Ito's, which colour-blind readers tell apart"""
MARKERS = {CIRCLE: "o", MRI_FEMUR: "s", MRI_KNEE: "^"}
LINES = {CIRCLE: ("#009E73", (0, (4, 4))), MRI_FEMUR: ("#CC79A7", (4, (4, 4)))}
"""Lines of simpler geometries: where two are the same, the dashes of one lie in the gaps of the other"""
OUTPUTS = (("error of the depth", (1e-11, 1e-1), "m"), ("error of the force", (1e-5, 1e5), "N"),
           ("error of the contact\npoint on the plateau", (1e-12, 1e-1), "m"))  # fmt: skip
"""Outputs with the range of their axis and their unit; smaller values are drawn at the lower end, labelled 0"""
BAND, BAND_SHARE = "#CFCFCF", 0.1
"""Colour of the band of the inputs, and the least part of the largest effect that counts for it"""
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
        for output, (_, ends, unit) in enumerate(OUTPUTS):
            axis = axes[output, column]
            levels(axis, [row for row in study.rows if row.scene == scene.name], output, ends)
            references(axis, study, scene.name, output)
            dress(axis, ends, unit, zero=any(row.error[output] <= ends[0] for row in study.rows))
    for output, (label, *_) in enumerate(OUTPUTS):
        axes[output, 0].set_ylabel(label, fontsize=11)
    key(figure)
    figure.savefig(path, dpi=DPI)


def levels(axis: Any, rows: Sequence[Row], output: int, ends: tuple[float, float]) -> None:
    """Draw a line per geometry and level through its tolerances; the default one has a larger marker."""
    for (geometry, level), group in groupby(rows, key=lambda row: row[:2]):
        chosen = list(group)
        costs = [row.microseconds for row in chosen]
        errors = [min(max(row.error[output], ends[0]), ends[1]) for row in chosen]
        sizes = [58 if row.tolerance == DEFAULT_TOLERANCE else 20 for row in chosen]
        axis.plot(costs, errors, color=COLOURS[level], linewidth=1.0, alpha=0.7, zorder=3)
        axis.scatter(costs, errors, s=sizes, color=COLOURS[level], marker=MARKERS[geometry], zorder=4, clip_on=False,
                     linewidths=0.5, edgecolors="white")  # fmt: skip


def references(axis: Any, study: Study, scene: str, output: int) -> None:
    """Draw the errors of simpler geometries, and the band of uncertain inputs."""
    low, high = band([each for each in study.effects if each.scene == scene], output)
    axis.axhspan(low, high, color=BAND, zorder=0, linewidth=0)
    for left in study.left:
        if left.scene == scene and left.geometry in LINES:
            colour, style = LINES[left.geometry]
            axis.axhline(left.error[output], color=colour, linewidth=2.0, linestyle=style, zorder=2)


def band(effects: Sequence[Effect], output: int) -> tuple[float, float]:
    """Least and largest effect on an output of the inputs that matter for it."""
    sizes = [each.worst[output] for each in effects]
    return min(size for size in sizes if size >= BAND_SHARE * max(sizes)), max(sizes)


def dress(axis: Any, ends: tuple[float, float], unit: str, *, zero: bool) -> None:
    """Set axes and grid; ticks have units, and there is one at the lower end if something is 0."""
    from matplotlib.ticker import EngFormatter, FixedLocator, FuncFormatter, LogLocator, NullFormatter

    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.set_ylim(*ends)
    ticks = [10.0**power for power in range(-12, 6, 3) if 2.0 * ends[0] < 10.0**power <= ends[1]]
    named = EngFormatter(unit)
    axis.yaxis.set_major_locator(FixedLocator([*[ends[0]] * zero, *ticks]))
    axis.yaxis.set_major_formatter(FuncFormatter(lambda value, _: named(value) if value > ends[0] else "0"))
    axis.yaxis.set_minor_locator(LogLocator(base=10.0, numticks=20))
    axis.yaxis.set_minor_formatter(NullFormatter())
    axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.grid(visible=True, which="major", color="0.9", linewidth=0.8)
    axis.set_axisbelow(True)
    axis.tick_params(labelsize=9)
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)


def key(figure: Any) -> None:
    """Draw the legend below the panels: a column for each kind."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    def marks(looks: dict[str, dict[str, Any]]) -> list[Line2D]:
        return [Line2D([], [], label=label, **look) for label, look in looks.items()]

    def point(marker: str, size: float) -> dict[str, Any]:
        return {"color": "0.4", "marker": marker, "linestyle": "", "markersize": size}

    references = marks({
        f"what the {name} leaves out": {"color": LINES[geometry][0], "linestyle": LINES[geometry][1], "linewidth": 2.0}
        for name, geometry in (("circle", CIRCLE), ("flat plateau", MRI_FEMUR))
    })  # fmt: skip
    columns: dict[str, list[Any]] = {
        "level (colour)": marks({level: {"color": colour, "linewidth": 2.5} for level, colour in COLOURS.items()}),
        "geometry (shape)": marks({geometry: point(marker, 7) for geometry, marker in MARKERS.items()}),
        "tolerance (size)": marks({"1e-6 m, the default": point("o", 7), "1e-4, 1e-5, 1e-8 m": point("o", 4)}),
        "beside": [*references, Patch(color=BAND, label="what uncertain inputs do")],
    }
    longest = max(map(len, columns.values()))
    handles = []
    for title, column in columns.items():
        blanks = [Line2D([], [], linestyle="", label="") for _ in range(longest - len(column))]
        handles += [Line2D([], [], linestyle="", label=title), *column, *blanks]
    legend = figure.legend(handles=handles, loc="outside lower center", ncols=len(columns), frameon=False, fontsize=10)
    for text in legend.get_texts():
        if text.get_text() in columns:
            text.set_fontweight("bold")
