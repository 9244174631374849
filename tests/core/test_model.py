"""The model as users call it: against independent solvers, and the promises of its interface."""

from __future__ import annotations

import copy
import math
import pickle
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from knee_contact_ros.core.contact_laws.base import ContactLaw, Layer, LayerFormula
from knee_contact_ros.core.levels import LEVELS
from knee_contact_ros.core.model import LARGEST_ANGLE, LARGEST_LOAD
from knee_contact_ros.core.types import Contact, ContactState, Fidelity, Point, Status
from tests.core.surfaces import ellipse
from tests.helpers.scenes import DAMPING, LAW_ARGUMENTS, MASS, RADIUS, STIFFNESS, law, model, quick

TICKS = np.arange(0.0, 0.4, 0.005)
ANGLE = 0.3 + 0.5 * np.sin(2 * np.pi * TICKS)
LOAD = 700.0 + 400.0 * np.sin(2 * np.pi * 3.0 * TICKS)


def read_reference(path: Path) -> np.ndarray:
    """One table of the independent solver."""
    return np.genfromtxt(path, delimiter=",", comments="#", skip_header=3, names=True)


@pytest.mark.parametrize("tolerance", [1e-6, 1e-8, 1e-10])
@pytest.mark.parametrize(
    ("scene", "name"),
    [
        ("gait2354_right_kelvin_voigt", "kelvin_voigt"),
        ("gait2354_right_two_layer", "two_layer_viscoelastic"),
        ("pull_apart_and_land", "kelvin_voigt"),
    ],
)
def test_independent_answers_are_met_to_the_tolerance(
    reference_data: Path, scene: str, name: str, tolerance: float
) -> None:
    reference = read_reference(reference_data / "reference" / f"{scene}.csv")
    series = quick(model(law(name), tolerance)).run(reference["t"], reference["flexion_angle"], reference["load"])
    depth = series.penetration_depth - series.gap
    error = np.abs(depth - (RADIUS - reference["femoral_height"]))
    assert error.max() <= tolerance
    # The reference is given to 1e-14 m; the static start is exact on both sides.
    assert np.mean(error <= series.error_estimate + 1e-14) >= 0.98
    assert np.mean(series.status & Status.NOT_CONVERGED == 0) >= 0.6


def test_a_general_solver_gives_the_same_knee() -> None:
    """SciPy on the turning ellipse, restarted at every tick: other method, other formulation (depth as the state)."""
    geometry = ellipse(160)
    series = model(law("kelvin_voigt"), 1e-9, geometry).run(TICKS, ANGLE, LOAD)

    def surface(angle: float, rate: float) -> tuple[float, float]:
        h, slope = geometry.support(angle)
        return h, slope * rate

    depth = (LOAD[0] / STIFFNESS) ** (1 / 1.5)
    first_rate = (ANGLE[1] - ANGLE[0]) / (TICKS[1] - TICKS[0])
    h, h_rate = surface(ANGLE[0], first_rate)
    state = np.array([h - depth, h_rate])
    for i in range(1, len(TICKS)):
        duration = TICKS[i] - TICKS[i - 1]
        rate, load_rate = (ANGLE[i] - ANGLE[i - 1]) / duration, (LOAD[i] - LOAD[i - 1]) / duration

        def motion(s: float, z: np.ndarray, i: int = i, rate: float = rate, slope: float = load_rate) -> list[float]:
            h, h_rate = surface(ANGLE[i - 1] + rate * s, rate)
            force = max(STIFFNESS * max(h - z[0], 0.0) ** 1.5 + DAMPING * (h_rate - z[1]), 0.0)
            return [z[1], (force - LOAD[i - 1] - slope * s) / MASS]

        state = solve_ivp(motion, (0.0, duration), state, method="DOP853", rtol=1e-11, atol=1e-14).y[:, -1]
        assert series.femoral_height[i] == pytest.approx(state[0], abs=1e-9)


def test_run_and_tick_give_the_same_bits() -> None:
    knee = model(law("two_layer_viscoelastic"), 1e-6, ellipse(40))
    series = knee.run(TICKS, ANGLE, LOAD)
    stream = knee.stream()
    rows = [stream.tick(*row) for row in zip(TICKS.tolist(), ANGLE.tolist(), LOAD.tolist(), strict=True)]
    assert b"".join(row.tobytes() for row in rows) == series.tobytes()


