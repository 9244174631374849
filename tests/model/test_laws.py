"""Every law of the table behaves as a contact law must."""

import itertools
import math
from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from knee_contact_ros.model.laws import (
    COMMON,
    CONTACT_LAWS,
    ContactLaw,
    Layer,
    check,
    hertz_stiffness,
    relative_radius,
)
from studies.reference import LAWS
from tests import ROOT
from tests.helpers.scenes import DAMPING, LAW_ARGUMENTS, LAYER_DEPTH, STIFFNESS, law

depths = st.floats(1e-9, 5e-3)
FLOOR = 0.1  # least_impact_speed in LAW_ARGUMENTS


@pytest.mark.parametrize("name", CONTACT_LAWS)
def test_every_law_has_a_row_in_the_page_of_the_model(name):
    assert f"\n| `{name}` |" in (ROOT / "docs" / "explanation" / "model.md").read_text(
        encoding="utf-8"
    )


@pytest.mark.parametrize("name", CONTACT_LAWS)
@settings(max_examples=40)
@given(depth=depths, more=depths)
def test_the_static_force_begins_at_0_grows_with_the_depth_and_does_not_jump(name, depth, more):
    static = law(name).static_force
    assert static(0.0) == static(-depth) == 0.0
    # Below 1e-12 of the depth the difference drowns in rounding.
    assert more <= 1e-12 * depth or static(depth + more) > static(depth)
    for layer in law(name).layers[1:]:
        below, above = (static(layer.begin * (1.0 + side * 1e-12)) for side in (-1, 1))
        assert above == pytest.approx(below, rel=1e-9)  # the slope over a step of 2e-12


@pytest.mark.parametrize("name", CONTACT_LAWS)
@settings(max_examples=40)
@given(depth=depths, rate=st.floats(-0.5, 0.5))
def test_slopes_are_those_of_the_force(name, depth, rate):
    check(law(name))
    for layer, impact_speed in itertools.product(law(name).layers, (0.0, 3.0 * FLOOR)):
        there = layer.begin + depth
        value, over_depth, over_rate = layer.force_at(there, rate, impact_speed)
        step = 1e-4 * depth
        ahead, behind = (
            layer.force_at(there + side * step, rate, impact_speed)[0] for side in (1, -1)
        )
        # Central difference: relative error (step/depth)²/24 x O(1) < 1e-8, and rounding of forces up to 1e6 N.
        assert over_depth == pytest.approx(
            (ahead - behind) / (2 * step), rel=1e-6, abs=1e-9 / step
        )
        assert over_rate >= 0.0
        # The sum may be next to 0: rounding of terms up to 1e6 N.
        moved = layer.force_at(there, rate + 0.3, impact_speed)[0]
        assert value + over_rate * 0.3 == pytest.approx(moved, rel=1e-9, abs=1e-9)


SPRING = STIFFNESS * 1e-6
"""K δ^1.5 [N] at 0.1 mm"""
BOTH = STIFFNESS * LAYER_DEPTH**1.5 + 3.112e9 * 1e-6
"""K h^1.5 + K₂ (δ - h)^1.5 [N] at 0.6 mm"""
Numbers = tuple[dict[str, float], int, float, float, float]
"""Changed constants, number of the layer, depth [m], rate [m/s], and the force [N] there, worked out by hand"""


def impact_damped(*losses):
    """Numbers of a law K δⁿ (1 + D δ̇/v₀) with these D, worked out by hand, at e = 0.1, 0.5 and 0.9; D is 0 at e = 1."""
    return [
        *(
            ({"restitution": e}, 0, 1e-4, FLOOR, SPRING * (1.0 + loss))
            for e, loss in zip((0.1, 0.5, 0.9), losses, strict=True)
        ),
        ({"restitution": 1.0}, 0, 1e-4, -9.0, SPRING),
        ({}, 0, -1e-4, 2.0, 0.0),
    ]


