"""The integrators alone: coefficients, order, and the exactness of free flight."""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np
import pytest

from knee_contact_ros.core.contact_laws.base import ContactLaw, Layer
from knee_contact_ros.core.contact_laws.hunt_crossley import hunt_crossley
from knee_contact_ros.core.contact_modes import APART, BELOW, FORCE, NOWHERE, ContactMode, ContactModes
from knee_contact_ros.core.contact_pairs.on_plane import OnPlane
from knee_contact_ros.core.geometries import Circle
from knee_contact_ros.core.integrators import esdirk4, fehlberg, free_flight
from knee_contact_ros.core.integrators.base import FemurState, Motion, Stage, Step
from knee_contact_ros.core.integrators.doubling import doubled_step
from knee_contact_ros.core.integrators.free_flight import MAX_PEAK, Look, free_flight_step
from knee_contact_ros.core.integrators.massless import massless_step
from knee_contact_ros.core.integrators.tableaus import ESDIRK4, FEHLBERG
from knee_contact_ros.core.mechanisms.hinge import Hinge
from knee_contact_ros.core.prescribed import Interval
from knee_contact_ros.core.statics import NO_LIMIT
from tests.core.surfaces import ellipse
from tests.helpers.scenes import RADIUS, law

MASS, SPRING, DASHPOT = 2.0, 4e6, 2e3


def implicit_tableau() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A, b and c in full."""
    m = ESDIRK4
    first, third, fourth, fifth = m.last
    a = filled(((), m.second, m.third, m.fourth, m.fifth, (first, 0.0, third, fourth, fifth)))
    a[np.arange(1, 6), np.arange(1, 6)] = m.diagonal
    return a, a[5], np.array(m.nodes)


def explicit_tableau() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A, b of the 4th order, the same less that of the 5th, and c."""
    m = FEHLBERG
    b, e = np.insert([*m.weights, 0.0], 1, 0.0), np.insert(m.error, 1, 0.0)
    return filled(((), m.second, m.third, m.fourth, m.fifth, m.sixth)), b, e, np.array(m.nodes)


def filled(rows: tuple[tuple[float, ...], ...]) -> np.ndarray:
    """A lower triangle as a matrix."""
    a = np.zeros((6, 6))
    for i, row in enumerate(rows):
        a[i, : len(row)] = row
    return a


