"""The knee as closed polygons in the sagittal plane: two bones with their cartilage, and where they overlap.

All lengths are in metres; x is anterior, y superior. A polygon is an array of shape (n, 2) whose last point joins its
first. `drawing_of` gives what a viewer's process needs of a model, `picture_of` the polygons of a tick.

The outer edges of the cartilage, which touch, are the surfaces of the model, up to the resolution of the drawn lines.
All else is made up for the drawing: the shafts, their joins to the surfaces, and the cartilage's thickness unless the
contact law gives one (`Anatomy.thickness`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.model.knee import KneeModel
from knee_contact_ros.model.laws import ContactLaw
from knee_contact_ros.model.readouts import ContactPatch
from knee_contact_ros.streams.topics import LATERAL, MEDIAL, compartment_name

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
PLATEAU_REACH = 0.04
"""Half the length [m] of the tibial surface that overlaps and markers are made of"""
NEWTONS_PER_MM = 50.0
"""Scale of the force arrow [N/mm]"""
WALKING = np.radians(np.arange(0.0, 81.0, 5.0))
"""Flexion angles [rad] of a walking knee at which its contact is looked for"""
SHALLOW = 1e-6
"""Depth [m] in the first layer of every law"""
STILL = 1e-5
"""Movement [m] of the contact point below which it counts as standing still"""
POINTS = 13
"""Number of points along an overlap"""
SAMPLES = 33
"""Number of points at which the outlines are compared to find the ends of the overlap"""
MARGIN = 2.0
"""Width of the range that is searched first, in widths of the overlap of a circle and a plane"""
WIDENINGS = 4
"""Most doublings of that range: surfaces that are nearly congruent overlap over a greater length"""


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


class KneeOutlines(NamedTuple):
    """Parts of a knee's scene that do not change, as numbers: the process of a viewer needs no model."""

    knee: str
    """Name of the knee or the compartment"""
    femur: Floats
    """Points of the femoral surface, shape (n, 2) [m], femur frame"""
    tibia: Floats
    """Points of the tibial surface under the femur, shape (n, 2) [m], tibia frame"""
    second_layer: float
    """Penetration depth [m] at which the second layer begins; infinite or NaN if there is none"""
    contact_range: tuple[float, float]
    """Lowest and highest x [m] of the contact of a walking knee"""
    body_weight: float
    """Body weight [N], the unit of the forces shown"""
    anatomy: Anatomy
    """Polygons of bones and cartilage"""
    law: ContactLaw
    """Contact law, for pressure and patch"""
    patch: ContactPatch | None
    """Contact patch from which pressure is computed; None: not known"""
    height_prescribed: bool
    """Whether the femoral height drives the model, and not a load"""

    @property
    def has_bone(self) -> bool:
        """Whether the contact law has a second layer."""
        return math.isfinite(self.second_layer)

    @property
    def rings(self) -> bool:
        """Whether nothing damps the first layer of the contact law, so that force and depth ripple."""
        return self.law.force_at(SHALLOW, 0.0, impact_speed=1.0)[2] == 0.0

    @property
    def point_moves(self) -> bool:
        """Whether the contact of a walking knee moves along the plateau; that of a circle on a hinge does not."""
        low, high = self.contact_range
        return high - low > STILL


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


class Overlaps(NamedTuple):
    """Overlaps in `n` pictures, from posterior to anterior."""

    x: Floats
    """x [m], shape (n, POINTS)"""
    lower: Floats
    """y [m] on the femur, shape (n, POINTS); not above `upper`"""
    upper: Floats
    """y [m] on the tibia, shape (n, POINTS)"""


