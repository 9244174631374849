"""The knee as closed polygons in the sagittal plane: two bones with their cartilage, and where they overlap.

All lengths are in metres; x is anterior, y superior. A polygon is an array of shape (n, 2) whose last point joins its
first. `outlines_of` gives what a viewer's process needs of a model, `picture_of` the polygons of a tick.

The outer edges of the cartilage, which touch, are the surfaces of the model, up to the resolution of the drawn lines.
Everything else is only drawn: the shafts, their joins to the surfaces, and the cartilage's thickness unless the contact
law gives one (`Anatomy.thickness`).
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from ..model.closest import contact_point
from ..model.knee import KneeModel
from ..model.laws import ContactLaw
from ..model.readouts import ContactPatch
from ..model.types import Floats
from ..streams.topics import LATERAL, MEDIAL, compartment_name

DRAWN_THICKNESS = 2.2e-3
"""Thickness [m] of each cartilage where the law gives none: half the default of `contact.foundation_thickness`"""
MAGNIFICATION = 10.0
"""Factor by which the depth of a drawn overlap is magnified along the normal"""
SURFACE_POINTS = 121
"""Number of points along a drawn surface"""
JOIN_POINTS = 24
"""Number of points from the end of a surface to the shaft"""
TAPER = 0.12
"""Fraction of a surface, at each end, over which its cartilage thins out"""
SHAFT_ANGLE = math.radians(42.0)
"""Angle [rad] to each side of the shaft that is cut out of a closed femoral outline"""
SHAFT_BEGIN = 0.10
"""Distance from the condyle's posterior end to the femoral shaft, in extents of the condyle, as the next three"""
SHAFT_WIDTH = 0.50
SHAFT_RISE = 0.28
"""Height of the shaft's beginning above the ends of the surface"""
SHAFT_LENGTH = 1.05
"""Height of the shaft's end above the reference point"""
PLATEAU = 0.45
"""Half the length of the drawn plateau, in extents of the condyle; at most its measured length"""
PLATEAU_MARGIN = 0.012
"""Smallest distance [m] by which the plateau is drawn beyond the contact of a walking knee"""
TIBIA_WIDTH = 0.62
"""Width of the tibial shaft, in widths of the plateau, as the next two"""
TIBIA_DROP = 0.34
"""Depth of the shaft's beginning below the plateau"""
TIBIA_DEPTH = 0.60
"""Depth of the shaft's end below the plateau"""
TIBIA_LEAN = 2.5
"""The `lean` of the joins to the tibial shaft"""
PLATEAU_REACH = 0.04
"""Half the length [m] of the tibial surface for overlaps and markers"""
NEWTONS_PER_MM = 50.0
"""Scale of the force arrow [N/mm]"""
WALKING = np.radians(np.arange(0.0, 81.0, 5.0))
"""Flexion angles [rad] of a walking knee at which its contact is computed"""
SHALLOW_DEPTH = 1e-6
"""Depth [m] in the first layer of every law"""
MIN_MOVEMENT = 1e-5
"""Movement [m] of the contact point below which it counts as standing still"""
OVERLAP_POINTS = 13
"""Number of points along an overlap"""
OVERLAP_REACH = 0.03
"""Distance [m] to each side of the contact point within which the overlap lies"""
OVERLAP_SAMPLES = 97
"""Number of points that are compared there to find its ends"""


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
    """Whether the law gives no thickness, so that it is only drawn"""


class KneeOutlines(NamedTuple):
    """Constant parts of a knee's scene as numbers, so that a viewer's process needs no model."""

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
    """Contact patch from which pressure is computed; None: unknown"""
    height_prescribed: bool
    """Whether the femoral height drives the model instead of a load"""

    @property
    def has_bone(self) -> bool:
        """Whether the contact law has a second layer."""
        return math.isfinite(self.second_layer)

    @property
    def rings(self) -> bool:
        """Whether the first layer of the contact law has no damping, so that force and depth ripple."""
        return self.law.force_at(SHALLOW_DEPTH, 0.0, impact_speed=1.0)[2] == 0.0

    @property
    def point_moves(self) -> bool:
        """Whether the contact of a walking knee moves along the plateau; that of a circle on a hinge does not."""
        low, high = self.contact_range
        return high - low > MIN_MOVEMENT


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


