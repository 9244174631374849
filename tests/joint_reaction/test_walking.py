"""The load that is expected in level walking: where in a stride it is, when it counts, and what it leaves alone."""

import math

import pytest

from knee_contact_ros.joint_reaction.estimator import BIT_DOUBTFUL_LOAD, Estimator
from knee_contact_ros.joint_reaction.leg import NOT_MEASURED, Ground, Joints
from knee_contact_ros.joint_reaction.walking import (
    MEASURED_LOADS,
    NOT_WALKING,
    StrideLoads,
    StridePhase,
)
from tests.joint_reaction.examples import EPOCH, MS, PERSON, STANDING_STILL

RAMP = StrideLoads(
    tuple(float(each) for each in range(21)), tuple(float(each) for each in range(20, 11, -1))
)
"""Twenty times the part of a stance, and 20 less eight times that of a swing: no step where they meet"""
ROUNDING = 1e-9
"""[body weights] stamps of 1.7e18 ns are exact, and parts of a stride are sums of a few roundings of 1e-16"""
STEP = 10 * MS


def follow(stride, forces, since=0):
    """What is expected at forces [body weights] every 10 ms."""
    return [stride.expect_load(EPOCH + since + n * STEP, force) for n, force in enumerate(forces)]


def steps(*phases):
    """Forces [body weights] that hold for numbers of samples."""
    return [force for force, number in phases for _ in range(number)]


def test_a_stride_by_hand():
    found = follow(StridePhase(RAMP), steps((0.0, 5), (0.6, 71), (0.0, 42), (0.6, 50)))
    assert found[4] == NOT_WALKING
    assert found[5] == (0.0, 0.0)
    assert found[10] == pytest.approx(
        (20.0 * 0.05 / 0.71, 0.5), abs=ROUNDING
    )  # it gains its weight in 0.1 s
    assert found[40] == pytest.approx((20.0 * 0.35 / 0.71, 1.0), abs=ROUNDING)
    assert found[75] == pytest.approx(
        (20.0 * (1.0 - 0.2 * 0.6), 1.0), abs=ROUNDING
    )  # still borne: not over
    assert found[76].load == pytest.approx(
        20.0 * 0.88, abs=ROUNDING
    )  # a step is spread over 0.1 s
    assert found[81].load == pytest.approx(20.0 - 8.0 * 0.05 / 0.42 - 0.5 * 2.4, abs=ROUNDING)
    assert found[97].load == pytest.approx(20.0 - 8.0 * 0.21 / 0.42, abs=ROUNDING)
    # The next heel strike comes at the end of the swing: 12 there, 0 behind it.
    assert found[118].load == pytest.approx(20.0 - 8.0 * 0.41 / 0.42, abs=0.2)
    assert found[138] == pytest.approx((20.0 * 0.2 / 0.71, 1.0), abs=ROUNDING)


def test_the_pace_is_that_of_the_last_stance():
    found = follow(StridePhase(RAMP), steps((0.0, 5), (0.6, 100), (0.0, 45), (0.6, 60)))
    assert found[-1].load == pytest.approx(20.0 * 0.59 / 1.0, abs=ROUNDING)


@pytest.mark.parametrize(
    "forces",
    [
        steps((0.6, 50)),  # no heel strike was seen
        steps((0.0, 50)),
        steps((0.0, 5), (0.5, 140)),  # standing
        steps((0.0, 5), (0.6, 71), (0.0, 110)),  # sitting
        steps((0.0, 5), (0.6, 20), (0.0, 20)),  # a foot that taps
    ],
)
def test_what_is_no_walk_is_not_expected(forces):
    assert follow(StridePhase(), forces)[-1] == NOT_WALKING


def test_a_recording_may_begin_with_a_heel_strike_and_a_pause_begins_anew():
    stride = StridePhase(RAMP)
    assert follow(stride, steps((0.1, 1), (0.8, 30)))[-1].certainty == 1.0
    assert follow(stride, [0.8], since=2000 * MS) == [NOT_WALKING]
    assert stride.expect_load(EPOCH, 0.8) == NOT_WALKING


def estimate_mid_stance(share, assistance=0.0, flexion=0.3):
    """Axial, sensed and expected force [N] and status at 0.355 s of a stance."""
    estimator = Estimator("ground_force", PERSON._replace(expected_load=share))
    joints = Joints(flexion, NOT_MEASURED, NOT_MEASURED, assistance)
    for n in range(73):
        force = 0.0 if n == 0 else 600.0
        ground = Ground((0.0, force, 0.0), (NOT_MEASURED,) * 3)
        found = estimator.estimate(EPOCH + n * 5 * MS, joints, STANDING_STILL, ground)
    return found.axial_force, found.sensed_force, found.expected_force, found.status


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_the_estimate_is_the_weighted_mean_of_both_parts(share):
    axial, sensed, expected, status = estimate_mid_stance(share)
    assert status == 0
    assert expected == pytest.approx(MEASURED_LOADS.stance[10] * PERSON.weight, rel=1e-12)
    assert axial == pytest.approx((1.0 - share) * sensed + share * expected, rel=1e-12)


def test_what_an_actuator_changes_is_not_averaged_away():
    plain, helped = estimate_mid_stance(0.5), estimate_mid_stance(0.5, assistance=20.0)
    assert helped[1] < plain[1] - 100.0
    assert helped[0] - plain[0] == pytest.approx(helped[1] - plain[1], rel=1e-9)
    assert helped[2] == plain[2]


def test_another_movement_leaves_the_sensors_alone():
    axial, sensed, expected, status = estimate_mid_stance(0.5, flexion=1.2)
    assert status == BIT_DOUBTFUL_LOAD
    assert axial == sensed
    assert math.isnan(expected)
