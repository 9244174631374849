"""Figures over time: the course of every run and its comparisons, with the gait events."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from knee_contact_ros.streams.gait_events import HEEL_STRIKE, TOE_OFF
from knee_contact_ros.tools.report.cycles import COLUMNS
from knee_contact_ros.tools.report.figures import (
    MM,
    Figure,
    colour,
    differences_in,
    draw,
    has_bone,
    looks,
    plain,
    sentences,
    with_comparisons,
)
from knee_contact_ros.tools.report.gather import Moment
from knee_contact_ros.tools.report.runs import Run

SIZE = (5.2, 5.6)
FEW_EVENTS = 60
"""Largest number of heel strikes and toe-offs that are marked: more cannot be distinguished in a picture"""
FINE = 20_000_000
"""Largest width of a bucket [ns] that is drawn as a point of a line, and not as a range"""
FEW_POINTS = 20
"""Number of points below which each is marked: a line alone may not be seen"""
ROWS = (("flexion_angle", "flexion [°]"), ("contact_force", "contact force [BW]"), ("penetration_depth", "depth [mm]"))
LOOKS = {HEEL_STRIKE: {"color": "0.25", "linestyle": "-"}, TOE_OFF: {"color": "0.25", "linestyle": ":"}}


def over_time(runs: Sequence[Run]) -> list[Figure]:
    """Draw a figure for every run and its comparisons."""
    figures = []
    for number, group in enumerate(with_comparisons(runs), start=1):
        run, hues = group[0], [colour(runs, each) for each in group]
        png = draw(SIZE, partial(rows, runs=group, hues=hues))
        marks = "Vertical lines: heel strikes (full) and toe-offs (dotted), as found. " if marked_events(run) else ""
        width = run.gathered.course.width
        course = f"From the smallest to the largest value in each {width / 1e9:g} s. " if width > FINE else ""
        caption = sentences(marks, course, differences_in(group))
        figures.append(Figure(f"over_time_{number}", f"{run.name} over time", caption, png))
    return figures


def marked_events(run: Run) -> list[Moment]:
    """Heel strikes and toe-offs of a run; none if there are too many to be distinguished."""
    moments = [moment for moment in run.gathered.moments if moment.event.kind in LOOKS]
    return moments if len(moments) <= FEW_EVENTS else []


def rows(canvas: Any, runs: Sequence[Run], hues: Sequence[str]) -> None:
    """Draw flexion, contact force and depth over time, one above the other, for a run and its comparisons."""
    axes = canvas.subplots(len(ROWS), 1, sharex=True)
    marks = marked_events(runs[0])
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
        for moment in marks:
            axis.axvline(moment.elapsed, linewidth=0.9, zorder=1.5, **LOOKS[moment.event.kind])
        axis.set_ylabel(text)
    axes[-1].set_xlabel("time since the first tick [s]")
    if len(runs) > 1:
        canvas.legend(*axes[1].get_legend_handles_labels(), loc="outside lower center")
