"""Maps and curves of the page."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from studies.osteoarthritis.knees import (
    FIRST,
    MM,
    RAISED,
    SHIPPED,
    Curve,
    Floats,
    Grid,
    Knees,
    Table,
    equal_second,
    ratio,
    turning,
    turning_loss,
)

DPI = 150
WIDTH = 7.5
"""Width of a page [inches]"""
TICKS = (0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0)
SMALL = 8.5
REACHED: dict[str, Any] = {"color": "black", "linewidth": 1.2, "linestyle": (0, (4, 2))}
TURNING: dict[str, Any] = {"color": "black", "linewidth": 1.6}
SHIPPED_MARK: dict[str, Any] = {
    "marker": "*",
    "markersize": 12,
    "markerfacecolor": "white",
    "markeredgecolor": "black",
    "linestyle": "",
}


def sheet(height: float, rows: int, columns: int) -> tuple[Any, Any]:
    """A figure [inches] and its panels, shape (rows, columns)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)


def two_sheets(height: float) -> tuple[Any, tuple[Any, tuple[Any]]]:
    """A figure with two maps above, shape (1, 2), and one panel below."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    FigureCanvasAgg(figure)
    above, below = _halves(figure)
    return figure, (above.subplots(1, 2, sharex=True, sharey=True, squeeze=False), (below.subplots(),))


def _halves(figure: Any) -> Any:
    return figure.subfigures(2, 1, height_ratios=(1.0, 0.85))


def edges(middles: Floats) -> Floats:
    """Ends of the cells around values that grow, halfway in the logarithm."""
    logs = np.log(middles)
    inner = 0.5 * (logs[1:] + logs[:-1])
    return np.asarray(np.exp(np.concatenate([[2 * logs[0] - inner[0]], inner, [2 * logs[-1] - inner[-1]]])))


def paint(axis: Any, grid: Grid, values: Floats, colours: Any, norm: Any) -> Any:
    """Draw a table over layers and second stiffnesses."""
    return axis.pcolormesh(
        edges(MM * grid.layers), edges(grid.seconds / FIRST), values.T, cmap=colours, norm=norm, rasterized=True
    )  # fmt: skip


def dress(axes: Any, grid: Grid, titles: Sequence[str]) -> None:
    """Set axes, titles and labels of a sheet of maps, and mark the shipped knee."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

    across, upwards = edges(MM * grid.layers), edges(grid.seconds / FIRST)
    for axis in axes.flat:
        axis.set_xscale("log")
        axis.set_yscale("log")
        axis.set_xlim(across[0], across[-1])
        axis.set_ylim(upwards[0], upwards[-1])
        axis.xaxis.set_major_locator(FixedLocator(TICKS))
        axis.xaxis.set_minor_locator(NullLocator())
        for side in (axis.xaxis, axis.yaxis):
            side.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.tick_params(labelsize=SMALL)
        axis.plot(MM * SHIPPED.layer_depth, SHIPPED.stiffness_2 / FIRST, **SHIPPED_MARK)
    for axis, title in zip(axes[0], titles, strict=True):
        axis.set_title(title, fontsize=10)
    for axis in axes[-1]:
        axis.set_xlabel("first layer h [mm]", fontsize=9)
    for axis in axes[:, 0]:
        axis.set_ylabel("second stiffness K₂ / K₁", fontsize=9)


def reached(axis: Any, depth: float) -> None:
    """Draw a line at the healthy knee's largest depth [m], left of which the second layer is reached."""
    axis.axvline(MM * depth, **REACHED)


def save(figure: Any, folder: Path, name: str) -> None:
    """Write osteoarthritis_NAME.png."""
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / f"osteoarthritis_{name}.png", dpi=DPI, metadata={"Software": None})


