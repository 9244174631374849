"""Levels: what each makes of what is sensed, and what it does not look at."""

from __future__ import annotations

import math
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from knee_contact_ros.joint_reaction.estimator import LEVELS, Level
from knee_contact_ros.joint_reaction.leg import STANDING, UNKNOWN, Ground, Joints, net_moments
from tests.joint_reaction.examples import LEG, STANDING_STILL, angles, ground, motion

draws = st.integers(0, 2**32).map(Random)
LOWER = 0.061 * 75.0 * 9.80665
"""[N] shank and foot"""
FEW = 1e-11
"""[N m] or [N]: some roundings of 1e-16 of 3000 N at most"""
NOT_MEASURED = (UNKNOWN, UNKNOWN, UNKNOWN)


def under(force: float) -> Ground:
    return Ground((0.0, force, 0.0), NOT_MEASURED)


def test_levels_go_from_what_needs_least_to_what_knows_most() -> None:
    assert [way.level for way in LEVELS.values()] == list(Level)
    assert [level.name.lower() for level in Level] == list(LEVELS)
    errors = [way.error for way in LEVELS.values()]
    assert errors == sorted(errors, reverse=True)
    assert all(error.calibrated < error.uncalibrated for error in errors)


def test_the_weight_above_a_bent_knee_by_hand() -> None:
    """At 60 degrees the knee is half a shank off the line from hip to ankle."""
    found = LEVELS["ground_force"].dynamics(LEG, Joints(math.pi / 3.0, UNKNOWN, UNKNOWN), STANDING_STILL, under(500.0))
    assert found[0] == pytest.approx(500.0 * 0.5 * 0.246 * 1.8, abs=FEW)
    assert found.compression == pytest.approx(500.0 - LOWER, abs=FEW)
    assert math.isnan(found.plantarflexion)
    assert math.isnan(found.frontal)


def test_a_straight_or_unloaded_knee_needs_no_extensor() -> None:
    for flexion, force in ((0.0, 700.0), (-0.1, 700.0), (1.0, 0.0), (1.0, -5.0)):
        found = LEVELS["ground_force"].dynamics(LEG, Joints(flexion, UNKNOWN, UNKNOWN), STANDING_STILL, under(force))
        assert found.extension == 0.0
        assert found.compression == pytest.approx(max(force, 0.0) - LOWER, abs=FEW)


@given(draw=draws)
def test_the_ground_force_needs_no_more_than_itself_and_the_knee(draw: Random) -> None:
    joints, moving, (force, torque) = angles(draw), motion(draw), ground(draw)
    by = LEVELS["ground_force"].dynamics
    bare = by(
        LEG,
        Joints(joints.flexion, UNKNOWN, UNKNOWN),
        STANDING_STILL,
        Ground((UNKNOWN, force[1], UNKNOWN), NOT_MEASURED),
    )
    assert by(LEG, joints, moving, Ground(force, torque)) == pytest.approx(bare, nan_ok=True, abs=0.0)


@given(draw=draws)
def test_the_knee_moment_takes_foot_and_shank_as_one_body_whatever_the_ankle_does(draw: Random) -> None:
    joints, moving, sensed = angles(draw), motion(draw), ground(draw)
    stiff = net_moments(LEG, joints._replace(ankle=0.0), moving._replace(ankle=STANDING), sensed)
    for ankle in (joints.ankle, UNKNOWN):
        found = LEVELS["knee_moment"].dynamics(LEG, joints._replace(ankle=ankle), moving, sensed)
        assert found._replace(plantarflexion=0.0) == stiff._replace(plantarflexion=0.0)
        assert math.isnan(found.plantarflexion)


@given(draw=draws)
def test_without_the_hip_the_knee_moment_is_that_above_a_flat_foot(draw: Random) -> None:
    sensed = (angles(draw)._replace(hip=UNKNOWN), motion(draw), ground(draw))
    found, flat = LEVELS["knee_moment"].dynamics(LEG, *sensed), net_moments(LEG, *sensed)
    assert found._replace(plantarflexion=0.0) == flat._replace(plantarflexion=0.0)
    assert math.isnan(found.plantarflexion)


@given(draw=draws)
def test_the_ankle_moment_is_inverse_dynamics_as_it_is(draw: Random) -> None:
    sensed = (angles(draw), motion(draw), ground(draw))
    assert LEVELS["ankle_moment"].dynamics(LEG, *sensed) == net_moments(LEG, *sensed)
