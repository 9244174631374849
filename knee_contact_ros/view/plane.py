"""The knee as entities of Rerun: bones, cartilage and overlap in the plane, marks in front of them, the leg in space.

Rerun fills triangles in space, but not polygons in a plane. So the knee is in space, upright in front of a camera whose
distance and focal length make a millimetre of the knee one on the screen. A plane's view through that camera can be
moved and magnified, but not rotated. Layers in front are slightly nearer to the camera. On the screen y points down, so
y is negated here.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from ..model.types import MM, Floats, Rows
from ..streams.topics import SHANK, THIGH
from . import colours, layout
from .anatomy import (
    MAGNIFICATION,
    NEWTONS_PER_MM,
    OVERLAP_POINTS,
    KneeOutlines,
    find_overlaps,
    signed_areas,
    to_tibia_frame,
)
from .colours import Colour
from .layout import SCALE_BAR

_ON_SCREEN = np.array([MM, -MM])
"""Factors from m in the tibia frame to mm on the screen"""
CAMERA_DISTANCE = 1000.0
"""Distance of the camera from the knee [mm]"""
_LAYER_DISTANCE = 0.2
"""Distance between two layers [mm]: too small to be seen as a change of size, large enough to hide what is behind"""
_LAYERS = ("tibia", "tibial cartilage", "femur", "femoral cartilage", "edge", "overlap")
"""Names of the layers, from back to front"""
_EDGE_WIDTH = -0.6
"""Half-width on the screen at any magnification, as the next four; Rerun takes them as negative numbers"""
_AXIS_WIDTH = -1.0
_ARROW_WIDTH = -2.2
_POINT_SIZE = -4.5
_PATH_SIZE = -1.4
_POINT_ORDER = 40.0
"""Draw order of the contact point; that of other points is 30"""
_PATH_ORDER = 35.0
_INVISIBLE = -0.01
"""Half-width of a point of which only the label is visible"""
_WORD_ABOVE_AXIS = 9.0
"""Distance [mm] from the tip of an arrow to its word of one line above"""
_WORD_ABOVE_FORCE = 13.0
"""Distance [mm] from the tip of the force's arrow to its word of two lines above"""
_WORD_BELOW_OVERLAP = 1.0
"""Distance [mm] from the overlap to the depth's word below it"""
_WORD_BELOW_POINT = 7.0
"""Distance [mm] from the contact point to the gap's word below it, past the force's word"""
_FORCE_WORD_REACH = 0.8
"""Largest distance from the contact to the force's word, in extents of the femur: there is bone behind it"""
FEMUR_ENTITY = "femur"
POINT = "contact_point"
OVERLAP_ENTITY = "overlap"
ARROW = "contact_force_on_femur"
FORCE_WORD = "contact_force"
DEPTH_WORD = "depth"
_LEG_SCALE = 1e-4
"""Length of the force's arrow in space by the force [m/N]"""
Triangles = NDArray[np.uint32]
"""Triangles as indices of their corners, shape (m, 3)"""


def still_plane(drawing: KneeOutlines) -> Iterator[tuple[str, Any]]:
    """Yield paths and data of the polygons, and of the parts of the overlap that do not change."""
    knee = drawing.anatomy
    for name, layer, bone, cartilage, colour in (
        ("tibia", "tibial cartilage", knee.tibia_bone, knee.tibia_cartilage, colours.TIBIA),
        (FEMUR_ENTITY, "femoral cartilage", knee.femur_bone, knee.femur_cartilage, colours.FEMUR),
    ):
        yield f"{name}/bone", _filled(bone, name, colour)
        yield f"{name}/cartilage", _filled(cartilage, layer, colours.COVER)
        edges = [
            _in_space(_ON_SCREEN * np.concatenate([shape, shape[:1]]), "edge")
            for shape in (bone, cartilage)
        ]
        tints = [colours.EDGE, colours.COVER]
        yield f"{name}/edges", rr.LineStrips3D(edges, colors=tints, radii=[_EDGE_WIDTH])
    paints = [colours.CARTILAGE, colours.CARTILAGE]
    if drawing.has_bone:
        paints.append(colours.BONE)
    # A layer of the overlap is a band of triangles between two rows of points, which follow each other.
    begins = np.arange(OVERLAP_POINTS - 1)[:, None]
    upper = begins + np.array([0, 1, OVERLAP_POINTS])
    lower = begins + np.array([OVERLAP_POINTS, 1, OVERLAP_POINTS + 1])
    band = np.concatenate([upper, lower])
    layers = [band + 2 * OVERLAP_POINTS * number for number in range(len(paints))]
    indices = np.concatenate(layers).astype(np.uint32)
    vertex_colours = np.array(paints, dtype=np.uint8).repeat(2 * OVERLAP_POINTS, axis=0)
    yield (
        OVERLAP_ENTITY,
        rr.Mesh3D.from_fields(triangle_indices=indices, vertex_colors=vertex_colours),
    )