BANDS = (0.15, 0.25, 0.5, 0.75, 0.95, 1.05, 2.0, 5.0, 20.0, 130.0)
"""Bounds of the colours for ratios of forces; the middle band is drawn as no change"""
LOSS_BANDS = (-4.0, -1.0, -0.5, -0.2, -0.02, 0.02, 0.2, 0.4, 0.6, 0.8)
"""Bounds of the colours for losses [mm]"""
RED_TO_BLUE = "RdBu_r"
GROWING = "cividis"
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")
"""Okabe and Ito's colours"""


class Quantity(NamedTuple):
    """Quantity of a row of the second figure."""

    label: str
    of: Callable[[Table], Floats]
    bands: tuple[float, ...]


CHANGING = (
    Quantity("peak depth [mm]", lambda table: MM * table.peak_depth,
             (0.25, 0.4, 0.5, 0.6, 0.75, 1.0, 1.5, 2.0, 3.0, 4.1)),
    Quantity("time on the second layer [s of 1.93 s]", lambda table: table.bone_time,
             (0.0, 0.01, 0.2, 0.4, 0.6, 0.8, 1.0, 1.2, 1.4, 1.6, 1.75)),
    Quantity("peak pressure [MPa]", lambda table: 1e-6 * table.peak_pressure, (10, 14, 18, 22, 26, 30, 40, 50, 60, 85)),
)  # fmt: skip


def draw(knees: Knees, curves: list[Curve], folder: Path) -> None:
    """Write all figures into a folder."""
    ends = [0, len(knees.grid.shares) - 1]
    save(_forces(knees, ends), folder, "force")
    save(_changes(knees, ends), folder, "load")
    save(_losses(knees, ends, curves), folder, "loss")


def _share(knees: Knees, place: int) -> str:
    return f"share of the load {knees.grid.shares[place]:.1f}"


def _forces(knees: Knees, places: list[int]) -> Any:
    """Draw the peak force under both drives at two shares."""
    figure, axes = sheet(6.6, 2, 2)
    from matplotlib.colors import BoundaryNorm

    norm = BoundaryNorm(BANDS, 256)
    image = None
    for row, place in enumerate(places):
        depth = float(knees.healthy.peak_depth[place])
        for axis, table in zip(axes[row], (knees.forced, knees.led), strict=True):
            image = paint(axis, knees.grid, ratio(knees, table)[place], RED_TO_BLUE, norm)
            reached(axis, depth)
        fine = np.linspace(knees.grid.layers[0], depth, 400)[:-1]
        axes[row, 1].plot(MM * fine, equal_second(fine, depth) / FIRST, **TURNING)
        axes[row, 0].text(0.97, 0.95, _share(knees, place), transform=axes[row, 0].transAxes, ha="right", va="top",
                          fontsize=SMALL)  # fmt: skip
        _words(axes[row, 1])
        forced = ratio(knees, knees.forced)[place]
        told = f"no change: {forced.min():.3f} to {forced.max():.3f}"
        axes[row, 0].text(
            0.5, 0.2, told, transform=axes[row, 0].transAxes, ha="center", va="center", fontsize=9, fontweight="bold",
            bbox={"facecolor": "#f7f7f7", "edgecolor": "none", "pad": 2.0},
        )  # fmt: skip
    dress(axes, knees.grid, ("load prescribed", "healthy knee's height prescribed"))
    bar = figure.colorbar(image, ax=axes, location="bottom", shrink=0.85, aspect=40, ticks=BANDS, spacing="uniform")
    bar.set_label("peak contact force over the healthy knee's; white: within 5 %", fontsize=9)
    bar.ax.set_xticklabels([f"{band:g}" for band in BANDS], fontsize=SMALL)
    _key(figure, turning="the healthy force, by the law at rest")
    return figure


def _words(axis: Any) -> None:
    for x, y, word in ((0.05, 0.93, "rises"), (0.05, 0.05, "drops"), (0.80, 0.5, "no change")):
        axis.text(x, y, word, transform=axis.transAxes, ha="left" if x < 0.5 else "center", va="center", fontsize=9,
                  color="white" if x < 0.5 else "black", fontweight="bold")  # fmt: skip


