"""The sagittal plane in mm: femur over tibia, cartilage, overlap, contact point and force.

Rerun fills no polygons in a plane, but triangles in space. So the knee stands in space, upright before a camera whose
distance and focal length are such that a millimetre of the knee is one on the screen; a plane's view through that
camera can be moved and magnified, not turned. Layers in front stand a little nearer to the camera. On the screen y
points down, so y is negated here.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from knee_contact_ros.model.types import Rows
from knee_contact_ros.view import colours
from knee_contact_ros.view.frame import SCALE_BAR, Frame
from knee_contact_ros.view.outlines import NEWTONS_PER_MM, KneeOutlines
from knee_contact_ros.view.overlap import POINTS, overlaps
from knee_contact_ros.view.triangles import band, triangles_of

MM = 1e3
ON_SCREEN = np.array([MM, -MM])
"""Factors from m in the tibia frame to mm on the screen"""
PICTURE_PERIOD = 5_000_000
"""Time [ns] between two pictures: they are more than a screen can show"""
DISTANCE, LAYER_DISTANCE = 1000.0, 0.2
"""Distance of the camera from the knee [mm], and distance between two layers [mm]"""
LAYERS = ("tibia", "tibial cartilage", "femur", "femoral cartilage", "edge", "overlap")
"""Names of the layers, from back to front"""
THIN, LINE, WIDE, POINT_SIZE, PATH_SIZE = -0.6, -1.0, -2.2, -4.5, -1.4
"""Half-widths on the screen, whatever the magnification; Rerun takes them as negative numbers"""
ON_TOP, ABOVE = 40.0, 35.0
"""Draw orders of marks; that of other points is 30"""
UNSEEN = -0.01
"""Half-width of a point of which only the label is visible"""
ABOVE_AXIS, ABOVE_FORCE = 9.0, 13.0
"""Distances [mm] from the tip of an arrow to the place of its word above, of one line and of two"""
MAGNIFICATION = 10.0
"""Factor by which the depth of the drawn overlap is magnified along the normal"""
FORCE_WITHIN = 0.8
"""Largest distance from the contact to the force's word, in extents of the femur: there is bone behind it"""
CAMERA, BODY = "sagittal", "body"
"""Paths of the entities of the camera, with marks in front of the knee, and of the knee"""
MOVING_FEMUR, POINT, PATH, OVERLAP, ARROW, FORCE_NAME, DEPTH = (
    "femur", "contact_point", "contact_path", "overlap", "contact_force_on_femur", "contact_force", "depth"
)  # fmt: skip
Floats = NDArray[np.float64]
Send = Callable[[str, Any], None]
"""Function that takes the path of an entity and the data to show there"""


def camera() -> rr.Pinhole:
    """Make the camera before the plane: a millimetre at its distance is one on the screen."""
    return rr.Pinhole(focal_length=DISTANCE, principal_point=(0.0, 0.0), resolution=(1.0, 1.0))


def send_still_plane(drawing: KneeOutlines, send: Send) -> None:
    """Send the polygons, and the parts of the overlap that do not change."""
    knee = drawing.anatomy
    for name, bone, cover, colour in (
        ("tibia", knee.tibia_bone, knee.tibia_cartilage, colours.TIBIA),
        (MOVING_FEMUR, knee.femur_bone, knee.femur_cartilage, colours.FEMUR),
    ):
        cartilage = "tibial cartilage" if name == "tibia" else "femoral cartilage"
        send(f"{name}/bone", _filled(bone, name, colour))
        send(f"{name}/cartilage", _filled(cover, cartilage, colours.COVER))
        edges = [_in_space(ON_SCREEN * np.concatenate([shape, shape[:1]]), "edge") for shape in (bone, cover)]
        send(f"{name}/edges", rr.LineStrips3D(edges, colors=[colours.EDGE, colours.COVER], radii=[THIN]))
    rows = 2 if drawing.has_bone else 1
    indices = np.concatenate([band(POINTS, first=2 * POINTS * pair) for pair in range(1 + rows)])
    paints = np.array([colours.CARTILAGE, colours.CARTILAGE, colours.BONE][: 1 + rows], dtype=np.uint8)
    send(OVERLAP, rr.Mesh3D.from_fields(triangle_indices=indices, vertex_colors=paints.repeat(2 * POINTS, axis=0)))