def outlines_of_compartments(
    models: Sequence[KneeModel], names: Sequence[str], body_weight: float
) -> list[KneeOutlines]:
    """Make the outlines of the compartments of a knee: with shafts and plateaus of the same size.

    Forces will be shown in units of `body_weight` [N].
    """
    ranges = []
    for model in models:
        touched = []
        for angle in WALKING.tolist():
            x, _ = model.pair.mechanism.translation(angle)
            height = model.pair.femur.support(angle)[0]
            touched.append(contact_point(model.pair.closest(angle, height), x, height)[0])
        ranges.append((min(touched), max(touched)))
    anatomies = _anatomies(
        models, PLATEAU_MARGIN + max(abs(end) for both in ranges for end in both)
    )
    return [
        KneeOutlines(
            name,
            model.pair.femur.outline(),
            model.pair.tibia.outline(PLATEAU_REACH),
            model.cartilage_thickness,
            reach,
            body_weight,
            anatomy,
            model.law,
            model.patch,
            model.height_prescribed,
        )
        for model, name, reach, anatomy in zip(models, names, ranges, anatomies, strict=True)
    ]


def compartment_names(knee: str, models: Sequence[KneeModel]) -> list[str]:
    """Return the names of a knee's compartments: medial and lateral, or the knee's own."""
    return [compartment_name(knee, of) for of in (MEDIAL, LATERAL)] if len(models) > 1 else [knee]


def outlines_of(model: KneeModel, knee: str, body_weight: float) -> KneeOutlines:
    """Make the outlines of a knee with one compartment; see `outlines_of_compartments`."""
    return outlines_of_compartments([model], [knee], body_weight)[0]


def _anatomies(models: Sequence[KneeModel], least_plateau: float) -> list[Anatomy]:
    """Make the polygons of compartments, with plateaus of at least this half length [m]."""
    femora = [_even(_open(model.pair.femur.outline())) for model in models]
    extent = float(np.ptp(np.concatenate(femora)[:, 0]))
    shaft = min(float(femur[0, 0]) for femur in femora) + extent * np.array(
        [SHAFT_BEGIN, SHAFT_BEGIN + SHAFT_WIDTH]
    )
    begin = max(float(femur[end, 1]) for femur in femora for end in (0, -1)) + SHAFT_RISE * extent
    anatomies = []
    for model, femur in zip(models, femora, strict=True):
        both = min(model.cartilage_thickness, model.law.thickness)
        thickness = 0.5 * both if math.isfinite(both) else DRAWN_THICKNESS
        tibia = _even(model.pair.tibia.outline(max(PLATEAU * extent, least_plateau)))
        width = float(np.ptp(tibia[[0, -1], 0]))
        edge = float(tibia[[0, -1], 1].min())
        tibial_shaft = 0.5 * (tibia[0, 0] + tibia[-1, 0]) + 0.5 * TIBIA_WIDTH * width * np.array(
            [-1.0, 1.0]
        )
        ends = edge - TIBIA_DROP * width, edge - TIBIA_DEPTH * width
        anatomies.append(
            Anatomy(
                *_bone(
                    femur, thickness, 1.0, shaft, (begin, max(SHAFT_LENGTH * extent, begin)), 0.0
                ),
                *_bone(tibia, thickness, -1.0, tibial_shaft, ends, TIBIA_LEAN),
                thickness,
                not math.isfinite(both),
            )
        )
    return anatomies


