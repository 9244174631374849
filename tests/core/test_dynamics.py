"""One tick with events, against closed forms."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from knee_contact_ros.core.contact_laws import CONTACT_LAWS
from knee_contact_ros.core.contact_laws.base import ContactLaw
from knee_contact_ros.core.scene import DYNAMIC
from tests.helpers.scenes import STIFFNESS, advance, law

SPEED = 0.3
TOLERANCE = 1e-10


def impact(contact_law: ContactLaw, duration: float) -> tuple[float, float]:
    """Depth and rate after an impact without load from touch at SPEED."""
    result = advance(contact_law, 0.0, SPEED, duration, tolerance=TOLERANCE)
    return result.depth, result.rate


def stored_energy(contact_law: ContactLaw, depth: float) -> float:
    """Elastic energy at a depth: the static force summed up over the depth, layer by layer."""
    if depth <= 0.0:
        return 0.0
    borders = [layer.begin for layer in contact_law.layers if layer.begin < depth]
    parts = itertools.pairwise([*borders, depth])
    return sum(quad(contact_law.static_force, *part, epsabs=0.0, epsrel=1e-11)[0] for part in parts)


def test_hertz_impact_has_its_depth_and_duration_and_gives_all_energy_back() -> None:
    deepest = (5 * SPEED**2 / (4 * STIFFNESS)) ** 0.4  # m = 1 kg
    # Hertz 1882: twice the integral of 1/√(1 - x^2.5) from 0 to 1, which is 2.943 (by Beta functions).
    duration = 0.8 * math.sqrt(math.pi) * math.gamma(0.4) / math.gamma(0.9) * deepest / SPEED
    assert impact(law("hertz"), 0.5 * duration)[0] == pytest.approx(deepest, abs=10 * TOLERANCE)
    depth, rate = impact(law("hertz"), 0.02)
    # TOLERANCE x natural frequency (about 1.5 SPEED/deepest = 1e3 rad/s) over SPEED is 3e-7; with room
    assert rate == pytest.approx(-SPEED, rel=1e-6)
    # It parted at the end of the contact, and has flown at that speed since.
    assert 0.02 + depth / SPEED == pytest.approx(duration, rel=1e-6)


def test_linear_kelvin_voigt_impact_is_the_damped_oscillator() -> None:
    spring, dashpot = 1e6, 400.0
    linear = law("kelvin_voigt", stiffness=spring, exponent=1.0, damping=dashpot)
    decay, t = dashpot / 2, 1e-3
    frequency = math.sqrt(spring - decay**2)
    exact = SPEED / frequency * math.exp(-decay * t) * math.sin(frequency * t)
    assert impact(linear, t)[0] == pytest.approx(exact, abs=10 * TOLERANCE)
    # The force ends where K δ + C δ̇ = 0, at tan(ω t) = -2 decay ω / (ω² - decay²); from there the femur flies.
    ends = (math.pi - math.atan2(2 * decay * frequency, frequency**2 - decay**2)) / frequency
    speed = (
        SPEED * math.exp(-decay * ends) * (math.cos(frequency * ends) - decay / frequency * math.sin(frequency * ends))
    )
    assert impact(linear, 0.02)[1] == pytest.approx(speed, rel=1e-6)


def test_with_tension_the_law_pulls() -> None:
    linear = law("kelvin_voigt", stiffness=1e6, exponent=1.0, damping=400.0)
    held = advance(linear, 1e-5, -SPEED, 1e-6, allow_tension=True)
    free = advance(linear, 1e-5, -SPEED, 1e-6)
    assert held.force < 0.0
    assert free.force == 0.0


def test_a_knee_that_is_pulled_apart_flies_on_a_parabola() -> None:
    result = advance(law("kelvin_voigt"), -1e-3, 0.0, 0.01, load=-50.0, mass=2.0)
    assert result.depth == pytest.approx(-1e-3 - 0.5 * 25.0 * 0.01**2, abs=1e-16)
    assert result.evaluations == 0


def test_the_layer_is_met_exactly() -> None:
    # Undamped: the energy tells the speed at any depth on both sides of the layer.
    elastic = law("two_layer_elastic")
    result = advance(elastic, 4e-4, 0.5, 5e-4, tolerance=TOLERANCE)
    before = stored_energy(elastic, 4e-4) + 0.5 * 0.5**2
    after = stored_energy(elastic, result.depth) + 0.5 * result.rate**2
    # An error of TOLERANCE in depth is worth TOLERANCE x force (2 kN at most here).
    assert after == pytest.approx(before, abs=10 * TOLERANCE * 2e3)


@pytest.mark.parametrize("name", CONTACT_LAWS)
@settings(deadline=None, max_examples=60)
@given(
    depth=st.floats(-1e-3, 1e-3),
    rate=st.floats(-1.0, 1.0),
    mass=st.floats(0.1, 100.0),
    duration=st.floats(1e-4, 0.02),
)
def test_without_load_no_energy_is_made(name: str, depth: float, rate: float, mass: float, duration: float) -> None:
    contact_law = law(name)
    result = advance(contact_law, depth, rate, duration, mass=mass, tolerance=1e-9)
    before = stored_energy(contact_law, depth) + 0.5 * mass * rate**2
    after = stored_energy(contact_law, result.depth) + 0.5 * mass * result.rate**2
    # An error within the tolerance is worth tolerance x force in depth, and as much again in speed.
    assert after <= before + 2e-9 * contact_law.static_force(5e-3)
    assert result.force >= 0.0
    assert result.converged
    assert result.run_state.fidelity == DYNAMIC


def test_the_estimate_covers_the_error_of_an_impact() -> None:
    loose = advance(law("kelvin_voigt"), 0.0, SPEED, 5e-3, load=500.0, tolerance=1e-5)
    tight = advance(law("kelvin_voigt"), 0.0, SPEED, 5e-3, load=500.0, tolerance=1e-12)
    assert abs(loose.depth - tight.depth) <= loose.error_estimate <= 1e-5


def test_a_state_on_the_boundary_goes_where_it_moves() -> None:
    assert advance(law("kelvin_voigt"), 0.0, -SPEED, 1e-3).depth == pytest.approx(-SPEED * 1e-3, rel=1e-12)
    assert advance(law("kelvin_voigt"), 0.0, SPEED, 1e-4).depth > 0.0
