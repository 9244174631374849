"""The knee at a moment, drawn by matplotlib, without Rerun or a display."""

import math
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np

from ..model.knee import KneeModel
from ..model.types import MM, Floats
from .anatomy import MAGNIFICATION, Picture, picture_of

BONE_FILL = "#F0E8D6"
CARTILAGE_FILL = "#A9D0EC"
BONE_LINE = "#7A7060"
"""Colour of the edges of bones"""
CARTILAGE_LINE = "#4F93C4"
"""Colour of the edges of cartilage"""
CARTILAGE_OVERLAP = "#1F6FB2"
"""Colour of the overlap of cartilages"""
BONE_OVERLAP = "#C2357F"
"""Colour of an overlap beyond the first layer"""
FORCE_ARROW = "#C8481A"
DEPTH_COLOUR = "#1B1F24"
"""Colour of the depth"""
QUIET = "#5B6570"
"""Colour of names, directions and scale"""
MM_PER_WEIGHT = 6.0
"""Length [mm] of the force's arrow per body weight"""
SLENDER = 0.85
"""Smallest ratio of width to height of the space for a knee"""
NAME_INSIDE = {"femur": 11.0, "tibia": 4.0}
"""Distances [mm] of the bones' names from the ends of their shafts"""
CURVES_STYLE: dict[str, Any] = {
    "font.size": 10,
    "axes.titlesize": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "0.92",
    "axes.axisbelow": True,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
}
"""Style of pictures with curves"""


UNDATED: dict[str, Any] = {
    "png": {"Software": None},
    "svg": {"Date": None},
    "pdf": {"CreationDate": None},
}
"""Metadata of a picture by its format, without what changes from day to day"""
VECTOR_STYLE = {"pdf.fonttype": 42, "svg.hashsalt": "knee"}
"""Letters of PDF files as journals want them, and the same SVG file each time"""


@contextmanager
def saved_figure(
    files: Mapping[str, Any], size: tuple[float, float], dpi: int, **style: Any
) -> Iterator[Any]:
    """Yield a matplotlib figure of a size [in] and style to draw on, then write it into files or paths by format."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(VECTOR_STYLE | style):  # type: ignore[arg-type]
        figure = Figure(figsize=size, layout="constrained")
        yield figure
        with warnings.catch_warnings():
            # Of a letter of a name that no font has; a box is drawn instead.
            warnings.filterwarnings("ignore", "Glyph .* missing")
            for kind, file in files.items():
                figure.savefig(file, format=kind, dpi=dpi, metadata=UNDATED[kind])


def draw_knee(
    axis: Any, model: KneeModel, angle: float, height: float, force: float, body_weight: float
) -> None:
    """Draw femur and tibia with their cartilage, the magnified overlap, the force on the femur, directions, a scale.

    The knee has a flexion angle [rad], a femoral height [m] and a contact force [N]; the body weight is in N.
    """
    picture = picture_of(model, angle, height)
    contact = MM * np.array(picture.contact_point)
    normal = np.array(picture.normal)
    for bone, cartilage in (
        (picture.tibia_bone, picture.tibia_cartilage),
        (picture.femur_bone, picture.femur_cartilage),
    ):
        fill(axis, MM * bone, BONE_FILL)
        fill(
            axis, MM * cartilage, CARTILAGE_FILL, CARTILAGE_LINE
        )  # half a millimetre of it is but its edge
    layer = min(model.cartilage_thickness, model.law.thickness)
    fill(axis, MM * magnified_overlap(picture, layer), CARTILAGE_OVERLAP, CARTILAGE_OVERLAP)
    fill(axis, MM * magnified_overlap(picture, math.inf, layer), BONE_OVERLAP, BONE_OVERLAP)
    everything = MM * np.concatenate(picture[:4])
    left, bottom = everything.min(axis=0)
    right, top = everything.max(axis=0)
    aside = max(2.0, 0.5 * (SLENDER * (top - bottom) - (right - left)))
    left = left - aside
    right = right + aside
    axis.set(aspect="equal", xlim=(left, right), ylim=(bottom - 8.0, top + 2.0))
    axis.set_axis_off()
    end = contact + MM_PER_WEIGHT * force / body_weight * normal
    look = {
        "arrowstyle": "-|>",
        "color": FORCE_ARROW,
        "linewidth": 2.0,
        "shrinkA": 0,
        "shrinkB": 0,
    }
    axis.annotate("", end, contact, zorder=6, annotation_clip=False, arrowprops=look)
    style = {"ha": "center", "fontsize": 9, "fontweight": "bold", "zorder": 6}
    label = f"{force / body_weight:.2f} BW\n({force:.0f} N)"
    axis.text(end[0], end[1] + 1.0, label, color=FORCE_ARROW, va="bottom", **style)
    depth = MM * picture.depth
    words = (
        f"{depth:.3f} mm deep\n(drawn × {MAGNIFICATION:g})"
        if depth > 0.0
        else f"{-depth:.3f} mm apart"
    )
    below = contact - (MAGNIFICATION * max(depth, 0.0) + 1.5) * normal
    # The word stays within the picture.
    below = np.maximum(below, (left, bottom))
    axis.text(
        *below,
        words,
        color=DEPTH_COLOUR,
        va="top",
        **style | {"fontsize": 7.5, "fontweight": "normal"},
    )
    up = (-math.sin(angle), math.cos(angle))
    for text, bone, shaft in (
        ("femur", picture.femur_bone, up),
        ("tibia", picture.tibia_bone, (0.0, -1.0)),
    ):
        along = np.array(shaft)
        end = MM * bone[np.argsort((MM * bone - contact) @ along)[-2:]].mean(axis=0)
        axis.text(
            *(end - NAME_INSIDE[text] * along),
            text,
            color=QUIET,
            ha="center",
            va="center",
            fontsize=9,
        )
    y = bottom - 6.0
    style = {"color": QUIET, "fontsize": 8.5, "va": "center"}
    axis.text(left, y, "anterior →", ha="left", **style)
    axis.plot((right - 10.0, right), (y, y), color=QUIET, linewidth=2.0, solid_capstyle="butt")
    axis.text(right - 11.5, y, "10 mm", ha="right", **style)


def magnified_overlap(picture: Picture, most: float, least: float = 0.0) -> Floats:
    """Return the polygon [m] of the overlap from a depth to a deeper one [m], its depth magnified along the normal."""
    upper, lower = np.split(picture.overlap, 2)
    depth = (upper - lower[::-1])[:, 1:] * picture.normal[1]
    normal = np.array(picture.normal)
    top, bottom = (
        upper - MAGNIFICATION * np.minimum(depth, end) * normal for end in (least, most)
    )
    deep = depth[:, 0] > least
    return np.concatenate([top[deep], bottom[deep][::-1]])


def fill(axis: Any, polygon: Floats, colour: str, edge: str = BONE_LINE) -> None:
    """Fill a polygon, shape (n, 2), unless it has fewer than three points."""
    if len(polygon) > 2:
        axis.fill(*polygon.T, facecolor=colour, edgecolor=edge, linewidth=0.7)
