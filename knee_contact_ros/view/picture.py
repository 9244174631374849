"""The knee at a moment, drawn by matplotlib, without Rerun or a display.

`write_peak` writes a PNG of the knee where a recording's load is largest, or its contact force if no load drives;
`draw_knee` and `draw_contact` draw on the axes of a figure of the caller.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from knee_contact_ros.bags.provenance import read_provenance
from knee_contact_ros.bags.reader import answer_topics, read_answers
from knee_contact_ros.model.knee import KneeModel
from knee_contact_ros.parameters.build import build_model
from knee_contact_ros.parameters.schema import has_both
from knee_contact_ros.results import begin_of, stamp_text
from knee_contact_ros.streams.topics import MEDIAL
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.files import require
from knee_contact_ros.view.anatomy import Floats, Picture, picture_of

MM = 1e3
EXTRA = "report"
BONE, CARTILAGE, EDGE, SURFACE = "#F0E8D6", "#A9D0EC", "#7A7060", "#4F93C4"
OVERLAP, DEEP, FORCE, INK, QUIET = "#1F6FB2", "#C2357F", "#C8481A", "#1B1F24", "#5B6570"
"""Colours of the overlap of cartilages, of an overlap beyond the first layer, of the force, and of texts"""
MM_PER_WEIGHT = 6.0
"""Length [mm] of the force's arrow per body weight"""
SLENDER = 0.85
"""Least ratio of width to height of the room for a knee"""
FLAT = 0.5
"""Ratio of height to width of the magnified contact"""
SIDE, ABOVE, BELOW = 1.35, 0.5, 1.4
"""Range of the magnified contact: to each side in half-widths of the widest overlap, up and down in largest depths"""
LEAST_DEPTH = 0.1e-3
"""Least depth [m] for which the magnified contact has room"""
SIZE, DPI = (5.2, 6.4), 160
STYLE: Any = {"font.size": 10, "axes.titlesize": 10.5, "figure.dpi": DPI}


class Moment(NamedTuple):
    """A knee at a tick."""

    model: KneeModel
    flexion_angle: float
    """Flexion angle [rad]"""
    femoral_height: float
    """Height of the femoral reference point [m]"""
    contact_force: float
    """Contact force [N]"""
    body_weight: float
    """Body weight [N]"""

    @property
    def force(self) -> str:
        """The contact force in body weights and N, as text."""
        return f"{self.contact_force / self.body_weight:.2f} BW ({self.contact_force:.0f} N)"


def write_peak(recording: Path, output: Path) -> str:
    """Write a PNG of a recording's first knee where the load is largest; return a line on what it shows.

    Where the femoral height drives the model, the largest contact force counts.

    Args:
        recording: an .mcap file or a rosbag2 folder with answers.
        output: the PNG; one that exists is replaced.

    Raises:
        UsageError: matplotlib is not installed, or the recording has no answers or does not tell its parameters.
    """
    require(EXTRA, "matplotlib")
    topics = answer_topics(recording)
    if not topics:
        raise UsageError(f"recording {recording} has no answers (knee_contact_ros/msg/KneeContact)")
    provenance = read_provenance(recording)
    if provenance is None:
        raise UsageError(f"recording {recording} does not tell its parameters")
    known = provenance.parameters
    model = build_model(known, curves=provenance.texts())
    name, words = ("contact_force", "contact force") if model.height_prescribed else ("load", "load")
    answers = read_answers(recording, topics[0])
    row = answers[int(np.nan_to_num(answers[name], nan=-math.inf).argmax())]
    angle, height, force = (float(row[each]) for each in ("flexion_angle", "femoral_height", "contact_force"))
    moment = Moment(model, angle, height, force, known.body_weight)
    which = f"{MEDIAL} compartment, " if has_both(known) else ""
    title = f"{which}largest {words}, at {stamp_text(int(row['stamp']), begin_of(int(answers['stamp'][0])))} s"
    output.write_bytes(png(moment, title))
    depth = MM * row["penetration_depth"]
    return f"{title}: {moment.force}, depth {depth:.3f} mm at {math.degrees(moment.flexion_angle):.0f}° of flexion"


