"""The polygons of a knee, and the knee of matplotlib: drawn is what the answers say."""

from functools import cache
from typing import Any

import numpy as np
import pytest
from matplotlib.path import Path as Outline

from knee_contact_ros import load_model
from knee_contact_ros.view import picture
from knee_contact_ros.view.anatomy import (
    DRAWN_THICKNESS,
    OVERLAP_REACH,
    SURFACE_POINTS,
    outlines_of,
    picture_of,
)
from knee_contact_ros.view.picture import magnified_overlap

DEPTH = 0.7e-3
KNEES: dict[str, list[Any]] = {
    "healthy": ["healthy.yaml"],
    "osteoarthritis": ["osteoarthritis.yaml"],
    "MRI femur": ["osteoarthritis.yaml", "mri_femur.yaml"],
    "MRI knee": ["healthy.yaml", "mri_knee.yaml"],
    "hollow tibia": [
        "osteoarthritis.yaml",
        {"tibia.geometry": "circle", "translation.mechanism": "parallel_mechanism"},
    ],
    "MRI femur on a slope": ["healthy.yaml", "mri_femur.yaml", {"tibia.slope": -0.2}],
    "steep slope": ["osteoarthritis.yaml", {"tibia.slope": 0.5}],
    "elastic foundation": ["healthy.yaml", {"contact.law": "elastic_foundation"}],
}
ANGLES = (-0.1, 0.3, 1.2)
TWO_LAYERS = {"contact.law": "two_layer_elastic", "contact.layer_depth": 1e-3}


@cache
def model_of(config, name):
    return load_model([config / one if isinstance(one, str) else one for one in KNEES[name]])


def anatomy_of(model):
    return outlines_of(model, "knee", 700.0).anatomy


def pressed(model, angle, depth=DEPTH):
    """A knee as deep as that, to 1e-9 m."""
    height = 0.03
    for _ in range(60):
        closest = model.pair.closest(angle, height)
        height += (closest.depth - depth) / closest.normal_y
    picture = picture_of(model, angle, height)
    assert picture.depth == pytest.approx(depth, abs=1e-9)
    return picture


def area(polygon):
    return abs(
        0.5 * float(np.linalg.det(np.stack([polygon, np.roll(polygon, -1, axis=0)], axis=1)).sum())
    )


def crossings(polygon):
    """How many pairs of a polygon's sides cross, neighbours left out."""
    a, b = polygon, np.roll(polygon, -1, axis=0)

    def side(p, q, r):
        return np.sign(
            (q[:, None, 0] - p[:, None, 0]) * (r[None, :, 1] - p[:, None, 1])
            - (q[:, None, 1] - p[:, None, 1]) * (r[None, :, 0] - p[:, None, 0])
        )

    apart = side(a, b, a) * side(a, b, b)
    return int(np.triu((apart < 0.0) & (apart.T < 0.0), 2).sum())


@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize("name", KNEES)
def test_polygons_are_simple_on_their_sides_and_overlap_where_both_are(config, name, angle):
    model = model_of(config, name)
    picture = pressed(model, angle)
    for polygon in picture[:5]:
        assert np.isfinite(polygon).all()
        assert crossings(polygon) == 0
        # No side leaps over the knee.
        assert np.hypot(*np.diff(polygon, axis=0, append=polygon[:1]).T).max() < 0.06
    bones, covers = (
        (picture.femur_bone, picture.tibia_bone),
        (picture.femur_cartilage, picture.tibia_cartilage),
    )
    point, normal = np.array(picture.contact_point), np.array(picture.normal)
    # The cartilage: at the contact, between the bones and the surfaces.
    inside = 0.5 * min(anatomy_of(model).thickness, DEPTH)
    for bone, cover, deep, shallow in zip(
        bones, covers, (8e-3, -8e-3), (inside - DEPTH, -inside), strict=True
    ):
        assert Outline(bone).contains_point(point + deep * normal)
        assert Outline(cover).contains_point(point + shallow * normal)
    # The overlap, against a count of the points that lie in both closed outlines.
    low, high = picture.overlap.min(axis=0) - 1e-4, picture.overlap.max(axis=0) + 1e-4
    x, y = (
        np.linspace(*ends, number) for *ends, number in zip(low, high, (300, 150), strict=True)
    )
    grid = np.stack(np.meshgrid(x, y), axis=2).reshape(-1, 2)
    femur, tibia = (
        Outline(bone).contains_points(grid) | Outline(cover).contains_points(grid)
        for bone, cover in zip(bones, covers, strict=True)
    )
    counted = (femur & tibia).sum() * (x[1] - x[0]) * (y[1] - y[0])
    # Both are drawn as polygons whose corners cut some micrometres off 0.7 mm.
    assert area(picture.overlap) == pytest.approx(counted, rel=0.04)