def test_times_that_name_the_same_nanosecond_give_the_same_bits() -> None:
    stamps = np.arange(530_000_000, 730_000_000, 5_000_000)
    angle, load = np.linspace(0.1, 0.3, len(stamps)), np.linspace(300.0, 900.0, len(stamps))
    knee = model(law("kelvin_voigt"), 1e-6)
    series = [
        knee.run(time, angle, load).tobytes()
        for time in (stamps / 1e9, stamps * 1e-9, stamps // 10**9 + (stamps % 10**9) * 1e-9)
    ]
    assert series[0] == series[1] == series[2]


@pytest.mark.parametrize("name", ["kelvin_voigt", "two_layer_viscoelastic"])
def test_the_first_tick_is_the_static_solution(name: str) -> None:
    first = model(law(name)).stream().tick(0.0, 0.2, 1614.18)
    assert first.contact_force == pytest.approx(1614.18, rel=1e-12)
    assert first.penetration_rate == 0.0
    assert first.error_estimate == 0.0
    assert first.fidelity == Fidelity.DYNAMIC


def test_the_depth_of_a_circle_does_not_depend_on_the_angle() -> None:
    knee = model(law("kelvin_voigt"))
    assert np.array_equal(
        knee.run(TICKS, ANGLE, LOAD).penetration_depth, knee.run(TICKS, 0.0 * ANGLE, LOAD).penetration_depth
    )


def test_a_heavier_load_goes_deeper_by_the_law() -> None:
    load = np.full_like(TICKS, 1000.0)
    depths = [model(law("kelvin_voigt")).run(TICKS, ANGLE, load * k).penetration_depth[-1] for k in (1.0, 1.01)]
    assert depths[1] / depths[0] == pytest.approx(1.01 ** (2 / 3), rel=1e-9)


def test_the_knee_lifts_off_and_lands() -> None:
    load = np.where((TICKS > 0.1) & (TICKS < 0.2), -80.0, 600.0)
    series = model(law("kelvin_voigt"), 1e-6).run(TICKS, ANGLE, load)
    apart = series.contact_state == ContactState.SEPARATED
    assert apart.any()
    assert series.contact_state[-1] == ContactState.CARTILAGE
    assert np.all(series.contact_force[apart] == 0.0)
    assert np.all(series.gap[apart] >= 0.0)
    assert np.all(series.penetration_depth * series.gap == 0.0)
    assert np.all(series.contact_force >= 0.0)
    # A knee thrown 5 cm off carries its speed's error along: what exceeds the tolerance is said, and covered.
    exact = quick(model(law("kelvin_voigt"), 1e-11)).run(TICKS, ANGLE, load)
    assert np.all(np.abs(series.femoral_height - exact.femoral_height) <= series.error_estimate + 1e-14)
    assert np.array_equal(series.status == Status.NOT_CONVERGED, series.error_estimate > 1e-6)


def test_layers_share_the_depth() -> None:
    series = model(law("two_layer_viscoelastic")).run(TICKS, ANGLE, LOAD + 800.0)
    bone = series.contact_state == ContactState.BONE
    assert bone.any()
    assert np.array_equal(bone, series.penetration_depth > 5e-4)
    assert series.cartilage_depth + series.bone_depth == pytest.approx(series.penetration_depth, abs=1e-18)
    assert np.all(series.cartilage_depth <= 5e-4)


def test_the_contact_point_lies_on_the_plateau_under_the_lowest_point() -> None:
    geometry = ellipse(320)
    series = model(law("kelvin_voigt"), geometry=geometry).run(TICKS, ANGLE, LOAD)
    a, b = 0.034, 0.028
    h = np.hypot(a * np.sin(ANGLE), b * np.cos(ANGLE))
    assert series.contact_point.x == pytest.approx(-(a * a - b * b) * np.sin(ANGLE) * np.cos(ANGLE) / h, abs=1e-8)
    assert np.all(series.contact_point.y == 0.0)


def test_a_sloped_plateau_carries_the_load_by_its_normal_force() -> None:
    slope = 0.15
    load = np.full_like(TICKS, 1000.0)
    series = model(law("kelvin_voigt"), slope=slope).run(TICKS, 0.0 * ANGLE, load)
    assert series.contact_force[-1] * math.cos(slope) == pytest.approx(1000.0, rel=1e-9)
    last = series[-1]
    assert last.contact_point.y / last.contact_point.x == pytest.approx(math.tan(slope), rel=1e-12)
    # Distance of the reference point from the plateau: the radius less the depth.
    assert last.femoral_height * math.cos(slope) == pytest.approx(RADIUS - last.penetration_depth, abs=1e-15)


def test_a_budget_is_kept_and_missing_it_is_said() -> None:
    rough = LOAD * np.where(np.arange(len(TICKS)) % 2, 1.0, 0.2)
    series = quick(model(law("two_layer_viscoelastic"), 1e-10, budget=100)).run(TICKS, ANGLE, rough)
    # One step in the making may still be finished: 15 stages with a handful of Newton corrections each.
    assert series.evaluations.max() <= 100 + 15 * 30
    missed = series.status & Status.NOT_CONVERGED != 0
    settled = series.fidelity == Fidelity.QUASI_STATIC
    assert settled.any()
    assert np.all(missed[settled])
    # What could not be computed is answered with the static solution, and the next tick goes on from there.
    assert series.contact_force[settled] == pytest.approx(rough[settled], rel=1e-12)
    exact = quick(model(law("two_layer_viscoelastic"), 1e-10)).run(TICKS, ANGLE, rough)
    assert np.all(np.abs(series.penetration_depth - exact.penetration_depth)[settled] <= series.error_estimate[settled])


@pytest.mark.parametrize(
    ("time", "angle", "load", "words"),
    [
        ([0.0, 1.0], [0.0], [1.0, 1.0], "equal length"),
        ([[0.0]], [[0.0]], [[1.0]], "one-dimensional"),
        ([0.0, math.nan], [0.0, 0.0], [1.0, 1.0], "finite"),
        ([0.0, 1.0], [0.0, math.inf], [1.0, 1.0], "finite"),
        ([0.0, 1.0], [0.0, 1e300], [1.0, 1.0], "must not exceed 10 rad"),
        ([0.0, 1.0], [0.0, 0.0], [1.0, -1e9], "must not exceed 10 rad, 1e\\+06 N and 10 m"),
        ([0.0, 0.0], [0.0, 0.0], [1.0, 1.0], "increase"),
        ([1.0, 0.5], [0.0, 0.0], [1.0, 1.0], "increase"),
    ],
)
def test_series_that_make_no_sense_are_refused(time: list, angle: list, load: list, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        model(law("kelvin_voigt")).run(time, angle, load)


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("name", ["kelvin_voigt", "two_layer_viscoelastic"])
def test_every_evaluation_of_the_law_is_counted(name: str, level: str) -> None:
    calls = 0

    class Counting(NamedTuple):
        formula: LayerFormula

        def force_at(self, depth: float, rate: float, impact_speed: float) -> tuple[float, float, float]:
            nonlocal calls
            calls += 1
            return self.formula.force_at(depth, rate, impact_speed)

        def remembers_impact(self) -> bool:
            return self.formula.remembers_impact()

    counting_law = ContactLaw(tuple(Layer(layer.begin, Counting(layer.formula)) for layer in law(name).layers))
    load = np.where((TICKS > 0.1) & (TICKS < 0.12), -80.0, 2.0 * LOAD)
    knee = model(counting_law, 1e-7, level=level)
    calls = 0  # making the model has tried the law
    series = knee.run(TICKS, ANGLE, load)
    if level in ("dynamic", "auto"):  # without mass nothing flies
        assert series.contact_state.min() == ContactState.SEPARATED
    assert series.evaluations.sum() == calls


def test_an_empty_series_gives_an_empty_answer() -> None:
    assert len(model(law("kelvin_voigt")).run([], [], [])) == 0


def test_a_refused_tick_leaves_the_stream_as_it_was() -> None:
    knee, rows = model(law("kelvin_voigt")), list(zip(TICKS.tolist(), ANGLE.tolist(), LOAD.tolist(), strict=True))
    stream = knee.stream()
    answers: list[Contact] = []
    for row in rows:
        if len(answers) == 10:
            with pytest.raises(ValueError, match="finite"):
                stream.tick(row[0], math.nan, row[2])
        answers.append(stream.tick(*row))
    assert b"".join(contact.tobytes() for contact in answers) == knee.run(TICKS, ANGLE, LOAD).tobytes()


@pytest.mark.parametrize("name", ["hertz", "kelvin_voigt"])
@pytest.mark.parametrize(("stiffness", "exponent"), [(1.0, 1.0), (1.0, 3.0), (1e15, 1.0), (1e15, 3.0)])
@pytest.mark.parametrize("mass", [1e-4, 1e3])
@pytest.mark.parametrize("period", [1e-9, 1.0, 1e9])
def test_the_largest_samples_do_not_break_the_run(
    name: str, stiffness: float, exponent: float, mass: float, period: float
) -> None:
    damping = {"damping": 1e9} if name == "kelvin_voigt" else {}
    scene = law(name, stiffness=stiffness, exponent=exponent, **damping)
    load = np.array([LARGEST_LOAD, -LARGEST_LOAD, LARGEST_LOAD, -LARGEST_LOAD, 0.0, LARGEST_LOAD])
    angle = np.array([LARGEST_ANGLE, -LARGEST_ANGLE, LARGEST_ANGLE, 0.0, -LARGEST_ANGLE, LARGEST_ANGLE])
    knee = quick(model(scene, 1e-12, ellipse(24), mass=mass, budget=1000))
    series = knee.run(np.arange(6) * period, angle, load)
    for field in ("contact_force", "penetration_depth", "gap", "penetration_rate", "femoral_height", "error_estimate"):
        assert np.isfinite(series[field]).all(), field


@settings(deadline=None, max_examples=60)
@given(data=st.data())
def test_at_the_extremes_answers_are_finite_and_misses_are_said(data: st.DataObject) -> None:
    def power_of_ten(low: float, high: float) -> float:
        return 10.0 ** data.draw(st.floats(low, high))

    name = data.draw(st.sampled_from(sorted(LAW_ARGUMENTS)))
    ranges = {
        "stiffness": lambda: power_of_ten(3, 13),
        "stiffness_2": lambda: power_of_ten(3, 13),
        "exponent": lambda: data.draw(st.floats(1.0, 3.0)),
        "damping": lambda: data.draw(st.sampled_from([0.0, 1.0])) * power_of_ten(0, 7),
        "layer_depth": lambda: power_of_ten(-6, -2.3),
        "restitution": lambda: data.draw(st.floats(0.01, 1.0)),
        "least_impact_speed": lambda: power_of_ten(-6, 0),
        "youngs_modulus": lambda: power_of_ten(3, 11),
    }
    changes = {argument: ranges[argument]() for argument in LAW_ARGUMENTS[name] if argument in ranges}
    ticks = 8
    time = np.arange(ticks) * power_of_ten(-5, -1)
    load = np.array(data.draw(st.lists(st.floats(-5e3, 2e4), min_size=ticks, max_size=ticks)))
    angle = np.array(data.draw(st.lists(st.floats(-0.2, 1.5), min_size=ticks, max_size=ticks)))
    tolerance = power_of_ten(-10, -5)
    # The budget keeps the test short: what cannot be solved within it must be said.
    knee = quick(model(law(name, **changes), tolerance, ellipse(24), mass=power_of_ten(-4, 3), budget=2000))
    series = knee.run(time, angle, load)
    for field in ("contact_force", "penetration_depth", "gap", "penetration_rate", "femoral_height", "error_estimate"):
        assert np.isfinite(series[field]).all(), field
    assert np.all(series.contact_force >= 0.0)
    assert np.all(series.penetration_depth * series.gap == 0.0)
    said = series.status & Status.NOT_CONVERGED != 0
    assert np.all(said[(series.error_estimate > tolerance) | (series.fidelity == Fidelity.QUASI_STATIC)])


def test_an_answer_prints_with_the_names_of_its_fields() -> None:
    contact = model(law("kelvin_voigt")).stream().tick(0.0, 0.1, 800.0)
    assert str(contact).startswith("(flexion_angle=0.1, load=800.0, contact_force=")
    assert "contact_point=(" in str(contact)
    assert str(contact.contact_point).startswith("(x=0.0, y=")


def test_an_answer_consists_of_numbers_as_declared() -> None:
    contact = model(law("kelvin_voigt")).stream().tick(0.0, 0.1, 800.0)
    assert (type(contact.status), type(contact.evaluations), type(contact.load)) == (int, int, float)
    assert contact.evaluations - 1000 < 0  # which an unsigned number would not be
    assert (type(contact.contact_point), type(contact.contact_wrench.torque)) == (Point, Point)


def test_times_beyond_integer_nanoseconds_are_refused() -> None:
    knee = model(law("kelvin_voigt"))
    stream = knee.stream()
    for time in (1e10, -1e10, math.nan):
        with pytest.raises(ValueError, match="time must be finite"):
            stream.tick(time, 0.1, 800.0)
        with pytest.raises(ValueError, match="time must be finite"):
            knee.run([time], [0.1], [800.0])
    assert stream.tick(0.0, 0.1, 800.0).stamp == 0


def test_answers_that_are_alike_are_equal() -> None:
    first, again = (model(law("kelvin_voigt")).stream().tick(0.0, 0.1, 800.0) for _ in range(2))
    assert first == again == pickle.loads(pickle.dumps(first)) == copy.copy(first)  # noqa: S301  (our own)
    assert first != model(law("kelvin_voigt")).stream().tick(0.0, 0.1, 801.0)