BY_HAND: dict[str, list[Numbers]] = {
    "hertz": [({}, 0, 1e-4, 9.0, SPRING)],
    "kelvin_voigt": [
        ({}, 0, 1e-4, 0.1, SPRING + 0.1 * DAMPING),
        ({"exponent": 1.0, "stiffness": 1e6}, 0, 1e-4, -0.1, 100.0 - 0.1 * DAMPING),
    ],
    "two_layer_elastic": [({}, 0, 1e-4, 0.1, SPRING), ({}, 1, 6e-4, 0.1, BOTH)],
    "two_layer_viscoelastic": [
        ({}, 0, 1e-4, 0.1, SPRING),
        ({}, 1, 6e-4, 0.1, BOTH + 0.1 * DAMPING),
        ({"damp_first_layer": True}, 0, 1e-4, 0.1, SPRING + 0.1 * DAMPING),
    ],
    "hunt_crossley": impact_damped(1.35, 0.75, 0.15),
    "lankarani_nikravesh": impact_damped(0.7425, 0.5625, 0.1425),
    "flores": impact_damped(14.4, 1.6, 8 / 45),
    "gonthier": impact_damped(9.9, 1.5, 19 / 90),
    "elastic_foundation": [({}, 0, 5e-4, 9.0, 424.641558678300)],
}
"""Forces of every law, from its published formula; another law gets a row here"""


def test_every_law_with_numbers_is_in_the_table():
    unknown = (BY_HAND.keys() | LAWS.keys()) - CONTACT_LAWS.keys()
    assert not unknown, f"{unknown}: name it in CONTACT_LAWS (knee_contact_ros/model/laws.py)"


@pytest.mark.parametrize("name", CONTACT_LAWS)
def test_every_law_has_forces_worked_out_by_hand(name):
    assert name in BY_HAND, (
        f"the law {name} has no tested number: add a row to BY_HAND in tests/model/test_laws.py"
    )
    for changes, layer, depth, rate, force in BY_HAND[name]:
        # rounding of a power, and of the depth in the second layer against that of the whole contact
        found = law(name, **changes).layers[layer].force_at(depth, rate)[0]
        assert found == pytest.approx(force, rel=1e-12), (name, changes, depth, rate)


@pytest.mark.parametrize(
    "name",
    [name for name in CONTACT_LAWS if all(layer.form == COMMON for layer in law(name).layers)],
)
@settings(max_examples=40)
@given(depth=depths, rate=st.floats(-0.5, 0.5), speed=st.floats(0.0, 1.0))
def test_every_row_of_the_common_formula_agrees_with_the_independent_reference(
    name, depth, rate, speed
):
    assert name in LAWS, (
        f"the law {name} is not in the reference: write it from its source into studies/reference/laws.py (LAWS)"
    )
    theirs = LAWS[name](**LAW_ARGUMENTS[name])
    layer = int(0.0 <= theirs.layer_depth < depth)
    force = (
        theirs.stiffness[layer] * (depth - layer * theirs.layer_depth) ** theirs.exponent[layer]
    )
    if layer:
        force += theirs.stiffness[0] * theirs.layer_depth ** theirs.exponent[0]
    impact = 1.0 + theirs.loss * rate / max(speed, theirs.least_impact_speed)
    force = force * impact + theirs.damping[layer] * rate
    found = law(name).layers[layer].force_at(depth, rate, speed)[0]
    assert found == pytest.approx(force, rel=1e-9, abs=1e-9)


def test_the_elastic_foundation_is_the_sum_of_its_springs():
    modulus, radius, depth = 24e6 * 0.62 / (1.38 * 0.24), 1.0 / (1.0 / 0.034 - 1.0 / 0.095), 5e-4
    # Independent of the closed form: rings of springs by the midpoint rule, of error 1/(2 x number)².
    rings, reach = 1000, math.sqrt(2.0 * radius * depth)
    width = reach / rings
    middles = [(ring + 0.5) * width for ring in range(rings)]
    summed = sum(
        modulus * (depth - r**2 / (2.0 * radius)) / 4.4e-3 * 2.0 * math.pi * r * width
        for r in middles
    )
    assert law("elastic_foundation").static_force(depth) == pytest.approx(summed, rel=1e-6)


