"""Pictures of the page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from studies.load_validation.answers import BY_DEFAULT, FITTED, HALVES, Answer, peaks
from studies.load_validation.sections import deviations, one_number
from studies.load_validation.walks import Floats, Leg, Walk, nets_in
from studies.reproduction.figures import BLUE, DPI, GREEN, GREY, ORANGE, VERMILLION, panels

BLACK = "#000000"
SHOWN = 3.4
"""Time [s] of a trial that is drawn"""
COLOURS = {"ground_force": ORANGE, "knee_moment": BLUE, "ankle_moment": VERMILLION}
LINES = {"ground_force": ":", "knee_moment": "-", "ankle_moment": "--"}
MARKS = {"overground": "o", "treadmill": "^"}
WITHIN = 0.15


def draw(found: Sequence[Answer], folder: Path) -> None:
    """Draw the pictures of the instrumented knee."""
    folder.mkdir(parents=True, exist_ok=True)
    _forces(found, folder / "load_validation_forces.png")
    _peaks(found, folder / "load_validation_peaks.png")
    _spread(found, folder / "load_validation_spread.png")


def _store(figure: Figure, path: Path) -> None:
    figure.savefig(path, dpi=DPI, metadata={"Software": None})
    plt.close(figure)


def _shade(axes: Axes, walk: Walk, time: Floats) -> None:
    axes.fill_between(
        time, 0.0, 1.0, where=walk.stance.tolist(), transform=axes.get_xaxis_transform(), color=GREY, alpha=0.12,
        linewidth=0,
    )  # fmt: skip


def _gaps(walk: Walk, force: Floats) -> Floats:
    """Force in body weights, nan where the walk is not used."""
    shown: Floats = np.where(walk.used, force / walk.weight, np.nan)
    return shown


def _forces(found: Sequence[Answer], path: Path) -> None:
    walks = list({each.walk.name: each.walk for each in found}.values())
    figure, axes = panels(6.4, 2, len(walks), sharey=True, sharex="col")
    for place, walk in enumerate(walks):
        time = walk.time - walk.time[0]
        for row, how in enumerate((FITTED, BY_DEFAULT)):
            panel = axes[row * len(walks) + place]
            _shade(panel, walk, time)
            panel.plot(time, walk.reference / walk.weight, color=BLACK, linewidth=1.8, label="measured")
            for each in found:
                if each.walk is walk and each.how == how:
                    _level(panel, time, each)
            panel.set_title(f"{walk.name}, {'constants of the other trial' if how == FITTED else 'defaults'}")
            panel.set_xlim(0.0, min(SHOWN, float(time[walk.used][-1])))
        axes[len(walks) + place].set_xlabel("time [s]")
    for panel in axes[:: len(walks)]:
        panel.set_ylabel("axial force [BW]")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=4)
    _store(figure, path)


def _level(panel: Axes, time: Floats, answer: Answer) -> None:
    style = {"color": COLOURS[answer.level], "linestyle": LINES[answer.level], "linewidth": 1.3}
    force = _gaps(answer.walk, answer.force)
    panel.plot(time, force, label=answer.level, **style)  # type: ignore[arg-type]
    if answer.level == "knee_moment":
        one = deviations(answer, answer.deviation) / answer.walk.weight
        panel.fill_between(time, force - one, force + one, color=BLUE, alpha=0.15, linewidth=0)


def _peaks(found: Sequence[Answer], path: Path) -> None:
    levels = list(COLOURS)
    figure, axes = panels(3.2, 1, len(levels), sharex=True, sharey=True)
    ends = np.array([1.3, 3.0])
    for panel, level in zip(axes, levels, strict=True):
        panel.plot(ends, ends, color=GREY, linewidth=1.0)
        for factor in (1.0 - WITHIN, 1.0 + WITHIN):
            panel.plot(ends, factor * ends, color=GREY, linewidth=0.8, linestyle="--")
        for each in found:
            if each.level == level and each.how == FITTED:
                _dots(panel, each)
        panel.set(title=level, xlim=(1.5, 2.6), ylim=(1.4, 2.8))
    axes[1].set_xlabel("measured [BW]")
    axes[0].set_ylabel("ours [BW]")
    axes[0].legend(loc="lower right")
    _store(figure, path)


def _dots(panel: Axes, answer: Answer) -> None:
    both = peaks(answer.walk, answer.force)
    for half, filled in zip(HALVES, (True, False), strict=True):
        measured = np.array([peak.measured for peak in both if peak.half == half]) / answer.walk.weight
        ours = measured * (1.0 + np.array([peak.error for peak in both if peak.half == half]))
        colour = GREEN if answer.walk.name == "overground" else VERMILLION
        panel.scatter(
            measured, ours, s=26, marker=MARKS[answer.walk.name], edgecolors=colour, linewidths=1.1,
            facecolors=colour if filled else "none", label=answer.walk.name if filled else None,
        )  # fmt: skip


def _spread(found: Sequence[Answer], path: Path) -> None:
    shown = [each for each in found if each.level == "knee_moment" and each.how == FITTED]
    figure, axes = panels(3.4, 1, len(shown), sharex=True, sharey=True)
    for panel, answer in zip(axes, shown, strict=True):
        walk, weight = answer.walk, answer.walk.weight
        error = (answer.force - walk.reference) / weight
        for flags, colour, label in ((walk.stance, BLUE, "in stance"), (~walk.stance, ORANGE, "in swing")):
            some = walk.used & flags
            panel.scatter(answer.force[some] / weight, error[some], s=5, color=colour, alpha=0.5, label=label)
        force = np.linspace(0.0, 3.0, 200)
        told = np.array([answer.deviation.at(each, 1.0) for each in force.tolist()])
        single = one_number(found, answer)
        for times, width in ((1.0, 1.4), (2.0, 0.9)):
            for sign in (-times, times):
                panel.plot(force, sign * told, color=BLACK, linewidth=width)
        for sign in (-1.0, 1.0):
            panel.axhline(sign * single, color=GREY, linestyle="--", linewidth=1.0)
        panel.set(title=walk.name, xlabel="estimated force [BW]", xlim=(0.0, 3.0), ylim=(-1.6, 1.6))
    axes[0].set_ylabel("error [BW]")
    axes[0].legend(loc="upper left")
    _store(figure, path)


def draw_opensim(found: Sequence[Answer], legs: Sequence[Leg], folder: Path) -> None:
    """Draw our forces and moments of both legs beside OpenSim's."""
    folder.mkdir(parents=True, exist_ok=True)
    figure, axes = panels(8.0, 4, len(legs), sharex=True, sharey="row")
    for place, leg in enumerate(legs):
        walk = leg.walk
        column = axes[place :: len(legs)]
        for panel in column:
            _shade(panel, walk, walk.time)
        column[0].plot(walk.time, walk.reference / walk.weight, color=BLACK, linewidth=1.8, label="OpenSim")
        for each in found:
            if each.walk is walk and each.how == FITTED:
                panel_style = {"color": COLOURS[each.level], "linestyle": LINES[each.level], "linewidth": 1.3}
                column[0].plot(walk.time, _gaps(walk, each.force), label=each.level, **panel_style)  # type: ignore[arg-type]
        for panel, ours, theirs in zip(column[1:], nets_in(walk), (leg.knee, leg.ankle, leg.frontal), strict=True):
            panel.plot(walk.time, theirs, color=BLACK, linewidth=1.8)
            panel.plot(walk.time, np.where(walk.used, ours, np.nan), color=VERMILLION, linestyle="--", linewidth=1.3)
        column[0].set_title(f"{walk.name} leg; constants of the other leg")
        column[-1].set_xlabel("time [s]")
    labels = ("axial force [BW]", "knee, extension\n[N m]", "ankle, plantar-\nflexion [N m]", "knee, frontal\n[N m]")
    for panel, label in zip(axes[:: len(legs)], labels, strict=True):
        panel.set_ylabel(label)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=4)
    _store(figure, folder / "load_validation_opensim.png")
