"""The static solution, against values computed by hand from the paper's constants."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from knee_contact_ros.core.contact_laws import CONTACT_LAWS
from knee_contact_ros.core.contact_pairs import ContactPair, OnPlane, in_circle, on_profile
from knee_contact_ros.core.geometries import Circle
from knee_contact_ros.core.model import LARGEST_LOAD
from knee_contact_ros.core.statics import (
    ANSWER,
    DEEPEST,
    NO_LIMIT,
    START_HEIGHT,
    height_at,
    static_contact,
    static_depth,
)
from tests.core.surfaces import ellipse
from tests.helpers.scenes import BODY_WEIGHT, RADIUS, law

FIRST_PEAK, SECOND_PEAK = 1.81 * BODY_WEIGHT, 2.19 * BODY_WEIGHT


@pytest.mark.parametrize(
    ("name", "force", "depth"),
    [
        ("kelvin_voigt", SECOND_PEAK, 0.747035e-3),
        ("hertz", SECOND_PEAK, 0.747035e-3),
        ("kelvin_voigt", FIRST_PEAK, 0.657906e-3),
        ("hertz", FIRST_PEAK, 0.657906e-3),
        ("two_layer_elastic", SECOND_PEAK, 0.538046e-3),
        ("two_layer_viscoelastic", SECOND_PEAK, 0.538046e-3),
    ],
)
def test_static_depths_under_the_papers_loads(name: str, force: float, depth: float) -> None:
    assert static_depth(law(name), force, 0.0, 0.0, NO_LIMIT).depth == pytest.approx(
        depth, abs=0.5e-9
    )  # the value's last digit


@pytest.mark.parametrize("name", ["two_layer_elastic", "two_layer_viscoelastic"])
def test_force_at_the_papers_osteoarthritic_depth(name: str) -> None:
    assert law(name).static_force(0.521e-3) / BODY_WEIGHT == pytest.approx(1.6055, abs=0.5e-4)


@pytest.mark.parametrize("name", CONTACT_LAWS)
@given(force=st.floats(1e-6, 1e6))
def test_the_static_depth_carries_the_force(name: str, force: float) -> None:
    depth = static_depth(law(name), force, 0.0, 0.0, NO_LIMIT).depth
    # Rounding of the depth (1e-16 of up to 1 mm and more) times the slope; 1e-12 covers the steepest law here.
    assert law(name).static_force(depth) == pytest.approx(force, rel=1e-12)


@pytest.mark.parametrize("name", CONTACT_LAWS)
@pytest.mark.parametrize("force", [0.0, -100.0])
def test_without_load_the_surfaces_just_touch(name: str, force: float) -> None:
    assert static_depth(law(name), force, 0.0, 0.0, NO_LIMIT).depth == 0.0


def test_a_force_out_of_reach_is_answered_with_the_deepest() -> None:
    assert static_depth(law("hertz", stiffness=1e-20), 1e6, 0.0, 0.0, NO_LIMIT).depth == DEEPEST
    # The softest law that the parameters allow, under the largest load that a sample may have
    softest = law("hertz", stiffness=1.0, exponent=1.0)
    assert static_depth(softest, LARGEST_LOAD, 0.0, 0.0, NO_LIMIT).depth == pytest.approx(LARGEST_LOAD, rel=1e-15)


@pytest.mark.parametrize("name", CONTACT_LAWS)
@pytest.mark.parametrize("guess", [1e-9, 0.9, 0.999, 1.0, 1.1, 20.0])
@given(force=st.floats(1e-6, 1e6))
def test_a_guess_changes_what_it_costs_and_not_what_is_found(name: str, guess: float, force: float) -> None:
    depth = static_depth(law(name), force, 0.0, 0.0, NO_LIMIT).depth
    near = static_depth(law(name), force, guess * depth, 0.0, NO_LIMIT).depth
    assert near == pytest.approx(depth, rel=1e-12)  # as `test_the_static_depth_carries_the_force` has it


@pytest.mark.parametrize("name", CONTACT_LAWS)
@given(force=st.floats(1e-3, 1e5), near=st.floats(0.3, 3.0), resolution=st.floats(-12.0, -5.0))
def test_a_coarser_resolution_is_kept(name: str, force: float, near: float, resolution: float) -> None:
    depth = static_depth(law(name), force, 0.0, 0.0, NO_LIMIT).depth
    coarse = static_depth(law(name), force, near * depth, 10.0**resolution, NO_LIMIT).depth
    assert abs(coarse - depth) <= 10.0**resolution


HILL = np.linspace(-0.03, 0.03, 31)
PAIRS = {
    "plane": OnPlane(Circle(RADIUS)),
    "slope": OnPlane(ellipse(80), 0.2),
    "circle": in_circle(Circle(RADIUS), 0.095),
    "ellipse in a circle": in_circle(ellipse(80), 0.095),
    "on a hill": on_profile(ellipse(80), HILL, -4.0 * HILL**2),
}


@pytest.mark.parametrize("pair", PAIRS.values(), ids=PAIRS)
@pytest.mark.parametrize("name", CONTACT_LAWS)
def test_at_rest_the_normal_force_carries_the_load(pair: ContactPair, name: str) -> None:
    touch = pair.at(0.4, 3.0, 0.006, 0.1)
    contact = static_contact(law(name), touch, 900.0, START_HEIGHT, 0.0, 0.0, NO_LIMIT)
    depth, _, cosine = touch.touch(contact.height)
    assert depth == pytest.approx(contact.depth, abs=1e-15)  # a few roundings of a height of 34 mm
    # That rounding times the steepest slope (1e8 N/m in bone) is 1e-7 N
    assert cosine * law(name).static_force(depth) == pytest.approx(900.0, abs=1e-6)
    assert contact.force == pytest.approx(900.0 / cosine, rel=1e-12)
    free = static_contact(law(name), touch, -50.0, START_HEIGHT, 0.0, 0.0, NO_LIMIT)
    assert (free.depth, free.force, free.evaluations) == (0.0, 0.0, 0)
    assert touch.touch(free.height)[0] == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize("pair", PAIRS.values(), ids=PAIRS)
@pytest.mark.parametrize("start", [0.02, 0.1, 3.0])
def test_a_height_is_found_from_anywhere_above(pair: ContactPair, start: float) -> None:
    touch = pair.at(-0.2, 0.0, -0.004, 0.0)
    assert touch.touch(height_at(touch, 4e-4, start))[0] == pytest.approx(4e-4, abs=1e-15)


@pytest.mark.parametrize("near", [1e-12, 1e-6, 1.0, 1e6])
@pytest.mark.parametrize("name", CONTACT_LAWS)
def test_no_guess_is_too_far(name: str, near: float) -> None:
    found = static_depth(law(name), 900.0, near, 0.0, ANSWER)
    assert law(name).static_force(found.depth) == pytest.approx(900.0, rel=1e-6)
    assert found.evaluations <= ANSWER + 2  # a layer, and the last correction
