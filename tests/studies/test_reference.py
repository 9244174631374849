"""The reference that judges the model, against closed forms and against SciPy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import brentq

from benchmarks import reference as by_scipy
from benchmarks.gait import gait
from studies.accuracy import lift_off
from studies.reference import LAWS, Knee, Law, Reference, solve
from studies.reference.library import SOURCE, Accuracy
from studies.reference.radau_coefficients import header

K1, K2, C, LAYER, MASS = 7.905694e7, 3.112e9, 5000.0, 5e-4, 9.3014
SPRING = {"stiffness": K1, "exponent": 1.5}
LAYERS = SPRING | {"layer_depth": LAYER, "stiffness_2": K2}
IMPACT = SPRING | {"restitution": 0.5, "least_impact_speed": 0.1}
PEAK = 2.19 * 75.16 * 9.80665
ROUNDING = 1e-15
"""[m], [m/s]: closed forms are computed in double precision, and heights are a few centimetres"""


def thrown(law: Law) -> NDArray[np.float64]:
    """Rates [m/s] of a knee that is let go, thrown back and met without load: before the touch and behind it."""
    time = np.array([0.0, 0.01, 0.02, 0.04, 0.05, 0.06, 0.061, 0.062, 0.3, 0.31, 0.32, 0.33])
    load = np.array([50.0, -1.0, -1.0, -1.0, -1.0, 0.0, 1e3, 0.0, 0.0, 0.0, 0.0, 0.0])
    return solve(Knee(law, 2.0), time, np.zeros(12), load).rate


def delivered(e: float, loss: float) -> float:
    """Zero for the restitution that a loss delivers."""
    return (1.0 + e) * loss - math.log((1.0 + loss) / (1.0 - e * loss))


def test_the_table_of_coefficients_is_what_the_generator_makes() -> None:
    assert (SOURCE / "radau_table.h").read_text(encoding="utf-8") == header() + "\n"


@pytest.mark.parametrize(
    ("law", "millimetres"),
    [
        (LAWS["kelvin_voigt"](**SPRING, damping=C), 0.747035),
        (LAWS["two_layer_elastic"](**LAYERS), 0.538046),
    ],
)
def test_static_depth(law: Law, millimetres: float) -> None:
    solution = solve(Knee(law, MASS), [0.0, 1e-3], [0.1, 0.2], [PEAK, PEAK])
    assert 1e3 * solution.depth == pytest.approx(millimetres, abs=5e-7)
    assert solution.force == pytest.approx(PEAK, rel=ROUNDING)


@pytest.mark.parametrize("damping", [0.0, 40.0, 4e3, 4e7])
def test_linear_oscillator_under_a_ramp(damping: float) -> None:
    """M δ̈ + C δ̇ + K δ = L + r t from rest at L/K: δ = (L + r t)/K - r C/K² + a free oscillation."""
    stiffness, mass, load, ramp = 1e6, 2.0, 500.0, 2e4
    law = LAWS["kelvin_voigt"](stiffness=stiffness, exponent=1.0, damping=damping)
    time = np.linspace(0.0, 0.05, 26)
    solution = solve(Knee(law, mass), time, np.zeros(26), load + ramp * time)
    decay = 0.5 * damping / mass
    root = np.emath.sqrt(decay**2 - stiffness / mass)
    fast = decay + root
    slow, lag = stiffness / mass / fast, ramp * damping / stiffness**2
    # free part: lag at the beginning, and the rate -ramp/K
    free = (
        (lag * fast - ramp / stiffness) * np.exp(-slow * time)
        - (lag * slow - ramp / stiffness) * np.exp(-fast * time)
    ) / (fast - slow)
    exact = (load + ramp * time) / stiffness - lag + np.real(free)
    assert solution.depth == pytest.approx(exact, abs=1e-13 * lag + ROUNDING)


def test_a_clamped_contact_that_is_let_go_flies_from_where_its_force_ends() -> None:
    """A linear contact that creeps after its load, much quicker than a tick: at K δ + C δ̇ = 0, δ̇ = r/K, it lets go."""
    stiffness, damping, mass, load, ramp = 2.4e8, 4884.0, 0.0527, 16.0, -8276.0
    law = LAWS["kelvin_voigt"](stiffness=stiffness, exponent=1.0, damping=damping)
    time = np.array([0.0, 0.01, 0.0132])
    found = solve(
        Knee(law, mass), time, np.zeros(3), [load - 0.01 * ramp, load, load + 0.0032 * ramp]
    )
    # in contact L = K δ + C δ̇ + M δ̈ with δ̈ = 0: the force is the load's and ends with it; what began is long forgotten
    rate = ramp / stiffness
    flying = 0.0032 + load / ramp
    depth = -damping * rate / stiffness + rate * flying + ramp * flying**3 / (6.0 * mass)
    assert found.depth[-1] == pytest.approx(depth, rel=1e-12, abs=1e-14)


def test_free_flight_is_a_cubic() -> None:
    """Let go from rest and pulled off ever harder, turning: height and depth in closed form."""
    time, load = np.arange(6) * 0.01, -100.0 * np.arange(6) * 0.01
    angle, slope, a, b = 3.0 * time, 0.2, 0.03, 0.04
    solution = solve(Knee(LAWS["hertz"](**SPRING), 2.0, (a, b), slope), time, angle, load)

    def support(phi: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.sqrt(a**2 * np.sin(phi) ** 2 + b**2 * np.cos(phi) ** 2)

    before = support(angle - slope)
    first = (
        (a**2 - b**2) * math.sin(-slope) * math.cos(slope) / before[0] * 3.0
    )  # it follows its turning surface
    height = (before[0] + first * time) / math.cos(slope) + 100.0 * time**3 / 6.0 / 2.0
    assert solution.height == pytest.approx(height, abs=ROUNDING)
    assert solution.depth == pytest.approx(before - height * math.cos(slope), abs=ROUNDING)


@pytest.mark.parametrize("exponent", [1.0, 1.3, 1.5, 2.0, 2.7, 3.0])
def test_elastic_bounces_keep_their_energy(exponent: float) -> None:
    mass, load, stiffness = 1.0, 20.0, 3e3 ** (exponent + 0.5)
    time = np.arange(3000) * 1e-3
    loads = np.where(time < 0.02, 100.0, load)
    solution = solve(
        Knee(LAWS["hertz"](stiffness=stiffness, exponent=exponent), mass),
        time,
        np.zeros(3000),
        loads,
    )
    pressed = np.maximum(solution.depth, 0.0)
    energy = (
        mass / 2 * solution.rate**2
        + stiffness * pressed ** (exponent + 1) / (exponent + 1)
        - load * solution.depth
    )
    later = energy[25:]
    assert (solution.depth[25:] < 0.0).any()
    assert later == pytest.approx(later[0], rel=1e-13)


def test_what_an_impact_delivers() -> None:
    """The restitution e of K δⁿ (1 + D δ̇/v₀) solves (1 + e) D = ln((1 + D)/(1 - e D)), see Hunt & Crossley 1975."""
    rates = thrown(LAWS["hertz"](**SPRING))
    assert rates[-1] == pytest.approx(-rates[7], rel=1e-14)
    for name in ("hunt_crossley", "lankarani_nikravesh", "flores", "gonthier"):
        law = LAWS[name](**IMPACT)
        rates = thrown(law)
        wanted = brentq(
            delivered, 1e-3, min(1.0, 1.0 / law.loss) - 1e-12, args=(law.loss,), xtol=1e-16
        )
        assert rates[-1] == pytest.approx(-wanted * rates[7], rel=1e-12)


SCENES = {
    "gait": (LAWS["kelvin_voigt"](**SPRING, damping=C), by_scipy.kelvin_voigt(K1, 1.5, C)),
    "undamped": (LAWS["hertz"](**SPRING), by_scipy.kelvin_voigt(K1, 1.5, 0.0)),
    "layers": (
        LAWS["two_layer_viscoelastic"](**LAYERS, damping=C, damp_first_layer=False),
        by_scipy.two_layer(K1, 1.5, C, LAYER, K2, damped=False),
    ),
    "layers damped": (
        LAWS["two_layer_viscoelastic"](**LAYERS, damping=C, damp_first_layer=True),
        by_scipy.two_layer(K1, 1.5, C, LAYER, K2, damped=True),
    ),
    "impact": (LAWS["flores"](**IMPACT), by_scipy.impact_damped(K1, 1.5, 1.6, 0.1)),
}


@pytest.mark.parametrize(
    ("name", "series"),
    [("gait", "gait"), ("layers", "gait"), *((name, "lift-off") for name in SCENES)],
)
def test_scipy_agrees(name: str, series: str) -> None:
    law, layers = SCENES[name]
    time, angle, load = gait("right") if series == "gait" else lift_off()
    surface = by_scipy.ByHeight(by_scipy.ellipse_on_slope(0.034, 0.028, 0.12, 0.0))
    exact = by_scipy.solve(by_scipy.Scene(time, angle, load, layers, MASS, surface))
    solution = solve(Knee(law, MASS, (0.034, 0.028), 0.12), time, angle, load)
    # SciPy's relative tolerance is 1e-12, of heights of 34 mm, over some hundred steps; flights carry errors on
    assert solution.depth == pytest.approx(exact, abs=1e-11)
    assert np.max(solution.depth_bound) < 1e-14


@pytest.mark.parametrize("name", SCENES)
def test_series_and_implicit_steps_agree(name: str) -> None:
    law, _ = SCENES[name]
    knee = Knee(law, MASS, (0.034, 0.028), 0.12)
    other = Reference(knee, fine=Accuracy(1e-17, 1e-10, 26, 1e7, implicit=1))
    time, angle, load = lift_off()
    one, two = solve(knee, time, angle, load), other.take(time, angle, load)
    assert two.depth == pytest.approx(one.depth, abs=1e-14)
    assert two.force == pytest.approx(one.force, abs=1e-6)


def test_chunks_are_the_whole() -> None:
    law, _ = SCENES["layers"]
    time, angle, load = lift_off()
    whole, run = solve(Knee(law, MASS), time, angle, load), Reference(Knee(law, MASS))
    parts = [
        run.take(time[i : i + 100], angle[i : i + 100], load[i : i + 100])
        for i in range(0, len(time), 100)
    ]
    assert np.concatenate([part.depth for part in parts]).tobytes() == whole.depth.tobytes()


def test_what_is_given_up_is_unknown() -> None:
    law, _ = SCENES["gait"]
    solution = Reference(Knee(law, MASS), fine=Accuracy(1e-18, 1e-11, 26, 10.0)).take(*lift_off())
    first = int(np.argmax(np.isnan(solution.depth)))
    assert first > 0
    assert np.isnan(solution.depth[first:]).all()
    assert not np.isfinite(solution.depth_bound[first:]).any()
