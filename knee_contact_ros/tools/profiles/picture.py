"""The picture of a fit: slice and profile, circles, curvature, deviation and thickness."""

from __future__ import annotations

import io
from typing import Any

import numpy as np

from knee_contact_ros.core.arrays import Floats
from knee_contact_ros.tools.profiles.fit import Fit
from knee_contact_ros.tools.profiles.shape import FittedCircle
from knee_contact_ros.tools.profiles.words import MM, side

PROFILE, RAW, BONE = "#0072B2", "0.6", "#B08968"
CIRCLES = ("#D55E00", "#009E73", "#CC79A7", "#E69F00")
SIZE, DPI = (10.5, 5.4), 110
STYLE: Any = {"font.size": 9.5, "axes.titlesize": 10, "axes.spines.top": False, "axes.spines.right": False,
              "axes.grid": True, "grid.color": "0.92", "axes.axisbelow": True, "legend.frameon": False,
              "legend.fontsize": 8.5}  # fmt: skip
ROOM = 1.2
"""Of its height above a tibia"""
OVERHANG = 0.35
"""Share of its window by which a circle is drawn beyond it"""


def picture(fit: Fit, name: str) -> bytes:
    """The picture as PNG."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        canvas = Figure(figsize=SIZE, layout="constrained")
        FigureCanvasAgg(canvas)
        grid = canvas.add_gridspec(2, 2, width_ratios=(1.15, 1.0))
        title = f"{side(fit).capitalize()} of {name}, z = {MM * fit.z:g} mm"
        draw_slice(canvas.add_subplot(grid[:, 0]), fit, title.replace("$", r"\$"))
        top = canvas.add_subplot(grid[0, 1])
        draw_curvature(top, fit)
        draw_distances(canvas.add_subplot(grid[1, 1], sharex=top), fit)
        file = io.BytesIO()
        canvas.savefig(file, format="png", dpi=DPI)
    return file.getvalue()


def draw_slice(axis: Any, fit: Fit, title: str) -> None:
    """The slice as it was cut, the profile, its circles and the bone."""
    if fit.thickness is not None:
        for number, piece in enumerate(MM * fit.thickness.bone):
            axis.plot(*piece.T, color=BONE, linewidth=1.2, label=None if number else "bone")
    axis.plot(*(MM * fit.smoothed.raw).T, "o", color=RAW, markersize=3.0, label="slice of the mesh")
    axis.plot(*(MM * fit.shape.points).T, color=PROFILE, linewidth=1.6, label="profile")
    for each, colour in zip(fit.circles, CIRCLES, strict=False):
        arc = MM * arc_of(each)
        axis.plot(*arc.T, "--", color=colour, linewidth=1.3, label=f"{label(fit, each)}: {MM * each.radius:.1f} mm")
    axis.set_aspect("equal", adjustable="datalim" if fit.femur else "box")
    axis.margins(0.06)
    if not fit.femur:  # flat: the legend goes above it
        low, high = axis.get_ylim()
        axis.set_ylim(low, high + ROOM * (high - low))
    axis.set(xlabel="x, anterior [mm]", ylabel="y, superior [mm]", title=title)
    axis.legend(**({"loc": "center"} if fit.femur else {"loc": "upper center", "ncols": 2}))


def label(fit: Fit, each: FittedCircle) -> str:
    """A circle's window, short."""
    low, high = each.window
    return f"{low:.0f}° to {high:.0f}°" if fit.femur else f"x {low:.0f} to {high:.0f} mm"


def arc_of(each: FittedCircle) -> Floats:
    """The circle over its part and a little beyond, shape (n, 2) [m]."""
    aside = each.part - each.centre
    middle = aside.mean(axis=0)
    base = np.arctan2(middle[1], middle[0])
    angles = (np.arctan2(aside[:, 1], aside[:, 0]) - base + np.pi) % (2.0 * np.pi) - np.pi
    room = OVERHANG * np.ptp(angles)
    turn = base + np.linspace(angles.min() - room, angles.max() + room, 200)
    return np.asarray(each.centre + abs(each.radius) * np.column_stack([np.cos(turn), np.sin(turn)]))


def along(fit: Fit) -> tuple[Floats, str]:
    """What the right panels are drawn over, at the places of the shape."""
    if fit.femur:
        return np.degrees(fit.shape.normal), "outward normal: 0 down, posterior positive [°]"
    return MM * fit.shape.points[:, 0], "x, anterior [mm]"


def draw_curvature(axis: Any, fit: Fit) -> None:
    """Curvature along the profile, and that of the circles."""
    place, _ = along(fit)
    axis.plot(place, fit.shape.curvature / MM, color=PROFILE, linewidth=1.5)
    for each, colour in zip(fit.circles, CIRCLES, strict=False):
        axis.plot(each.window, (1.0 / (MM * each.radius),) * 2, "--", color=colour, linewidth=1.3)
    axis.axhline(0.0, color="0.5", linewidth=0.8)
    axis.set(ylabel="curvature [1/mm]", title="curvature (dashed: the circles)" if fit.femur else
             "curvature, concave positive (dashed: the circles)")  # fmt: skip


def draw_distances(axis: Any, fit: Fit) -> None:
    """How far the slice lies off the profile, and how thick the cartilage is."""
    from scipy.spatial import cKDTree

    place, name = along(fit)
    at = place[cKDTree(fit.shape.points).query(fit.smoothed.raw)[1]]
    axis.plot(at, MM * fit.smoothed.deviations, ".", color="0.3", markersize=3.5)
    axis.axhline(0.0, color=PROFILE, linewidth=1.2)
    title = (
        f"slice outside of the profile: {MM * fit.smoothed.rms:.3f} mm RMS, {MM * fit.smoothed.largest:.2f} mm at most"
    )
    axis.set(xlabel=name, ylabel="deviation [mm]", title=title)
    if fit.thickness is None:
        return
    axis.set_title(title, pad=14)
    other = axis.twinx()
    other.plot(place, MM * fit.thickness.along, color=BONE, linewidth=1.5)
    other.set_ylabel("cartilage [mm]", color=BONE)
    other.set_ylim(bottom=0.0)
    other.grid(visible=False)
    other.spines["right"].set_visible(True)
