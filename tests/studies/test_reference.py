"""The reference that judges the model, against closed forms and against SciPy."""

import numpy as np
import pytest

from benchmarks import reference as by_scipy
from benchmarks.gait import gait
from studies.accuracy import lift_off
from studies.reference import LAWS, Knee, Reference, solve
from studies.reference.library import SOURCE, Accuracy
from studies.reference.radau_coefficients import header

K1, K2, C, LAYER, MASS = 7.905694e7, 3.112e9, 5000.0, 5e-4, 9.3014
SPRING = {"stiffness": K1, "exponent": 1.5}
LAYERS = SPRING | {"layer_depth": LAYER, "stiffness_2": K2}
IMPACT = SPRING | {"restitution": 0.5, "least_impact_speed": 0.1}
PEAK = 2.19 * 75.16 * 9.80665
ROUNDING = 1e-15
"""[m], [m/s]: closed forms are computed in double precision, and heights are a few centimetres"""


def test_the_table_of_coefficients_is_what_the_generator_makes():
    assert (SOURCE / "radau_table.h").read_text(encoding="utf-8") == header() + "\n"


@pytest.mark.parametrize("damping", [0.0, 40.0, 4e3, 4e7])
def test_linear_oscillator_under_a_ramp(damping):
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


def test_a_clamped_contact_that_is_let_go_flies_from_where_its_force_ends():
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
def test_scipy_agrees(name, series):
    law, layers = SCENES[name]
    time, angle, load = gait("right") if series == "gait" else lift_off()
    surface = by_scipy.ByHeight(by_scipy.ellipse_on_slope(0.034, 0.028, 0.12, 0.0))
    exact = by_scipy.solve(by_scipy.Scene(time, angle, load, layers, MASS, surface))
    solution = solve(Knee(law, MASS, (0.034, 0.028), 0.12), time, angle, load)
    # SciPy's relative tolerance is 1e-12, of heights of 34 mm, over some hundred steps; flights carry errors on
    assert solution.depth == pytest.approx(exact, abs=1e-11)
    assert np.max(solution.depth_bound) < 1e-14


@pytest.mark.parametrize("name", SCENES)
def test_series_and_implicit_steps_agree(name):
    law, _ = SCENES[name]
    knee = Knee(law, MASS, (0.034, 0.028), 0.12)
    other = Reference(knee, fine=Accuracy(1e-17, 1e-10, 26, 1e7, implicit=1))
    time, angle, load = lift_off()
    one, two = solve(knee, time, angle, load), other.take(time, angle, load)
    assert two.depth == pytest.approx(one.depth, abs=1e-14)
    assert two.force == pytest.approx(one.force, abs=1e-6)


def test_chunks_are_the_whole():
    law, _ = SCENES["layers"]
    time, angle, load = lift_off()
    whole, run = solve(Knee(law, MASS), time, angle, load), Reference(Knee(law, MASS))
    parts = [
        run.take(time[i : i + 100], angle[i : i + 100], load[i : i + 100])
        for i in range(0, len(time), 100)
    ]
    assert np.concatenate([part.depth for part in parts]).tobytes() == whole.depth.tobytes()


def test_what_is_given_up_is_unknown():
    law, _ = SCENES["gait"]
    solution = Reference(Knee(law, MASS), fine=Accuracy(1e-18, 1e-11, 26, 10.0)).take(*lift_off())
    first = int(np.argmax(np.isnan(solution.depth)))
    assert first > 0
    assert np.isnan(solution.depth[first:]).all()
    assert not np.isfinite(solution.depth_bound[first:]).any()
