"""Every law of the table behaves as a contact law must."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from knee_contact_ros.core.contact_laws import CONTACT_LAWS
from knee_contact_ros.core.contact_laws.material import hertz_stiffness, relative_radius
from tests import ROOT
from tests.helpers.scenes import DAMPING, LAYER_DEPTH, STIFFNESS, law

depths = st.floats(1e-9, 5e-3)
rates = st.floats(-0.5, 0.5)
FLOOR = 0.1  # least_impact_speed in LAW_ARGUMENTS
# D at e = 0.1, 0.5 and 0.9, worked out by hand.
LOSSES = {
    "hunt_crossley": (1.35, 0.75, 0.15),
    "lankarani_nikravesh": (0.7425, 0.5625, 0.1425),
    "flores": (14.4, 1.6, 8 / 45),
    "gonthier": (9.9, 1.5, 19 / 90),
}


@pytest.mark.parametrize("name", CONTACT_LAWS)
def test_every_law_has_a_row_in_the_page_of_the_model(name: str) -> None:
    assert f"\n| `{name}` |" in (ROOT / "docs" / "model.md").read_text(encoding="utf-8")


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
    for layer, impact_speed in itertools.product(law(name).layers, (0.0, 3.0 * FLOOR)):
        force_at, depth_in_layer = layer.formula.force_at, layer.begin + depth
        value, over_depth, over_rate = force_at(depth_in_layer, rate, impact_speed)
        step = 1e-4 * depth
        ahead, behind = (force_at(depth_in_layer + side * step, rate, impact_speed)[0] for side in (-1, 1))
        # Central difference: relative error (step/depth)^2/24 x O(1) < 1e-8, and rounding of forces up to 1e6 N.
        assert over_depth == pytest.approx((behind - ahead) / (2 * step), rel=1e-6, abs=1e-9 * 1e6 / step * 1e-6)
        ahead, behind = (force_at(depth_in_layer, rate + side * 1e-3, impact_speed)[0] for side in (-1, 1))
        assert over_rate == pytest.approx((behind - ahead) / 2e-3, rel=1e-6, abs=1e-3)
        assert over_depth >= 0.0 or (layer.formula.remembers_impact() and value < 0.0)  # the formula pulls
        assert over_rate >= 0.0


def test_values_of_the_formulas() -> None:
    assert law("hertz").layers[0].formula.force_at(1e-4, 9.0, 0.0)[0] == pytest.approx(STIFFNESS * 1e-6, rel=1e-14)
    assert law("kelvin_voigt").layers[0].formula.force_at(1e-4, 0.1, 0.0)[0] == pytest.approx(
        STIFFNESS * 1e-6 + 0.1 * DAMPING, rel=1e-14
    )
    printed = law("two_layer_viscoelastic")
    assert printed.layers[0].formula.force_at(1e-4, 0.1, 0.0)[0] == pytest.approx(STIFFNESS * 1e-6, rel=1e-14)
    beyond = STIFFNESS * LAYER_DEPTH**1.5 + 3.112e9 * 1e-6 + 0.1 * DAMPING
    assert printed.layers[1].formula.force_at(LAYER_DEPTH + 1e-4, 0.1, 0.0)[0] == pytest.approx(beyond, rel=1e-12)
    damped = law("two_layer_viscoelastic", damp_first_layer=True)
    assert damped.layers[0].formula.force_at(1e-4, 0.1, 0.0)[0] == pytest.approx(
        STIFFNESS * 1e-6 + 0.1 * DAMPING, rel=1e-14
    )


@pytest.mark.parametrize("name", LOSSES)
def test_the_loss_depends_on_the_restitution(name: str) -> None:
    for restitution, loss in zip((0.1, 0.5, 0.9), LOSSES[name], strict=True):
        formula = law(name, restitution=restitution).layers[0].formula
        assert formula.force_at(1e-4, FLOOR, 0.0)[0] == pytest.approx(STIFFNESS * 1e-6 * (1.0 + loss), rel=1e-13)
        assert formula.force_at(1e-4, 0.0, 0.0)[0] == pytest.approx(STIFFNESS * 1e-6, rel=1e-14)
    lossless = law(name, restitution=1.0).layers[0].formula
    assert lossless.force_at(1e-4, -9.0, 2.0) == law("hertz").layers[0].formula.force_at(1e-4, -9.0, 2.0)


@pytest.mark.parametrize("name", LOSSES)
def test_an_impact_sets_the_damping_down_to_the_least_speed(name: str) -> None:
    def damping(speed: float) -> float:
        return law(name).layers[0].formula.force_at(1e-4, 0.0, speed)[2]

    assert damping(2.0) == pytest.approx(STIFFNESS * 1e-6 * LOSSES[name][1] / 2.0, rel=1e-13)
    at_floor = damping(0.0)
    assert at_floor == pytest.approx(STIFFNESS * 1e-6 * LOSSES[name][1] / FLOOR, rel=1e-13)
    for speed in (FLOOR, 1e-300, -1.0):
        assert damping(speed) == at_floor
    assert law(name).layers[0].formula.remembers_impact()


@pytest.mark.parametrize("name", LOSSES)
def test_the_formula_pulls_when_it_parts_faster_than_it_can(name: str) -> None:
    speed = 2.0
    force_at = law(name).layers[0].formula.force_at
    fastest = speed / LOSSES[name][1]
    assert force_at(1e-4, -0.999 * fastest, speed)[0] > 0.0
    force, over_depth, over_rate = force_at(1e-4, -2.0 * fastest, speed)
    assert force == pytest.approx(-STIFFNESS * 1e-6, rel=1e-13)
    assert over_depth == pytest.approx(1.5 * force / 1e-4, rel=1e-13)  # rounding
    assert over_rate > 0.0
    assert force_at(0.0, speed, speed) == (0.0, 0.0, 0.0)
    assert force_at(-1e-4, speed, speed) == (0.0, 0.0, 0.0)


def test_other_laws_do_not_care_for_the_impact() -> None:
    layers = [layer for name in CONTACT_LAWS for layer in law(name).layers if not layer.formula.remembers_impact()]
    assert len(layers) >= len(CONTACT_LAWS) - len(LOSSES)
    for layer in layers:
        assert layer.formula.force_at(7e-4, 0.1, 2.0) == layer.formula.force_at(7e-4, 0.1, 0.0)


def test_the_elastic_foundation_is_the_sum_of_its_springs() -> None:
    modulus, radius, depth = 24e6 * 0.62 / (1.38 * 0.24), 1.0 / (1.0 / 0.034 - 1.0 / 0.095), 5e-4
    foundation = law("elastic_foundation")
    # Independent of the closed form: rings of springs by the midpoint rule, of error 1/(2 x number)^2.
    rings, reach = 1000, math.sqrt(2.0 * radius * depth)
    width = reach / rings
    middles = [(ring + 0.5) * width for ring in range(rings)]
    summed = sum(modulus * (depth - r**2 / (2.0 * radius)) / 4.4e-3 * 2.0 * math.pi * r * width for r in middles)
    assert foundation.layers[0].formula.force_at(depth, 9.0, 0.0)[0] == pytest.approx(summed, rel=1e-6)
    assert foundation.static_force(depth) == pytest.approx(424.64, abs=0.005)  # by hand
    flat = law("elastic_foundation", tibial_radius=math.inf).static_force(depth)
    assert flat == pytest.approx(math.pi * modulus / 4.4e-3 * 0.034 * depth**2, rel=1e-13)


def test_stiffness_of_the_papers_materials() -> None:
    radius = relative_radius(0.034, 0.095)
    assert radius == pytest.approx(0.034 * 0.095 / 0.061, rel=1e-14)
    bone, cartilage = hertz_stiffness(17.2e9, 0.39, radius), hertz_stiffness(24e6, 0.38, radius)
    assert bone == pytest.approx(3.112e9, abs=0.5e6)
    assert bone / 10**4.5 == pytest.approx(98408, abs=0.5)  # N/mm^1.5
    assert cartilage == pytest.approx(4.30e6, abs=0.005e6)
    assert cartilage / 10**4.5 == pytest.approx(136, abs=0.5)


@pytest.mark.parametrize(
    ("femoral", "tibial"), [(0.034, 0.034), (0.095, 0.034), (0.034, -0.095), (0.0, 0.1), (-0.1, 0.1), (0.034, math.nan)]
)
def test_radii_that_do_not_fit_are_refused(femoral: float, tibial: float) -> None:
    with pytest.raises(ValueError, match=r"^0 < femoral radius < tibial radius \(concave\) is needed, got .*$"):
        relative_radius(femoral, tibial)
    with pytest.raises(ValueError, match="tibial radius"):
        law("elastic_foundation", femoral_radius=femoral, tibial_radius=tibial)