@pytest.mark.parametrize("name", KNEES)
def test_triangles_cover_the_bones_once(config, name):
    pytest.importorskip("rerun", reason="needs the extra viewer")
    from knee_contact_ros.view.plane import triangles_of

    picture = pressed(model_of(config, name), 0.3)
    for polygon in (picture.femur_bone, picture.tibia_bone[::-1]):
        triangles = triangles_of(polygon)
        assert len(triangles) == len(polygon) - 2
        # As much as the polygon, to rounding: none lies over another, or outside.
        assert sum(area(polygon[corners]) for corners in triangles) == pytest.approx(
            area(polygon), rel=1e-9
        )


@pytest.mark.parametrize("name", KNEES)
def test_surfaces_are_the_model_s(config, name):
    model = model_of(config, name)
    anatomy = anatomy_of(model)
    outline, drawn = model.pair.femur.outline(), anatomy.femur_cartilage[:SURFACE_POINTS]
    nearest = np.hypot(*(drawn[:, None] - outline[None]).transpose(2, 0, 1)).min(axis=1)
    assert nearest.max() < 1e-3  # the outlines' own points lie up to 1.2 mm apart
    assert drawn[:, 1].min() == pytest.approx(outline[:, 1].min(), abs=2e-5)
    tibia = anatomy.tibia_cartilage[:SURFACE_POINTS]
    assert (np.diff(tibia[:, 0]) > 0.0).all()
    assert tibia[:, 1] == pytest.approx(
        np.interp(tibia[:, 0], *model.pair.tibia.outline(0.05).T), abs=2e-5
    )


@pytest.mark.parametrize(
    ("changes", "thickness", "is_drawn"),
    [
        ({}, DRAWN_THICKNESS, True),
        (TWO_LAYERS, 0.5e-3, False),
        (
            {"contact.law": "elastic_foundation", "contact.foundation_thickness": 3e-3},
            1.5e-3,
            False,
        ),
    ],
)
def test_the_thickness_is_that_of_the_law_if_it_has_one(changes, thickness, is_drawn):
    anatomy = anatomy_of(load_model(changes))
    assert (anatomy.thickness, anatomy.thickness_is_drawn) == (pytest.approx(thickness), is_drawn)
    surface, bone = anatomy.tibia_cartilage[:SURFACE_POINTS], anatomy.tibia_bone[:SURFACE_POINTS]
    assert np.hypot(*(surface - bone)[SURFACE_POINTS // 2]) == pytest.approx(thickness)
    assert surface[[0, -1]] == pytest.approx(bone[[0, -1]])  # it thins out


def test_the_bones_touch_at_the_depth_of_the_law():
    for depth, touch in ((0.95e-3, False), (1.05e-3, True)):
        picture = pressed(load_model(TWO_LAYERS), 0.2, depth)
        assert Outline(picture.tibia_bone).contains_points(picture.femur_bone).any() == touch


def test_the_overlap_is_empty_apart_and_fills_the_search_range_when_deep():
    whole = picture_of(load_model({}), 0.2, -0.03).overlap
    assert np.ptp(whole[:, 0]) == pytest.approx(2.0 * OVERLAP_REACH)
    picture = picture_of(load_model({}), 0.2, 0.035)
    assert picture.depth == pytest.approx(-1e-3)
    assert picture.overlap.shape == (0, 2)


def test_the_drawn_overlap_has_the_depth_of_the_contact():
    # A circle on a plane.
    posed = picture_of(load_model(["healthy", "osteoarthritis"]), 0.1, 0.034 - 0.7e-3)
    # Chords of the drawn outline: half a degree of a circle of 34 mm lies 0.3 µm behind it
    assert np.ptp(posed.overlap[:, 1]) == pytest.approx(0.7e-3, abs=1e-5)
    deep = magnified_overlap(posed, np.inf, 0.5e-3)
    assert np.ptp(deep[:, 1]) == pytest.approx(2e-3, abs=1e-4)
    assert np.ptp(magnified_overlap(posed, 0.5e-3)[:, 1]) == pytest.approx(5e-3, abs=1e-4)
    assert not len(magnified_overlap(posed, np.inf, 0.8e-3))


@pytest.mark.parametrize(
    ("depth", "label"), [(0.7e-3, "0.700 mm deep\n(drawn × 10)"), (-0.4e-3, "0.400 mm apart")]
)
def test_depth_and_scale_are_written_also_apart(depth, label):
    from matplotlib.figure import Figure

    knee = Figure().subplots()
    picture.draw_knee(knee, load_model("healthy"), 0.1, 0.034 - depth, 1000.0, 737.0)
    texts = {text.get_text() for text in knee.texts}
    assert {"femur", "tibia", "anterior →", "10 mm", "1.36 BW\n(1000 N)", label} <= texts
