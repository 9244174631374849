"""The knee as closed polygons in the sagittal plane: two bones with their cartilage, and where they overlap.

All lengths are in metres; x is anterior, y superior. `anatomy_of` gives the polygons of a model before it moves,
`picture_of` those of a tick in the tibia frame. A polygon is an array of shape (n, 2) whose last point joins its first.

The outer edges of the cartilage, which touch, are the surfaces of the model, up to the resolution of the drawn lines.
All else is made up for the drawing: the shafts, their joins to the surfaces, and the cartilage's thickness unless the
contact law gives one (`Anatomy.thickness`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.model.knee import KneeModel
from knee_contact_ros.view.overlap import overlaps

Floats = NDArray[np.float64]
DRAWN_THICKNESS = 2.2e-3
"""Thickness [m] of each cartilage where the law gives none: half the default of `contact.foundation_thickness`"""
SURFACE_POINTS = 121
"""Number of points along a drawn surface"""
JOIN_POINTS = 24
"""Number of points from the end of a surface to the shaft"""
TAPER = 0.12
"""Part of a surface, at each end, over which its cartilage thins out"""
UNCOVERED = math.radians(42.0)
"""Angle [rad] to each side of the shaft that is cut out of a closed femoral outline"""
SHAFT_BEGIN, SHAFT_WIDTH, SHAFT_RISE, SHAFT_LENGTH = 0.10, 0.50, 0.28, 1.05
"""Dimensions of the femoral shaft, in extents of the condyle from posterior to anterior: distance from the condyle's
posterior end to the shaft, width, height of the shaft's beginning above that end, and of its end above the reference
point"""
PLATEAU = 0.45
"""Half the length of the drawn plateau, in extents of the condyle; at most what was measured of it"""
PLATEAU_MARGIN = 0.012
"""Least distance [m] that the plateau is drawn beyond the contact of a walking knee"""
TIBIA_WIDTH, TIBIA_DROP, TIBIA_DEPTH = 0.62, 0.34, 0.60
"""Dimensions of the tibial shaft, in widths of the plateau: width, and depth of its beginning and end below it"""


class Anatomy(NamedTuple):
    """Polygons of a knee before it moves."""

    femur_bone: Floats
    """Femoral bone [m], femur frame, about the reference point"""
    femur_cartilage: Floats
    """Femoral cartilage [m], femur frame; its first `SURFACE_POINTS` are the surface, from posterior to anterior"""
    tibia_bone: Floats
    """Tibial bone [m], tibia frame"""
    tibia_cartilage: Floats
    """Tibial cartilage [m], tibia frame; its first `SURFACE_POINTS` are the surface, from posterior to anterior"""
    thickness: float
    """Thickness [m] of each cartilage except at its ends: half of the law's thickness of both together, so that the
    bones touch where the law says so; or `DRAWN_THICKNESS`"""
    thickness_is_drawn: bool
    """Whether the law gives no thickness, so that it is one of the drawing only"""


class Picture(NamedTuple):
    """Polygons of a knee at a tick [m], tibia frame."""

    femur_bone: Floats
    femur_cartilage: Floats
    tibia_bone: Floats
    tibia_cartilage: Floats
    overlap: Floats
    """Overlap of both cartilages: along the tibia, and back along the femur; empty when apart"""
    contact_point: tuple[float, float]
    """Contact point [m] on the tibia"""
    normal: tuple[float, float]
    """Unit normal from tibia to femur"""
    depth: float
    """Depth of the overlap [m]; negative when apart"""
    anatomy: Anatomy
    """Polygons of the same knee before it moves"""


def anatomy_of(model: KneeModel, contact_range: tuple[float, float] = (0.0, 0.0)) -> Anatomy:
    """Make the polygons of a model; `contact_range` are the lowest and highest x [m] of the contact on the plateau."""
    femur = even(_open(model.pair.femur.outline()))
    extent = float(np.ptp(femur[:, 0]))
    reach = max(PLATEAU * extent, PLATEAU_MARGIN + max(map(abs, contact_range)))
    tibia = even(model.pair.outline(reach))
    thickness, is_drawn = cartilage_of(model)
    return Anatomy(*_femur(femur, thickness, extent), *_tibia(tibia, thickness), thickness, is_drawn)


def cartilage_of(model: KneeModel) -> tuple[float, bool]:
    """Return the fields `thickness` and `thickness_is_drawn` of `Anatomy`."""
    thickness = min(model.cartilage_thickness, model.law.thickness)
    return (0.5 * thickness, False) if math.isfinite(thickness) else (DRAWN_THICKNESS, True)


def picture_of(model: KneeModel, flexion_angle: float, femoral_height: float) -> Picture:
    """Make the polygons of a tick, from the flexion angle [rad] and the femoral height [m] of its answer."""
    knee = anatomy_of(model)
    x, _ = model.pair.mechanism.translation(flexion_angle)
    pose = flexion_angle, x, femoral_height
    closest = model.closest(flexion_angle, femoral_height)
    point, normal = closest.point(x, femoral_height), (closest.normal_x, closest.normal_y)
    overlap = np.zeros((0, 2))
    if closest.depth > 0.0:
        femur, tibia = model.pair.femur.outline(), model.pair.outline(10.0 * model.femoral_radius)
        region = overlaps(
            placed(femur, *pose)[None], tibia, np.array(point[:1]), np.array([closest.depth]), model.femoral_radius
        )
        upper, lower = (np.stack([region.x[0], y[0]], axis=1) for y in (region.upper, region.lower))
        overlap = np.concatenate([upper, lower[::-1]])
    return Picture(
        placed(knee.femur_bone, *pose), placed(knee.femur_cartilage, *pose), knee.tibia_bone, knee.tibia_cartilage,
        overlap, point, normal, closest.depth, knee,
    )  # fmt: skip


def placed(points: Floats, angle: float, x: float, height: float) -> Floats:
    """Transform points of the femur, shape (n, 2) [m], to the tibia frame; flexion [rad] turns anterior to superior."""
    cosine, sine = math.cos(angle), math.sin(angle)
    return np.asarray(points @ np.array([[cosine, sine], [-sine, cosine]]) + (x, height))


def even(points: Floats) -> Floats:
    """Resample a polyline, shape (m, 2), at `SURFACE_POINTS` points with equal distances along it."""
    distance = _distance(points)
    places = np.linspace(0.0, distance[-1], SURFACE_POINTS)
    return np.stack([np.interp(places, distance, axis) for axis in points.T], axis=1)


def _femur(surface: Floats, thickness: float, extent: float) -> tuple[Floats, Floats]:
    """Make bone and cartilage of the femur; `surface` goes from posterior to anterior over `extent` [m]."""
    inner = surface + _covered(surface, thickness) * _left(surface)
    rear, front = surface[0], surface[-1]
    begin = max(rear[1], front[1]) + SHAFT_RISE * extent
    posterior = np.array([surface[:, 0].min() + SHAFT_BEGIN * extent, begin])
    posterior[0] = max(posterior[0], rear[0] + SHAFT_BEGIN * extent)
    anterior = posterior + np.array([SHAFT_WIDTH * extent, 0.0])
    top = max(SHAFT_LENGTH * extent, begin)
    ends = np.array([[anterior[0], top], [posterior[0], top]])
    up = np.array([0.0, 1.0])
    before = _join(posterior, -up, rear, surface[1] - rear)
    behind = _join(front, front - surface[-2], anterior, up)
    return np.concatenate([inner, behind[1:], ends, before[:-1]]), _band(surface, inner)


def _tibia(surface: Floats, thickness: float) -> tuple[Floats, Floats]:
    """Make bone and cartilage of the tibia; `surface` goes from posterior to anterior."""
    inner = surface - _covered(surface, thickness) * _left(surface)
    rear, front = surface[0], surface[-1]
    width = float(front[0] - rear[0])
    middle, begin = 0.5 * (rear[0] + front[0]), min(rear[1], front[1]) - TIBIA_DROP * width
    anterior, posterior = (np.array([middle + side * 0.5 * TIBIA_WIDTH * width, begin]) for side in (1.0, -1.0))
    bottom = min(rear[1], front[1]) - TIBIA_DEPTH * width
    down = np.array([0.0, -1.0])
    behind = _join(front, 0.4 * (front - surface[-2]) / np.hypot(*(front - surface[-2])) + down, anterior, down)
    before = _join(posterior, -down, rear, 0.4 * (surface[1] - rear) / np.hypot(*(surface[1] - rear)) - down)
    ends = np.array([[anterior[0], bottom], [posterior[0], bottom]])
    return np.concatenate([inner, behind[1:], ends, before[:-1]]), _band(surface, inner)


def _open(points: Floats) -> Floats:
    """Return a femoral outline from posterior to anterior; a closed one without the part that the shaft covers."""
    if np.allclose(points[0], points[-1]):
        middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
        turn = np.mod(-np.arctan2(*(points[:-1] - middle).T), math.tau)  # from superior over posterior
        order = np.argsort(turn)
        kept = (turn[order] > UNCOVERED) & (turn[order] < math.tau - UNCOVERED)
        return np.asarray(points[:-1][order][kept])
    return points if _turns_left(points) else points[::-1]


def _turns_left(points: Floats) -> bool:
    """Return whether a line turns counterclockwise, as from posterior over inferior to anterior."""
    (x, y), (next_x, next_y) = points.T, np.roll(points, -1, axis=0).T
    return bool((x * next_y - next_x * y).sum() > 0.0)


def _distance(points: Floats) -> Floats:
    """Return the distance [m] along a polyline from its first point to each of its points, shape (n,)."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])