def png(moment: Moment, title: str) -> bytes:
    """Return a PNG of the knee with its magnified contact."""
    import io

    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        figure = Figure(figsize=SIZE, layout="constrained")
        FigureCanvasAgg(figure)
        knee, contact = figure.subplots(2, 1, height_ratios=(1.9, 1.0))
        draw_knee(knee, moment)
        knee.set_title(title)
        draw_contact(contact, moment, Window.around([moment]))
        file = io.BytesIO()
        figure.savefig(file, format="png", dpi=DPI, metadata={"Software": None})
    return file.getvalue()


class Window(NamedTuple):
    """Range that magnified contacts show; the same for all that are compared."""

    half_width: float
    """Half the width along the surface [m]"""
    above: float
    """Height above the tibia's surface [m]"""
    below: float
    """Depth below the tibia's surface [m]"""

    @classmethod
    def around(cls, moments: Sequence[Moment]) -> Window:
        """Return a window that is wide and high enough for several knees."""
        pictures = [posed(moment) for moment in moments]
        depth, gap = (max(LEAST_DEPTH, *(sign * picture.depth for picture in pictures)) for sign in (1.0, -1.0))
        radius = max(moment.model.femoral_radius for moment in moments)
        widths = [0.5 * float(np.ptp(picture.overlap[:, 0])) for picture in pictures if len(picture.overlap)]
        half_width = SIDE * max([*widths, math.sqrt(2.0 * radius * LEAST_DEPTH)])
        return cls(half_width, max(ABOVE * depth, BELOW * gap if gap > LEAST_DEPTH else 0.0), BELOW * depth)

    @property
    def magnification(self) -> float:
        """Magnification of heights relative to widths; a whole number if it is above 1."""
        factor = FLAT * 2.0 * self.half_width / (self.above + self.below)
        return max(round(factor), 1) if factor > 1.0 else factor


def draw_knee(axis: Any, moment: Moment) -> None:
    """Draw femur and tibia with their cartilage, the force on the femur, directions and a scale."""
    picture = posed(moment)
    contact = MM * np.array(picture.contact_point)
    for bone, cartilage in (
        (picture.tibia_bone, picture.tibia_cartilage), (picture.femur_bone, picture.femur_cartilage),
    ):  # fmt: skip
        fill(axis, MM * bone, BONE)
        fill(axis, MM * cartilage, CARTILAGE, SURFACE)  # half a millimetre of it is but its edge
    fill(axis, MM * picture.overlap, OVERLAP, OVERLAP)
    everything = MM * np.concatenate(picture[:4])
    (left, bottom), (right, top) = everything.min(axis=0), everything.max(axis=0)
    aside = max(2.0, 0.5 * (SLENDER * (top - bottom) - (right - left)))
    left, right = left - aside, right + aside
    axis.set(aspect="equal", xlim=(left, right), ylim=(bottom - 8.0, top + 2.0))
    axis.set_axis_off()
    end = contact + MM_PER_WEIGHT * moment.contact_force / moment.body_weight * np.array(picture.normal)
    look = {"arrowstyle": "-|>", "color": FORCE, "linewidth": 2.0, "shrinkA": 0, "shrinkB": 0}
    axis.annotate("", end, contact, zorder=6, annotation_clip=False, arrowprops=look)
    axis.text(end[0], end[1] + 1.0, moment.force.replace(" (", "\n("), color=FORCE, fontweight="bold", ha="center",
              va="bottom", fontsize=9, zorder=6)  # fmt: skip
    up = (-math.sin(moment.flexion_angle), math.cos(moment.flexion_angle))
    for text, bone, shaft in (("femur", picture.femur_bone, up), ("tibia", picture.tibia_bone, (0.0, -1.0))):
        along = np.array(shaft)
        end = MM * bone[np.argsort((MM * bone - contact) @ along)[-2:]].mean(axis=0)
        axis.text(*(end - 11.0 * along), text, color=QUIET, ha="center", va="center", fontsize=9)
    y, style = bottom - 6.0, {"color": QUIET, "fontsize": 8.5, "va": "center"}
    axis.text(left, y, "anterior →", ha="left", **style)
    axis.plot((right - 10.0, right), (y, y), color=QUIET, linewidth=2.0, solid_capstyle="butt")
    axis.text(right - 11.5, y, "10 mm", ha="right", **style)


