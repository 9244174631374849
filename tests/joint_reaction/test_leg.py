"""Proportions by the published table, net moments against Lagrange's equations, and motion against NumPy's fit."""

import math
from random import Random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from knee_contact_ros.joint_reaction.leg import (
    MIN_MOTION_SAMPLES,
    MOTIONLESS,
    NOT_MEASURED,
    NOT_TURNING,
    Ground,
    Joints,
    MotionFilter,
    leg_of,
    net_moments,
)
from tests.joint_reaction.examples import (
    EPOCH,
    LEG,
    MS,
    STANDING_STILL,
    angles,
    ground,
    motion,
    walking,
)
from tests.joint_reaction.lagrange import Chain

ROUNDINGS = 1e-10
"""[N m] or [N]: the reference subtracts powers up to 1e5 W, some ten roundings of 1e-16 of them"""
FEW = 1e-11
"""[N m] or [N]: some roundings of 1e-16 of the 3000 N at most that are added here"""
WINDOW = 0.05
SPAN = 50 * MS
FIT = 1e-11
"""Of an angle of 1 rad: 1e-16 by the condition of a parabola on stamps in one window (524, a Hilbert matrix; of a few
stamps that lie anyhow some more), by some tens of additions. A rate has it by the window, an acceleration twice."""
Samples = list[tuple[int, Joints]]
draws = st.integers(0, 2**32).map(Random)
bodies = st.builds(leg_of, st.floats(30.0, 200.0), st.floats(1.2, 2.2))


def test_a_leg_of_100_kg_and_2_m():
    """Winter 2009: table 4.1 (leg and foot; the foot from ankle to second metatarsal), figure 4.1 (lengths)."""
    foot = (0.152**2 + 0.078**2) ** 0.5  # [m] half a foot's length ahead, an ankle's height down
    expected = (
        980.665,
        0.490,
        0.492,
        0.016,
        4.65,
        0.433 * 0.492,
        4.65 * (0.302 * 0.492) ** 2,
        1.45,
        0.076,
        0.039,
        1.45 * (0.475 * foot) ** 2,
    )
    assert leg_of(100.0, 2.0) == pytest.approx(expected, rel=1e-14)  # roundings, here as below


def by_lagrange(leg, joints, moving, under):
    turning = (moving.hip, moving.flexion, moving.ankle)
    return Chain(leg).holds(
        np.array([joints.hip, joints.flexion, joints.ankle]),
        np.array([one.rate for one in turning]),
        np.array([one.acceleration for one in turning]),
        np.array(under.force[:2]),
        under.torque[2],
    )


def still(joints, under, leg=LEG):
    return net_moments(leg, joints, STANDING_STILL, under)


@given(leg=bodies, draw=draws)
def test_moments_and_compression_are_those_of_lagrange_and_newton(leg, draw):
    """A foot whose ankle is not known is one body with the shank; without the hip it stands flat, and nothing moves."""
    joints, moving, under = angles(draw), motion(draw), ground(draw)
    flat = joints._replace(hip=joints.flexion - joints.ankle)  # shank + ankle: 0
    for found, expected in (
        ((joints, moving), (joints, moving)),
        (
            (joints._replace(ankle=NOT_MEASURED), moving),
            (joints._replace(ankle=0.0), moving._replace(ankle=NOT_TURNING)),
        ),
        ((joints._replace(hip=NOT_MEASURED), moving), (flat, STANDING_STILL)),
    ):
        assert net_moments(leg, *found, under)[:3] == pytest.approx(
            by_lagrange(leg, *expected, under), abs=ROUNDINGS
        )
    alone = net_moments(leg, joints._replace(hip=NOT_MEASURED), moving, under)
    assert alone.frontal == pytest.approx(still(flat, under, leg).frontal, abs=FEW)


@given(draw=draws)
def test_the_frontal_moment_is_that_of_all_the_grounds_wrench_about_the_knee(draw):
    joints, (force, torque) = angles(draw), ground(draw)
    shank = joints.hip - joints.flexion
    down, forward = (
        [math.sin(shank), -math.cos(shank), 0.0],
        [math.cos(shank), math.sin(shank), 0.0],
    )
    ankle = LEG.shank_length * np.array(down) - np.array([0.0, 0.0, LEG.knee_offset])
    moment = np.array(torque) + np.cross(ankle, force)
    assert still(joints, Ground(force, torque)).frontal == pytest.approx(
        -float(moment @ forward), abs=FEW
    )