def residuals(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> list[float]:
    """What is left of the conditions of the 4th order."""
    return [
        b.sum() - 1, b @ c - 1 / 2, b @ c**2 - 1 / 3, b @ a @ c - 1 / 6, b @ c**3 - 1 / 4,
        (b * c) @ a @ c - 1 / 8, b @ a @ c**2 - 1 / 12, b @ a @ a @ c - 1 / 24,
    ]  # fmt: skip


def test_coefficients_satisfy_the_order_conditions() -> None:
    a, b, c = implicit_tableau()
    assert a.sum(axis=1) == pytest.approx(c, abs=1e-15)
    assert residuals(a, b, c) == pytest.approx([0.0] * 8, abs=1e-15)  # rounding of eight-term sums


def test_coefficients_of_the_explicit_pair_satisfy_the_order_conditions() -> None:
    a, b, error, c = explicit_tableau()
    # Rounding of sums of terms up to 8
    assert a.sum(axis=1) == pytest.approx(c, abs=2e-15)
    assert residuals(a, b, c) == pytest.approx([0.0] * 8, abs=2e-15)
    fifth = b - error
    assert residuals(a, fifth, c) == pytest.approx([0.0] * 8, abs=2e-15)
    more = [
        fifth @ c**4 - 1 / 5, (fifth * c**2) @ a @ c - 1 / 10, (fifth * c) @ a @ c**2 - 1 / 15,
        (fifth * c) @ a @ a @ c - 1 / 30, fifth @ (a @ c) ** 2 - 1 / 20, fifth @ a @ c**3 - 1 / 20,
        fifth @ a @ (c * (a @ c)) - 1 / 40, fifth @ a @ a @ c**2 - 1 / 60, fifth @ a @ a @ a @ c - 1 / 120,
    ]  # fmt: skip
    assert more == pytest.approx([0.0] * 9, abs=2e-15)


@pytest.mark.parametrize("turned", [False, True])
def test_where_a_layer_begins_the_difference_of_the_orders_is_a_tenth_of_the_error(turned: bool) -> None:
    _, b, error, c = explicit_tableau()
    way = (1.0 - c if turned else c) ** 1.5
    true_error = abs(float(b @ way) - 0.4)
    assert fehlberg.SINGULAR * abs(float(error @ way)) == pytest.approx(true_error, rel=0.4)


def test_the_method_damps_what_is_infinitely_stiff() -> None:
    a, b, _ = implicit_tableau()

    def amplification(z: float) -> float:
        return float(1 + z * b @ np.linalg.solve(np.eye(6) - z * a, np.ones(6)))

    # L-stable: it goes to 0 like 1/z. (Beyond 1e6 the solution of the linear system loses its digits.)
    assert abs(amplification(-1e3)) < 0.02
    assert amplification(-1e5) == pytest.approx(amplification(-1e4) / 10, rel=0.01)


class Spring(NamedTuple):
    """A linear spring and dashpot, that pull, too."""

    def force_at(self, depth: float, rate: float, impact_speed: float) -> tuple[float, float, float]:
        """See `LayerFormula`."""
        return SPRING * depth + DASHPOT * rate, SPRING, DASHPOT

    def remembers_impact(self) -> bool:
        """See `LayerFormula`."""
        return False


METHODS = ("implicit", "explicit")
SPRING_LAW = ContactLaw((Layer(-1.0, Spring()),))


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


def integrate(method: str, steps: int, duration: float) -> tuple[float, Step]:
    """Error of the depth after so many steps, and the last step."""
    interval = Interval(OnPlane(Circle(RADIUS)), Hinge(), duration, 0.0, 0.0, 0.0, 0.0, math.nan)
    state = FemurState(RADIUS - 1e-3, -0.5)
    h = duration / steps
    motion = Motion(interval, ContactModes(SPRING_LAW, True), ContactMode(0, True), 0.0, MASS, NOWHERE)
    for i in range(steps):
        if method == "explicit":
            step = fehlberg.fehlberg_step(motion, i * h, state, h)
        else:
            step = doubled_step(motion, esdirk4.ORDER, esdirk4.STAGE_ORDER, i * h, state, h, 1e-18, NO_LIMIT)
        state = step.state
    return abs(RADIUS - state.height - oscillator(1e-3, 0.5, duration)[0]), step


@pytest.mark.parametrize("method", METHODS)
def test_the_damped_oscillator_is_met_at_fourth_order(method: str) -> None:
    errors = [integrate(method, steps, 4e-3)[0] for steps in (8, 16, 32)]
    orders = [math.log2(coarse / fine) for coarse, fine in itertools.pairwise(errors)]
    assert min(orders) > 3.8


@pytest.mark.parametrize("method", METHODS)
def test_the_error_estimate_is_that_of_the_step(method: str) -> None:
    error, step = integrate(method, 1, 5e-4)
    assert abs(step.error.height) == pytest.approx(error, rel=0.3)  # first neglected term of the estimate


def flying(interval: Interval) -> Motion:
    """A femur without contact."""
    return Motion(interval, ContactModes(law("kelvin_voigt"), False), ContactMode(APART, False), 0.0, MASS, NOWHERE)


def test_free_flight_is_exact() -> None:
    load, load_rate, height, velocity, h = 300.0, -2e4, RADIUS + 1e-3, 0.4, 0.01
    interval = Interval(OnPlane(Circle(RADIUS)), Hinge(), h, 0.0, 0.0, load, load_rate, math.nan)
    step = free_flight_step(flying(interval), 0.0, FemurState(height, velocity), h)
    assert step.state.height == pytest.approx(
        height + velocity * h - (load * h**2 / 2 + load_rate * h**3 / 6) / MASS, abs=1e-16
    )
    assert step.state.velocity == pytest.approx(velocity - (load * h + load_rate * h**2 / 2) / MASS, abs=1e-14)
    assert step.evaluations == 0


def test_a_flight_sees_a_turning_profile_brush_the_plateau(monkeypatch: pytest.MonkeyPatch) -> None:
    # Half axes of 34 and 28 mm: the longer one points down at a right angle, here between the stages at 0.5 and 0.75.
    geometry, turn, h, brush = ellipse(320), 0.6, 0.01, 0.62
    begin = 0.5 * math.pi - brush * turn
    deepest = geometry.support(0.5 * math.pi)[0]
    nearest = max(geometry.support(begin + fraction * turn)[0] for fraction in (0.5, 0.75))
    height = 0.5 * (deepest + nearest)  # apart at every quarter, and pressed between two
    interval = Interval(OnPlane(geometry), Hinge(), h, begin, turn / h, 0.0, 0.0, math.nan)
    stages: dict[float, Stage] = {}
    look = free_flight.in_flight

    def watched(motion: Motion, s: float, state: FemurState, t: float) -> Look:
        found = look(motion, s, state, t)
        stages[t / h] = found.stage
        return found

    monkeypatch.setattr(free_flight, "in_flight", watched)
    step = free_flight_step(flying(interval), 0.0, FemurState(height, 0.0), h)
    quarters = {0.25, 0.5, 0.75, 1.0}
    assert quarters < set(stages)
    assert all(stages[fraction].depth < 0.0 for fraction in quarters)
    assert step.crossing.boundary == BELOW
    assert step.crossing.fraction == min(fraction for fraction, stage in stages.items() if stage.depth > 0.0)
    assert 0.5 < step.crossing.fraction < 0.75
    peak_at, peak = min(stages.items(), key=lambda item: abs(item[1].rate))
    assert peak_at == pytest.approx(brush, abs=1e-5)  # the spline's lowest point there is the ellipse's to 1e-6
    # The first try, along an all but straight line, leaves 1.1e-5 m/s; all but the second of the others halve it.
    assert abs(peak.rate) <= 1.2e-5 / 2.0 ** (MAX_PEAK - 2)
    assert peak.depth == pytest.approx(deepest - height, abs=1e-15)  # that squared, over 2 x 39 m/s², and rounding


def test_a_flight_sees_a_load_that_ends_press_the_surfaces_together_for_a_moment() -> None:
    """Between the first two stages the femur turns back, touches and is let go: its depth falls at both of them."""
    load, load_rate, rate, h = 8.0, -4e3, -0.0028, 16e-3
    interval = Interval(OnPlane(Circle(RADIUS)), Hinge(), h, 0.0, 0.0, load, load_rate, math.nan)

    def moved(t: float) -> tuple[float, float]:
        """Exact depth and its rate."""
        return (
            rate * t + (0.5 * load * t**2 + load_rate * t**3 / 6.0) / MASS,
            rate + (load * t + 0.5 * load_rate * t**2) / MASS,
        )

    assert moved(0.25 * h)[1] < 0.0  # as at the beginning
    touches = min(root.real for root in np.roots([load_rate / 6.0 / MASS, 0.5 * load / MASS, rate]) if root.real > 0.0)
    peak = max(root.real for root in np.roots([0.5 * load_rate / MASS, load / MASS, rate]))
    assert moved(peak)[0] > 1e-7
    step = free_flight_step(flying(interval), 0.0, FemurState(RADIUS, -rate), h)
    assert step.crossing.boundary == BELOW
    assert touches <= step.crossing.fraction * h <= peak + 1e-9


def test_a_flight_sees_surfaces_that_overlap_press_again_for_a_moment() -> None:
    """Both terms of the force change: its maximum comes before that of the rate, when it is below 0 again."""
    contact, depth, load, load_rate, h = law("kelvin_voigt"), 1e-4, 50.0, -25e3, 0.01
    at_rest, _, damping = contact.layers[0].formula.force_at(depth, 0.0, 0.0)
    rate, mass = -(at_rest + 1.0) / damping, 9.3014

    def force(t: float) -> float:
        """Of the formula [N] after a flight of `t` [s]."""
        moved = rate * t + (0.5 * load * t**2 + load_rate * t**3 / 6.0) / mass
        return contact.layers[0].formula.force_at(
            depth + moved, rate + (load * t + 0.5 * load_rate * t**2) / mass, 0.0
        )[0]

    turn = -load / load_rate  # of the rate
    peak = max(np.linspace(0.0, turn, 1001), key=force)
    assert force(0.0) < 0.0 < force(peak)
    assert all(force(t) < 0.0 for t in (turn, *(part * h for part in (0.25, 0.5, 0.75, 1.0))))
    interval = Interval(OnPlane(Circle(RADIUS)), Hinge(), h, 0.0, 0.0, load, load_rate, math.nan)
    motion = Motion(interval, ContactModes(contact, False), ContactMode(0, False), 0.0, mass, NOWHERE)
    step = free_flight_step(motion, 0.0, FemurState(RADIUS - depth, -rate), h)
    assert step.crossing.boundary == FORCE
    assert 0.0 < step.crossing.fraction * h < turn
    assert force(step.crossing.fraction * h) > 0.0


@pytest.mark.parametrize("seed", range(3))
def test_the_estimate_of_a_step_without_mass_does_not_vanish(seed: int) -> None:
    """The pair's own goes through 0 where it changes its sign: every tenth step errs by over six times that."""
    random, ratios = np.random.default_rng(seed), []
    for _ in range(300):
        exponent, stiffness = random.uniform(1.0, 3.0), 1e9
        spring = hunt_crossley(stiffness=stiffness, exponent=exponent, restitution=0.5, least_impact_speed=0.05)
        begin, end = 10 ** random.uniform(1.0, 3.0, 2)
        depth = (begin / stiffness) ** (1.0 / exponent) * random.uniform(0.8, 1.2)
        _, slope, damping = spring.layers[0].formula.force_at(depth, 0.0, 0.0)
        h = random.uniform(0.2, 1.0) * damping / slope
        interval = Interval(OnPlane(Circle(RADIUS)), Hinge(), h, 0.0, 0.0, begin, (end - begin) / h, math.nan)
        motion = Motion(interval, ContactModes(spring, True), ContactMode(0, True), 0.0, 0.0, NOWHERE)
        state = FemurState(RADIUS - depth, 0.0)
        step = massless_step(motion, 0.0, state, h)
        for i in range(64):
            state = massless_step(motion, i * h / 64, state, h / 64).state
        if step.solved and step.end.depth > 0.0 and state.height < RADIUS:
            ratios.append(abs(step.state.height - state.height) / step.error.height)
    assert len(ratios) > 200
    assert max(ratios) < 6.0  # 4.9 in thousands of them; without Simpson's rule beside it, over 300


def test_a_stiff_stage_is_solved() -> None:
    stiff = ContactModes(law("kelvin_voigt", stiffness=1e13, damping=1e7), False)
    interval = Interval(OnPlane(Circle(RADIUS)), Hinge(), 0.1, 0.0, 0.0, 2e4, 0.0, math.nan)
    motion = Motion(interval, stiff, ContactMode(0, True), 0.0, 1e-4, NOWHERE)
    step = esdirk4.esdirk4_step(motion, 0.0, FemurState(RADIUS - 1e-3, -5.0), 0.1, 1e-12, NO_LIMIT)
    assert step.solved
    assert all(math.isfinite(value) for value in (*step.state, step.end.force))
