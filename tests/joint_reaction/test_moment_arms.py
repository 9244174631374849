"""Moment arms: what the polynomials give is written down, and beyond their range they are as at its end."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from knee_contact_ros.joint_reaction.muscles import (
    ACHILLES,
    GASTROCNEMIUS,
    GASTROCNEMIUS_SHARE,
    HAMSTRINGS,
    LEAST_DORSIFLEXION,
    LEAST_FLEXION,
    MOST_DORSIFLEXION,
    MOST_FLEXION,
    QUADRICEPS,
    arm,
)

MUSCLES = {"quadriceps": QUADRICEPS, "hamstrings": HAMSTRINGS, "gastrocnemius": GASTROCNEMIUS, "achilles": ACHILLES}
RANGES = {name: (math.radians(-10.0), math.radians(110.0)) for name in MUSCLES}
RANGES["achilles"] = (math.radians(-30.0), math.radians(25.0))
WRITTEN_DOWN = {
    "quadriceps": {0: 44.63, 30: 45.84, 60: 37.52, 90: 27.32},
    "hamstrings": {0: 26.16, 30: 34.25, 60: 31.20, 90: 18.83},
    "gastrocnemius": {0: 22.20, 30: 20.92, 60: 17.74, 90: 13.73},
    "achilles": {-20: 47.82, -10: 47.40, 0: 45.73, 20: 38.67},
}
"""[mm] at angles [deg]; each is a sum of powers, by hand"""
each_muscle = pytest.mark.parametrize("name", MUSCLES)


@each_muscle
def test_arms_stay_what_they_were_fitted_to(name: str) -> None:
    for degrees, millimetres in WRITTEN_DOWN[name].items():  # with two decimals
        assert 1e3 * arm(MUSCLES[name], math.radians(degrees)) == pytest.approx(millimetres, abs=0.0051)


@each_muscle
def test_arms_are_the_polynomials_and_always_of_one_sign(name: str) -> None:
    for angle in np.linspace(*RANGES[name], 200)[1:-1].tolist():
        expected = float(np.polynomial.polynomial.polyval(angle, MUSCLES[name]))
        assert arm(MUSCLES[name], angle) == pytest.approx(expected, rel=1e-14)  # roundings
        assert 0.005 < arm(MUSCLES[name], angle) < 0.06


def test_the_ranges_are_those_that_were_fitted_to() -> None:
    told = [math.degrees(end) for end in (LEAST_FLEXION, MOST_FLEXION, LEAST_DORSIFLEXION, MOST_DORSIFLEXION)]
    assert told == pytest.approx([-10.0, 110.0, -30.0, 25.0], abs=0.003)  # four decimals of a radian


@each_muscle
@given(beyond=st.floats(0.0, 10.0))
def test_beyond_the_range_an_arm_is_that_at_its_end(name: str, beyond: float) -> None:
    for end, sign in zip(RANGES[name], (-1.0, 1.0), strict=True):
        # the end is told with four decimals of a radian, and no arm changes by more than 0.05 m/rad
        assert arm(MUSCLES[name], end + sign * beyond) == pytest.approx(arm(MUSCLES[name], end), abs=0.05 * 5e-5)
        assert arm(MUSCLES[name], end + sign * (1.0 + beyond)) == arm(MUSCLES[name], end + sign)


def test_the_gastrocnemius_share_is_that_of_force_times_arm() -> None:
    """Maximum isometric forces [N] and arms [mm] of the three plantarflexors in gait2354."""
    calf, soleus, tibialis = 2500.0 * 46.0, 4000.0 * 45.0, 3600.0 * 11.0
    assert GASTROCNEMIUS_SHARE == 0.342
    assert pytest.approx(calf / (calf + soleus + tibialis), abs=0.003) == GASTROCNEMIUS_SHARE  # arms to half a mm
