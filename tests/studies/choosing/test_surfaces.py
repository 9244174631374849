"""The reference's measured surfaces, against closed forms and against the model."""

import math

import numpy as np
import pytest

from knee_contact_ros import load_model
from knee_contact_ros.model.closest import contact_point
from studies.choosing.scenes import CIRCLE, MRI_FEMUR, MRI_KNEE, geometries
from studies.choosing.surfaces import deepest, femur_through, lowest, plateau_through

A, B = 0.034, 0.028
ANGLES = np.linspace(-0.1, 1.9, 21).tolist()
GEOMETRIES = {geometry.name: geometry for geometry in geometries()}


def ellipse_points(number):
    """The lower part of an ellipse, from posterior to anterior."""
    turn = np.linspace(math.radians(150.0), math.radians(390.0), number)
    return np.stack([A * np.cos(turn), B * np.sin(turn)])


def test_the_lowest_point_is_that_of_an_ellipse():
    femur = femur_through(ellipse_points(400))
    for angle in ANGLES:
        x, y = lowest(femur, angle)
        support = math.hypot(A * math.sin(angle), B * math.cos(angle))
        # A spline through 400 points of it is off by their distance to the fourth power: 1e-12 m or so.
        assert -y == pytest.approx(support, abs=1e-11)
        assert -x == pytest.approx(
            (A * A - B * B) * math.sin(angle) * math.cos(angle) / support, abs=1e-8
        )


def test_on_a_concave_circle_the_centres_tell_the_depth():
    turn = np.linspace(math.radians(150.0), math.radians(390.0), 600)
    femur = femur_through(A * np.array([np.cos(turn), np.sin(turn)]))
    x = np.linspace(-0.04, 0.04, 400)
    radius, height = 0.095, 0.0336
    plateau = plateau_through(np.array([x, radius - np.sqrt(radius**2 - x**2)]))
    # The splines are good to some 1e-12 m here.
    assert deepest(femur, plateau, 0.3, height).depth == pytest.approx(A - height, abs=1e-11)


@pytest.mark.parametrize("name", [CIRCLE, MRI_FEMUR, MRI_KNEE])
def test_the_model_finds_the_same_contact(name):
    geometry = GEOMETRIES[name]
    model = load_model(list(geometry.files))
    for angle in ANGLES:
        for height in (0.0215, 0.0225, 0.024):
            state = (0.034 - height if name == CIRCLE else height, 0.0)
            depth, _ = geometry.femur.contact(state, angle, 0.0)
            closest = model.pair.closest(angle, height)
            # The model searches to 1e-14 m and below; the place of a flat minimum is known to the root of that.
            assert closest.depth == pytest.approx(depth, abs=1e-13)
            expected = geometry.contact_x(angle, state[0])
            assert contact_point(closest, 0.0, height)[0] == pytest.approx(expected, abs=1e-7)
