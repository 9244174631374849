"""The figures over time: every run's course, with its gait events."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from knee_contact_ros.pipeline.gait.events import HEEL_STRIKE, TOE_OFF
from knee_contact_ros.tools.report.cycles import COLUMNS
from knee_contact_ros.tools.report.figures import MM, Figure, colour, draw, has_bone, looks, plain, sentences, told
from knee_contact_ros.tools.report.runs import Run

SIZE = (5.2, 5.6)
FEW_EVENTS = 60
"""Heel strikes and toe-offs that can be told apart in a picture"""
FINE = 20_000_000
"""[ns] of a bucket that is drawn as a point of a line, and not as a range"""
FEW_POINTS = 20
"""Points that are marked: a line alone may not be seen"""
ROWS = (("flexion_angle", "flexion [°]"), ("contact_force", "contact force [BW]"), ("penetration_depth", "depth [mm]"))
LOOKS = {HEEL_STRIKE: {"color": "0.25", "linestyle": "-"}, TOE_OFF: {"color": "0.25", "linestyle": ":"}}


def over_time(runs: Sequence[Run]) -> list[Figure]:
    """A figure for every run and its comparisons."""
    found = []
    for number, run in enumerate(each for each in runs if each.beside is None):
        shown = [run, *(each for each in runs if each.beside == runs.index(run))]
        hues = [colour(runs, each) for each in shown]
        png = draw(SIZE, partial(rows, runs=shown, hues=hues))
        strikes = [moment for moment in run.gathered.moments if moment.event.kind in LOOKS]
        marks = "Vertical lines: heel strikes (full) and toe-offs (dotted), as found. " if drawn(strikes) else ""
        width = run.gathered.course.width
        course = f"From the smallest to the largest value in each {width / 1e9:g} s. " if width > FINE else ""
        found.append(
            Figure(f"over_time_{number + 1}", f"{run.name} over time", sentences(marks, course, told(shown)), png)
        )
    return found


def drawn(moments: Sequence[Any]) -> bool:
    """Whether so many events can be drawn."""
    return 0 < len(moments) <= FEW_EVENTS


def rows(canvas: Any, runs: Sequence[Run], hues: Sequence[str]) -> None:
    """Flexion, force and depth one above the other."""
    axes = canvas.subplots(len(ROWS), 1, sharex=True)
    base = runs[0]
    marks = [moment for moment in base.gathered.moments if moment.event.kind in LOOKS]
    for axis, (name, text) in zip(axes, ROWS, strict=True):
        for place, run in enumerate(runs):
            if place and name == "flexion_angle":
                continue  # the same inputs
            factor = {"flexion_angle": float(np.degrees(1.0)), "contact_force": 1.0 / run.parameters.body_weight}
            time, lowest, highest = run.gathered.course.lines()
            low, high = (factor.get(name, MM) * values[:, COLUMNS.index(name)] for values in (lowest, highest))
            hue = hues[place]
            label = plain(run.label) if name == "contact_force" else None
            if run.gathered.course.width <= FINE:
                marker = "." if len(time) < FEW_POINTS else None
                style, width = looks(run, hue)
                axis.plot(time, high, style, color=hue, linewidth=0.7 * width, marker=marker, label=label)
            else:
                axis.fill_between(time, low, high, color=hue, alpha=0.5, linewidth=0.3, label=label)
            if name == "penetration_depth" and has_bone(run):
                axis.axhline(MM * run.parameters.contact.layer_depth, color="0.35", linestyle=":", linewidth=1.2)
        for moment in marks if drawn(marks) else ():
            axis.axvline(moment.elapsed, linewidth=0.9, zorder=1.5, **LOOKS[moment.event.kind])
        axis.set_ylabel(text)
    axes[-1].set_xlabel("time since the first tick [s]")
    if len(runs) > 1:
        canvas.legend(*axes[1].get_legend_handles_labels(), loc="outside lower center")