def drawings_of(models: Sequence[KneeModel], names: Sequence[str], body_weight: float) -> list[KneeOutlines]:
    """Make the outlines of the compartments of a knee: with shafts and plateaus of the same size.

    Forces will be shown in units of `body_weight` [N].
    """
    ranges = []
    for model in models:
        touched = []
        for angle in WALKING.tolist():
            x, _ = model.pair.mechanism.translation(angle)
            height = model.pair.femur.support(angle)[0]
            touched.append(model.closest(angle, height).point(x, height)[0])
        ranges.append((min(touched), max(touched)))
    size = _size_of(models, ranges)
    return [
        KneeOutlines(
            name, model.pair.femur.outline(), model.pair.outline(PLATEAU_REACH), model.cartilage_thickness, reach,
            body_weight, anatomy_of(model, size), model.law, model.patch, model.height_prescribed,
        )
        for model, name, reach in zip(models, names, ranges, strict=True)
    ]  # fmt: skip


def compartments_of(knee: str, models: Sequence[KneeModel]) -> list[str]:
    """Return the names of a knee's compartments: medial and lateral, or the knee's own."""
    return [compartment_name(knee, of) for of in (MEDIAL, LATERAL)] if len(models) > 1 else [knee]


def drawing_of(model: KneeModel, knee: str, body_weight: float) -> KneeOutlines:
    """Make the outlines of a knee with one compartment; see `drawings_of`."""
    return drawings_of([model], [knee], body_weight)[0]


class Size(NamedTuple):
    """Dimensions that the compartments of a knee have in common."""

    rear: float
    """x [m] of the posterior end of the femoral surfaces, femur frame"""
    ends: float
    """Greatest height y [m] of the ends of the femoral surfaces, femur frame"""
    extent: float
    """Extent [m] of the femoral surfaces from posterior to anterior"""
    plateau: float
    """Half the length [m] of the drawn plateaus"""


def _size_of(models: Sequence[KneeModel], ranges: Sequence[tuple[float, float]] = ((0.0, 0.0),)) -> Size:
    """Return the dimensions of a drawing of compartments, from the ranges of their contact points."""
    femora = [_even(_open(model.pair.femur.outline())) for model in models]
    extent = float(np.ptp(np.concatenate(femora)[:, 0]))
    reach = max(PLATEAU * extent, PLATEAU_MARGIN + max(abs(end) for both in ranges for end in both))
    rear, ends = min(femur[0, 0] for femur in femora), max(femur[end, 1] for femur in femora for end in (0, -1))
    return Size(float(rear), float(ends), extent, reach)


def anatomy_of(model: KneeModel, size: Size | None = None) -> Anatomy:
    """Make the polygons of a model, of its own size if none is given."""
    size = size or _size_of([model])
    femur, tibia = _even(_open(model.pair.femur.outline())), _even(model.pair.outline(size.plateau))
    thickness, is_drawn = cartilage_of(model)
    return Anatomy(*_femur(femur, thickness, size), *_tibia(tibia, thickness), thickness, is_drawn)


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
    point = closest.point(x, femoral_height)
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
        overlap, point, (closest.normal_x, closest.normal_y), closest.depth, knee,
    )  # fmt: skip


def placed(points: Floats, angle: Any, x: Any, height: Any) -> Floats:
    """Transform points of the femur, shape (m, 2) [m], to the tibia frame; flexion turns anterior to superior.

    Angle [rad], x and height [m] are numbers, or arrays of shape (n,), which give points of shape (n, m, 2).
    """
    cosine, sine, x, height = (np.asarray(each)[..., None] for each in (np.cos(angle), np.sin(angle), x, height))
    (along, up) = points.T
    return np.stack([x + cosine * along - sine * up, height + sine * along + cosine * up], axis=-1)


