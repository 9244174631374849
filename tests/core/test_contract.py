"""The contract of contact laws: every law of the table keeps it, and what breaks a clause is refused with its name."""

from __future__ import annotations

import inspect
import itertools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from knee_contact_ros import UsageError, load_model
from knee_contact_ros.core.contact_laws import CONTACT_LAWS
from knee_contact_ros.core.contact_laws.base import ContactLaw, Layer, power_law
from knee_contact_ros.core.contact_laws.contract import broken_clauses, check
from knee_contact_ros.core.contact_laws.hertz import HertzFormula
from knee_contact_ros.core.contact_laws.impact_damping import ImpactDamped
from knee_contact_ros.core.contact_laws.kelvin_voigt import KelvinVoigtFormula
from knee_contact_ros.core.contact_laws.two_layer import SpringAndDashpot
from knee_contact_ros.parameters.build import contact_law
from knee_contact_ros.parameters.schema import ContactParameters
from tests.helpers.scenes import LAW_ARGUMENTS, law, model

K, C = 7.9e7, 5e3
H = 5e-4
"""[m] where the second layer begins, or a kink is"""
ForceAt = Callable[[float, float, float], tuple[Any, ...]]


class Own(NamedTuple):
    """A formula of one's own."""

    of: ForceAt
    remembers: bool = False

    def force_at(self, depth: float, rate: float, impact_speed: float) -> tuple[Any, ...]:
        """See `LayerFormula`."""
        return self.of(depth, rate, impact_speed)

    def remembers_impact(self) -> bool:
        """See `LayerFormula`."""
        return self.remembers


def one_layer(of: ForceAt, remembers: bool = False) -> ContactLaw:
    """A law of one formula."""
    return ContactLaw((Layer(0.0, Own(of, remembers)),))


def two_layers(first: ForceAt, second: ForceAt) -> ContactLaw:
    """A law whose second layer begins at `H`."""
    return ContactLaw((Layer(0.0, Own(first)), Layer(H, Own(second))))


def spring(depth: float) -> tuple[float, float]:
    """Hertz."""
    return power_law(K, 1.5, depth)


def good(depth: float, rate: float, _: float) -> tuple[float, float, float]:
    """Kelvin-Voigt."""
    force, slope = spring(depth)
    return force + C * rate, slope, C


def allowed(name: str) -> tuple[float, float]:
    """Range of a parameter of the contact law."""
    bounds = {key: getattr(limit, key) for limit in ContactParameters.model_fields[name].metadata
              for key in ("ge", "gt", "le", "lt") if hasattr(limit, key)}  # fmt: skip
    low, high = bounds.get("ge", bounds.get("gt")), bounds.get("le", bounds.get("lt"))
    assert low is not None
    assert high is not None
    return low, high


def constant(data: st.DataObject, name: str) -> float | bool:
    """A parameter anywhere in its range; one that goes over decades by its logarithm."""
    if isinstance(ContactParameters.model_fields[name].default, bool):
        return data.draw(st.booleans())
    low, high = allowed(name)
    if name in ("exponent", "restitution", "poissons_ratio"):
        return min(data.draw(st.floats(low, high)), math.nextafter(high, low) if name == "poissons_ratio" else high)
    if low == 0.0 and name == "damping" and data.draw(st.booleans()):
        return 0.0
    return min(10.0 ** data.draw(st.floats(math.log10(max(low, 1e-12)), math.log10(high))), high)


@pytest.mark.parametrize("name", CONTACT_LAWS)
@settings(deadline=None, max_examples=60)
@given(data=st.data())
def test_every_law_keeps_the_contract_with_all_constants_allowed(name: str, data: st.DataObject) -> None:
    constants = {argument: constant(data, argument) for argument in inspect.signature(CONTACT_LAWS[name]).parameters}
    if "tibial_radius" in constants:
        assume(constants["femoral_radius"] < constants["tibial_radius"])
    assert broken_clauses(CONTACT_LAWS[name](**constants)) == []


