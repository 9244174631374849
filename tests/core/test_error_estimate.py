"""The carried error: against the motions that it linearises."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.linalg import expm

from knee_contact_ros.core.contact_laws.base import ContactLaw
from knee_contact_ros.core.contact_pairs.base import ContactPair
from knee_contact_ros.core.contact_pairs.on_curve import CurveContact
from knee_contact_ros.core.contact_pairs.on_plane import OnPlane
from knee_contact_ros.core.contact_pairs.tibial_circle import TibialCircle
from knee_contact_ros.core.error_estimate import (
    SAFETY,
    behind_jump,
    carry,
    carry_in_flight,
    lost_swing,
    settled_doubt,
)
from knee_contact_ros.core.geometries import Circle
from knee_contact_ros.core.integrators.base import INSIDE, NO_ERROR, FemurState, Stage, StateError, Step, leap
from knee_contact_ros.core.levels import LEVELS
from knee_contact_ros.core.levels.dynamic import dynamic_tick
from knee_contact_ros.core.mechanisms.hinge import Hinge
from knee_contact_ros.core.prescribed import Interval
from knee_contact_ros.core.regions import Regions
from knee_contact_ros.core.scene import Advance, Progress, Scene
from knee_contact_ros.core.stepping import orders
from tests.core.test_geometries import ellipse
from tests.scenes import RADIUS, law, moving

MASS = 2.0


@pytest.mark.parametrize(("stiffness", "damping"), [(4e6, 2e3), (4e6, 4e4), (0.0, 2e3), (0.0, 0.0), (8e6, 8e3)])
def test_an_error_is_carried_by_the_linear_contact(stiffness: float, damping: float) -> None:
    motion = np.array([[0.0, 1.0], [-stiffness / MASS, -damping / MASS]])
    expected = expm(2e-3 * motion) @ [3e-7, -1e-4]
    carried = carry(StateError(3e-7, -1e-4), stiffness, damping, MASS, 2e-3)
    assert carried == pytest.approx(tuple(expected), rel=1e-9)  # rounding of the exponential's scaling


@pytest.mark.parametrize("rate", [0.2, -0.2])
@pytest.mark.parametrize("jump", [50.0, -50.0])
def test_behind_a_jump_the_error_is_that_of_two_femora_that_meet_it(rate: float, jump: float) -> None:
    # Two femora under no load, one higher by e: they meet the boundary e/rate apart in time; so long the force acts.
    e, mass, t = 1e-6, MASS, 1e-3
    height, velocity = 0.0, -rate  # the boundary lies at the height 0
    meeting = [-h / velocity for h in (height, height + e)]
    velocities = [velocity + jump / mass * (t - begin) for begin in meeting]
    found = behind_jump(StateError(e, 0.0), rate, jump, 0.0, mass, 1.0)
    assert found.velocity == pytest.approx(velocities[1] - velocities[0], rel=1e-12)
    assert found.height == e


def test_a_jump_met_at_no_speed_is_not_felt_longer_than_the_interval() -> None:
    found = behind_jump(StateError(1e-6, 0.0), 0.0, 50.0, 0.0, MASS, 5e-3)
    assert abs(found.velocity) == pytest.approx(5e-3 * 50.0 / MASS)


def swinging(frequency: float, damping: float, h: float, amplitude: float, kept: float) -> Step:
    """A step that begins with a swing of some speed about a load of 100 N, and ends with a part of it."""
    stiffness = frequency**2 * MASS
    begin = Stage(1e-4, amplitude, 100.0, stiffness, 0.0)
    end = Stage(1e-4, kept * amplitude, 100.0, stiffness, 0.0)
    return Step(FemurState(0.034, 0.0), NO_ERROR, begin, end, INSIDE, stiffness, damping, 0.0, 0, True)


def test_a_swing_that_the_step_has_damped_away_is_lost() -> None:
    h, frequency, damping = 0.01, 1e4, 40.0
    lost = lost_swing(swinging(frequency, damping, h, 0.3, 0.0), 100.0, 0.0, MASS, h)
    assert lost == pytest.approx(0.3 * math.exp(-0.5 * damping / MASS * h), rel=1e-12)
    # What is still there is not lost, nor what the contact damps, nor what a small step has resolved.
    assert lost_swing(swinging(frequency, 0.0, h, 0.3, 1.0), 100.0, 0.0, MASS, h) == 0.0
    assert lost_swing(swinging(frequency, 3.0 * frequency * MASS, h, 0.3, 0.0), 100.0, 0.0, MASS, h) == 0.0
    assert lost_swing(swinging(frequency, 0.0, 4e-4, 0.3, 0.0), 100.0, 0.0, MASS, 4e-4) == 0.0


def test_a_knee_that_follows_its_load_slowly_does_not_swing() -> None:
    step = swinging(1e4, 0.0, 0.01, 0.0, 0.0)
    slow = 3e4 / step.stiffness
    end = step.end._replace(rate=slow, force=400.0)
    following = step._replace(begin=step.begin._replace(rate=slow), end=end)
    assert lost_swing(following, 100.0, 3e4, MASS, 0.01) == pytest.approx(
        0.0, abs=1e-15
    )  # rounding of 400 N / stiffness


def test_what_is_left_to_the_static_answer_is_in_doubt() -> None:
    # Pulled by 300 N for 2 ms from rest in contact: it may be anywhere up to where it flies freely.
    pulled = settled_doubt(1e-4, 0.0, -300.0, -300.0, MASS, 2e-3)
    assert pulled.height >= 1e-4 + 0.5 * 300.0 / MASS * 2e-3**2
    assert pulled.velocity >= 300.0 / MASS * 2e-3
    # Pressed: no faster than what the load gives over the way to the bottom.
    pressed = settled_doubt(1e-3, 0.2, 800.0, 2000.0, MASS, 2e-3)
    assert pressed.velocity == pytest.approx(0.2 + math.sqrt(2.0 * 2000.0 * 1e-3 / MASS))
    assert pressed.height == pytest.approx(1e-3 + 2e-3 * pressed.velocity)


@pytest.mark.parametrize("height", [3e-7, -3e-7])
@pytest.mark.parametrize("velocity", [1e-4, -1e-4, 4e-4, -4e-4])
def test_in_flight_the_parts_of_an_error_do_not_cancel(height: float, velocity: float) -> None:
    carried = carry_in_flight(StateError(height, velocity), 2e-3)
    assert abs(carried.height) == pytest.approx(3e-7 + 2e-3 * abs(velocity), rel=1e-15)  # rounding of the sum
    # It points to where the larger part has led.
    assert math.copysign(1.0, carried.height) == math.copysign(1.0, height + 2e-3 * velocity)
    assert carried.velocity == velocity


def advanced(contact_law: ContactLaw, start: Progress, duration: float, load: float = 0.0) -> Advance:
    """One tick of a circle of 2 kg under a constant load."""
    pair, hinge = OnPlane(Circle(RADIUS)), Hinge()
    interval = Interval(pair, hinge, duration, 0.0, 0.0, load, 0.0, math.nan)
    scene = Scene(pair, hinge, Regions(contact_law, False), MASS, 1e-10, 0.0, 0, LEVELS["dynamic"])
    return dynamic_tick(scene, interval, start, 0)


def begun(depth: float, rate: float, speed: float, doubt: float = 0.0) -> Progress:
    """A contact that began at a speed, give or take a doubt."""
    start = moving(FemurState(RADIUS - depth, -rate))
    return start._replace(impact_speed=speed, impact_error=doubt)


def test_a_doubtful_impact_speed_puts_the_force_in_doubt() -> None:
    # Hardly any time goes by: the force differs at once, and the depth not yet.
    flores, duration, depth = law("flores"), 1e-9, 3e-4
    doubtful = advanced(flores, begun(depth, 0.3, 0.5, 0.02), duration)
    one, other = (advanced(flores, begun(depth, 0.3, speed), duration) for speed in (0.5, 0.52))
    stiffness = flores.layers[0].formula.force_at(depth, 0.3, 0.5)[1]
    assert doubtful.force == one.force
    assert one.error_estimate < 1e-10
    assert abs(other.force - one.force) > 1.0
    assert abs(other.force - one.force) <= doubtful.error_estimate * stiffness


def test_a_doubtful_impact_speed_is_felt_for_as_long_as_the_contact_lasts() -> None:
    # At the bottom the damping ends, and with it the doubt of the force; what it has done to the femur stays.
    flores = law("flores")
    short, long = 0.0, 5e-3
    for _ in range(40):
        middle = 0.5 * (short + long)
        short, long = (middle, long) if advanced(flores, begun(1e-4, 0.4, 0.5), middle).rate > 0.0 else (short, middle)
    doubtful = advanced(flores, begun(1e-4, 0.4, 0.5, 0.02), short)
    one, other = (advanced(flores, begun(1e-4, 0.4, speed), short) for speed in (0.5, 0.52))
    assert abs(doubtful.rate) < 1e-6
    assert 1e-7 < abs(other.depth - one.depth) <= doubtful.error_estimate


def test_what_was_in_doubt_at_a_touch_is_published_for_its_tick() -> None:
    # The dashpot makes the carried error forget; the tick in which femur and tibia met still says what it met with.
    doubt = StateError(1e-6, 0.0)
    start = moving(FemurState(RADIUS + 1e-4, -0.2))._replace(error=doubt)
    touched = advanced(law("kelvin_voigt"), start, 0.5, load=800.0)
    assert not math.isnan(touched.progress.impact_speed)
    assert abs(touched.progress.error.height) < 1e-8
    assert touched.error_estimate >= SAFETY * 1e-6


@pytest.mark.parametrize(
    ("pair", "turn", "expected"),
    [
        (OnPlane(Circle(RADIUS)), 0.3, (4, 2)),
        (OnPlane(ellipse(60)), 0.3, (1, 1)),  # 5 of its points: its third derivative jumps at each
        (OnPlane(ellipse(60)), -0.3, (1, 1)),
        (OnPlane(ellipse(60)), 0.02, (4, 2)),  # less than one
        (CurveContact(Circle(RADIUS), TibialCircle(0.02)), 0.3, (2, 2)),  # a hollow too narrow for the femur
    ],
)
def test_a_step_is_of_the_order_that_its_surface_allows(
    pair: ContactPair, turn: float, expected: tuple[int, int]
) -> None:
    duration = 0.005
    interval = Interval(pair, Hinge(), duration, 0.4, turn / duration, 800.0, 0.0, math.nan)
    assert orders(interval, duration) == expected


def test_a_leap_is_told_from_a_glide() -> None:
    turn, h, radius = 4.0, 2e-3, 0.1
    rates = [turn * (0.01 + radius * turn * h * fraction) for fraction in (0.0, 0.5, 1.0)]
    assert leap(rates[0], rates[1], turn, 0.5 * h) == 0.0
    assert leap(rates[1], rates[2], turn, 0.5 * h) == 0.0
    found = leap(rates[1], rates[2] + 0.003 * turn, turn, 0.5 * h)  # by 3 mm to the next bump
    # The glide within the half step is in it.
    assert found == pytest.approx(0.003 * turn + radius * turn**2 * h / 2, rel=1e-12)
