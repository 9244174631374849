"""Forward dynamics from tick to tick: exact cases, impacts, flights, rebounds, layers, and how it converges.

Impacts under the laws that remember the speed of first touch have closed forms. With w = δ̇/v₀ the motion
m δ̈ = -K δⁿ (1 + D w) integrates once: w/D - ln(1 + D w)/D² falls by K δⁿ⁺¹/((n + 1) m v₀²).
"""

import math
from typing import NamedTuple

import numpy as np
import pytest
from scipy.optimize import brentq

from knee_contact_ros.model.laws import CONTACT_LAWS
from knee_contact_ros.model.steps import SINGULAR_ERROR_FACTOR
from knee_contact_ros.model.tableaux import ESDIRK, FEHLBERG
from knee_contact_ros.model.types import Status
from studies.reference import LAWS
from tests.helpers.scenes import LAW_ARGUMENTS, STIFFNESS, law, model
from tests.model.scenes import LAWS_ON_PAIRS, PAIRS, fast, signed, thrown

SPEED = 0.3
TOLERANCE = 1e-10
TICKS = np.arange(0.0, 0.4, 0.005)
ANGLE = 0.3 + 0.5 * np.sin(2 * np.pi * TICKS)
LOAD = 700.0 + 400.0 * np.sin(2 * np.pi * 3.0 * TICKS)


def impact(contact_law, duration):
    """What has become of an impact of 1 kg without load from touch at `SPEED`."""
    return thrown(model(contact_law, TOLERANCE, mass=1.0), 0.0, SPEED, duration)


def test_hertz_impact_has_its_depth_and_duration_and_gives_all_energy_back():
    deepest = (5 * SPEED**2 / (4 * STIFFNESS)) ** 0.4  # m = 1 kg
    # Hertz 1882: twice the integral of 1/√(1 - x^2.5) from 0 to 1, which is 2.943 (by Beta functions).
    duration = 0.8 * math.sqrt(math.pi) * math.gamma(0.4) / math.gamma(0.9) * deepest / SPEED
    assert signed(impact(law("hertz"), 0.5 * duration)) == pytest.approx(
        deepest, abs=10 * TOLERANCE
    )
    parted = impact(law("hertz"), 0.02)
    # TOLERANCE x natural frequency (about 1.5 SPEED/deepest = 1e3 rad/s) over SPEED is 3e-7; with room
    assert parted.penetration_rate == pytest.approx(-SPEED, rel=1e-6)
    # It parted at the end of the contact, and has flown at that speed since.
    assert 0.02 + signed(parted) / SPEED == pytest.approx(duration, rel=1e-6)


def test_linear_kelvin_voigt_impact_is_the_damped_oscillator():
    spring, dashpot = 1e6, 400.0
    linear = law("kelvin_voigt", stiffness=spring, exponent=1.0, damping=dashpot)
    decay, t = dashpot / 2, 1e-3
    frequency = math.sqrt(spring - decay**2)
    exact = SPEED / frequency * math.exp(-decay * t) * math.sin(frequency * t)
    assert signed(impact(linear, t)) == pytest.approx(exact, abs=10 * TOLERANCE)
    # The force ends where K δ + C δ̇ = 0, at tan(ω t) = -2 decay ω / (ω² - decay²); from there the femur flies.
    ends = (math.pi - math.atan2(2 * decay * frequency, frequency**2 - decay**2)) / frequency
    cosine, sine = math.cos(frequency * ends), math.sin(frequency * ends)
    speed = SPEED * math.exp(-decay * ends) * (cosine - decay / frequency * sine)
    # As above: 1e-10 m times 1e3 rad/s, over 0.1 m/s
    assert impact(linear, 0.02).penetration_rate == pytest.approx(speed, rel=1e-6)
    # That may pull, it goes on swinging.
    swings = thrown(model(linear, TOLERANCE, mass=1.0, allow_tension=True), 1e-5, -SPEED, 1e-6)
    assert (
        swings.contact_force
        < 0.0
        == thrown(model(linear, TOLERANCE, mass=1.0), 1e-5, -SPEED, 1e-6).contact_force
    )