def overlaps(femur: Floats, tibia: Floats, middle: Floats, depth: Floats, radius: float) -> Overlaps:
    """Find the overlap in `n` pictures, at least one; it has no width where the surfaces are apart.

    Args:
        femur: outline of the femur in every picture, shape (n, m, 2) [m], tibia frame.
        tibia: outline of the tibia, shape (k, 2) [m], x ascending.
        middle: x of the contact point [m], shape (n,).
        depth: penetration depth [m], shape (n,).
        radius: approximate radius of the femur [m].
    """
    half = MARGIN * np.sqrt(2.0 * radius * np.maximum(depth, 0.0))
    for _ in range(1 + WIDENINGS):
        x = middle[:, None] + half[:, None] * np.linspace(-1.0, 1.0, SAMPLES)
        deep = np.interp(x, *tibia.T) - lowest_at(femur, x)
        cut = (deep[:, [0, -1]] > 0.0).any(axis=1)
        if not cut.any():
            break
        half = np.where(cut, 2.0 * half, half)
    begin, end = _crossing(x, deep), _crossing(x[:, ::-1], deep[:, ::-1])
    x = begin[:, None] + (end - begin)[:, None] * np.linspace(0.0, 1.0, POINTS)
    upper = np.interp(x, *tibia.T)
    return Overlaps(x, np.minimum(lowest_at(femur, x), upper), upper)


def lowest_at(outlines: Floats, x: Floats) -> Floats:
    """Return the lowest y [m] of outlines, shape (n, m, 2) [m], at `x`, shape (n, s) [m]; infinite beyond them."""
    lowest = np.full(x.shape, np.inf)
    begin, end = outlines[:, :-1], outlines[:, 1:]
    left, right = np.minimum(begin[..., 0], end[..., 0]), np.maximum(begin[..., 0], end[..., 0])
    below = (begin[..., 1] < outlines[..., 1].mean(axis=1)[:, None]).any(axis=0)
    near = below & (left.min(axis=0) <= x.max()) & (right.max(axis=0) >= x.min())
    for segment in np.flatnonzero(near).tolist():
        (x0, y0), (x1, y1) = begin[:, segment, :, None].swapaxes(0, 1), end[:, segment, :, None].swapaxes(0, 1)
        width = x1 - x0
        part = (x - x0) / np.where(width == 0.0, 1.0, width)
        on_it = (part >= 0.0) & (part <= 1.0) & (width != 0.0)
        lowest = np.where(on_it, np.minimum(lowest, y0 + part * (y1 - y0)), lowest)
    return lowest


def _crossing(x: Floats, deep: Floats) -> Floats:
    """Return where the outlines first cross along `x` [m], shape (n,); the middle of `x` where they do not overlap."""
    rows, inside = np.arange(len(x)), deep > 0.0
    after = inside.argmax(axis=1)
    before = np.maximum(after - 1, 0)
    over, under = np.maximum(-deep[rows, before], 0.0), np.maximum(deep[rows, after], 0.0)
    part = np.where(np.isfinite(over) & (under > 0.0), under / np.where(under > 0.0, over + under, 1.0), 0.0)
    crossing = x[rows, after] + part * (x[rows, before] - x[rows, after])
    return np.asarray(np.where(inside.any(axis=1), crossing, x.mean(axis=1)))


def _femur(surface: Floats, thickness: float, size: Size) -> tuple[Floats, Floats]:
    """Make bone and cartilage of the femur; `surface` goes from posterior to anterior."""
    inner = surface + _covered(surface, thickness) * _left(surface)
    rear, front, extent = surface[0], surface[-1], size.extent
    begin = size.ends + SHAFT_RISE * extent
    posterior = np.array([size.rear + SHAFT_BEGIN * extent, begin])
    anterior = posterior + np.array([SHAFT_WIDTH * extent, 0.0])
    up, top = np.array([0.0, 1.0]), max(SHAFT_LENGTH * extent, begin)
    posterior_join = _join(posterior, -up, rear, surface[1] - rear)
    anterior_join = _join(front, front - surface[-2], anterior, up)
    return _bone(inner, anterior_join, (anterior[0], posterior[0]), top, posterior_join), _band(surface, inner)


