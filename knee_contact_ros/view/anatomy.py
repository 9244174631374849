"""The knee as closed polygons in the sagittal plane: two bones with their cartilage, and where they overlap.

Everything is in metres; x is anterior, y superior. `anatomy_of` prepares a model once, `picture_of` gives the polygons
of a tick in the tibia frame. A polygon is an array of shape (n, 2) whose last point joins its first one.

What touches is the model's: the outer edges of the cartilage are the surfaces that the model was given, up to how
finely lines are drawn. All else is drawn around them: the shafts, the way they join the surfaces, and the cartilage's
thickness unless the contact law tells one (`Anatomy.thickness`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.core.model import KneeModel
from knee_contact_ros.view.overlap import overlaps

Floats = NDArray[np.float64]
DRAWN_THICKNESS = 2.2e-3
"""[m] of either cartilage where the law tells none: half the default of `contact.foundation_thickness`"""
SURFACE_POINTS = 121
"""Along a drawn surface"""
JOIN_POINTS = 24
"""From a surface's end to the shaft"""
TAPER = 0.12
"""Part of a surface, at either end, over which its cartilage thins out"""
UNCOVERED = math.radians(42.0)
"""To both sides of the shaft, what is cut out of a femur that is closed all around"""
SHAFT_BEGIN, SHAFT_WIDTH, SHAFT_RISE, SHAFT_LENGTH = 0.10, 0.50, 0.28, 1.05
"""Of the femoral shaft, in extents of the condyle from back to front: from the condyle's rear end to the shaft's rear,
its width, how far above the rear end it begins, and where it ends above the reference point"""
PLATEAU = 0.45
"""How far the plateau is drawn to both sides, in extents of the condyle; as far as it was measured at most"""
PLATEAU_MARGIN = 0.012
"""How far [m] it is drawn at least beyond where a walking knee touches it"""
TIBIA_WIDTH, TIBIA_DROP, TIBIA_DEPTH = 0.62, 0.34, 0.60
"""Of the tibial shaft, in widths of the plateau: its width, how far below the plateau it begins, and where it ends"""


class Anatomy(NamedTuple):
    """A knee's polygons before it moves, plain numbers."""

    femur_bone: Floats
    """Femur frame, about the reference point [m]"""
    femur_cartilage: Floats
    """Likewise; its first `SURFACE_POINTS` are the surface that touches, from posterior to anterior"""
    tibia_bone: Floats
    """Tibia frame [m]"""
    tibia_cartilage: Floats
    """Likewise, in the same order"""
    thickness: float
    """[m] of either cartilage but at its ends: half of what the law takes for both together, so that the bones touch
    where the law says so; or `DRAWN_THICKNESS`"""
    thickness_is_drawn: bool
    """Whether the law tells none, so that it is of the drawing alone"""


class Picture(NamedTuple):
    """A knee's polygons at a tick [m], tibia frame."""

    femur_bone: Floats
    femur_cartilage: Floats
    tibia_bone: Floats
    tibia_cartilage: Floats
    overlap: Floats
    """Where the outer edges of both cartilages overlap: along the tibia, and back along the femur; empty when apart"""
    contact_point: tuple[float, float]
    """[m] on the tibia"""
    normal: tuple[float, float]
    """Unit, from tibia to femur"""
    depth: float
    """[m] signed: < 0 apart"""
    anatomy: Anatomy
    """The same knee before it moves"""


def anatomy_of(model: KneeModel, contact_range: tuple[float, float] = (0.0, 0.0)) -> Anatomy:
    """The knee of a model; the plateau is drawn beyond where its contact lies (lowest and highest x [m])."""
    femur = even(_open(model.pair.femur.outline()))
    extent = float(np.ptp(femur[:, 0]))
    reach = max(PLATEAU * extent, PLATEAU_MARGIN + max(map(abs, contact_range)))
    tibia = even(model.pair.outline(reach))
    thickness, is_drawn = cartilage_of(model)
    return Anatomy(*_femur(femur, thickness, extent), *_tibia(tibia, thickness), thickness, is_drawn)


def cartilage_of(model: KneeModel) -> tuple[float, bool]:
    """Thickness [m] of either cartilage, and whether it is of the drawing alone: see `Anatomy.thickness`."""
    told = min(model.cartilage_thickness, model.modes.law.thickness)
    return (0.5 * told, False) if math.isfinite(told) else (DRAWN_THICKNESS, True)


