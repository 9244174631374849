"""The knee's polygons: closed and simple, on the right side of each other, and overlapping as much as they should."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.path import Path as Outline

from knee_contact_ros.model.knee import KneeModel
from knee_contact_ros.parameters.build import build_model
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.view.anatomy import DRAWN_THICKNESS, SURFACE_POINTS, Picture, anatomy_of, picture_of
from knee_contact_ros.view.scene import triangles_of

DEPTH = 0.7e-3
KNEES: dict[str, list[Any]] = {
    "healthy": ["healthy.yaml"],
    "osteoarthritis": ["osteoarthritis.yaml"],
    "MRI femur": ["osteoarthritis.yaml", "mri_femur.yaml"],
    "MRI knee": ["healthy.yaml", "mri_knee.yaml"],
    "hollow tibia": [
        "osteoarthritis.yaml", {"tibia.geometry": "circle", "translation.mechanism": "parallel_mechanism"}
    ],
    "MRI femur on a slope": ["healthy.yaml", "mri_femur.yaml", {"tibia.slope": -0.2}],
    "steep slope": ["osteoarthritis.yaml", {"tibia.slope": 0.5}],
    "elastic foundation": ["healthy.yaml", {"contact.law": "elastic_foundation"}],
}  # fmt: skip
ANGLES = (-0.1, 0.3, 1.2)


@cache
def model_of(config: Path, name: str) -> KneeModel:
    return build_model(load_parameters([config / one if isinstance(one, str) else one for one in KNEES[name]]))


def pressed(model: KneeModel, angle: float, depth: float = DEPTH) -> Picture:
    """A knee as deep as that, to 1e-9 m."""
    height = 0.03
    for _ in range(60):
        closest = model.closest(angle, height)
        height += (closest.depth - depth) / closest.normal_y
    picture = picture_of(model, angle, height)
    assert picture.depth == pytest.approx(depth, abs=1e-9)
    return picture


def area(polygon: np.ndarray) -> float:
    (x, y), (next_x, next_y) = polygon.T, np.roll(polygon, -1, axis=0).T
    return abs(0.5 * float((x * next_y - next_x * y).sum()))


def crossings(polygon: np.ndarray) -> int:
    """How many pairs of a polygon's sides cross, neighbours left out."""
    a, b = polygon, np.roll(polygon, -1, axis=0)

    def side(p: np.ndarray, q: np.ndarray, r: np.ndarray) -> np.ndarray:
        return np.sign(
            (q[:, None, 0] - p[:, None, 0]) * (r[None, :, 1] - p[:, None, 1])
            - (q[:, None, 1] - p[:, None, 1]) * (r[None, :, 0] - p[:, None, 0])
        )

    apart = side(a, b, a) * side(a, b, b)
    return int(np.triu((apart < 0.0) & (apart.T < 0.0), 2).sum())


@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize("name", KNEES)
def test_polygons_are_simple_and_on_their_sides(config: Path, name: str, angle: float) -> None:
    model = model_of(config, name)
    picture = pressed(model, angle)
    for polygon in picture[:5]:
        assert np.isfinite(polygon).all()
        assert crossings(polygon) == 0
        assert np.hypot(*np.diff(polygon, axis=0, append=polygon[:1]).T).max() < 0.06  # no side leaps over the knee
    femur, tibia = Outline(picture.femur_bone), Outline(picture.tibia_bone)
    point, normal = np.array(picture.contact_point), np.array(picture.normal)
    assert femur.contains_point(point + 8e-3 * normal)
    assert tibia.contains_point(point - 8e-3 * normal)
    # The cartilage: at the contact, between the bones and the surfaces.
    inside = 0.5 * min(anatomy_of(model).thickness, DEPTH)
    assert Outline(picture.tibia_cartilage).contains_point(point - inside * normal)
    assert Outline(picture.femur_cartilage).contains_point(point - (DEPTH - inside) * normal)
    overlap = picture.overlap.mean(axis=0)
    assert Outline(np.concatenate([picture.overlap, picture.overlap[:1]])).contains_point(overlap)


@pytest.mark.parametrize("name", KNEES)
def test_triangles_cover_the_bones_once(config: Path, name: str) -> None:
    picture = pressed(model_of(config, name), 0.3)
    for polygon in (picture.femur_bone, picture.tibia_bone[::-1]):
        triangles = triangles_of(polygon)
        assert len(triangles) == len(polygon) - 2
        # As much as the polygon, to rounding: none lies over another, or outside.
        assert sum(area(polygon[corners]) for corners in triangles) == pytest.approx(area(polygon), rel=1e-9)


