"""The picture: peaks over torque, and one stance of three knees."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from studies.assistance.walks import Floats, Peaks, Walk

COLOURS = ("#0072B2", "#D55E00", "#555555")
"""Okabe and Ito's colours of the laws in their order, and of a knee without assistance"""
LINES: tuple[Any, ...] = ("-", (0, (5, 2)))
SIZE, DPI = (7.5, 5.6), 150
SHOWN = (0.55, 1.45)
"""Times [s] of the first stance"""
MM = 1e3
HEADROOM = 1.12
"""Ratio of the axis' upper end to the largest value, which leaves room for the key"""


def draw(torques: Sequence[float], found: Mapping[str, Sequence[Walk]], shown: int, path: Path) -> None:
    """Draw the picture; `shown` is the place of the torque whose stance is drawn below."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=SIZE, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplot_mosaic([["force", "depth"], ["stance", "stance"]], height_ratios=(1.0, 0.95))
    _peaks(axes["force"], torques, found, lambda peaks: np.array(peaks.force), "peak contact force [N]")
    _peaks(axes["depth"], torques, found, lambda peaks: MM * np.array(peaks.depth), "peak penetration depth [mm]")
    for name in ("force", "depth"):
        axes[name].set_title("whole gait; band: load ± 1 standard deviation", fontsize=9)
    axes["stance"].set_title("first stance, as estimated", fontsize=9)
    axes["force"].legend(loc="lower left", fontsize=8, frameon=False)
    _stance(axes["stance"], found, shown, torques[shown])
    for axis in axes.values():
        axis.spines[["top", "right"]].set_visible(False)
        axis.tick_params(labelsize=8.5)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=DPI)


def _peaks(
    axis: Any,
    torques: Sequence[float],
    found: Mapping[str, Sequence[Walk]],
    values: Callable[[Peaks], Floats],
    label: str,
) -> None:
    for (name, walks), colour, line in zip(found.items(), COLOURS, LINES, strict=False):
        below, middle, above = np.array([values(walk.peaks) for walk in walks]).T
        axis.fill_between(torques, below, above, color=colour, alpha=0.14, linewidth=0.0)
        axis.plot(torques, middle, color=colour, linestyle=line, linewidth=1.8, label=name)
    axis.set_xlim(torques[0], torques[-1])
    axis.set_ylim(0.0)
    axis.set_xlabel("nominal torque of the assistance [N m]", fontsize=9)
    axis.set_ylabel(label, fontsize=9)


def _stance(axis: Any, found: Mapping[str, Sequence[Walk]], shown: int, torque: float) -> None:
    first = next(iter(found.values()))[0]
    seen = (first.time >= SHOWN[0]) & (first.time <= SHOWN[1])
    axis.plot(first.time[seen], first.force[seen], color=COLOURS[2], linewidth=1.4, label="no assistance")
    for (name, walks), colour, line in zip(found.items(), COLOURS, LINES, strict=False):
        force = walks[shown].force[seen]
        axis.plot(first.time[seen], force, color=colour, linestyle=line, linewidth=1.8, label=f"{torque:g} N m, {name}")
    axis.set_xlim(*SHOWN)
    axis.set_ylim(0.0, HEADROOM * first.force[seen].max())
    axis.set_xlabel("time [s]", fontsize=9)
    axis.set_ylabel("contact force [N]", fontsize=9)
    axis.legend(loc="lower center", fontsize=8, frameon=False)