def test_stiffness_of_the_papers_materials():
    radius = relative_radius(0.034, 0.095)
    assert radius == pytest.approx(0.034 * 0.095 / 0.061, rel=1e-14)
    bone, cartilage = hertz_stiffness(17.2e9, 0.39, radius), hertz_stiffness(24e6, 0.38, radius)
    # The values' last digits; in N/mm^1.5 the second time
    assert (bone, cartilage) == (
        pytest.approx(3.112e9, abs=0.5e6),
        pytest.approx(4.30e6, abs=0.005e6),
    )
    assert (bone / 10**4.5, cartilage / 10**4.5) == (
        pytest.approx(98408, abs=0.5),
        pytest.approx(136, abs=0.5),
    )


@pytest.mark.parametrize(
    ("femoral", "tibial"),
    [(0.034, 0.034), (0.095, 0.034), (0.034, -0.095), (0.0, 0.1), (-0.1, 0.1), (0.034, math.nan)],
)
def test_radii_that_do_not_fit_are_refused(femoral, tibial):
    refused: list[Callable[[], object]] = [
        lambda: relative_radius(femoral, tibial),
        lambda: law("elastic_foundation", femoral_radius=femoral, tibial_radius=tibial),
    ]
    for make in refused:
        with pytest.raises(
            ValueError, match=r"^0 < femoral radius < tibial radius \(concave\) is needed, got .*$"
        ):
            make()


@pytest.mark.parametrize(
    ("begins", "words"),
    [
        ((), "first layer must begin at 0 m"),
        ((1e-4,), "first layer must begin at 0 m"),
        ((0.0, 0.0), "each next one deeper"),
        ((0.0, 2e-4, 1e-4), "each next one deeper"),
        ((0.0, math.nan), "each next one deeper"),
    ],
)
def test_layers_out_of_order_are_refused(begins, words):
    with pytest.raises(ValueError, match=words):
        check(ContactLaw(tuple(Layer(begin, stiffness=1e6) for begin in begins)))
    check(ContactLaw((Layer(stiffness=1e6), Layer(1e-4, 1.0, 1e7))))


@pytest.mark.parametrize(
    ("force_at", "words"),
    [
        (
            lambda depth, rate: (1.0 + 1e6 * depth, 1e6, 0.0),
            "layer 2 does not begin with the force at which the layer before ends",
        ),
        (
            lambda depth, rate: (math.inf if depth > 1e-3 else 1e6 * depth, 1e6, 0.0),
            "is not finite",
        ),
        (lambda depth, rate: (1e6 * depth, 2e6, 0.0), "wrong or negative slopes"),
        (lambda depth, rate: (1e6 * depth - 5.0 * rate, 1e6, -5.0), "wrong or negative slopes"),
        (lambda depth, rate: (1e6 * depth + 5.0 * rate**2, 1e6, 0.0), "is not linear in the rate"),
    ],
)
def test_an_own_formula_that_is_no_law_is_refused(
    force_at,
    words,
    monkeypatch,
):
    """Its layer lies on a linear one that ends at 0.1 mm."""
    own = Layer(1e-4, form=1.0)
    common = Layer.force_at

    def formula(layer, depth, rate, speed=0.0):
        return force_at(depth, rate) if layer.form == 1.0 else common(layer, depth, rate, speed)

    monkeypatch.setattr(Layer, "force_at", formula)
    with pytest.raises(ValueError, match=words):
        check(ContactLaw((Layer(stiffness=1e6, exponent=1.0), own)))
