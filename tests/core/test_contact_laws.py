"""Every law of the table behaves as a contact law must."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from knee_contact_ros.core.contact_laws import CONTACT_LAWS
from tests.scenes import DAMPING, LAW_ARGUMENTS, LAYER_DEPTH, STIFFNESS, law

depths = st.floats(1e-9, 5e-3)
rates = st.floats(-0.5, 0.5)


def test_every_law_is_tested() -> None:
    assert set(LAW_ARGUMENTS) == set(CONTACT_LAWS)


@pytest.mark.parametrize("name", CONTACT_LAWS)
def test_apart_there_is_no_static_force(name: str) -> None:
    assert law(name).static_force(0.0) == 0.0
    assert law(name).static_force(-1e-3) == 0.0


@pytest.mark.parametrize("name", CONTACT_LAWS)
@given(depth=depths, more=depths)
def test_static_force_grows_with_depth(name: str, depth: float, more: float) -> None:
    # Below 1e-12 of the depth the difference drowns in rounding.
    if more > 1e-12 * depth:
        assert law(name).static_force(depth + more) > law(name).static_force(depth)


@pytest.mark.parametrize("name", CONTACT_LAWS)
def test_static_force_is_continuous_between_layers(name: str) -> None:
    for layer in law(name).layers[1:]:
        below, above = (law(name).static_force(layer.begin * (1.0 + side * 1e-12)) for side in (-1, 1))
        assert above == pytest.approx(below, rel=1e-9)  # the slope over a step of 2e-12


@pytest.mark.parametrize("name", CONTACT_LAWS)
@given(depth=depths, rate=rates)
def test_slopes_are_those_of_the_force(name: str, depth: float, rate: float) -> None:
    for layer in law(name).layers:
        depth_in_layer = layer.begin + depth
        _, over_depth, over_rate = layer.force(depth_in_layer, rate)
        step = 1e-4 * depth
        ahead, behind = (layer.force(depth_in_layer + side * step, rate)[0] for side in (-1, 1))
        # Central difference: relative error (step/depth)^2/24 x O(1) < 1e-8, and rounding of forces up to 1e6 N.
        assert over_depth == pytest.approx((behind - ahead) / (2 * step), rel=1e-6, abs=1e-9 * 1e6 / step * 1e-6)
        ahead, behind = (layer.force(depth_in_layer, rate + side * 1e-3)[0] for side in (-1, 1))
        assert over_rate == pytest.approx((behind - ahead) / 2e-3, rel=1e-6, abs=1e-3)
        assert over_depth >= 0.0
        assert over_rate >= 0.0


def test_values_of_the_formulas() -> None:
    assert law("hertz").layers[0].force(1e-4, 9.0)[0] == pytest.approx(STIFFNESS * 1e-6, rel=1e-14)
    assert law("kelvin_voigt").layers[0].force(1e-4, 0.1)[0] == pytest.approx(
        STIFFNESS * 1e-6 + 0.1 * DAMPING, rel=1e-14
    )
    printed = law("two_layer_viscoelastic")
    assert printed.layers[0].force(1e-4, 0.1)[0] == pytest.approx(STIFFNESS * 1e-6, rel=1e-14)
    beyond = STIFFNESS * LAYER_DEPTH**1.5 + 3.112e9 * 1e-6 + 0.1 * DAMPING
    assert printed.layers[1].force(LAYER_DEPTH + 1e-4, 0.1)[0] == pytest.approx(beyond, rel=1e-12)
    damped = law("two_layer_viscoelastic", damp_first_layer=True)
    assert damped.layers[0].force(1e-4, 0.1)[0] == pytest.approx(STIFFNESS * 1e-6 + 0.1 * DAMPING, rel=1e-14)
