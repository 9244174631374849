"""The figure of answers: flexion, force, depth and contact point over time."""

from __future__ import annotations

from typing import Any

import numpy as np

from knee_contact_ros.model.types import NANOSECOND, Rows
from knee_contact_ros.results.columns import begin_in
from knee_contact_ros.results.extra import library

SIZE = (8.0, 8.0)
"""Width and height [inch]"""
LEAST = 1.0
"""The least distance [mm] from the mean to the ends of the contact point's axis, as the point may hardly move"""
LOAD, CONTACT, DEPTH, POINT = "#b8bec6", "#c1272d", "#1b5e9e", "#4b7f52"


def figure_of(rows: Rows) -> Any:
    """Draw flexion, load and contact force, depth, and the contact point on the plateau, as a matplotlib `Figure`."""
    matplotlib, pyplot = library("matplotlib"), library("matplotlib.pyplot")
    figure, axes = pyplot.subplots(4, 1, sharex=True, figsize=SIZE, layout="constrained")
    flexion, force, depth, point = axes
    begin = begin_in(rows)
    time = NANOSECOND * (np.asarray(rows["stamp"]) - begin)
    flexion.plot(time, np.degrees(rows["flexion_angle"]), color="black")
    flexion.set_ylabel("flexion [°]")
    force.plot(time, rows["load"], color=LOAD, linewidth=5.0, label="load")
    force.plot(time, rows["contact_force"], color=CONTACT, label="contact force")
    force.set_ylabel("force [N]")
    force.set_ylim(bottom=min(0.0, force.get_ylim()[0]))
    force.legend(loc="best", frameon=False)
    depth.plot(time, 1e3 * np.asarray(rows["penetration_depth"]), color=DEPTH)
    depth.set_ylim(bottom=0.0)
    depth.set_ylabel("depth [mm]")
    places = 1e3 * np.asarray(rows["contact_point"]["x"])
    point.plot(time, places, color=POINT)
    if len(places) and np.ptp(places) < LEAST:
        point.set_ylim(places.mean() - LEAST, places.mean() + LEAST)
    point.set_ylabel("contact point,\nanterior [mm]")
    point.set_xlabel(f"time [s] from {NANOSECOND * begin:.3f} s on" if begin else "time [s]")
    for one in axes:
        if len(time) == 1:  # a single point makes no line
            pyplot.setp(one.lines, marker="o")
        one.grid(visible=True, alpha=0.3)
        one.margins(x=0.0)
    figure.align_ylabels(axes)
    if "inline" in matplotlib.get_backend():
        pyplot.close(figure)  # a notebook shows the result of a cell anyway, and would show the figure twice
    return figure
