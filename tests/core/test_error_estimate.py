"""The propagated error: against the motions that it linearises."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from knee_contact_ros.core.contact_laws.base import ContactLaw
from knee_contact_ros.core.contact_modes import ContactModes
from knee_contact_ros.core.contact_pairs.base import ContactPair
from knee_contact_ros.core.contact_pairs.on_curve import CurveContact
from knee_contact_ros.core.contact_pairs.on_plane import OnPlane
from knee_contact_ros.core.contact_pairs.tibial_circle import TibialCircle
from knee_contact_ros.core.error_estimate import (
    EXACT,
    EXPECTED,
    LARGEST_HEIGHT_ERROR,
    LARGEST_VELOCITY_ERROR,
    PropagatedError,
    bounded,
    force_reach,
    propagated,
    propagated_in_flight,
    propagated_over_step,
    reach,
    saltation,
    velocity_reach,
    with_bound,
    with_doubt,
    with_step,
    with_uncorrelated_bound,
)
from knee_contact_ros.core.geometries import Circle
from knee_contact_ros.core.integrators.base import FemurState, StateError, leap
from knee_contact_ros.core.levels import LEVELS
from knee_contact_ros.core.levels.dynamic import dynamic_tick
from knee_contact_ros.core.mechanisms.hinge import Hinge
from knee_contact_ros.core.prescribed import Interval
from knee_contact_ros.core.scene import RunState, Scene, TickResult
from knee_contact_ros.core.stepping import orders
from tests.core.surfaces import ellipse
from tests.helpers.scenes import RADIUS, law, moving

MASS = 2.0
HELD = math.sqrt(4e6 / MASS)


def of(height: float, velocity: float) -> PropagatedError:
    """An error of which all is known."""
    return PropagatedError(height, velocity, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(("stiffness", "damping"), [(4e6, 2e3), (4e6, 4e4), (0.0, 2e3), (0.0, 0.0), (8e6, 8e3)])
def test_an_error_is_carried_by_the_linear_contact(stiffness: float, damping: float) -> None:
    motion = np.array([[0.0, 1.0], [-stiffness / MASS, -damping / MASS]])
    through = expm(2e-3 * motion)
    spread = np.array([[4e-14, 1e-12], [1e-12, 9e-10]])
    carried = propagated(PropagatedError(3e-7, -1e-4, 4e-14, 1e-12, 9e-10), stiffness, damping, MASS, 2e-3)
    # rounding of the exponential's scaling, and of differences in the covariance
    assert carried[:2] == pytest.approx(tuple(through @ [3e-7, -1e-4]), rel=1e-9)
    expected = through @ spread @ through.T
    assert carried[2:] == pytest.approx((expected[0, 0], expected[0, 1], expected[1, 1]), rel=1e-8)


@pytest.mark.parametrize("damping", [0.0, 3e3])
def test_a_stiffness_that_changes_over_a_step_carries_an_error_at_fourth_order(damping: float) -> None:
    def wrong(h: float) -> float:
        begin, end = 4e6, 4e6 * (1.0 + 300.0 * h)
        exact = solve_ivp(
            lambda s, z: [z[1], -(begin + (end - begin) * s / h) / MASS * z[0] - damping / MASS * z[1]],
            (0.0, h), [1.0, 100.0], rtol=1e-12, atol=1e-14,
        ).y[:, -1]  # fmt: skip
        found = propagated_over_step(of(1.0, 100.0), begin, 0.5 * (begin + end), end, damping, MASS, h)
        return abs(found.height - exact[0])

    # Per step one order more; the middle's slope alone gives 2^3.
    assert wrong(4e-4) / wrong(2e-4) > 2.0**4


def test_a_stiffness_that_changes_over_many_decays_leaves_the_velocity_at_its_creep() -> None:
    """A released contact keeps that velocity: a series that no longer converges made a tenth of it."""
    begin, end, damping, h = 4.5e5, 4.1e5, 3e4, 1.3e-3
    exact = solve_ivp(
        lambda s, z: [z[1], -(begin + (end - begin) * s / h) / MASS * z[0] - damping / MASS * z[1]],
        (0.0, h), [1e-7, -1.5e-6], rtol=1e-12, atol=1e-20, method="Radau",
    ).y[:, -1]  # fmt: skip
    found = propagated_over_step(of(1e-7, -1.5e-6), begin, 0.5 * (begin + end), end, damping, MASS, h)
    # The middle's stiffness for the end's, which are 5 % apart
    assert tuple(found[:2]) == pytest.approx(tuple(exact), rel=0.06)


@pytest.mark.parametrize("rate", [0.2, -0.2])
@pytest.mark.parametrize("jump", [50.0, -50.0])
def test_behind_a_jump_the_error_is_that_of_two_femora_that_meet_it(rate: float, jump: float) -> None:
    # Two femora under no load, one higher by e: they meet the boundary e/rate apart in time; so long the force acts.
    e, mass, t = 1e-6, MASS, 1e-3
    height, velocity = 0.0, -rate  # the boundary lies at the height 0
    meeting = [-h / velocity for h in (height, height + e)]
    velocities = [velocity + jump / mass * (t - begin) for begin in meeting]
    found = saltation(of(e, 0.0), rate, jump, 0.0, mass, 1.0)
    assert found.velocity == pytest.approx(velocities[1] - velocities[0], rel=1e-12)
    assert found.height == e


def test_a_jump_met_at_no_speed_is_not_felt_longer_than_the_interval() -> None:
    found = saltation(of(1e-6, 0.0), 0.0, 50.0, 0.0, MASS, 5e-3)
    assert 0.0 < abs(found.velocity) <= 5e-3 * 50.0 / MASS


def test_parts_of_an_error_cancel_and_what_is_not_known_of_them_does_not() -> None:
    one = with_step(EXACT, StateError(1e-7, 0.0), 0.5, HELD)
    both = with_step(one, StateError(-1e-7, 0.0), 0.5, HELD)
    assert both.height == 0.0
    assert both.hh == pytest.approx(2.0 * one.hh, rel=1e-12)  # rounding
    assert reach(both, math.inf) > 0.5e-7


def test_an_error_that_has_grown_out_of_all_bounds_stays_a_number() -> None:
    for wild in (of(math.inf, 0.0), of(math.nan, 1.0), PropagatedError(0.0, 0.0, math.inf, math.nan, 1e300)):
        kept = bounded(wild)
        assert np.isfinite(kept).all()
        assert reach(kept, 100.0) == LARGEST_HEIGHT_ERROR
        assert kept.vv <= LARGEST_VELOCITY_ERROR**2
    assert bounded(of(1e-7, 1e-4)) == of(1e-7, 1e-4)


def test_a_swing_that_passes_zero_is_still_an_error() -> None:
    assert reach(of(0.0, 1e-4), 1e3) == pytest.approx(EXPECTED * 1e-7, rel=1e-12)  # rounding
    assert reach(of(0.0, 1e-4), math.inf) == 0.0


def test_the_forces_error_is_that_of_spring_and_dashpot_together() -> None:
    # An error that creeps: the dashpot carries what the spring does not.
    creeping = of(1e-6, -1e-6 * 4e6 / 2e4)
    assert force_reach(creeping, 4e6, 2e4, 0.0, math.inf) == pytest.approx(0.0, abs=1e-14)  # rounding of 4 N
    assert force_reach(of(1e-6, 0.0), 4e6, 2e4, 0.0, math.inf) == pytest.approx(EXPECTED * 4.0, rel=1e-12)


def test_bounds_add_up() -> None:
    once = with_bound(EXACT, 1e-7, 1e-4)
    assert reach(once, math.inf) == pytest.approx(1e-7, rel=1e-12)  # rounding
    assert reach(with_bound(once, 2e-7, 0.0), math.inf) == pytest.approx(3e-7, rel=1e-12)


def test_what_adds_aside_leaves_a_late_femur_late() -> None:
    """Both errors follow from one time: what is added aside is what this time does not tell, in the same direction."""
    late, speed, acceleration = 1e-6, 3.0, 5e3
    error = PropagatedError(
        0.0, 0.0, (late * speed) ** 2, late * late * speed * acceleration, (late * acceleration) ** 2
    )
    for _ in range(100):
        error = with_uncorrelated_bound(error, 0.0, 3e-9)
    own = error.vv - error.hv**2 / error.hh
    assert own == pytest.approx((100 * 1e-9) ** 2, rel=1e-2)  # a difference of squares
    once = with_uncorrelated_bound(EXACT, 3e-6, 0.0)
    assert with_uncorrelated_bound(once, 3e-6, 0.0).hh == pytest.approx(4.0 * once.hh, rel=1e-12)  # rounding


def test_doubt_in_another_direction_each_time_adds_as_squares() -> None:
    error = with_doubt(with_doubt(of(0.0, 0.0), 3e-6), 3e-6)
    assert velocity_reach(error) == pytest.approx(3e-6 * math.sqrt(2.0), rel=1e-12)  # rounding


def test_in_flight_a_velocity_is_carried_into_the_height() -> None:
    carried = propagated_in_flight(PropagatedError(3e-7, -1e-4, 4e-14, 0.0, 9e-10), 2e-3)
    assert carried == pytest.approx((1e-7, -1e-4, 4e-14 + 36e-16, 18e-13, 9e-10), rel=1e-9)  # rounding of differences


def advanced(contact_law: ContactLaw, start: RunState, duration: float, load: float = 0.0) -> TickResult:
    """One tick of a circle of 2 kg under a constant load."""
    pair, hinge = OnPlane(Circle(RADIUS)), Hinge()
    interval = Interval(pair, hinge, duration, 0.0, 0.0, load, 0.0, math.nan)
    scene = Scene(pair, hinge, ContactModes(contact_law, False), MASS, 1e-10, 0.0, 0, LEVELS["dynamic"])
    return dynamic_tick(scene, interval, start, 0)


def begun(depth: float, rate: float, speed: float, doubt: float = 0.0) -> RunState:
    """A contact that began at a speed, give or take a doubt."""
    start = moving(FemurState(RADIUS - depth, -rate))
    return start._replace(impact_speed=speed, impact_error=doubt)


def test_a_doubtful_impact_speed_puts_the_force_in_doubt() -> None:
    # Hardly any time goes by: the force differs at once, and the depth not yet.
    flores, duration, depth = law("flores"), 1e-9, 3e-4
    doubtful = advanced(flores, begun(depth, 0.3, 0.5, 0.02), duration)
    one, other = (advanced(flores, begun(depth, 0.3, speed), duration) for speed in (0.5, 0.52))
    assert doubtful.force == one.force
    assert one.error_estimate < 1e-10
    assert abs(other.force - one.force) > 1.0
    assert abs(other.force - one.force) <= doubtful.force_error_estimate


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


def test_a_contact_that_lets_go_keeps_the_doubt_of_its_speed() -> None:
    """Nothing presses, and its surfaces part at a speed that its impact has set, in one long step up to no force."""
    flores, duration, depth = law("flores"), 0.05, 3e-4
    doubtful = advanced(flores, begun(depth, -0.3, 0.5, 5e-4), duration)
    one, other = (advanced(flores, begun(depth, -0.3, speed), duration) for speed in (0.5, 0.5005))
    assert doubtful.depth == one.depth < -1e-3
    assert 1e-6 < abs(other.depth - one.depth) <= doubtful.error_estimate
    later = advanced(flores, doubtful.run_state, duration)
    after = advanced(flores, other.run_state, duration)
    assert abs(after.depth - later.depth) <= later.error_estimate


def test_a_femur_that_lands_late_lands_at_another_speed() -> None:
    """The load has pressed it on for that time, and damping that remembers the impact goes by it ever after."""
    flores, above = law("flores"), 1e-4
    error = PropagatedError(height=1e-6, velocity=0.0, hh=0.0, hv=0.0, vv=0.0)
    lands = moving(FemurState(RADIUS + above, -0.05))._replace(error=error, depth=-above)
    late = moving(FemurState(RADIUS + above + 1e-6, -0.05))._replace(depth=-above - 1e-6)
    one, other = (advanced(flores, start, 2e-3, load=200.0).run_state for start in (lands, late))
    assert other.impact_speed != one.impact_speed
    assert abs(other.impact_speed - one.impact_speed) <= one.impact_error


def test_a_touch_that_comes_too_late_to_be_sure_of_is_in_doubt_for_its_tick() -> None:
    # The answer has long come to rest by the tick's end; the exact femur may still be on its way.
    error = PropagatedError(0.0, 0.0, 1e-4, 0.0, 0.0)  # 1 cm
    start = moving(FemurState(RADIUS + 1e-4, -0.02))._replace(error=error, depth=-1e-4)
    touched = advanced(law("kelvin_voigt"), start, 0.05, load=1.0)
    assert not math.isnan(touched.run_state.impact_speed)
    assert touched.error_estimate > 1e-3


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