@pytest.mark.parametrize("damping", [0.0, 2e3, 4e4])
@pytest.mark.parametrize("duration", [1e-4, 4e-3, 0.05])
def test_a_linear_contact_that_may_pull_is_the_damped_oscillator(damping, duration):
    """Swinging and creeping, by explicit and by implicit steps; at rest it lies at 0.2 mm."""
    mass, spring, rest = 2.0, 4e6, 2e-4
    linear = law("kelvin_voigt", stiffness=spring, exponent=1.0, damping=damping)
    knee = model(linear, TOLERANCE, mass=mass, allow_tension=True)
    motion = np.array([[0.0, 1.0], [-spring / mass, -damping / mass]])
    values, vectors = np.linalg.eig(motion)
    away = (
        vectors @ np.diag(np.exp(values * duration)) @ np.linalg.inv(vectors) @ [1e-4, 0.02]
    ).real
    found = thrown(knee, rest + 1e-4, 0.02, duration, load=spring * rest)
    assert abs(signed(found) - rest - away[0]) <= found.error_estimate <= TOLERANCE
    # The tolerance times spring and dashpot
    force = spring * (rest + away[0]) + damping * away[1]
    assert abs(found.contact_force - force) <= found.force_error_estimate + 1e-9 * spring * rest


@pytest.mark.parametrize(("load", "load_rate"), [(-50.0, 0.0), (300.0, -2e4), (-20.0, 5e3)])
def test_a_flight_is_a_parabola(load, load_rate):
    knee, h, mass = model(law("kelvin_voigt"), mass=2.0), 0.01, 2.0
    begins = thrown(knee, -5e-2, -0.4, h, load=load)
    assert signed(begins) == pytest.approx(
        -5e-2 - 0.4 * h + 0.5 * load / mass * h**2, abs=1e-16
    )  # rounding of 0.1 m
    assert begins.evaluations == 1  # the probe that finds no touch
    # thrown off by a jump of the load, it flies on while the load changes
    time = h * np.arange(4.0)
    series = knee.run(time, 0.0 * time, [100.0, -1e3, load, load + load_rate * h])
    rate, fall = series.penetration_rate[2], load * h**2 / 2 + load_rate * h**3 / 6
    assert signed(series)[3] == pytest.approx(
        signed(series)[2] + rate * h + fall / mass, abs=1e-15
    )
    assert series.penetration_rate[3] == pytest.approx(
        rate + (load * h + load_rate * h**2 / 2) / mass, abs=1e-13
    )


def test_a_state_on_the_boundary_goes_where_it_moves():
    knee = model(law("kelvin_voigt"), TOLERANCE, mass=1.0)
    assert signed(thrown(knee, 0.0, -SPEED, 1e-3)) == pytest.approx(
        -SPEED * 1e-3, rel=1e-12
    )  # rounding
    assert signed(thrown(knee, 0.0, SPEED, 1e-4)) > 0.0


IMPACT_DAMPED = [name for name in CONTACT_LAWS if law(name).remembers_impact]


def loss_of(name, restitution):
    """D of a law at a coefficient of restitution, from its source; test_laws.py names a law that is missing there."""
    return LAWS[name](**(LAW_ARGUMENTS[name] | {"restitution": restitution})).loss


GAP = 1e-6


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


def delivered_restitution(loss):
    """Speed after over speed before the impact: the root e of (1 + e) D = ln((1 + D)/(1 - e D))."""
    end = min(1.0, (1.0 - 1e-14) / loss)
    return float(
        brentq(
            lambda e: (1.0 + e) * loss - math.log((1.0 + loss) / (1.0 - e * loss)),
            0.0,
            end,
            xtol=1e-14,
        )
    )


@pytest.mark.parametrize(
    ("name", "half", "least", "error"),
    [
        ("hunt_crossley", 0.663, 0.9, 0.01),
        ("lankarani_nikravesh", 0.725, 0.92, 0.01),
        ("flores", 0.470, 0.1, 0.05),
        ("flores", 0.470, 0.83, 0.01),
        ("gonthier", 0.488, 0.1, 0.033),
    ],
)
def test_the_stated_limits_of_validity(name, half, least, error):
    assert delivered_restitution(loss_of(name, 0.5)) == pytest.approx(
        half, abs=0.5e-3
    )  # the last digit
    for hundredth in range(round(100 * least), 100):
        restitution = hundredth / 100
        assert abs(delivered_restitution(loss_of(name, restitution)) - restitution) < error


