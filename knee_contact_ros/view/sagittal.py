"""The sagittal plane in mm: femur over plateau, overlap, contact point and force.

On the screen y points down in Rerun's 2-D views, so y is negated here.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from knee_contact_ros.core.types import Rows
from knee_contact_ros.view.colours import APART, BONE, CARTILAGE, FORCE, NAME_OF_STATE, OF_STATE, SURFACE, WAY
from knee_contact_ros.view.outlines import NEWTONS_PER_MM, KneeOutlines
from knee_contact_ros.view.overlap import overlaps

MM = 1e3
ON_SCREEN = np.array([MM, -MM])
"""From [m] in the tibia frame to mm on the screen"""
PICTURE_PERIOD = 5_000_000
"""[ns] of stamps in which there is one picture: more than a screen can show"""
WIDE, NARROW, POINT_SIZE, PATH_SIZE = -1.5, -0.8, -4.5, -1.2
"""Half widths on the screen, whatever the magnification: negative in Rerun"""
ON_TOP, ABOVE = 40.0, 35.0
"""Draw orders; 30 is that of other points"""
LONG_AXIS = 45.0
"""Length [mm] of the femur's axis that is drawn"""
SAGITTAL, FEMUR, POINT, PATH, OVERLAP, ARROW, LEGEND = (
    "sagittal", "femur", "contact_point", "contact_path", "overlap", "contact_force_on_femur", "legend"
)  # fmt: skip
Send = Callable[[str, Any], None]
"""Takes an entity's path and what to show there"""


def plane_still(drawing: KneeOutlines, send: Send) -> None:
    """Send what does not change."""
    femur, extent = drawing.femur * ON_SCREEN, extent_of(drawing)
    send(f"{FEMUR}/surface", rr.LineStrips2D([femur], colors=[SURFACE], radii=[WIDE]))
    axis = [[0.0, 0.0], [0.0, -LONG_AXIS]]
    send(f"{FEMUR}/long_axis", rr.LineStrips2D([axis], colors=[APART], radii=[NARROW]))
    send(f"{FEMUR}/reference_point", rr.Points2D([[0.0, 0.0]], colors=[APART], radii=[PATH_SIZE]))
    send("tibial_plateau", rr.LineStrips2D([drawing.tibia * ON_SCREEN], colors=[SURFACE], radii=[WIDE]))
    send(POINT, rr.Points2D.from_fields(radii=[POINT_SIZE], draw_order=ON_TOP))
    send(PATH, rr.Points2D.from_fields(colors=[WAY], radii=[PATH_SIZE], draw_order=ABOVE))
    send(ARROW, rr.Arrows2D.from_fields(colors=[FORCE], radii=[WIDE]))
    names, colours = list(NAME_OF_STATE.values()), [APART, CARTILAGE, BONE]
    places = [[(number - 1) * extent, 0.35 * extent] for number in range(len(names))]
    send(LEGEND, rr.Points2D(places, labels=names, colors=colours, radii=[POINT_SIZE], show_labels=True))


class Pictures:
    """Chooses the answers that are drawn: the first one of every `PICTURE_PERIOD`."""

    def __init__(self) -> None:
        self._period = -1  # of the last picture

    def choose(self, stamps: NDArray[np.int64]) -> NDArray[np.intp]:
        """Indices of those that are drawn, among answers that go on where the last ones ended."""
        periods = stamps // PICTURE_PERIOD
        new = np.flatnonzero(np.diff(periods, prepend=self._period))
        self._period = int(periods[-1])
        return new


def plane_moving(drawing: KneeOutlines, shown: Rows, layer: float, send: Send) -> None:
    """Send pictures, at least one; the second layer begins at the depth `layer` [m]."""
    zero = np.zeros(len(shown))
    half = -0.5 * shown["flexion_angle"]  # the screen's y points down, so a turn changes its sign
    turn = np.stack([zero, zero, np.sin(half), np.cos(half)], axis=1)
    place = np.stack([MM * shown["femoral_x"], -MM * shown["femoral_height"], zero], axis=1)
    send(FEMUR, rr.Transform3D.columns(translation=place, quaternion=turn))
    point = np.stack([shown["contact_point"]["x"], shown["contact_point"]["y"]], axis=1) * ON_SCREEN
    colours = OF_STATE[shown["contact_state"].astype(int)]
    send(POINT, rr.Points2D.columns(positions=point, colors=colours))
    send(PATH, rr.Points2D.columns(positions=point))
    arrow = shown["contact_force"][:, None] / NEWTONS_PER_MM * np.stack([shown["normal_x"], -shown["normal_y"]], axis=1)
    send(ARROW, rr.Arrows2D.columns(origins=point, vectors=arrow))
    send(OVERLAP, _overlap(drawing, shown, layer))


def extent_of(drawing: KneeOutlines) -> float:
    """How far the femur reaches from its reference point [mm]."""
    return MM * float(np.hypot(*drawing.femur.T).max())


def turned(femur: NDArray[np.float64], shown: Rows) -> NDArray[np.float64]:
    """Outlines of the femur, shape (n, m, 2) [m], in the tibia frame; flexion turns from anterior to superior."""
    cosine, sine = np.cos(shown["flexion_angle"])[:, None], np.sin(shown["flexion_angle"])[:, None]
    x = shown["femoral_x"][:, None] + cosine * femur[:, 0] - sine * femur[:, 1]
    y = shown["femoral_height"][:, None] + sine * femur[:, 0] + cosine * femur[:, 1]
    return np.stack([x, y], axis=2)


def _overlap(drawing: KneeOutlines, shown: Rows, layer: float) -> Any:
    """Upright lines where the outlines overlap, in the colour of the layer that is reached there."""
    radius = 0.5 * float(np.ptp(drawing.femur[:, 0]))
    found = overlaps(
        turned(drawing.femur, shown), drawing.tibia, shown["contact_point"]["x"], shown["penetration_depth"], radius
    )
    there = (found.upper > found.lower) & (shown["penetration_depth"] > 0.0)[:, None]
    ends = np.stack([np.stack([found.x, found.lower], axis=2), np.stack([found.x, found.upper], axis=2)], axis=2)
    deep = found.upper - found.lower > layer
    colours = np.where(deep[..., None], *np.array([BONE, CARTILAGE], dtype=np.uint8))
    numbers = there.sum(axis=1)
    radii = np.repeat(0.5 * MM * (found.x[:, 1] - found.x[:, 0]), numbers)
    lines = (ends * ON_SCREEN)[there]
    return rr.LineStrips2D.columns(strips=lines, colors=colours[there], radii=radii).partition(numbers)