def _changes(knees: Knees, places: list[int]) -> Any:
    """Draw what changes under the load."""
    from matplotlib.colors import BoundaryNorm

    figure, axes = sheet(8.6, len(CHANGING), 2)
    for row, quantity in zip(axes, CHANGING, strict=True):
        norm, image = BoundaryNorm(quantity.bands, 256), None
        for axis, place in zip(row, places, strict=True):
            image = paint(axis, knees.grid, quantity.of(knees.forced)[place], GROWING, norm)
            axis.axvline(MM * knees.healthy.peak_depth[place], **{**REACHED, "color": "white"})
        bar = figure.colorbar(image, ax=row, ticks=quantity.bands, spacing="uniform", aspect=14)
        bar.ax.set_yticklabels([f"{band:g}" for band in quantity.bands], fontsize=SMALL)
        bar.set_label(quantity.label, fontsize=9)
    dress(axes, knees.grid, [_share(knees, place) for place in places])
    _key(figure, light=True)
    return figure


def _losses(knees: Knees, places: list[int], curves: list[Curve]) -> Any:
    """Draw how much higher the bones must be led for the force to drop, and the peak force over that rise."""
    from matplotlib.colors import BoundaryNorm

    figure, (axes, (below,)) = two_sheets(7.2)
    norm, image = BoundaryNorm(LOSS_BANDS, 256), None
    for axis, place in zip(axes[0], places, strict=True):
        image = paint(axis, knees.grid, MM * turning_loss(knees)[place], RED_TO_BLUE, norm)
        reached(axis, float(knees.healthy.peak_depth[place]))
    dress(axes, knees.grid, [_share(knees, place) for place in places])
    bar = figure.colorbar(image, ax=axes, ticks=LOSS_BANDS, spacing="uniform", aspect=14)
    bar.ax.set_yticklabels([f"{band:g}" for band in LOSS_BANDS], fontsize=SMALL)
    bar.set_label("rise of the path at which the\nforce is the healthy one [mm]", fontsize=9)
    _curves(below, knees, curves)
    _key(figure)
    return figure


def _curves(axis: Any, knees: Knees, curves: list[Curve]) -> None:
    """Draw peak force over the rise, and where each curve should cross 1."""
    from matplotlib.ticker import FuncFormatter

    for curve, colour in zip(curves, COLOURS, strict=True):
        label = f"h = {MM * curve.layer:g} mm, K₂ / K₁ = {curve.second / FIRST:.3g}"
        axis.plot(MM * RAISED, curve.ratio, color=colour, linewidth=1.8, label=label)
        axis.plot(MM * turning(knees, curve.layer, curve.second), 1.0, "o", color=colour, markersize=7)
    axis.axhline(1.0, color="0.4", linewidth=0.8)
    axis.set_yscale("log")
    axis.set_ylim(0.01, 30.0)
    axis.set_xlim(0.0, MM * RAISED[-1])
    axis.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_xlabel("rise of the healthy knee's path, as by cartilage lost [mm]", fontsize=9)
    axis.set_ylabel("peak force over healthy", fontsize=9)
    axis.set_title(_share(knees, 0), fontsize=10)
    axis.grid(visible=True, color="0.9", linewidth=0.8)
    axis.set_axisbelow(True)
    axis.tick_params(labelsize=SMALL)
    axis.legend(fontsize=SMALL, frameon=False, loc="lower left")


def _key(figure: Any, turning: str = "", *, light: bool = False) -> None:
    """Draw the legend above the panels."""
    from matplotlib.lines import Line2D

    line: dict[str, Any] = {**REACHED, "color": "0.5"} if light else REACHED
    handles = [
        Line2D([], [], label="shipped knee: 0.5 mm on bone", **SHIPPED_MARK),
        Line2D([], [], label="healthy knee's largest depth", **line),
    ]
    if turning:
        handles.append(Line2D([], [], label=turning, **TURNING))
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles), frameon=False, fontsize=SMALL)