def _filled(polygon: Floats, layer: str, colour: Colour) -> rr.Mesh3D:
    """Make a filled polygon [m], shape (n, 2), of a colour in a layer."""
    return rr.Mesh3D(
        vertex_positions=_in_space(polygon * _ON_SCREEN, layer),
        triangle_indices=triangles_of(polygon),
        albedo_factor=colour,
    )


def _word(place: Any, text: str, colour: Colour = colours.LIGHT_TEXT) -> rr.Points2D:
    """Make a word below a place on the screen [mm]."""
    return rr.Points2D(
        [place], labels=[text], colors=[colour], radii=[_INVISIBLE], show_labels=True
    )


def still_marks(drawing: KneeOutlines) -> Iterator[tuple[str, Any]]:
    """Yield paths and data of the marks in front of the knee, as far as they do not change."""
    frame = layout.frame_of(drawing)
    corner = np.array(frame.axes)
    ends = np.array([[frame.axis_length, 0.0], [0.0, -frame.axis_length]])
    white = [colours.LIGHT_TEXT]
    yield (
        "axes",
        rr.Arrows2D(origins=[corner] * 2, vectors=ends, colors=white, radii=[_AXIS_WIDTH]),
    )
    yield "axes/anterior", _word(corner + 1.1 * ends[0], "anterior")
    yield "axes/superior", _word(corner + ends[1] - [0.0, _WORD_ABOVE_AXIS], "superior")
    bar = np.array([frame.scale, frame.scale]) + np.array([[0.0, 0.0], [SCALE_BAR, 0.0]])
    yield "scale", rr.LineStrips2D([bar], colors=white, radii=[_ARROW_WIDTH])
    yield "scale/name", _word(bar.mean(axis=0), f"{SCALE_BAR:g} mm")
    yield "tibia/name", _word(frame.tibia_name, "tibia", colours.INK)
    yield f"{FEMUR_ENTITY}/name", _word(frame.femur_name, "femur", colours.INK)
    yield POINT, rr.Points2D.from_fields(radii=[_POINT_SIZE], draw_order=_POINT_ORDER)
    path = rr.Points2D.from_fields(
        colors=[colours.CONTACT_PATH], radii=[_PATH_SIZE], draw_order=_PATH_ORDER
    )
    yield layout.CONTACT_PATH_ENTITY, path
    yield ARROW, rr.Arrows2D.from_fields(colors=[colours.FORCE], radii=[_ARROW_WIDTH])
    ink = rr.Points2D.from_fields(colors=[colours.INK], radii=[_INVISIBLE], show_labels=True)
    yield FORCE_WORD, ink
    yield DEPTH_WORD, ink


def moving_plane(drawing: KneeOutlines, answers: Rows, layer: float) -> Iterator[tuple[str, Any]]:
    """Yield paths and columns of poses and overlaps, at least one; the second layer begins at the depth `layer` [m]."""
    yield FEMUR_ENTITY, _pose(answers)
    femur = to_tibia_frame(
        drawing.femur, answers["flexion_angle"], answers["femoral_x"], answers["femoral_height"]
    )
    rows = [*find_overlaps(femur, drawing.tibia, answers["contact_point"]["x"])]
    normal = np.stack([answers["normal_x"], answers["normal_y"]], axis=1)
    depth = (rows[0] - rows[1])[..., 1] * normal[:, None, 1]
    # The overlap as it is, and its layers with their depth magnified; each along the tibia and along the femur.
    edges = [0.0 * depth, depth]
    if drawing.has_bone:
        bone_begins = np.minimum(depth, layer)
        edges[1:1] = [bone_begins, bone_begins]
    rows += [rows[0] - MAGNIFICATION * edge[..., None] * normal[:, None] for edge in edges]
    vertices = _in_space((np.stack(rows, axis=1) * _ON_SCREEN).reshape(-1, 2), "overlap")
    lengths = np.full(len(answers), len(rows) * OVERLAP_POINTS)
    yield OVERLAP_ENTITY, rr.Mesh3D.columns(vertex_positions=vertices).partition(lengths)


