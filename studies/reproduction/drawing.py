"""Common parts of all figures: the colour-blind safe colours of Okabe & Ito, sizes, storing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

BLUE, ORANGE, GREEN, VERMILLION, PURPLE, GREY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#666666"
SIZE: dict[Any, Any] = {
    "font.size": 9.5,
    "axes.titlesize": 9.5,
    "legend.fontsize": 8.5,
    "axes.grid": True,
    "grid.alpha": 0.3,
}
WIDTH, DPI = 7.5, 150
MARKERS = ("v", "s", "o", "D")
"""Markers of the four phases, in their order"""


def panels(height: float, rows: int = 1, columns: int = 1, **options: Any) -> tuple[Figure, list[Axes]]:
    """A figure [inches] and its panels in reading order."""
    plt.rcParams.update(SIZE)
    figure, axes = plt.subplots(rows, columns, figsize=(WIDTH, height), squeeze=False, layout="constrained", **options)
    return figure, list(axes.flat)


def heel_strike(axes: Axes, time: float, label: str = "") -> None:
    """Draw a vertical line at a heel strike [s]."""
    axes.axvline(time, color=GREY, linewidth=1.0, linestyle=":", label=label or None)


def store(figure: Figure, folder: Path, name: str) -> None:
    """Write a figure as reproduction_NAME.png."""
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / f"reproduction_{name}.png", dpi=DPI, metadata={"Software": None})
    plt.close(figure)
