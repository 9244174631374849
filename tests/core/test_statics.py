"""The static solution, against values computed by hand from the paper's constants."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from knee_contact_ros.core.contact_laws import CONTACT_LAWS
from knee_contact_ros.core.statics import static_depth
from tests.scenes import BODY_WEIGHT, law

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
    assert static_depth(law(name), force).depth == pytest.approx(depth, abs=0.5e-9)  # the value's last digit


@pytest.mark.parametrize("name", ["two_layer_elastic", "two_layer_viscoelastic"])
def test_force_at_the_papers_osteoarthritic_depth(name: str) -> None:
    assert law(name).static_force(0.521e-3) / BODY_WEIGHT == pytest.approx(1.6055, abs=0.5e-4)


@pytest.mark.parametrize("name", CONTACT_LAWS)
@given(force=st.floats(1e-6, 1e6))
def test_the_static_depth_carries_the_force(name: str, force: float) -> None:
    depth = static_depth(law(name), force).depth
    # Rounding of the depth (1e-16 of up to 1 mm and more) times the slope; 1e-12 covers the steepest law here.
    assert law(name).static_force(depth) == pytest.approx(force, rel=1e-12)


@pytest.mark.parametrize("name", CONTACT_LAWS)
@pytest.mark.parametrize("force", [0.0, -100.0])
def test_without_load_the_surfaces_just_touch(name: str, force: float) -> None:
    assert static_depth(law(name), force).depth == 0.0


def test_a_force_out_of_reach_is_refused() -> None:
    with pytest.raises(ValueError, match="no static depth"):
        static_depth(law("hertz", stiffness=1e-20), 1e6)