def picture_of(model: KneeModel, flexion_angle: float, femoral_height: float) -> Picture:
    """Make the polygons of a tick, from the flexion angle [rad] and the femoral height [m] of its answer."""
    knee = outlines_of(model, "", 1.0).anatomy
    x, _ = model.pair.mechanism.translation(flexion_angle)
    pose = flexion_angle, x, femoral_height
    closest = model.pair.closest(flexion_angle, femoral_height)
    point = contact_point(closest, x, femoral_height)
    overlap = np.zeros((0, 2))
    if closest.depth > 0.0:
        femur = model.pair.femur.outline()
        tibia = model.pair.tibia.outline(10.0 * model.pair.femoral_radius)
        upper, lower = find_overlaps(
            to_tibia_frame(femur, *pose)[None], tibia, np.array(point[:1])
        )
        overlap = np.concatenate([upper[0], lower[0, ::-1]])
    return Picture(
        to_tibia_frame(knee.femur_bone, *pose),
        to_tibia_frame(knee.femur_cartilage, *pose),
        knee.tibia_bone,
        knee.tibia_cartilage,
        overlap,
        point,
        (closest.normal_x, closest.normal_y),
        closest.depth,
    )


def to_tibia_frame(points: Floats, angle: Any, x: Any, height: Any) -> Floats:
    """Transform points of the femur, shape (m, 2) [m], to the tibia frame; flexion turns anterior to superior.

    Angle [rad], x and height [m] are numbers, or arrays of shape (n,), which give points of shape (n, m, 2).
    """
    cosine, sine, x, height = (
        np.asarray(each)[..., None] for each in (np.cos(angle), np.sin(angle), x, height)
    )
    (along, up) = points.T
    return np.stack([x + cosine * along - sine * up, height + sine * along + cosine * up], axis=-1)


def find_overlaps(femur: Floats, tibia: Floats, middle: Floats) -> tuple[Floats, Floats]:
    """Find the overlap in `n` pictures: its points on the tibia, and those on the femur below or at them.

    Both are of shape (n, POINTS, 2) [m], from posterior to anterior, and the same where the surfaces are apart.

    Args:
        femur: outline of the femur in every picture, shape (n, m, 2) [m], tibia frame.
        tibia: outline of the tibia, shape (k, 2) [m], x ascending.
        middle: x of the contact point [m], shape (n,).
    """
    x = middle[:, None] + np.linspace(-OVERLAP_REACH, OVERLAP_REACH, OVERLAP_SAMPLES)
    deep = np.interp(x, *tibia.T) - lowest_at(femur, x)
    begin = _edge(x, deep)
    end = _edge(x[:, ::-1], deep[:, ::-1])
    x = begin[:, None] + (end - begin)[:, None] * np.linspace(0.0, 1.0, OVERLAP_POINTS)
    upper = np.interp(x, *tibia.T)
    return np.stack([x, upper], axis=2), np.stack(
        [x, np.minimum(lowest_at(femur, x), upper)], axis=2
    )


def lowest_at(outlines: Floats, x: Floats) -> Floats:
    """Return y [m] of the lower halves of outlines, shape (n, m, 2) [m], at `x`, shape (n, s) [m]; infinite beyond."""
    lowest = np.empty(x.shape)
    for row, outline, along in zip(lowest, outlines, x, strict=True):
        half = outline[outline[:, 1] <= outline[:, 1].mean()]
        half = half[half[:, 0].argsort()]
        row[:] = np.interp(along, half[:, 0], half[:, 1], left=np.inf, right=np.inf)
    return lowest


