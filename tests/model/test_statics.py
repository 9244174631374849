"""The static solution, against values computed by hand from the paper's constants."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from knee_contact_ros.model import statics
from knee_contact_ros.model.closest import touch
from knee_contact_ros.model.laws import CONTACT_LAWS
from tests.helpers.scenes import BODY_WEIGHT, law, model
from tests.model.scenes import LAWS_ON_PAIRS, PAIRS, ROUNDING

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
def test_static_depths_under_the_papers_loads(name, force, depth):
    # the values' last digit
    assert statics.plain_static_depth(law(name).rows, force) == pytest.approx(depth, abs=0.5e-9)
    first = model(law(name)).stream().tick(0.0, 0.2, force)
    assert first.penetration_depth == pytest.approx(depth, abs=0.5e-9)
    assert first.contact_force == pytest.approx(force, rel=1e-12)  # rounding of the depth


@pytest.mark.parametrize("name", ["two_layer_elastic", "two_layer_viscoelastic"])
def test_force_at_the_papers_osteoarthritic_depth(name):
    assert law(name).static_force(0.521e-3) / BODY_WEIGHT == pytest.approx(1.6055, abs=0.5e-4)


@pytest.mark.parametrize("name", CONTACT_LAWS)
@settings(max_examples=40)
@given(force=st.floats(1e-6, 1e6), guess=st.sampled_from([1e-9, 0.9, 0.999, 1.0, 1.1, 20.0]))
def test_the_static_depth_carries_the_force_whatever_the_guess(name, force, guess):
    contact_law = law(name)
    depth = statics.plain_static_depth(contact_law.rows, force)
    # Rounding of the depth (1e-16 of up to 1 mm and more) times the slope; 1e-12 covers the steepest law here.
    assert contact_law.static_force(depth) == pytest.approx(force, rel=1e-12)
    found, _ = statics.static_depth(contact_law.rows, force, guess * depth, 0.0, statics.NO_LIMIT)
    assert found == pytest.approx(depth, rel=1e-12)


@pytest.mark.parametrize("name", CONTACT_LAWS)
def test_no_guess_is_too_far_and_no_load_is_none(name):
    rows = law(name).rows
    for near in (1e-12, 1e-6, 1.0, 1e6):
        depth, evaluations = statics.static_depth(
            rows, 900.0, near, 0.0, statics.MAX_ANSWER_EVALUATIONS
        )
        assert law(name).static_force(depth) == pytest.approx(900.0, rel=1e-6)
        assert (
            evaluations <= statics.MAX_ANSWER_EVALUATIONS + 2
        )  # a layer, and the last correction
    for force in (0.0, -100.0):
        assert statics.static_depth(rows, force, 1e-3, 0.0, statics.NO_LIMIT) == (0.0, 0)


@pytest.mark.parametrize(("name", "kind"), LAWS_ON_PAIRS)
def test_at_rest_the_normal_force_carries_the_load(name, kind):
    surfaces, rows = PAIRS[kind]().surfaces, law(name).rows
    height, depth, force, stiffness, damping, cosine, _ = statics.static_contact(
        surfaces, rows, 0.4, 900.0, statics.START_HEIGHT, 0.0, 0.0, statics.NO_LIMIT
    )
    found, _, upright = touch(surfaces, 0.4, 0.0, height)
    assert found == pytest.approx(depth, abs=ROUNDING)
    # That rounding times the steepest slope (1e8 N/m in bone) is 1e-7 N
    assert upright * law(name).static_force(found) == pytest.approx(900.0, abs=1e-6)
    assert (force, cosine) == pytest.approx(
        (900.0 / upright, upright), rel=1e-12
    )  # n_y is that of the height
    assert (stiffness, damping) == law(name).force_at(depth, 0.0)[1:]
    free = statics.static_contact(
        surfaces, rows, 0.4, -50.0, statics.START_HEIGHT, 0.0, 0.0, statics.NO_LIMIT
    )
    assert (free[1], free[2], free[6]) == (0.0, 0.0, 0)
    assert touch(surfaces, 0.4, 0.0, free[0])[0] == pytest.approx(0.0, abs=ROUNDING)


@pytest.mark.parametrize("kind", PAIRS)
@pytest.mark.parametrize("start", [0.04, 0.1, 3.0])
def test_a_height_is_found_from_anywhere_above(kind, start):
    surfaces = PAIRS[kind]().surfaces
    height = statics.height_at(surfaces, 0.6, 4e-4, start)
    assert touch(surfaces, 0.6, 0.0, height)[0] == pytest.approx(4e-4, abs=ROUNDING)