@pytest.mark.parametrize("name", CONTACT_LAWS)
def test_every_law_keeps_the_contract_at_the_ends_of_what_is_allowed(name: str) -> None:
    arguments = [argument for argument in LAW_ARGUMENTS[name] if not argument.endswith("_radius")]
    ends = [(False, True) if argument == "damp_first_layer" else
            tuple(end or 1e-12 for end in allowed(argument)) for argument in arguments]  # fmt: skip
    for values in itertools.product(*ends):
        changes = dict(zip(arguments, values, strict=True))
        if changes.get("poissons_ratio") == 0.5:
            changes["poissons_ratio"] = math.nextafter(0.5, 0.0)
        assert broken_clauses(law(name, **changes)) == [], changes


def steep(depth: float, rate: float, _: float) -> tuple[float, float, float]:
    """A force that grows e-fold every 20 µm."""
    scaled = math.exp(min(max(depth, 0.0) / 2e-5, 600.0))
    return 0.01 * (scaled - 1.0) + C * rate, 500.0 * scaled if depth >= 0.0 else 0.0, C


def growing_damping(depth: float, rate: float, _: float) -> tuple[float, float, float]:
    """Damping K'δ, of less power than the spring."""
    force, slope = spring(depth)
    damping = 1e6 * max(depth, 0.0)
    return force + damping * rate, slope + (1e6 * rate if depth > 0.0 else 0.0), damping


@pytest.mark.parametrize("of", [good, steep, growing_damping])
def test_laws_of_ones_own_are_as_good(of: ForceAt) -> None:
    own = one_layer(of)
    check(own)
    model(own)


def nan_before_touch(depth: float, rate: float, _: float) -> tuple[float, float, float]:
    return (*good(depth, rate, _)[:2], C if depth > -1e-3 else math.nan)


def overflowing(depth: float, _rate: float, _: float) -> tuple[float, float, float]:
    scaled = math.exp(depth / 2e-5)
    return 0.01 * (scaled - 1.0), 500.0 * scaled, 0.0


def complex_before_touch(depth: float, _rate: float, _: float) -> tuple[Any, ...]:
    return K * depth**1.5, 1.5 * K * depth**0.5, 0.0


def over_impact_speed(depth: float, rate: float, impact_speed: float) -> tuple[float, float, float]:
    force, slope = spring(depth)
    return force * (1.0 + rate / impact_speed), slope, force / impact_speed


def secret_impact(depth: float, rate: float, impact_speed: float) -> tuple[float, float, float]:
    damping = C * (1.0 + impact_speed)
    return spring(depth)[0] + damping * rate, spring(depth)[1], damping


def impact_at_rest(depth: float, rate: float, impact_speed: float) -> tuple[float, float, float]:
    stiffer = 1.0 + 0.01 * max(impact_speed, 0.0)
    force, slope = spring(depth)
    return stiffer * force + C * rate, stiffer * slope, C


def preloaded(depth: float, rate: float, _: float) -> tuple[float, float, float]:
    return good(depth, rate, _)[0] + 10.0, *good(depth, rate, _)[1:]


def leaping(depth: float, rate: float, _: float) -> tuple[float, float, float]:
    force, slope, damping = good(depth, rate, _)
    return force + (10.0 if depth > H else 0.0), slope, damping


def kinked(depth: float, rate: float, _: float) -> tuple[float, float, float]:
    beyond = max(depth - H, 0.0)
    force, slope, damping = good(depth, rate, _)
    return force + 1e5 * beyond, slope + (1e5 if depth > H else 0.0), damping


def kinked_damping(depth: float, rate: float, _: float) -> tuple[float, float, float]:
    force, slope = spring(depth)
    damping, more = C * min(max(depth / H, 0.0), 1.0), C / H if 0.0 < depth <= H else 0.0
    whole = force + damping * rate
    return whole, slope + more * rate if whole >= 0.0 else max(slope + more * rate, 0.0), damping


def leaping_before_touch(depth: float, rate: float, _: float) -> tuple[float, float, float]:
    force, slope, damping = good(depth, rate, _)
    return force - (5.0 if depth < 0.0 else 0.0), slope, damping


def quadratic_damping(depth: float, rate: float, _: float) -> tuple[float, float, float]:
    force, slope = spring(depth)
    return force + C * rate * abs(rate), slope, 2.0 * C * abs(rate)


def clamped(depth: float, rate: float, _: float) -> tuple[float, float, float]:
    force, slope, damping = good(depth, rate, _)
    return (force, slope, damping) if force > 0.0 else (0.0, 0.0, 0.0)


