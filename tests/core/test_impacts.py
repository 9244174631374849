"""Impacts under the laws that remember the speed of first touch, against closed forms.

With w = δ̇/v₀ the motion m δ̈ = -K δⁿ (1 + D w) integrates once: w/D - ln(1 + D w)/D² falls by K δⁿ⁺¹/((n + 1) m v₀²).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from knee_contact_ros.core.contact_laws.base import LayerFormula
from knee_contact_ros.core.scene import TickResult
from tests.helpers.scenes import advance, law

LOSSES: dict[str, Callable[[float], float]] = {
    "hunt_crossley": lambda e: 1.5 * (1.0 - e),
    "lankarani_nikravesh": lambda e: 0.75 * (1.0 - e**2),
    "flores": lambda e: 8.0 * (1.0 - e) / (5.0 * e),
    "gonthier": lambda e: (1.0 - e**2) / e,
}
RESTITUTIONS = (0.1, 0.3, 0.5, 0.7, 0.9, 0.99)
GAP = 1e-6
TOLERANCE = 1e-10


class Impact(NamedTuple):
    """A free impact: exponent, stiffness [N/m^n], mass [kg] and speed of first touch [m/s]."""

    exponent: float
    stiffness: float
    mass: float
    speed: float


IMPACTS = (
    Impact(1.0, 1e6, 9.3, 0.5),
    Impact(1.5, 7.905694e7, 1.0, 5.0),
    Impact(2.0, 1.7e9, 20.0, 0.2),
    Impact(3.0, 1e12, 0.5, 1.0),
)


def delivered_restitution(loss: float) -> float:
    """Speed after over speed before the impact: the root e of (1 + e) D = ln((1 + D)/(1 - e D))."""
    return float(
        brentq(
            lambda e: (1.0 + e) * loss - math.log((1.0 + loss) / (1.0 - e * loss)),
            0.0,
            min(1.0, (1.0 - 1e-14) / loss),
            xtol=1e-14,
        )
    )


def largest_depth(loss: float, impact: Impact) -> float:
    """Depth [m] at which the rate is 0."""
    exponent, stiffness, mass, speed = impact
    energy = mass / stiffness * speed**2 * (loss - math.log1p(loss)) / loss**2
    return ((exponent + 1.0) * energy) ** (1.0 / (exponent + 1.0))


class Contact(NamedTuple):
    """One contact by the reference: when and how deep it was deepest, when it ended and at what speed it parted."""

    deepest_at: float
    depth: float
    duration: float
    parting: float


def reference_contact(formula: LayerFormula, mass: float, speed: float, size: float, load: float = 0.0) -> Contact:
    """Solve one contact from touch at `speed` to its end; `size` is the order of its depth [m]."""

    def peak(_t: float, y: list[float]) -> float:
        return y[1]

    def end(_t: float, y: list[float]) -> float:
        return y[0]

    peak.direction, end.direction, end.terminal = -1.0, -1.0, True  # type: ignore[attr-defined]
    # Depth in units of `size`, rate in units of `speed`: one absolute tolerance for both.
    solution = solve_ivp(
        lambda _t, y: (y[1], (load - formula.force_at(size * y[0], speed * y[1], speed)[0]) * size / (mass * speed**2)),
        (0.0, 1e3),
        (0.0, 1.0),
        method="DOP853",
        events=(peak, end),
        rtol=1e-12,
        atol=1e-14,
    )
    (deepest_at,), (duration,) = solution.t_events
    return Contact(
        deepest_at * size / speed,
        solution.y_events[0][0][0] * size,
        duration * size / speed,
        -solution.y_events[1][0][1] * speed,
    )


def scene(name: str, restitution: float, impact: Impact) -> tuple[LayerFormula, float, float]:
    """Formula of a law after an impact, and what it ought to deliver: restitution and largest depth."""
    contact_law = law(name, stiffness=impact.stiffness, exponent=impact.exponent, restitution=restitution)
    loss = LOSSES[name](restitution)
    return contact_law.layers[0].formula, delivered_restitution(loss), largest_depth(loss, impact)


@pytest.mark.parametrize(
    ("name", "delivered"),
    [("hunt_crossley", 0.663), ("lankarani_nikravesh", 0.725), ("flores", 0.470), ("gonthier", 0.488)],
)
def test_what_half_a_restitution_delivers(name: str, delivered: float) -> None:
    assert delivered_restitution(LOSSES[name](0.5)) == pytest.approx(delivered, abs=0.5e-3)


@pytest.mark.parametrize(
    ("name", "least", "error"),
    [
        ("hunt_crossley", 0.9, 0.01),
        ("lankarani_nikravesh", 0.92, 0.01),
        ("flores", 0.1, 0.05),
        ("flores", 0.83, 0.01),
        ("gonthier", 0.1, 0.033),
    ],
)
def test_the_stated_limits_of_validity(name: str, least: float, error: float) -> None:
    for hundredth in range(round(100 * least), 100):
        restitution = hundredth / 100
        assert abs(delivered_restitution(LOSSES[name](restitution)) - restitution) < error


@pytest.mark.parametrize("impact", IMPACTS, ids=lambda impact: f"n={impact.exponent:g}")
@pytest.mark.parametrize("name", LOSSES)
def test_the_formulas_deliver_the_closed_forms(name: str, impact: Impact) -> None:
    for restitution in RESTITUTIONS:
        formula, delivered, depth = scene(name, restitution, impact)
        reference = reference_contact(formula, impact.mass, impact.speed, depth)
        assert reference.depth == pytest.approx(depth, rel=1e-9)
        assert reference.parting / impact.speed == pytest.approx(delivered, rel=1e-8)


@pytest.mark.parametrize("restitution", [0.1, 0.5, 0.9])
@pytest.mark.parametrize("impact", IMPACTS, ids=lambda impact: f"n={impact.exponent:g}")
@pytest.mark.parametrize("name", LOSSES)
def test_the_integrator_delivers_the_closed_forms(name: str, impact: Impact, restitution: float) -> None:
    formula, delivered, depth = scene(name, restitution, impact)
    reference = reference_contact(formula, impact.mass, impact.speed, depth)
    contact_law = law(name, stiffness=impact.stiffness, exponent=impact.exponent, restitution=restitution)
    touch = GAP / impact.speed

    def after(contact_time: float) -> TickResult:
        result = advance(contact_law, -GAP, impact.speed, touch + contact_time, mass=impact.mass, tolerance=TOLERANCE)
        assert result.converged
        return result

    deepest = after(reference.deepest_at)
    assert abs(deepest.depth - depth) <= deepest.error_estimate <= TOLERANCE
    # An error of TOLERANCE in depth is one of TOLERANCE x speed/depth in the rate.
    assert deepest.rate == pytest.approx(0.0, abs=TOLERANCE * impact.speed / depth)
    for share in (0.9, 1.1):
        assert after(share * reference.deepest_at).depth < deepest.depth
    apart = after(1.5 * reference.duration)
    assert apart.depth < 0.0
    assert -apart.rate / impact.speed == pytest.approx(delivered, abs=TOLERANCE / depth)


@pytest.mark.parametrize("name", LOSSES)
def test_a_soft_touch_loses_less(name: str) -> None:
    # Below the least impact speed of 0.1 m/s the loss falls with the speed.
    speed = 0.02
    impact = Impact(1.5, 7.905694e7, 1.0, speed)
    loss = LOSSES[name](0.5) * speed / 0.1
    result = advance(law(name), -GAP, speed, 0.05, tolerance=TOLERANCE)
    assert result.depth < 0.0
    assert -result.rate / speed == pytest.approx(
        delivered_restitution(loss), abs=TOLERANCE / largest_depth(loss, impact)
    )


@pytest.mark.parametrize("name", LOSSES)
def test_every_touch_has_its_own_speed(name: str) -> None:
    # A femur of 1 kg falls under 50 N, bounces, and falls again; the flight between is a parabola.
    contact_law, load = law(name), 50.0
    speed = math.sqrt(1.0 + 2.0 * load * GAP)
    first = reference_contact(contact_law.layers[0].formula, 1.0, speed, 1e-3, load)
    second = reference_contact(contact_law.layers[0].formula, 1.0, first.parting, 1e-3, load)
    touch = 2.0 * GAP / (1.0 + speed)
    flight = 2.0 * first.parting / load
    before = touch + first.duration + flight
    result = advance(contact_law, -GAP, 1.0, before + second.deepest_at, load=load, tolerance=TOLERANCE)
    # The estimate counts what the first impact leaves in the speed, over the whole flight.
    assert abs(result.depth - second.depth) <= result.error_estimate <= 10 * TOLERANCE
    later = 0.25 * second.parting / load
    result = advance(contact_law, -GAP, 1.0, before + second.duration + later, load=load, tolerance=TOLERANCE)
    assert -result.rate == pytest.approx(second.parting - load * later, abs=TOLERANCE * speed / second.depth)
