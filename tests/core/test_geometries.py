"""Support functions: exact cases, convergence of the spline, and noise that must not be taken for the surface."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from knee_contact_ros.core.geometries import Circle, Profile
from tests.core.surfaces import ellipse
from tests.helpers.scenes import RADIUS

ANGLES = np.radians(np.linspace(-10.0, 110.0, 97))


def densest(outline: np.ndarray, angle: float) -> float:
    """Support by brute force over many points of a curve."""
    x, y = outline.T
    return float(np.max(-(math.sin(angle) * x + math.cos(angle) * y)))


def test_a_circle_looks_the_same_from_everywhere() -> None:
    assert all(Circle(RADIUS).support(angle) == (RADIUS, 0.0) for angle in ANGLES)


def test_spline_through_an_ellipse_converges_at_fourth_order() -> None:
    a, b = 0.034, 0.028

    def largest_error(points: int) -> float:
        profile = ellipse(points, a, b)
        exact = [math.hypot(a * math.sin(angle), b * math.cos(angle)) for angle in ANGLES]
        return max(abs(profile.support(angle)[0] - h) for angle, h in zip(ANGLES, exact, strict=True))

    errors = [largest_error(points) for points in (40, 80, 160)]
    orders = [math.log2(coarse / fine) for coarse, fine in itertools.pairwise(errors)]
    assert min(orders) > 3.7
    assert errors[-1] < 1e-9


def test_the_slope_of_an_ellipses_support_is_the_contact_point() -> None:
    a, b = 0.034, 0.028
    profile = ellipse(320, a, b)
    for angle in ANGLES:
        h = math.hypot(a * math.sin(angle), b * math.cos(angle))
        slope = (a * a - b * b) * math.sin(angle) * math.cos(angle) / h
        assert profile.support(angle)[1] == pytest.approx(slope, abs=1e-8)  # 4th-order error of the points' spacing


@given(
    radii=st.lists(st.floats(0.9, 1.1), min_size=24, max_size=24),
    angle=st.floats(-0.3, 2.0),
)
def test_a_noisy_curve_is_touched_at_its_lowest_point(radii: list[float], angle: float) -> None:
    t = np.linspace(-np.pi - 0.9, 0.9, len(radii))
    profile = Profile(RADIUS * np.array(radii) * np.cos(t), RADIUS * np.array(radii) * np.sin(t))
    depth, slope = profile.support(angle)
    lowest = densest(profile.outline(400), angle)
    # Brute force lies above the lowest point by (25 um between the points)^2 x curvature (2/mm in noise) / 8 at most.
    assert lowest <= depth + 1e-15
    assert lowest == pytest.approx(depth, abs=2e-7)
    assert abs(slope) <= 2.0 * RADIUS


def test_the_raw_mri_profile_is_not_taken_in_by_its_noise(reference_data) -> None:
    x, y = np.loadtxt(
        reference_data / "geometry" / "femur_medial_raw.csv", delimiter=",", comments="#", skiprows=4, unpack=True
    )
    profile = Profile(x * 1e-3, y * 1e-3)
    outline = profile.outline(400)
    for angle in ANGLES:
        assert densest(outline, angle) == pytest.approx(profile.support(angle)[0], abs=1e-9)


def test_points_that_repeat_count_once() -> None:
    t = np.linspace(-3.0, 0.0, 12)
    x, y = RADIUS * np.cos(t), RADIUS * np.sin(t)
    assert Profile(np.repeat(x, 2), np.repeat(y, 2)).support(0.4) == Profile(x, y).support(0.4)


@pytest.mark.parametrize(
    ("x", "y", "words"),
    [
        ([0.0, 1.0, 2.0], [0.0, 1.0, 0.0], "at least 4"),
        ([0.0, 0.0, 0.0, 0.0, 0.0], [1.0, 1.0, 1.0, 1.0, 1.0], "at least 4"),
        ([0.0, 1.0, math.nan, 3.0], [0.0, 1.0, 0.0, 1.0], "not finite"),
    ],
)
def test_profiles_that_cannot_be_used_are_refused(x: list[float], y: list[float], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        Profile(x, y)
