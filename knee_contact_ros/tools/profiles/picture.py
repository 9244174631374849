"""Picture of a fit: slice and profile, circles, curvature, deviations and thickness of cartilage."""

from __future__ import annotations

import io
from typing import Any

import numpy as np

from knee_contact_ros.model.types import Floats
from knee_contact_ros.tools.profiles.fit import Fit
from knee_contact_ros.tools.profiles.shape import FittedCircle
from knee_contact_ros.tools.profiles.words import MM, side

PROFILE, RAW, BONE = "#0072B2", "0.6", "#B08968"
CIRCLES = ("#D55E00", "#009E73", "#CC79A7", "#E69F00")
LINE = 0.24
"""Height of a line of the legend with its share of the margins [in]"""
WIDTHS = (4.6, 3.5, 2.4, 1.4)
"""Line widths of circles in the plot of curvature, where they may lie on each other"""
FEMUR, TIBIA, DPI = (10.5, 6.4), (7.6, 8.6), 110
"""Size of a picture [in] and its resolution: a femur's slice is beside the plots along it, a tibia's above them"""
STYLE: Any = {"font.size": 9.5, "axes.titlesize": 10, "axes.spines.top": False, "axes.spines.right": False,
              "axes.grid": True, "grid.color": "0.92", "axes.axisbelow": True, "legend.frameon": False,
              "legend.fontsize": 8.5}  # fmt: skip


def picture(fit: Fit, name: str) -> bytes:
    """Draw the picture of a fit, as PNG; `name` is the mesh's."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    panels = [draw_curvature, draw_circles, draw_deviations, *([draw_cartilage] if fit.thickness else [])]
    with mpl.rc_context(STYLE):
        canvas = Figure(figsize=FEMUR if fit.femur else TIBIA, layout="constrained")
        if fit.femur:
            grid = canvas.add_gridspec(len(panels), 2, width_ratios=(1.1, 1.0))
            whole, rows = canvas.add_subplot(grid[:, 0]), [grid[row, 1] for row in range(len(panels))]
        else:
            grid = canvas.add_gridspec(1 + len(panels), 1, height_ratios=(1.5, *[1.0] * len(panels)))
            whole, rows = canvas.add_subplot(grid[0]), [grid[row] for row in range(1, 1 + len(panels))]
        title = f"{side(fit).capitalize()} of {name}, z = {MM * fit.z:g} mm"
        draw_slice(whole, fit, title.replace("$", r"\$"))
        first = None
        for draw, row in zip(panels, rows, strict=True):
            axis = canvas.add_subplot(row, sharex=first)
            first = first or axis
            draw(axis, fit)
            axis.tick_params(labelbottom=row is rows[-1])
        axis.set_xlabel(along(fit)[1])
        if not fit.femur:
            axis.set_xlim(whole.get_xlim())
        canvas.align_ylabels()
        columns, entries = 3 if fit.femur else 2, 2 + len(fit.circles) + (fit.thickness is not None)
        below = LINE * -(-entries // columns) / canvas.get_size_inches()[1]
        canvas.legend(loc="lower center", ncols=columns)
        canvas.set_layout_engine("constrained", rect=(0.0, below, 1.0, 1.0 - below))
        file = io.BytesIO()
        canvas.savefig(file, format="png", dpi=DPI, metadata={"Software": None})
    return file.getvalue()


def draw_slice(axis: Any, fit: Fit, title: str) -> None:
    """Draw the slice, the profile and the bone, and for a femur the sectors to which its circles are fitted."""
    if fit.thickness is not None:
        for number, piece in enumerate(MM * fit.thickness.bone):
            axis.plot(*piece.T, color=BONE, linewidth=1.2, label=None if number else "bone")
    axis.plot(*(MM * fit.smoothed.raw).T, "o", color=RAW, markersize=3.0, label="slice of the mesh")
    axis.plot(*(MM * fit.shape.points).T, color=PROFILE, linewidth=1.6, label="profile")
    for each, colour in zip(fit.circles if fit.femur else (), CIRCLES, strict=False):
        sector = MM * np.vstack([each.centre, arc_of(each), each.centre])
        axis.plot(*sector.T, color=colour, linewidth=1.0)
        axis.plot(*(MM * each.centre), "o", color=colour, markersize=4.0)
    axis.set_aspect("equal", adjustable="datalim" if fit.femur else "box")
    axis.margins(0.06)
    axis.set(xlabel="x, anterior [mm]" if fit.femur else "", ylabel="y, superior [mm]", title=title)


def label(fit: Fit, each: FittedCircle) -> str:
    """Window of a circle for the legend."""
    low, high = each.window
    return f"{low:.0f}° to {high:.0f}°" if fit.femur else f"x {low:.0f} to {high:.0f} mm"


def arc_of(each: FittedCircle) -> Floats:
    """Points of a circle's arc over the part to which it is fitted, shape (200, 2) [m]."""
    offset = each.part - each.centre
    middle = offset.mean(axis=0)
    base = np.arctan2(middle[1], middle[0])
    angles = (np.arctan2(offset[:, 1], offset[:, 0]) - base + np.pi) % (2.0 * np.pi) - np.pi
    turn = base + np.linspace(angles.min(), angles.max(), 200)
    return np.asarray(each.centre + abs(each.radius) * np.column_stack([np.cos(turn), np.sin(turn)]))