def picture_of(model: KneeModel, flexion_angle: float, femoral_height: float) -> Picture:
    """Draw the polygons of a tick, from the flexion angle [rad] and the femoral height [m] of its answer."""
    knee = anatomy_of(model)
    x, _ = model.mechanism.translation(flexion_angle)
    pose = flexion_angle, x, femoral_height
    closest = model.pair.closest(*pose)
    point, normal = closest.point(x, femoral_height), (closest.normal_x, closest.normal_y)
    overlap = np.zeros((0, 2))
    if closest.depth > 0.0:
        femur, tibia = model.pair.femur.outline(), model.pair.outline(10.0 * model.femoral_radius)
        found = overlaps(
            placed(femur, *pose)[None], tibia, np.array(point[:1]), np.array([closest.depth]), model.femoral_radius
        )
        upper, lower = (np.stack([found.x[0], y[0]], axis=1) for y in (found.upper, found.lower))
        overlap = np.concatenate([upper, lower[::-1]])
    return Picture(
        placed(knee.femur_bone, *pose), placed(knee.femur_cartilage, *pose), knee.tibia_bone, knee.tibia_cartilage,
        overlap, point, normal, closest.depth, knee,
    )  # fmt: skip


def placed(points: Floats, angle: float, x: float, height: float) -> Floats:
    """Points of the femur, shape (n, 2) [m], in the tibia frame; flexion [rad] turns from anterior to superior."""
    cosine, sine = math.cos(angle), math.sin(angle)
    return np.asarray(points @ np.array([[cosine, sine], [-sine, cosine]]) + (x, height))


def even(points: Floats) -> Floats:
    """Resample a polyline, shape (m, 2), at `SURFACE_POINTS` points with equal distances along it."""
    distance = _distance(points)
    places = np.linspace(0.0, distance[-1], SURFACE_POINTS)
    return np.stack([np.interp(places, distance, axis) for axis in points.T], axis=1)


def _femur(surface: Floats, thickness: float, extent: float) -> tuple[Floats, Floats]:
    """Bone and cartilage of the femur; `surface` from posterior to anterior, `extent` [m] between these."""
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
    """Bone and cartilage of the tibia; `surface` from posterior to anterior."""
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
    """A femoral outline from posterior to anterior, without what the shaft covers where it is closed all around."""
    if np.allclose(points[0], points[-1]):
        middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
        turn = np.mod(-np.arctan2(*(points[:-1] - middle).T), math.tau)  # from superior over posterior
        order = np.argsort(turn)
        kept = (turn[order] > UNCOVERED) & (turn[order] < math.tau - UNCOVERED)
        return np.asarray(points[:-1][order][kept])
    return points if _turns_left(points) else points[::-1]


def _turns_left(points: Floats) -> bool:
    """Whether a line turns against the clock, as from posterior over inferior to anterior."""
    (x, y), (next_x, next_y) = points.T, np.roll(points, -1, axis=0).T
    return bool((x * next_y - next_x * y).sum() > 0.0)


def _distance(points: Floats) -> Floats:
    """Return the distance [m] along a polyline from its first point to each of its points, shape (n,)."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])


def _left(points: Floats) -> Floats:
    """Unit vectors to the left of a line, shape (n, 2)."""
    along = np.gradient(points, axis=0)
    return np.asarray(np.stack([-along[:, 1], along[:, 0]], axis=1) / np.hypot(*along.T)[:, None])


def _covered(surface: Floats, thickness: float) -> Floats:
    """Thickness [m] of the cartilage along a surface, shape (n, 1): it thins out towards both ends."""
    way = _distance(surface) / _distance(surface)[-1]
    part = np.clip(np.minimum(way, 1.0 - way) / TAPER, 0.0, 1.0)
    return np.asarray(thickness * np.sqrt(1.0 - (1.0 - part[:, None]) ** 2))


def _band(surface: Floats, inner: Floats) -> Floats:
    """The cartilage: there along the surface, and back along the bone."""
    return np.concatenate([surface, inner[-2:0:-1]])


def _join(begin: Floats, begin_along: Floats, end: Floats, end_along: Floats) -> Floats:
    """A smooth line between two points with directions of their own (Hermite), shape (JOIN_POINTS, 2)."""
    reach = float(np.hypot(*(end - begin)))
    first, last = (reach * along / np.hypot(*along) for along in (begin_along, end_along))
    t = np.linspace(0.0, 1.0, JOIN_POINTS)[:, None]
    return np.asarray(
        (2.0 * t**3 - 3.0 * t**2 + 1.0) * begin + (t**3 - 2.0 * t**2 + t) * first
        + (3.0 * t**2 - 2.0 * t**3) * end + (t**3 - t**2) * last
    )  # fmt: skip
