"""Common parts of the maps: layers along, stiffness ratio upwards, and the shipped knee."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from studies.osteoarthritis.grid import FIRST, SHIPPED, Floats, Grid

MM = 1e3
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
