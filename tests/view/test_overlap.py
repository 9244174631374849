"""The overlap of two outlines, against a circle over a plane."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from knee_contact_ros.view.anatomy import MARGIN, POINTS, SAMPLES, lowest_at, overlaps

RADIUS = 0.034
CORNERS = 181
CHORD = RADIUS * (1.0 - math.cos(math.pi / (CORNERS - 1)))
"""How far the corners cut into the circle [m]"""


def circle(x: float, height: float) -> np.ndarray:
    angles = np.linspace(0.0, math.tau, CORNERS)
    return np.stack([x + RADIUS * np.cos(angles), height + RADIUS * np.sin(angles)], axis=1)


PLANE = np.array([[-0.04, 0.0], [0.04, 0.0]])


@given(x=st.floats(-0.01, 0.01), depth=st.floats(1e-5, 3e-3))
def test_it_is_the_segment_of_the_circle_below_the_plane(x: float, depth: float) -> None:
    femur = np.array([circle(x, RADIUS - depth)])
    found = overlaps(femur, PLANE, np.array([x]), np.array([depth]), RADIUS)
    assert found.x.shape == found.lower.shape == found.upper.shape == (1, POINTS)
    rise = np.sqrt(RADIUS**2 - (found.x[0] - x) ** 2)
    lower = np.minimum(RADIUS - depth - rise, 0.0)
    assert (np.abs(found.lower[0] - lower) <= 1.01 * CHORD * RADIUS / rise).all()  # on a slope; 1.01: second order
    assert found.upper[0] == pytest.approx(0.0, abs=0.0)
    half = math.sqrt(2.0 * RADIUS * depth - depth**2)
    step = MARGIN * math.sqrt(2.0 * RADIUS * depth) * 2.0 / (SAMPLES - 1)
    # The outline lies up to a chord's height inside of the circle or outside, and meets the plane there.
    inner, outer = (math.sqrt(2.0 * RADIUS * max(depth + off, 0.0)) for off in (-CHORD, CHORD))
    width = np.ptp(found.x[0])
    # Where it ends is told by two of the places that were looked at, along a line.
    assert 2.0 * min(inner, half) - 0.1 * step <= width <= 2.0 * outer + 0.1 * step


@pytest.mark.parametrize("tibial_radius", [0.036, 0.04, 0.095])
def test_it_is_as_wide_as_the_lens_in_a_plateau_that_nearly_fits(tibial_radius: float) -> None:
    turns = np.linspace(-1.2, 1.2, 2001)
    tibia = tibial_radius * np.stack([np.sin(turns), 1.0 - np.cos(turns)], axis=1)
    depth = 5e-4
    found = overlaps(np.array([circle(0.0, RADIUS - depth)]), tibia, np.array([0.0]), np.array([depth]), RADIUS)
    apart = tibial_radius - RADIUS + depth  # from centre to centre
    half = math.sqrt(RADIUS**2 - ((tibial_radius**2 - RADIUS**2 - apart**2) / (2.0 * apart)) ** 2)
    assert np.ptp(found.x[0]) == pytest.approx(2.0 * half, rel=0.05)
    assert found.upper[0, [0, -1]] == pytest.approx(found.lower[0, [0, -1]], abs=0.1 * depth)


def test_there_is_none_apart() -> None:
    femur = np.array([circle(0.0, RADIUS + 1e-3)])
    found = overlaps(femur, PLANE, np.array([0.0]), np.array([0.0]), RADIUS)
    assert not (found.upper > found.lower).any()


def test_every_picture_is_its_own() -> None:
    poses = [(0.0, RADIUS - 1e-3), (0.005, RADIUS + 1.0), (-0.01, RADIUS - 2e-3)]
    femur = np.array([circle(*pose) for pose in poses])
    middle, depth = np.array([0.0, 0.005, -0.01]), np.array([1e-3, 0.0, 2e-3])
    together = overlaps(femur, PLANE, middle, depth, RADIUS)
    for i in range(3):
        alone = overlaps(femur[[i]], PLANE, middle[[i]], depth[[i]], RADIUS)
        for one, all_of_them in zip(alone, together, strict=True):
            assert np.array_equal(one[0], all_of_them[i])
    assert [(together.upper > together.lower)[i].any() for i in range(3)] == [True, False, True]


def test_the_lower_side_counts() -> None:
    outline = circle(0.0, 0.0)[None]
    assert lowest_at(outline, np.array([[0.0]]))[0, 0] == pytest.approx(-RADIUS, abs=CHORD)
    assert lowest_at(outline, np.array([[0.1]]))[0, 0] == math.inf