def draw_contact(axis: Any, moment: Moment, window: Window) -> None:
    """Draw the contact, magnified along its normal: the overlap of femur and tibia, if neither were deformed."""
    picture = posed(moment)
    for part, colour in (
        (picture.tibia_cartilage, CARTILAGE), (picture.tibia_bone, BONE), (picture.femur_cartilage, CARTILAGE),
        (picture.femur_bone, BONE),
    ):  # fmt: skip
        fill(axis, in_contact_frame(picture, part), colour)
    overlap = in_contact_frame(picture, picture.overlap)
    fill(axis, overlap, OVERLAP, OVERLAP)
    anatomy = picture.anatomy
    deep = overlap[:0] if anatomy.thickness_is_drawn else beyond(overlap, 2.0 * MM * anatomy.thickness)
    fill(axis, deep, DEEP, DEEP)
    width, low, high = MM * window.half_width, -MM * window.below, MM * window.above
    axis.set(aspect=window.magnification, xlim=(-width, width), ylim=(low, high), xticks=[], yticks=[])
    for edge in axis.spines.values():
        edge.set_color("0.75")
    depth = MM * picture.depth
    axis.annotate("", (0.0, 0.0), (0.0, -depth), zorder=6,
                  arrowprops={"arrowstyle": "<->", "color": "white" if depth > 0.0 else INK, "shrinkA": 0, "shrinkB": 0,
                              "linewidth": 1.2})  # fmt: skip
    words = f"depth {depth:.3f} mm" if depth > 0.0 else f"{-depth:.3f} mm apart"
    axis.text(0.98, 0.05, words, ha="right", va="bottom", fontsize=8.5, fontweight="bold", color=INK, zorder=6,
              transform=axis.transAxes)  # fmt: skip
    bone = " (pink: bone)" if len(deep) else ""
    axis.set_xlabel(f"contact, heights × {window.magnification:g}{bone}", fontsize=8.5, color=QUIET, labelpad=3)


def posed(moment: Moment) -> Picture:
    """Return the polygons of a knee at its moment."""
    return picture_of(moment.model, moment.flexion_angle, moment.femoral_height)


def in_contact_frame(picture: Picture, points: Floats) -> Floats:
    """Transform points, shape (n, 2) [m], to mm along the surface and along its normal, from the contact point."""
    across, up = picture.normal
    return np.asarray(MM * (points - picture.contact_point) @ np.array([[up, across], [-across, up]]))


def beyond(overlap: Floats, layer: float) -> Floats:
    """Return the polygon of the part of an overlap that is deeper than the first layer [mm]."""
    upper, lower = overlap[: len(overlap) // 2], overlap[len(overlap) // 2 :][::-1]
    deep = upper[:, 1] - lower[:, 1] > layer
    inset = np.array([0.0, 0.5 * layer])
    return np.concatenate([(upper - inset)[deep], (lower + inset)[deep][::-1]])


def fill(axis: Any, polygon: Floats, colour: str, edge: str = EDGE) -> None:
    """Fill a polygon, shape (n, 2), unless it has fewer than three points."""
    if len(polygon) > 2:
        axis.fill(*polygon.T, facecolor=colour, edgecolor=edge, linewidth=0.7)