@pytest.mark.parametrize("name", KNEES)
def test_surfaces_are_the_model_s(config: Path, name: str) -> None:
    model = model_of(config, name)
    anatomy = anatomy_of(model)
    outline, drawn = model.pair.femur.outline(), anatomy.femur_cartilage[:SURFACE_POINTS]
    nearest = np.hypot(*(drawn[:, None] - outline[None]).transpose(2, 0, 1)).min(axis=1)
    assert nearest.max() < 1e-3  # the outlines' own points lie up to 1.2 mm apart
    assert drawn[:, 1].min() == pytest.approx(outline[:, 1].min(), abs=2e-5)
    tibia = anatomy.tibia_cartilage[:SURFACE_POINTS]
    assert (np.diff(tibia[:, 0]) > 0.0).all()
    reference = model.pair.outline(0.05)
    assert tibia[:, 1] == pytest.approx(np.interp(tibia[:, 0], *reference.T), abs=2e-5)


@pytest.mark.parametrize(
    ("changes", "thickness", "is_drawn"),
    [
        ({}, DRAWN_THICKNESS, True),
        ({"contact.law": "two_layer_elastic", "contact.layer_depth": 1e-3}, 0.5e-3, False),
        ({"contact.law": "elastic_foundation", "contact.foundation_thickness": 3e-3}, 1.5e-3, False),
    ],
)
def test_the_law_tells_the_thickness_if_it_can(changes: dict[str, Any], thickness: float, is_drawn: bool) -> None:
    anatomy = anatomy_of(build_model(load_parameters(changes)))
    assert anatomy.thickness == pytest.approx(thickness)
    assert anatomy.thickness_is_drawn is is_drawn
    surface, bone = anatomy.tibia_cartilage[:SURFACE_POINTS], anatomy.tibia_bone[:SURFACE_POINTS]
    middle = SURFACE_POINTS // 2
    assert np.hypot(*(surface - bone)[middle]) == pytest.approx(thickness)
    assert surface[[0, -1]] == pytest.approx(bone[[0, -1]])  # it thins out


def test_the_bones_touch_where_the_law_says_so() -> None:
    model = build_model(load_parameters({"contact.law": "two_layer_elastic", "contact.layer_depth": 1e-3}))
    for depth, touch in ((0.95e-3, False), (1.05e-3, True)):
        picture = pressed(model, 0.2, depth)
        tibia = Outline(picture.tibia_bone)
        assert tibia.contains_points(picture.femur_bone).any() == touch


@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize("name", KNEES)
def test_the_overlap_is_what_both_cover(config: Path, name: str, angle: float) -> None:
    """Against a count of the places that lie in both closed outlines."""
    model = model_of(config, name)
    picture = pressed(model, angle)
    low, high = picture.overlap.min(axis=0) - 1e-4, picture.overlap.max(axis=0) + 1e-4
    steps = (300, 150)
    x, y = (np.linspace(*ends, number) for *ends, number in zip(low, high, steps, strict=True))
    places = np.stack(np.meshgrid(x, y), axis=2).reshape(-1, 2)
    femur, tibia = (
        Outline(one).contains_points(places) | Outline(other).contains_points(places)
        for one, other in ((picture.femur_bone, picture.femur_cartilage), (picture.tibia_bone, picture.tibia_cartilage))
    )
    cell = (x[1] - x[0]) * (y[1] - y[0])
    # Both are drawn as polygons whose corners cut some micrometres off 0.7 mm.
    assert area(picture.overlap) == pytest.approx((femur & tibia).sum() * cell, rel=0.04)


def test_the_overlap_of_a_circle_and_a_plane_is_a_segment(config: Path) -> None:
    picture = pressed(model_of(config, "healthy"), 0.3)
    radius = 0.034
    half = math.acos(1.0 - DEPTH / radius)
    segment = radius**2 * (half - math.sin(half) * math.cos(half))
    assert area(picture.overlap) == pytest.approx(segment, rel=0.02)  # corners every 2 degrees
    assert np.ptp(picture.overlap[:, 0]) == pytest.approx(2.0 * radius * math.sin(half), rel=0.01)


def test_there_is_no_overlap_apart() -> None:
    picture = picture_of(build_model(load_parameters({})), 0.2, 0.035)
    assert picture.depth == pytest.approx(-1e-3)
    assert picture.overlap.shape == (0, 2)
