"""Pictures of the page: both persons side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from knee_contact_ros.joint_reaction.estimator import LOAD_LEVELS
from studies.reproduction.figures import DPI, GREEN, GREY, VERMILLION, panels
from studies.validation.data import Walk
from studies.validation.split import loads, rules
from studies.validation.total import OTHERS, Estimate

BLACK = "#000000"
SHOWN = {"ngait_tm_fast1": (1.4, 4.0), "PS_ngait_og_ss1": (0.0, 2.0)}
"""Trials that are drawn, and between which times [s]"""
LEVEL_STYLES = {"ground_force": (GREEN, ":"), "knee_moment": (VERMILLION, "-")}
SPLIT_STYLES = {
    "curve": ("share by load", GREEN, ":"),
    "moment": ("moment balance, 70 mm", VERMILLION, "-"),
}


def draw(found: Sequence[Estimate], walks: Sequence[Walk], folder: Path) -> None:
    """Write the picture of total and medial forces, by constants of the other person."""
    shown = [walk for walk in walks if walk.name in SHOWN]
    figure, axes = panels(5.6, 2, len(shown), sharex="col", sharey="row")
    grid = np.reshape(np.array(axes, dtype=object), (2, len(shown)))
    for place, walk in enumerate(shown):
        time, weight = walk.time - walk.time[0], walk.person.body_weight
        first, last = SHOWN[walk.name]
        seen = (time >= first) & (time <= last)
        for panel, truth in zip(grid[:, place], (walk.total, walk.medial), strict=True):
            panel.plot(
                time[seen], truth[seen] / weight, color=BLACK, linewidth=1.8, label="measured"
            )
            panel.fill_between(
                time[seen],
                0.0,
                1.0,
                where=walk.stance[seen].tolist(),
                transform=panel.get_xaxis_transform(),
                color=GREY,
                alpha=0.12,
                linewidth=0,
            )
        for each in found:
            if each.walk is walk and each.how == OTHERS and each.level in LEVEL_STYLES:
                colour, line = LEVEL_STYLES[each.level]
                force, told = each.force[seen] / weight, LOAD_LEVELS[each.level].uncalibrated
                grid[0, place].plot(
                    time[seen],
                    force,
                    color=colour,
                    linestyle=line,
                    linewidth=1.3,
                    label=each.level,
                )
                if each.level == "knee_moment":
                    off = np.hypot(told.floor, told.part * force)
                    grid[0, place].fill_between(
                        time[seen], force - off, force + off, color=colour, alpha=0.15, lw=0
                    )
        split = rules([each for each in walks if each.person.name != walk.person.name])
        for form, (label, colour, line) in SPLIT_STYLES.items():
            medial = np.clip(split[form](walk), -0.5, loads(walk)[0].max())
            grid[1, place].plot(
                time[seen], medial[seen], color=colour, linestyle=line, linewidth=1.3, label=label
            )
        grid[0, place].set_title(f"{walk.person.name}, {walk.name}")
        grid[1, place].set_xlabel("time [s]")
    for panel, label in zip(
        grid[:, 0], ("total force [BW]", "medial force, total given [BW]"), strict=True
    ):
        panel.set_ylabel(label)
    for row in grid:
        row[-1].legend(fontsize="small", loc="upper right")
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / "validation.png", dpi=DPI, metadata={"Software": None})
    plt.close(figure)