def send_still_marks(frame: Frame, send: Send) -> None:
    """Send the marks in front of the knee, as far as they do not change."""
    corner, length = np.array(frame.axes), frame.axis_length
    ends = np.array([[length, 0.0], [0.0, -length]])
    send("axes", rr.Arrows2D(origins=[corner, corner], vectors=ends, colors=[colours.TEXT], radii=[LINE]))
    send("axes/anterior", _text(corner + 1.1 * ends[0], "anterior"))
    send("axes/superior", _text(corner + ends[1] - [0.0, ABOVE_AXIS], "superior"))
    bar = np.array([frame.scale, frame.scale]) + np.array([[0.0, 0.0], [SCALE_BAR, 0.0]])
    send("scale", rr.LineStrips2D([bar], colors=[colours.TEXT], radii=[WIDE]))
    send("scale/name", _text(bar.mean(axis=0), f"{SCALE_BAR:g} mm"))
    send("tibia/name", _text(frame.tibia_name, "tibia", colours.INK))
    send(f"{MOVING_FEMUR}/name", _text(frame.femur_name, "femur", colours.INK))
    send(POINT, rr.Points2D.from_fields(radii=[POINT_SIZE], draw_order=ON_TOP))
    send(PATH, rr.Points2D.from_fields(colors=[colours.WAY], radii=[PATH_SIZE], draw_order=ABOVE))
    send(ARROW, rr.Arrows2D.from_fields(colors=[colours.FORCE], radii=[WIDE]))
    send(FORCE_NAME, rr.Points2D.from_fields(colors=[colours.INK], radii=[UNSEEN], show_labels=True))
    send(
        DEPTH,
        rr.Points2D.from_fields(positions=[frame.depth_name], colors=[colours.TEXT], radii=[UNSEEN], show_labels=True),
    )


class Pictures:
    """Selects the answers that are drawn: the first of every `PICTURE_PERIOD`."""

    def __init__(self) -> None:
        self._period = -1  # of the last picture

    def choose(self, stamps: NDArray[np.int64]) -> NDArray[np.intp]:
        """Return the indices of the answers that are drawn; `stamps` [ns] continue those of the previous call."""
        periods = stamps // PICTURE_PERIOD
        new = np.flatnonzero(np.diff(periods, prepend=self._period))
        self._period = int(periods[-1])
        return new


def send_moving_plane(drawing: KneeOutlines, answers: Rows, layer: float, send: Send) -> None:
    """Send poses and overlaps, of at least one picture; the second layer begins at the depth `layer` [m]."""
    send(MOVING_FEMUR, _pose(answers))
    send(OVERLAP, _overlap(drawing, answers, layer))


def send_moving_marks(drawing: KneeOutlines, answers: Rows, send: Send) -> None:
    """Send the marks in front of the knee, of at least one picture."""
    send(MOVING_FEMUR, _pose(answers))
    point = np.stack([answers["contact_point"]["x"], answers["contact_point"]["y"]], axis=1) * ON_SCREEN
    of_state = colours.OF_STATE[answers["contact_state"].astype(int)]
    send(POINT, rr.Points2D.columns(positions=point, colors=of_state))
    send(PATH, rr.Points2D.columns(positions=point))
    force = answers["contact_force"]
    arrow = force[:, None] / NEWTONS_PER_MM * np.stack([answers["normal_x"], -answers["normal_y"]], axis=1)
    send(ARROW, rr.Arrows2D.columns(origins=point, vectors=arrow))
    weights = force / drawing.body_weight
    labels = [f"{n:.0f} N\n{w:.2f} BW" if n else "0 N" for n, w in zip(force.tolist(), weights.tolist(), strict=True)]
    within = np.minimum(1.0, FORCE_WITHIN * extent_of(drawing) / np.maximum(np.hypot(*arrow.T), 1e-9))
    place = point + within[:, None] * arrow
    # Apart, the word stands on the tibia: there may be no bone above it.
    place[~(answers["gap"] > 0.0), 1] -= ABOVE_FORCE
    send(FORCE_NAME, rr.Points2D.columns(positions=place, labels=labels))
    depths, gaps = (MM * answers[name] for name in ("penetration_depth", "gap"))
    labels = [_depth_label(*pair) for pair in zip(depths.tolist(), gaps.tolist(), strict=True)]
    send(DEPTH, rr.Points2D.columns(labels=labels))