def _left(points: Floats) -> Floats:
    """Return unit vectors to the left of a line at its points, shape (n, 2)."""
    along = np.gradient(points, axis=0)
    return np.asarray(np.stack([-along[:, 1], along[:, 0]], axis=1) / np.hypot(*along.T)[:, None])


def _covered(surface: Floats, thickness: float) -> Floats:
    """Return the thickness [m] of the cartilage along a surface, shape (n, 1): it thins out towards both ends."""
    place = _distance(surface) / _distance(surface)[-1]
    part = np.clip(np.minimum(place, 1.0 - place) / TAPER, 0.0, 1.0)
    return np.asarray(thickness * np.sqrt(1.0 - (1.0 - part[:, None]) ** 2))


def _band(surface: Floats, inner: Floats) -> Floats:
    """Make the polygon of the cartilage: along the surface, and back along the bone."""
    return np.concatenate([surface, inner[-2:0:-1]])


def _join(begin: Floats, begin_along: Floats, end: Floats, end_along: Floats) -> Floats:
    """Join two points with given directions by a smooth line (cubic Hermite), shape (JOIN_POINTS, 2)."""
    reach = float(np.hypot(*(end - begin)))
    first, last = (reach * along / np.hypot(*along) for along in (begin_along, end_along))
    t = np.linspace(0.0, 1.0, JOIN_POINTS)[:, None]
    return np.asarray(
        (2.0 * t**3 - 3.0 * t**2 + 1.0) * begin + (t**3 - 2.0 * t**2 + t) * first
        + (3.0 * t**2 - 2.0 * t**3) * end + (t**3 - t**2) * last
    )  # fmt: skip
