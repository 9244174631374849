"""The integrators alone: coefficients, order, and the exactness of free flight."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from knee_contact_ros.core.contact_pairs.on_plane import OnPlane
from knee_contact_ros.core.geometries import Circle
from knee_contact_ros.core.integrators import esdirk4
from knee_contact_ros.core.integrators.base import FemurState, Step
from knee_contact_ros.core.integrators.doubling import doubled_step
from knee_contact_ros.core.integrators.free_flight import MAX_PEAK, free_flight_step
from knee_contact_ros.core.mechanisms.hinge import Hinge
from knee_contact_ros.core.prescribed import Interval
from tests.core.test_geometries import ellipse
from tests.scenes import RADIUS, law

MASS, SPRING, DASHPOT = 2.0, 4e6, 2e3


def tableau() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A, b and c in full."""
    a = np.zeros((6, 6))
    for i, row in enumerate(esdirk4.A):
        a[i, : len(row)] = row
        a[i, i] = esdirk4.GAMMA if i else 0.0
    return a, a[5], np.array(esdirk4.C)


def test_coefficients_satisfy_the_order_conditions() -> None:
    a, b, c = tableau()
    assert a.sum(axis=1) == pytest.approx(c, abs=1e-15)
    residuals = [
        b.sum() - 1, b @ c - 1 / 2, b @ c**2 - 1 / 3, b @ a @ c - 1 / 6, b @ c**3 - 1 / 4,
        (b * c) @ a @ c - 1 / 8, b @ a @ c**2 - 1 / 12, b @ a @ a @ c - 1 / 24,
    ]  # fmt: skip
    assert residuals == pytest.approx([0.0] * 8, abs=1e-15)  # rounding of eight-term sums


def test_the_method_damps_what_is_infinitely_stiff() -> None:
    a, b, _ = tableau()

    def amplification(z: float) -> float:
        return float(1 + z * b @ np.linalg.solve(np.eye(6) - z * a, np.ones(6)))

    # L-stable: it goes to 0 like 1/z. (Beyond 1e6 the solution of the linear system loses its digits.)
    assert abs(amplification(-1e3)) < 0.02
    assert amplification(-1e5) == pytest.approx(amplification(-1e4) / 10, rel=0.01)


def spring(depth: float, rate: float) -> tuple[float, float, float]:
    """A linear spring and dashpot."""
    return SPRING * depth + DASHPOT * rate, SPRING, DASHPOT


def oscillator(depth: float, rate: float, t: float) -> tuple[float, float]:
    """Exact depth and rate of the linear oscillator at t."""
    decay, frequency = DASHPOT / (2 * MASS), math.sqrt(SPRING / MASS - (DASHPOT / (2 * MASS)) ** 2)
    cosine, sine = math.cos(frequency * t), math.sin(frequency * t)
    envelope = math.exp(-decay * t)
    slope = (rate + decay * depth) / frequency
    return (
        envelope * (depth * cosine + slope * sine),
        envelope * ((slope * frequency - decay * depth) * cosine - (decay * slope + frequency * depth) * sine),
    )


def integrate(steps: int, duration: float) -> tuple[float, Step]:
    """Error of the depth after so many doubled steps, and the last step."""
    interval = Interval(OnPlane(Circle(RADIUS)), Hinge(), duration, 0.0, 0.0, 0.0, 0.0)
    state = FemurState(RADIUS - 1e-3, -0.5)
    h = duration / steps

    def single(s: float, state: FemurState, h: float) -> Step:
        return esdirk4.esdirk4_step(interval, spring, MASS, s, state, h, 1e-18)

    for i in range(steps):
        step = doubled_step(single, esdirk4.ORDER, esdirk4.STAGE_ORDER, MASS, i * h, state, h)
        state = step.state
    return abs(RADIUS - state.height - oscillator(1e-3, 0.5, duration)[0]), step


def test_the_damped_oscillator_is_met_at_fourth_order() -> None:
    errors = [integrate(steps, 4e-3)[0] for steps in (8, 16, 32)]
    orders = [math.log2(coarse / fine) for coarse, fine in itertools.pairwise(errors)]
    assert min(orders) > 3.8


def test_the_error_estimate_is_that_of_the_step() -> None:
    error, step = integrate(1, 5e-4)
    assert abs(step.error.height) == pytest.approx(error, rel=0.3)  # first neglected term of Richardson's estimate


def test_free_flight_is_exact() -> None:
    load, load_rate, height, velocity, h = 300.0, -2e4, RADIUS + 1e-3, 0.4, 0.01
    interval = Interval(OnPlane(Circle(RADIUS)), Hinge(), h, 0.0, 0.0, load, load_rate)
    step = free_flight_step(interval, None, MASS, 0.0, FemurState(height, velocity), h)
    assert step.state.height == pytest.approx(
        height + velocity * h - (load * h**2 / 2 + load_rate * h**3 / 6) / MASS, abs=1e-16
    )
    assert step.state.velocity == pytest.approx(velocity - (load * h + load_rate * h**2 / 2) / MASS, abs=1e-14)
    assert step.evaluations == 0


def test_a_flight_sees_a_turning_profile_brush_the_plateau() -> None:
    # Half axes of 34 and 28 mm: the longer one points down at a right angle, here between the stages at 0.5 and 0.75.
    geometry, turn, h, brush = ellipse(320), 0.6, 0.01, 0.62
    begin = 0.5 * math.pi - brush * turn
    deepest = geometry.support(0.5 * math.pi)[0]
    nearest = max(geometry.support(begin + fraction * turn)[0] for fraction in (0.5, 0.75))
    height = 0.5 * (deepest + nearest)  # apart at every quarter, and pressed between two
    interval = Interval(OnPlane(geometry), Hinge(), h, begin, turn / h, 0.0, 0.0)
    step = free_flight_step(interval, None, MASS, 0.0, FemurState(height, 0.0), h)
    fractions = [stage.fraction for stage in step.stages]
    assert fractions == sorted(fractions)
    assert {0.25, 0.5, 0.75, 1.0} < set(fractions)
    assert all(stage.depth < 0.0 for stage in step.stages if stage.fraction in {0.25, 0.5, 0.75, 1.0})
    peak = min(step.stages, key=lambda stage: abs(stage.rate))
    assert peak.fraction == pytest.approx(brush, abs=1e-5)  # the spline's lowest point there is the ellipse's to 1e-6
    # The first try, along an all but straight line, leaves 1.1e-5 m/s; all but the second of the others halve it.
    assert abs(peak.rate) <= 1.2e-5 / 2.0 ** (MAX_PEAK - 2)
    assert peak.depth == pytest.approx(deepest - height, abs=1e-15)  # that squared, over 2 x 39 m/s², and rounding


def test_a_stiff_stage_is_solved() -> None:
    stiff = law("kelvin_voigt", stiffness=1e13, damping=1e7).layers[0].force
    interval = Interval(OnPlane(Circle(RADIUS)), Hinge(), 0.1, 0.0, 0.0, 2e4, 0.0)
    step = esdirk4.esdirk4_step(interval, stiff, 1e-4, 0.0, FemurState(RADIUS - 1e-3, -5.0), 0.1, 1e-12)
    assert step.solved
    assert all(math.isfinite(value) for value in (*step.state, step.stages[-1].force))
