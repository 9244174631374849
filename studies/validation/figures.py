"""Pictures of the page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from knee_contact_ros.joint_reaction.compartments import MeasuredShare
from knee_contact_ros.parameters.files import read_share_table
from knee_contact_ros.system.files import find_file
from studies.reproduction.figures import DPI, GREEN, GREY, VERMILLION, panels
from studies.validation.data import BODY_WEIGHT, Floats, Measured
from studies.validation.sections import answers, in_stance

SHOWN = 3.0
"""Time [s] of a trial that is drawn"""
BLACK = "#000000"
STYLES = {
    "`fixed_share` 0.5": ("one half", GREY, "--"),
    "`moment_balance`, 40 mm": ("moment balance", GREEN, ":"),
    "`measured_share`, fitted to the other trial": ("table of the other trial", VERMILLION, "-"),
}


def draw(trials: Sequence[Measured], folder: Path) -> None:
    """Write all pictures."""
    folder.mkdir(parents=True, exist_ok=True)
    _forces(trials, folder / "validation_forces.png")
    _share(trials, folder / "validation_share.png")


def _forces(trials: Sequence[Measured], path: Path) -> None:
    figure, axes = panels(7.2, 3, len(trials), sharex="col", sharey="row", height_ratios=(1.5, 1.5, 1.0))
    grid = np.reshape(np.array(axes, dtype=object), (3, len(trials)))
    for place, measured in enumerate(trials):
        shown = measured.time <= measured.time[0] + SHOWN
        time = measured.time[shown] - measured.time[0]
        found = {each.name: each.medial[shown] for each in answers(measured, [t for t in trials if t is not measured])}
        medial, total = measured.medial[shown], measured.total[shown]
        for panel in grid[:, place]:
            _stances(panel, time, in_stance(measured)[shown])
        for panel, truth in ((grid[0, place], medial), (grid[1, place], total - medial)):
            panel.plot(time, truth, color=BLACK, linewidth=1.8, label="measured")
        for name, (label, colour, line) in STYLES.items():
            style = {"color": colour, "linestyle": line, "linewidth": 1.3, "label": label}
            grid[0, place].plot(time, found[name], **style)
            grid[1, place].plot(time, total - found[name], **style)
            grid[2, place].plot(time, found[name] - medial, **style)
        grid[0, place].set_title(measured.name)
        grid[2, place].set_xlabel("time [s]")
    grid[0, 0].set_ylim(-200.0, 1400.0)
    grid[1, 0].set_ylim(-200.0, 1400.0)
    grid[2, 0].set_ylim(-500.0, 500.0)
    for panel, label in zip(grid[:, 0], ("medial force [N]", "lateral force [N]", "error, medial [N]"), strict=True):
        panel.set_ylabel(label)
    figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=4)
    figure.savefig(path, dpi=DPI, metadata={"Software": None})
    plt.close(figure)


def _stances(axes: Axes, time: Floats, on: Floats) -> None:
    axes.fill_between(
        time, 0.0, 1.0, where=(on > 0.5).tolist(), transform=axes.get_xaxis_transform(),
        color=GREY, alpha=0.12, linewidth=0,
    )  # fmt: skip


def _share(trials: Sequence[Measured], path: Path) -> None:
    """Draw the shipped table over the measured shares."""
    name = "share_medial.csv"
    table = read_share_table(name, find_file(name).read_text(encoding="utf-8"))
    figure, axes = panels(3.4, 1, len(trials), sharey=True)
    levels: dict[str, Any] = {"cmap": "RdBu_r", "vmin": 0.1, "vmax": 0.9}
    angle, load = np.meshgrid(np.linspace(-15.0, 75.0, 361), np.linspace(0.0, 2.8, 281))
    between = MeasuredShare(table, 1.0).share(load, np.radians(angle))
    for panel, measured in zip(axes, trials, strict=True):
        mesh = panel.pcolormesh(angle, load, between, rasterized=True, **levels)
        shares = measured.medial / measured.total
        panel.scatter(
            np.degrees(measured.flexion), measured.total / BODY_WEIGHT, c=shares, s=14, edgecolors="black",
            linewidths=0.25, **levels,
        )  # fmt: skip
        panel.set_title(measured.name)
        panel.set_xlabel("flexion [°]")
        panel.grid(visible=False)
    axes[0].set_ylabel("axial load [BW]")
    figure.colorbar(mesh, ax=axes, label="medial share")
    figure.savefig(path, dpi=DPI, metadata={"Software": None})
    plt.close(figure)