def moving_marks(drawing: KneeOutlines, answers: Rows) -> Iterator[tuple[str, Any]]:
    """Yield paths and columns of the marks in front of the knee, of at least one picture."""
    yield FEMUR_ENTITY, _pose(answers)
    contact = answers["contact_point"]
    point = np.stack([contact["x"], contact["y"]], axis=1) * _ON_SCREEN
    tints = colours.STATE_COLOURS[answers["contact_state"].astype(int)]
    yield POINT, rr.Points2D.columns(positions=point, colors=tints)
    yield layout.CONTACT_PATH_ENTITY, rr.Points2D.columns(positions=point)
    force = answers["contact_force"]
    normal = np.stack([answers["normal_x"], -answers["normal_y"]], axis=1)
    arrow = force[:, None] / NEWTONS_PER_MM * normal
    yield ARROW, rr.Arrows2D.columns(origins=point, vectors=arrow)
    weight = drawing.body_weight
    labels = [
        f"{newtons:.0f} N\n{newtons / weight:.2f} BW" if newtons else "0 N"
        for newtons in force.tolist()
    ]
    farthest = _FORCE_WORD_REACH * MM * float(np.ptp(drawing.femur[:, 0]))
    lengths = np.maximum(np.hypot(*arrow.T), 1e-9)
    place = point + np.minimum(1.0, farthest / lengths)[:, None] * arrow
    # Apart, the word stands on the tibia: there may be no bone above it.
    place[~(answers["gap"] > 0.0), 1] -= _WORD_ABOVE_FORCE
    yield FORCE_WORD, rr.Points2D.columns(positions=place, labels=labels)
    depths = MM * answers["penetration_depth"]
    gaps = MM * answers["gap"]
    below = point.copy()
    below_overlap = MAGNIFICATION * depths + _WORD_BELOW_OVERLAP
    below[:, 1] += np.where(depths > 0.0, below_overlap, _WORD_BELOW_POINT)
    magnified = f"mm deep\ndrawn × {MAGNIFICATION:g}"
    labels = [
        f"{depth:.2f} {magnified}" if depth > 0.0 else f"{gap:.2f} mm apart"
        for depth, gap in zip(depths.tolist(), gaps.tolist(), strict=True)
    ]
    yield DEPTH_WORD, rr.Points2D.columns(positions=below, labels=labels)


def moving_leg(drawing: KneeOutlines, answers: Rows) -> Iterator[tuple[str, Any]]:
    """Yield paths and columns of the leg in space [m], tibia frame: where the thigh is, and the force on the femur."""
    zero = np.zeros(len(answers))
    half = 0.5 * answers["flexion_angle"]
    thigh = rr.Transform3D.columns(
        translation=np.stack([answers["femoral_x"], answers["femoral_height"], zero], axis=1),
        quaternion=np.stack([zero, zero, np.sin(half), np.cos(half)], axis=1),
        parent_frame=[f"{drawing.knee}/{SHANK}"] * len(answers),
        child_frame=[f"{drawing.knee}/{THIGH}"] * len(answers),
    )
    yield "thigh", thigh
    point = np.stack([answers["contact_point"][axis] for axis in "xyz"], axis=1)
    normal = np.stack([answers["normal_x"], answers["normal_y"], zero], axis=1)
    arrow = _LEG_SCALE * answers["contact_force"][:, None] * normal
    yield ARROW, rr.Arrows3D.columns(origins=point, vectors=arrow)


def _pose(answers: Rows) -> Any:
    """Return the poses of the femur as a column of transforms."""
    zero = np.zeros(len(answers))
    # The screen's y points down, so a turn changes its sign.
    half = -0.5 * answers["flexion_angle"]
    turn = np.stack([zero, zero, np.sin(half), np.cos(half)], axis=1)
    place = np.stack([MM * answers["femoral_x"], -MM * answers["femoral_height"], zero], axis=1)
    return rr.Transform3D.columns(translation=place, quaternion=turn)


def _in_space(points: Floats, layer: str) -> NDArray[np.float32]:
    """Return points of the screen, shape (n, 2) [mm], in space before the camera, shape (n, 3) [mm]."""
    distance = np.full((len(points), 1), CAMERA_DISTANCE - _LAYER_DISTANCE * _LAYERS.index(layer))
    return np.concatenate([points, distance], axis=1).astype(np.float32)


def triangles_of(polygon: Floats) -> Triangles:
    """Triangulate a simple polygon, shape (n, 2), of either orientation, by cutting off ears: n - 2 triangles.

    Ears that are not next to each other are cut off together.
    """
    counterclockwise = signed_areas(polygon).sum() > 0.0
    left = np.arange(len(polygon))[:: 1 if counterclockwise else -1]
    triangles = []
    while len(left) > 3:
        corners = np.stack([np.roll(left, 1), left, np.roll(left, -1)])
        a, b, c = polygon[corners][:, :, None]
        others = polygon[left]
        inside = (
            (_turn(a, b, others) >= 0.0)
            & (_turn(b, c, others) >= 0.0)
            & (_turn(c, a, others) >= 0.0)
        )
        # An ear turns to the left, and only its own three corners are inside.
        ears = (_turn(a, b, c)[:, 0] > 0.0) & (inside.sum(axis=1) == 3)
        # A simple polygon has an ear; where rounding hides all of them, argmax takes the first corner.
        first = int(ears.argmax())
        others_cut = first + 2 + np.flatnonzero(ears[first + 2 : -1 : 2]) * 2
        cut = [first, *others_cut][: len(left) - 3]
        triangles += [*corners[:, cut].T]
        left = np.delete(left, cut)
    return np.array([*triangles, left], dtype=np.uint32)


def _turn(a: Floats, b: Floats, c: Floats) -> Floats:
    """Return twice the area of triangles, positive if their corners go counterclockwise."""
    x, y = np.moveaxis(b - a, -1, 0)
    other_x, other_y = np.moveaxis(c - a, -1, 0)
    return np.asarray(x * other_y - y * other_x)