def _tibia(surface: Floats, thickness: float) -> tuple[Floats, Floats]:
    """Make bone and cartilage of the tibia; `surface` goes from posterior to anterior."""
    inner = surface - _covered(surface, thickness) * _left(surface)
    rear, front = surface[0], surface[-1]
    width, edge = float(front[0] - rear[0]), min(rear[1], front[1])
    middle, begin = 0.5 * (rear[0] + front[0]), edge - TIBIA_DROP * width
    anterior, posterior = (np.array([middle + side * 0.5 * TIBIA_WIDTH * width, begin]) for side in (1.0, -1.0))
    down, first, last = np.array([0.0, -1.0]), surface[1] - rear, front - surface[-2]
    anterior_join = _join(front, 0.4 * last / np.hypot(*last) + down, anterior, down)
    posterior_join = _join(posterior, -down, rear, 0.4 * first / np.hypot(*first) - down)
    bone = _bone(inner, anterior_join, (anterior[0], posterior[0]), edge - TIBIA_DEPTH * width, posterior_join)
    return bone, _band(surface, inner)


def _bone(
    inner: Floats, anterior_join: Floats, shaft: tuple[float, float], end: float, posterior_join: Floats
) -> Floats:
    """Make the polygon of a bone: under the cartilage, along a join to the shaft, across its end, and back."""
    return np.concatenate([inner, anterior_join[1:], [[x, end] for x in shaft], posterior_join[:-1]])


def _band(surface: Floats, inner: Floats) -> Floats:
    """Make the polygon of the cartilage: along the surface, and back along the bone."""
    return np.concatenate([surface, inner[-2:0:-1]])


def _open(points: Floats) -> Floats:
    """Return a femoral outline from posterior to anterior; a closed one without the part that the shaft covers."""
    if np.allclose(points[0], points[-1]):
        middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
        turn = np.mod(-np.arctan2(*(points[:-1] - middle).T), math.tau)  # from superior over posterior
        order = np.argsort(turn)
        kept = (turn[order] > UNCOVERED) & (turn[order] < math.tau - UNCOVERED)
        return np.asarray(points[:-1][order][kept])
    (x, y), (next_x, next_y) = points.T, np.roll(points, -1, axis=0).T
    counterclockwise = (x * next_y - next_x * y).sum() > 0.0  # as from posterior over inferior to anterior
    return points if counterclockwise else points[::-1]


def _even(points: Floats) -> Floats:
    """Resample a polyline, shape (m, 2), at `SURFACE_POINTS` points with equal distances along it."""
    distance = _distance(points)
    at = np.linspace(0.0, distance[-1], SURFACE_POINTS)
    return np.stack([np.interp(at, distance, axis) for axis in points.T], axis=1)


def _distance(points: Floats) -> Floats:
    """Return the distance [m] along a polyline from its first point to each of its points, shape (n,)."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])


def _left(points: Floats) -> Floats:
    """Return unit vectors to the left of a line at its points, shape (n, 2)."""
    along = np.gradient(points, axis=0)
    return np.asarray(np.stack([-along[:, 1], along[:, 0]], axis=1) / np.hypot(*along.T)[:, None])


def _covered(surface: Floats, thickness: float) -> Floats:
    """Return the thickness [m] of the cartilage along a surface, shape (n, 1): it thins out towards both ends."""
    along = _distance(surface) / _distance(surface)[-1]
    part = np.clip(np.minimum(along, 1.0 - along) / TAPER, 0.0, 1.0)
    return np.asarray(thickness * np.sqrt(1.0 - (1.0 - part[:, None]) ** 2))


def _join(begin: Floats, begin_along: Floats, end: Floats, end_along: Floats) -> Floats:
    """Join two points with given directions by a smooth line (cubic Hermite), shape (JOIN_POINTS, 2)."""
    reach = float(np.hypot(*(end - begin)))
    first, last = (reach * along / np.hypot(*along) for along in (begin_along, end_along))
    t = np.linspace(0.0, 1.0, JOIN_POINTS)[:, None]
    return np.asarray(
        (2.0 * t**3 - 3.0 * t**2 + 1.0) * begin + (t**3 - 2.0 * t**2 + t) * first
        + (3.0 * t**2 - 2.0 * t**3) * end + (t**3 - t**2) * last
    )  # fmt: skip