@pytest.mark.parametrize(
    ("name", "impact", "restitution"),
    [
        *((name, IMPACTS[1], 0.5) for name in IMPACT_DAMPED),
        *(("hunt_crossley", impact, 0.5) for impact in IMPACTS if impact != IMPACTS[1]),
        ("flores", IMPACTS[1], 0.1),
        ("gonthier", IMPACTS[1], 0.9),
    ],
)
def test_impacts_deliver_the_closed_forms(name, impact, restitution):
    exponent, stiffness, mass, speed = impact
    loss = loss_of(name, restitution)
    energy = mass / stiffness * speed**2 * (loss - math.log1p(loss)) / loss**2
    depth = ((exponent + 1.0) * energy) ** (1.0 / (exponent + 1.0))
    contact_law = law(name, stiffness=stiffness, exponent=exponent, restitution=restitution)
    knee = model(contact_law, TOLERANCE, mass=mass)

    def after(contact_time):
        return thrown(knee, -GAP, speed, GAP / speed + contact_time)

    long = 100.0 * depth / speed
    deepest = after(brentq(lambda time: after(time).penetration_rate, 0.0, long, xtol=1e-9 * long))
    assert abs(signed(deepest) - depth) <= deepest.error_estimate <= TOLERANCE
    apart = after(long)
    assert signed(apart) < 0.0
    # An error of TOLERANCE in depth is one of TOLERANCE x speed/depth in the rate.
    assert -apart.penetration_rate / speed == pytest.approx(
        delivered_restitution(loss), abs=TOLERANCE / depth
    )


def test_coefficients_satisfy_the_order_conditions():
    explicit = lower(FEHLBERG.stages, 0.0)
    weights = np.array(FEHLBERG.weights)
    fifth = weights - np.array(FEHLBERG.errors)
    c = np.array([0.0, *FEHLBERG.nodes])
    implicit = lower(ESDIRK.stages, ESDIRK.diagonal)
    d = np.array([0.0, *ESDIRK.nodes])
    # Rounding of sums of terms up to 8
    for a, b, nodes in ((explicit, weights, c), (explicit, fifth, c), (implicit, implicit[5], d)):
        assert a.sum(axis=1) == pytest.approx(nodes, abs=2e-15)
        assert residuals(a, b, nodes) == pytest.approx([0.0] * 8, abs=2e-15)
    # L-stable: the amplification goes to 0 like 1/z. (Beyond 1e6 the linear system loses its digits.)
    small, smaller = (
        1 + z * implicit[5] @ np.linalg.solve(np.eye(6) - z * implicit, np.ones(6))
        for z in (-1e4, -1e5)
    )
    assert abs(small) < 0.002
    assert smaller == pytest.approx(small / 10, rel=0.01)
    # Where a layer begins, as t^1.5, the difference of the orders is a tenth of the error, in either direction.
    for way in (c**1.5, (1.0 - c) ** 1.5):
        true = abs(float(weights @ way) - 0.4)
        assert SINGULAR_ERROR_FACTOR * abs(float((weights - fifth) @ way)) == pytest.approx(
            true, rel=0.4
        )


def lower(rows, diagonal):
    """The matrix of a method's stages, the diagonal of which begins with its second."""
    a = np.diag([0.0, *5 * (diagonal,)])
    for i, row in enumerate(rows, start=1):
        a[i, : len(row)] += row
    return a


def residuals(a, b, c):
    """What is left of the conditions of the 4th order."""
    return [
        b.sum() - 1,
        b @ c - 1 / 2,
        b @ c**2 - 1 / 3,
        b @ a @ c - 1 / 6,
        b @ c**3 - 1 / 4,
        (b * c) @ a @ c - 1 / 8,
        b @ a @ c**2 - 1 / 12,
        b @ a @ a @ c - 1 / 24,
    ]


@pytest.mark.parametrize(("name", "kind"), LAWS_ON_PAIRS)
def test_answers_converge_with_the_tolerance(name, kind):
    """Errors stay within the tolerance against a run at 1e-11 m, and cost is what tells tolerances apart."""
    time = 2e-3 * np.arange(80)
    angle, load = 0.3 + 0.2 * np.sin(15.0 * time), 700.0 + 500.0 * np.sin(60.0 * time)
    pair = PAIRS[kind]()
    exact, *others = (
        fast(model(law(name), tolerance, pair=pair)).run(time, angle, load)
        for tolerance in (1e-11, 1e-5, 1e-7, 1e-9)
    )
    for tolerance, found in zip((1e-5, 1e-7, 1e-9), others, strict=True):
        error = np.abs(signed(found) - signed(exact))
        fine = (found.status == Status.OK) & (exact.error_estimate < 0.1 * tolerance)
        assert error[fine].max(initial=0.0) <= tolerance
        assert np.mean(error <= found.error_estimate + exact.error_estimate + 1e-14) >= 0.97
        assert fine.mean() > 0.9 or tolerance == 1e-9
    costs = [int(found.evaluations.sum()) for found in others]
    assert costs == sorted(costs)