def _pose(answers: Rows) -> Any:
    """Return the poses of the femur as a column of transforms."""
    zero = np.zeros(len(answers))
    half = -0.5 * answers["flexion_angle"]  # the screen's y points down, so a turn changes its sign
    turn = np.stack([zero, zero, np.sin(half), np.cos(half)], axis=1)
    place = np.stack([MM * answers["femoral_x"], -MM * answers["femoral_height"], zero], axis=1)
    return rr.Transform3D.columns(translation=place, quaternion=turn)


def extent_of(drawing: KneeOutlines) -> float:
    """Return the extent of the femur from posterior to anterior [mm]."""
    return MM * float(np.ptp(drawing.femur[:, 0]))


def turned(femur: Floats, answers: Rows) -> Floats:
    """Return the femur's outlines, shape (n, m, 2) [m], tibia frame; flexion turns anterior to superior."""
    cosine, sine = np.cos(answers["flexion_angle"])[:, None], np.sin(answers["flexion_angle"])[:, None]
    x = answers["femoral_x"][:, None] + cosine * femur[:, 0] - sine * femur[:, 1]
    y = answers["femoral_height"][:, None] + sine * femur[:, 0] + cosine * femur[:, 1]
    return np.stack([x, y], axis=2)


def _overlap(drawing: KneeOutlines, answers: Rows, layer: float) -> Any:
    """Return the vertices of the overlap as it is, and of its layers with their depth magnified."""
    radius = 0.5 * extent_of(drawing) / MM
    middle, deepest = answers["contact_point"]["x"], answers["penetration_depth"]
    region = overlaps(turned(drawing.femur, answers), drawing.tibia, middle, deepest, radius)
    normal = np.stack([answers["normal_x"], answers["normal_y"]], axis=1)
    depth = (region.upper - region.lower) * normal[:, None, 1]
    rows = [np.stack([region.x, y], axis=2) for y in (region.upper, region.lower)]
    ends = [0.0 * depth, depth] if not drawing.has_bone else [
        0.0 * depth, np.minimum(depth, layer), np.minimum(depth, layer), depth
    ]  # fmt: skip
    rows += [rows[0] - MAGNIFICATION * end[..., None] * normal[:, None] for end in ends]
    corners = np.stack(rows, axis=1) * ON_SCREEN
    vertices = _in_space(corners.reshape(-1, 2), "overlap")
    return rr.Mesh3D.columns(vertex_positions=vertices).partition(np.full(len(answers), len(rows) * POINTS))


def _depth_label(depth: float, gap: float) -> str:
    """Return the text beside the overlap; depth and gap are in mm."""
    return f"{gap:.2f} mm apart" if depth <= 0.0 else f"{depth:.2f} mm deep\ndrawn × {MAGNIFICATION:g}"


def _filled(polygon: Floats, layer: str, colour: colours.Colour) -> rr.Mesh3D:
    """Make a filled polygon [m] in a layer."""
    vertices = _in_space(polygon * ON_SCREEN, layer)
    return rr.Mesh3D(vertex_positions=vertices, triangle_indices=triangles_of(polygon), albedo_factor=colour)


def _text(place: Any, text: str, colour: colours.Colour = colours.TEXT) -> rr.Points2D:
    """Make a word below a place on the screen, shape (2,) [mm]."""
    return rr.Points2D([place], labels=[text], colors=[colour], radii=[UNSEEN], show_labels=True)


def _in_space(points: Floats, layer: str) -> NDArray[np.float32]:
    """Return points of the screen, shape (n, 2) [mm], in space before the camera, shape (n, 3) [mm]."""
    distance = np.full((len(points), 1), DISTANCE - LAYER_DISTANCE * LAYERS.index(layer))
    return np.concatenate([points, distance], axis=1).astype(np.float32)