def _edge(x: Floats, deep: Floats) -> Floats:
    """Return where the outlines first cross along `x` [m], shape (n,); the middle of `x` where they do not overlap."""
    rows = np.arange(len(x))
    inside = deep > 0.0
    inside[:, OVERLAP_SAMPLES // 2] = True
    after = inside.argmax(axis=1)
    over = np.maximum(deep[rows, after], 0.0)
    # An overlap that begins before the first point ends there: the crossing is at the point itself.
    under = np.where(after > 0, deep[rows, after - 1], -np.inf)
    return np.asarray(
        x[rows, after]
        + (x[:, 0] - x[:, 1]) * over / np.maximum(over - under, np.finfo(float).tiny)
    )


def _bone(
    surface: Floats,
    thickness: float,
    up: float,
    shaft: Floats,
    ends: tuple[float, float],
    lean: float,
) -> tuple[Floats, Floats]:
    """Make the polygons of a bone and its cartilage; `surface` goes from posterior to anterior.

    Args:
        surface: points of the surface, shape (n, 2) [m].
        thickness: thickness of the cartilage [m].
        up: 1 if the bone is above its surface, -1 if it is below.
        shaft: x of the posterior and the anterior side of the shaft [m].
        ends: y at which the shaft begins and ends [m].
        lean: how much the joins to the shaft begin in its direction, and not in the surface's.
    """
    inner = surface + up * _covered(surface, thickness) * _left(surface)
    away = np.array([0.0, up])
    rear, front = shaft
    begin, end = ends
    first = _unit(surface[1] - surface[0])
    last = _unit(surface[-1] - surface[-2])
    anterior = _join(surface[-1], last + lean * away, np.array([front, begin]), away)
    posterior = _join(np.array([rear, begin]), -away, surface[0], first - lean * away)
    bone = np.concatenate([inner, anterior[1:], [[front, end], [rear, end]], posterior[:-1]])
    return bone, np.concatenate([surface, inner[-2:0:-1]])


def _open(points: Floats) -> Floats:
    """Return a femoral outline from posterior to anterior; a closed one without the part that the shaft covers."""
    if np.allclose(points[0], points[-1]):
        middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
        # Angles are counted from superior over posterior.
        turn = np.mod(-np.arctan2(*(points[:-1] - middle).T), math.tau)
        order = np.argsort(turn)
        kept = (turn[order] > SHAFT_ANGLE) & (turn[order] < math.tau - SHAFT_ANGLE)
        return np.asarray(points[:-1][order][kept])
    # From posterior over inferior to anterior is counterclockwise.
    return points if signed_areas(points).sum() > 0.0 else points[::-1]


def signed_areas(points: Floats) -> Floats:
    """Return twice the area of the triangles from the origin to each side of a polygon; counterclockwise positive."""
    x, y = points.T
    next_x, next_y = np.roll(points, -1, axis=0).T
    return np.asarray(x * next_y - next_x * y)


def _even(points: Floats) -> Floats:
    """Resample a polyline, shape (m, 2), at `SURFACE_POINTS` points with equal distances along it."""
    distance = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    at = np.linspace(0.0, distance[-1], SURFACE_POINTS)
    return np.stack([np.interp(at, distance, axis) for axis in points.T], axis=1)


def _unit(vectors: Floats) -> Floats:
    """Return vectors, shape (..., 2), with length 1."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def _left(points: Floats) -> Floats:
    """Return unit vectors to the left of a line at its points, shape (n, 2)."""
    return _unit(np.gradient(points, axis=0) @ np.array([[0.0, 1.0], [-1.0, 0.0]]))


def _covered(surface: Floats, thickness: float) -> Floats:
    """Return the thickness [m] of the cartilage along a surface, shape (n, 1): it thins out towards both ends."""
    along = np.linspace(0.0, 1.0, len(surface))[:, None]
    part = np.clip(np.minimum(along, 1.0 - along) / TAPER, 0.0, 1.0)
    return np.asarray(thickness * np.sqrt(1.0 - (1.0 - part) ** 2))


def _join(begin: Floats, begin_along: Floats, end: Floats, end_along: Floats) -> Floats:
    """Join two points with given directions by a smooth line, shape (JOIN_POINTS, 2)."""
    reach = np.linalg.norm(end - begin)
    slopes = [reach * _unit(along) for along in (begin_along, end_along)]
    return np.asarray(
        CubicHermiteSpline([0.0, 1.0], [begin, end], slopes)(np.linspace(0.0, 1.0, JOIN_POINTS))
    )
