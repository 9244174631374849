"""Oscillations that a step damps away although the contact does not."""

from __future__ import annotations

import math

import pytest

from knee_contact_ros.core.integrators.base import INSIDE, NO_ERROR, FemurState, Stage, Step
from knee_contact_ros.core.unresolved_motion import lost_swing
from tests.helpers.scenes import MASS


def swinging(frequency: float, damping: float, h: float, amplitude: float, kept: float) -> Step:
    """A step that begins with a swing of some speed about a load of 100 N, and ends with a part of it."""
    stiffness = frequency**2 * MASS
    begin = Stage(1e-4, amplitude, 100.0, stiffness, 0.0)
    end = Stage(1e-4, kept * amplitude, 100.0, stiffness, 0.0)
    return Step(FemurState(0.034, 0.0), NO_ERROR, begin, end, INSIDE, stiffness, damping, 1.0, 0.0, 0, True)


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