def along(samples, window=WINDOW):
    """At every sample of a stream."""
    motion = MotionFilter(window)
    return [motion.add_angles(*sample) for sample in samples]


def within(samples, span=SPAN):
    """Those that a window sees from the last one on."""
    return [sample for sample in samples if samples[-1][0] - sample[0] <= span]


def assert_fitted(found, samples, window=WINDOW):
    """As by NumPy, about the middle of the stamps, but for rounding."""
    times = np.array([1e-9 * (stamp - samples[0][0]) for stamp, _ in samples])
    times -= times.mean()
    scale = float(np.abs(times).max())
    for turning, angle in zip(
        found, np.array([joints[:3] for _, joints in samples]).T, strict=True
    ):
        square, slope, _ = np.polyfit(times / scale, angle, 2).tolist()
        assert turning.rate == pytest.approx(slope / scale, abs=FIT / window)
        assert turning.acceleration == pytest.approx(2.0 * square / scale**2, abs=FIT / window**2)


@pytest.mark.parametrize("window", [0.02, 0.05, 0.2])
@pytest.mark.parametrize("shaken", [0.0, 0.4])
def test_it_is_numpys_fit_all_along_a_stream(window, shaken):
    samples = walking(700, MS, shaken)
    found = along(samples, window)
    for number in range(round(1e3 * window) + 1, 700, 23):
        assert_fitted(found[number], within(samples[: number + 1], round(1e9 * window)), window)


@pytest.mark.parametrize(
    ("step", "shaken"), [(MS, 0.0), (MS, 0.9), (7 * MS, 0.5), (MS // 40, 0.0), (MS // 40, 0.9)]
)
def test_bits_depend_on_what_is_in_the_window_alone(step, shaken):
    """However long the stream has run, and whatever came before: no sum goes on from one stamp to the next."""
    samples = walking(3000, step, shaken)
    motion = MotionFilter(WINDOW)
    for number in range(1000):
        motion.add_angles(EPOCH - 2000 * MS + number * MS, Joints(1e300, -1e300, 1e17))
    found = [motion.add_angles(*sample) for sample in samples]
    assert found[-1] != MOTIONLESS
    for number in range(2000, 3000, 97):
        assert along(within(samples[: number + 1]))[-1] == found[number]


def test_it_forgets_on_request_and_after_a_pause():
    samples, motion = walking(200), MotionFilter(WINDOW)
    for sample in samples:
        motion.add_angles(*sample)
    motion.forget_angles()
    earlier, later = (
        [(stamp + shift * MS, joints) for stamp, joints in samples] for shift in (-3000, 60000)
    )
    assert [motion.add_angles(*sample) for sample in [*earlier, *later]] == [
        *along(earlier),
        *along(later),
    ]


@pytest.mark.parametrize(
    ("samples", "still"),
    [
        (walking(100), 25),  # until half a window is known
        (walking(8, 12 * MS), MIN_MOTION_SAMPLES - 1),  # until a few angles are
        (walking(30, 20 * MS), 30),  # three in a window
    ],
)
def test_it_is_still_until_enough_is_known(samples, still):
    assert [motion == MOTIONLESS for motion in along(samples)] == [True] * still + [False] * (
        len(samples) - still
    )
    assert set(along(samples, 0.0)) == {MOTIONLESS}


@pytest.mark.parametrize("missing", [("hip",), ("ankle",), ("hip", "ankle")])
@pytest.mark.parametrize("one", [True, False])
def test_a_joint_that_is_not_measured_stands_and_harms_no_other(missing, one):
    """One angle that is missing is forgotten with its window."""
    samples = walking(200)
    known = [one and number != 100 for number in range(200)]
    seen = [
        each if there else (each[0], each[1]._replace(**dict.fromkeys(missing, NOT_MEASURED)))
        for each, there in zip(samples, known, strict=True)
    ]
    standing = dict.fromkeys(missing, NOT_TURNING)
    for number, (found, whole) in enumerate(zip(along(seen), along(samples), strict=True)):
        assert found == (whole if one and not 100 <= number <= 150 else whole._replace(**standing))
