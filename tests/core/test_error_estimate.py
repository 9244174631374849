"""The carried error: against the motions that it linearises."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.linalg import expm

from knee_contact_ros.core.error_estimate import behind_jump, carry, lost_swing, settled_doubt
from knee_contact_ros.core.integrators.base import NO_ERROR, FemurState, Stage, StateError, Step

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
    found = behind_jump(StateError(e, 0.0), rate, jump, mass, 1.0)
    assert found.velocity == pytest.approx(velocities[1] - velocities[0], rel=1e-12)
    assert found.height == e


def test_a_jump_met_at_no_speed_is_not_felt_longer_than_the_interval() -> None:
    found = behind_jump(StateError(1e-6, 0.0), 0.0, 50.0, MASS, 5e-3)
    assert abs(found.velocity) == pytest.approx(5e-3 * 50.0 / MASS)


def swinging(frequency: float, damping: float, h: float, amplitude: float, kept: float) -> Step:
    """A step that begins with a swing of some speed about a load of 100 N, and ends with a part of it."""
    stiffness = frequency**2 * MASS
    begin = Stage(0.0, 1e-4, amplitude, 100.0, stiffness)
    end = Stage(1.0, 1e-4, kept * amplitude, 100.0, stiffness)
    return Step(FemurState(0.034, 0.0), NO_ERROR, begin, (end,), stiffness, damping, 0, True)


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
    end = step.stages[-1]._replace(rate=slow, force=400.0)
    following = step._replace(begin=step.begin._replace(rate=slow), stages=(end,))
    assert lost_swing(following, 100.0, 3e4, MASS, 0.01) == pytest.approx(
        0.0, abs=1e-15
    )  # rounding of 400 N / stiffness


def test_what_is_left_to_the_static_answer_is_in_doubt() -> None:
    # Pulled by 300 N for 2 ms from rest in contact: it may be anywhere up to where it flies freely.
    pulled = settled_doubt(1e-4, 0.0, (-300.0, -300.0), MASS, 2e-3)
    assert pulled.height >= 1e-4 + 0.5 * 300.0 / MASS * 2e-3**2
    assert pulled.velocity >= 300.0 / MASS * 2e-3
    # Pressed: no faster than what the load gives over the way to the bottom.
    pressed = settled_doubt(1e-3, 0.2, (800.0, 2000.0), MASS, 2e-3)
    assert pressed.velocity == pytest.approx(0.2 + math.sqrt(2.0 * 2000.0 * 1e-3 / MASS))
    assert pressed.height == pytest.approx(1e-3 + 2e-3 * pressed.velocity)