def falling(depth: float, rate: float, _: float) -> tuple[float, float, float]:
    near = min(max(depth, 0.0), 2e-3)
    return 1e6 * near * (1.0 - near / 2e-3) + C * rate, 0.0, C


def concave(depth: float, rate: float, _: float) -> tuple[float, float, float]:
    scaled = math.exp(-min(max(depth, 0.0), 1.0) / 1e-3)
    return 1e3 * (1.0 - scaled) + C * rate, 1e6 * scaled if depth >= 0.0 else 0.0, C


def negative_damping(depth: float, rate: float, _: float) -> tuple[float, float, float]:
    return spring(depth)[0] - C * rate, spring(depth)[1], -C


def blunt_where_it_pulls(depth: float, rate: float, _: float) -> tuple[float, float, float]:
    force, slope = spring(depth)
    return force * (1.0 + rate), slope * max(1.0 + rate, 0.0), force


def one_percent_soft(depth: float, rate: float, _: float) -> tuple[float, float, float]:
    force, slope, damping = good(depth, rate, _)
    return force, 0.99 * slope, damping


def one_percent_damped(depth: float, rate: float, _: float) -> tuple[float, float, float]:
    return (*good(depth, rate, _)[:2], 1.01 * C)


def hidden_negative(depth: float, rate: float, _: float) -> tuple[float, float, float]:
    """Its true slope is negative where it still presses, shortly before it lets go; it says 0."""
    force, slope = spring(depth)
    deep = max(depth, 0.0)
    damping = 1e13 * deep**3
    return force + damping * rate, max(slope + 3e13 * deep**2 * rate, 0.0), damping


hertz_formula = HertzFormula(K, 1.5)
twice = SpringAndDashpot(0.0, 0.0, K, 1.5, 0.0)


@pytest.mark.parametrize(
    ("broken", "words"),
    [
        (ContactLaw(()), "layers: there is none"),
        (ContactLaw((Layer(1e-3, hertz_formula),)), "layers: the first one begins at 0.001 m; allowed is 0"),
        (ContactLaw((Layer(0.0, hertz_formula), Layer(H, hertz_formula), Layer(1e-4, hertz_formula))),
         "layers: one begins at 0.0001 m, and the one before at 0.0005 m"),
        (ContactLaw((Layer(0.0, hertz_formula), Layer(0.0, hertz_formula))), "layers: one begins at 0 m"),
        (ContactLaw((Layer(0.0, hertz_formula), Layer(math.inf, hertz_formula))), "layers: one begins at inf m"),
        (ContactLaw((Layer(0.0, hertz_formula),), 0.0), "layers: the thickness is 0 m; allowed is > 0"),
        (ContactLaw((Layer(0.0, hertz_formula), Layer(H, twice))),
         "layers: their formulas are of several types, HertzFormula and SpringAndDashpot; allowed is one"),
        (ContactLaw((Layer(0.0, Own(good)), Layer(H, Own(good, True)))), "layers: remembers_impact is true in some"),
        (one_layer(nan_before_touch), r"layer 1 \(Own\), finite: at a depth of -10 m and a rate of -10000 m/s"),
        (one_layer(overflowing), r"layer 1 \(Own\), finite: at a depth of 1 m .* all must be finite"),
        (one_layer(complex_before_touch), r"layer 1 \(Own\), finite: at a depth of -10 m"),
        (one_layer(over_impact_speed, True), r"finite: at a depth of .* all must be finite"),
        (one_layer(secret_impact), r"impact: .* after one at 2 m/s; remembers_impact is false"),
        (one_layer(impact_at_rest, True), r"impact: .* a rate of 0 m/s .*; at rest it must be the same"),
        (one_layer(preloaded), r"touch: at a depth of 0 m and a rate of 0 m/s the force is 10 N; allowed is 0"),
        (two_layers(good, preloaded), r"layer 2 \(Own\), joint: at a depth of 0.0005 m and at rest the force leaps"),
        (one_layer(leaping), r"smooth: at a depth of 0.0005 m .* the force goes from .* at once"),
        (one_layer(kinked), r"smooth: at a depth of 0.0005 m .* its slope from .* inside a layer"),
        (one_layer(kinked_damping), r"smooth: at a depth of 0.0005 m and a rate of 10 m/s .* its slope from"),
        (one_layer(leaping_before_touch), r"smooth: at a depth of 0 m .* the force is 0 N, and -1e-09 m off -5 N"),
        (one_layer(quadratic_damping), r"affine: at a depth of .* it must be"),
        (one_layer(clamped), r"affine: at a depth of .* the force is 0 N"),
        (one_layer(falling), r"rising: at a depth of 0.00316228 m .* less than"),
        (one_layer(concave), r"rising: .* the slope is .* within a layer it must not fall"),
        (one_layer(negative_damping), r"slopes: .* allowed is >= 0"),
        (one_layer(blunt_where_it_pulls), r"slopes: .* that over the depth is 0 N/m; the force says -"),
        (one_layer(one_percent_soft), r"slopes: .* that over the depth is .* the force says"),
        (one_layer(one_percent_damped), r"slopes: .* that over the rate is 5050 N s/m; the force says 5000 N s/m"),
        (one_layer(hidden_negative), r"slopes: .* that over the depth is 0 N/m; the force says -"),
    ],
)  # fmt: skip
def test_a_law_that_breaks_a_clause_is_refused_with_its_name(broken: ContactLaw, words: str) -> None:
    with pytest.raises(ValueError, match=f"^contact law: .*{words}") as refused:
        model(broken)
    assert "\n" not in str(refused.value)