def along(fit: Fit) -> tuple[Floats, str]:
    """Horizontal coordinate of the plots along the profile, at the places of the shape, with its label."""
    if fit.femur:
        return np.degrees(fit.shape.normal), "outward normal: 0 down, posterior positive [°]"
    return MM * fit.shape.points[:, 0], "x, anterior [mm]"


def place_of(fit: Fit, points: Floats) -> Floats:
    """Horizontal coordinates of points, shape (n, 2) [m], in these plots: those of the nearest place of the shape."""
    from scipy.spatial import cKDTree

    return np.asarray(along(fit)[0][cKDTree(fit.shape.points).query(points)[1]])


def draw_curvature(axis: Any, fit: Fit) -> None:
    """Draw the curvature along the profile, and that of the circles."""
    axis.plot(along(fit)[0], fit.shape.curvature / MM, color=PROFILE, linewidth=1.5)
    for each, colour, width in zip(fit.circles, CIRCLES, WIDTHS, strict=False):
        axis.plot(each.window, (1.0 / (MM * each.radius),) * 2, color=colour, linewidth=width)
    axis.axhline(0.0, color="0.5", linewidth=0.8)
    title = "curvature of the profile and of the circles"
    axis.set(ylabel="[1/mm]", title=title if fit.femur else f"{title}, concave positive")


def draw_circles(axis: Any, fit: Fit) -> None:
    """Draw the distance of the profile from each circle within its window; as arcs they would hide each other."""
    for each, colour in zip(fit.circles, CIRCLES, strict=False):
        outwards = 1.0 if fit.femur or each.radius < 0.0 else -1.0  # out of a concave tibia is towards the centre
        off = outwards * (np.hypot(*(each.part - each.centre).T) - abs(each.radius))
        axis.plot(place_of(fit, each.part), MM * off, color=colour, linewidth=1.5,
                  label=f"circle over {label(fit, each)}: radius {MM * each.radius:.1f} mm")  # fmt: skip
    axis.axhline(0.0, color="0.5", linewidth=0.8)
    axis.set(ylabel="[mm]", title="profile outside of each circle")


def draw_deviations(axis: Any, fit: Fit) -> None:
    """Draw the distance of the slice from the profile."""
    axis.plot(place_of(fit, fit.smoothed.raw), MM * fit.smoothed.deviations, ".", color="0.3", markersize=3.5)
    axis.axhline(0.0, color=PROFILE, linewidth=1.2)
    most = f"{MM * fit.smoothed.rms:.3f} mm RMS, {MM * fit.smoothed.largest:.2f} mm at most"
    axis.set(ylabel="[mm]", title=f"slice outside of the profile: {most}")


def draw_cartilage(axis: Any, fit: Fit) -> None:
    """Draw the thickness of the cartilage."""
    if fit.thickness is None:
        return
    axis.plot(along(fit)[0], MM * fit.thickness.along, color=BONE, linewidth=1.5)
    axis.set(ylabel="[mm]", title=f"cartilage: {MM * fit.thickness.mean:.2f} mm on average where gait touches")
    axis.set_ylim(bottom=0.0)