def test_a_formula_that_changes_is_refused() -> None:
    calls = 0

    def wearing(depth: float, rate: float, _: float) -> tuple[float, float, float]:
        nonlocal calls
        calls += 1
        force, slope = power_law(K * (1.0 + 1e-4 * calls), 1.5, depth)
        return force + C * rate, slope, C

    assert any("pure: " in broken for broken in broken_clauses(one_layer(wearing)))


def test_what_breaks_one_clause_breaks_no_other() -> None:
    """So that the words are those of the mistake."""
    alone = (one_percent_soft, one_percent_damped, preloaded, quadratic_damping, leaping_before_touch, negative_damping)
    for of in alone:
        assert len(broken_clauses(one_layer(of))) == (2 if of is quadratic_damping else 1), of


def test_equal_numbers_of_another_type_are_another_law() -> None:
    """Named tuples compare by their numbers alone."""

    class Mistyped(NamedTuple):
        stiffness: float
        exponent: float
        damping: float

        def force_at(self, depth: float, rate: float, _: float) -> tuple[float, float, float]:
            force, slope = power_law(self.stiffness, self.exponent, depth)
            return force + self.damping * rate, 1.01 * slope, self.damping

        def remembers_impact(self) -> bool:
            return False

    right = ContactLaw((Layer(0.0, KelvinVoigtFormula(K, 1.5, C)),))
    wrong = ContactLaw((Layer(0.0, Mistyped(K, 1.5, C)),))
    assert right == wrong
    assert broken_clauses(right) == []
    assert broken_clauses(wrong) != []


def test_a_law_that_has_no_hash_is_tried_all_the_same() -> None:
    class Listed(NamedTuple):
        constants: list[float]

        def force_at(self, depth: float, rate: float, _: float) -> tuple[float, float, float]:
            force, slope = power_law(self.constants[0], 1.5, depth)
            return force, 1.01 * slope, 0.0 * rate

        def remembers_impact(self) -> bool:
            return False

    assert broken_clauses(ContactLaw((Layer(0.0, Listed([K])),)))


def test_where_impact_damping_pulls_its_slope_is_still_the_true_one() -> None:
    formula = ImpactDamped(K, 1.5, 1.0, 0.1)
    force, slope, damping = formula.force_at(1e-4, -1.0, 0.5)
    before, after = (formula.force_at(1e-4 + offset, -1.0, 0.5)[0] for offset in (-1e-10, 1e-10))
    assert force < 0.0
    assert slope == pytest.approx((after - before) / 2e-10, rel=1e-6)  # rounding of a difference of 2e-10 m
    assert damping > 0.0


def test_a_law_of_the_table_that_breaks_it_is_refused_from_parameters(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(CONTACT_LAWS, "hertz", lambda stiffness: one_layer(one_percent_soft))
    words = r"^parameter contact\.law: hertz: contact law: layer 1 \(Own\), slopes: .* the force says"
    with pytest.raises(UsageError, match=words):
        load_model({"contact.law": "hertz"})
    with pytest.raises(UsageError, match=words):
        contact_law(ContactParameters(law="hertz"))
