"""Estimates sample by sample: what each level makes of what is sensed."""

import math
from random import Random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from knee_contact_ros.joint_reaction.estimator import LOAD_LEVELS, Estimator
from knee_contact_ros.joint_reaction.leg import (
    NOT_MEASURED,
    NOT_TURNING,
    Ground,
    Joints,
    MotionFilter,
    Turning,
    net_moments,
)
from knee_contact_ros.model.types import Status
from tests.joint_reaction.examples import (
    EPOCH,
    LEG,
    MS,
    PERSON,
    STANDING_STILL,
    angles,
    ground,
    motion,
)
from tests.joint_reaction.lagrange import Chain

WINDOW = 0.05
STANCE = Ground((20.0, 700.0, -15.0), (3.0, 2.0, 40.0))
NO_TORQUE = (NOT_MEASURED, NOT_MEASURED, NOT_MEASURED)
FEW = 1e-11
"""[N m] or [N]: some roundings of 1e-16 of 3000 N at most"""
draws = st.integers(0, 2**32).map(Random)


class EstimatorWithMotion:
    """An estimator with a filter that computes the motion of the same joints."""

    def __init__(self, level, *trust):
        self.estimator, self.motion = Estimator(level, PERSON, *trust), MotionFilter(WINDOW)

    def at(self, stamp, joints, sensed, status=0):
        return self.estimator.estimate(
            stamp, joints, self.motion.add_angles(stamp, joints), sensed, status
        )


@pytest.mark.parametrize(
    ("flexion", "force", "extension"),
    [
        (
            math.pi / 3.0,
            500.0,
            0.6 * 500.0 * 0.5 * 0.246 * 1.8,
        ),  # half a shank off the line from hip to ankle
        (0.0, 700.0, 0.0),
        (-0.1, 700.0, 0.0),
        (1.0, 0.0, 0.0),
        (1.0, -5.0, 0.0),
    ],
)
def test_the_weight_above_a_bent_knee_by_hand(flexion, force, extension):
    under = Ground((0.0, force, 0.0), NO_TORQUE)
    found = LOAD_LEVELS["ground_force"].dynamics(
        LEG, Joints(flexion, NOT_MEASURED, NOT_MEASURED), STANDING_STILL, under
    )
    compression = max(force, 0.0) - 0.061 * 75.0 * 9.80665  # without shank and foot
    expected = (extension, NOT_MEASURED, compression, NOT_MEASURED)
    assert found == pytest.approx(expected, abs=FEW, nan_ok=True)
    turning = STANDING_STILL._replace(
        flexion=Turning(3.0, 100.0)
    )  # half of it stopped by flexors, where nothing is borne
    stopped = LOAD_LEVELS["ground_force"].dynamics(
        LEG, Joints(flexion, NOT_MEASURED, NOT_MEASURED), turning, under
    )
    inertia = (
        0.0465 * 75.0 * (0.302**2 + 0.433**2) * (0.246 * 1.8) ** 2
        + 0.0145 * 75.0 * (0.246 * 1.8) ** 2
    )
    inertia += 0.0145 * 75.0 * 0.475**2 * ((0.5 * 0.152 * 1.8) ** 2 + (0.039 * 1.8) ** 2)
    free = 1.0 - max(force, 0.0) / (75.0 * 9.80665)
    assert found.extension - stopped.extension == pytest.approx(
        0.5 * inertia * 100.0 * free, rel=1e-9
    )


@given(draw=draws)
def test_what_each_level_looks_at(draw):
    joints, moving, sensed = angles(draw), motion(draw), ground(draw)

    def by(level, joints, moving=moving, sensed=sensed):
        """What is not a number, as a text."""
        return [
            each if math.isfinite(each) else "?"
            for each in LOAD_LEVELS[level].dynamics(LEG, joints, moving, sensed)
        ]

    bare = (
        Joints(joints.flexion, NOT_MEASURED, NOT_MEASURED),
        STANDING_STILL._replace(flexion=moving.flexion),
        Ground((NOT_MEASURED, sensed.force[1], NOT_MEASURED), NO_TORQUE),
    )
    assert by("ground_force", joints) == by("ground_force", *bare)
    extension, _, compression, frontal = net_moments(
        LEG, joints._replace(ankle=0.0), moving._replace(ankle=NOT_TURNING), sensed
    )
    for ankle in (
        joints.ankle,
        NOT_MEASURED,
    ):  # foot and shank are one body, whatever the ankle does
        assert by("knee_moment", joints._replace(ankle=ankle)) == [
            extension,
            "?",
            compression,
            frontal,
        ]
    flat = joints._replace(hip=NOT_MEASURED)
    extension, _, compression, frontal = net_moments(LEG, flat, moving, sensed)
    assert by("knee_moment", flat) == [extension, "?", compression, frontal]
    assert by("ankle_moment", joints) == list(net_moments(LEG, joints, moving, sensed))


@pytest.mark.parametrize(
    ("level", "number"),
    [("ground_force", 0), ("knee_moment", 1), ("ankle_moment", 2), ("net_load", 3)],
)
def test_what_is_passed_through_and_how_far_it_is_trusted(level, number):
    weight, error = 75.0 * 9.80665, LOAD_LEVELS[level]
    for calibrated, measured in ((False, error.uncalibrated), (True, error.calibrated)):
        for given_deviation, floor, part in (
            (0.0, measured.floor, measured.part),
            (0.2, 0.2, 0.0),
        ):
            trusted = EstimatorWithMotion(level, calibrated, given_deviation)
            found = trusted.at(EPOCH, Joints(0.4, 0.2, 0.1, 12.5, 3.0), STANCE, 17)
            assert (found.flexion_angle, found.assistance) == (0.4, 12.5)
            assert (found.level, found.calibrated, found.status) == (number, calibrated, 17)
            expected = math.sqrt((floor * weight) ** 2 + (part * found.axial_force) ** 2)
            assert found.standard_deviation == pytest.approx(
                expected, rel=4e-15
            )  # products in another order


ANKLE = {"ankle_moment"}
KNEE = {
    "sensed_force",
    "axial_force",
    "standard_deviation",
    "quadriceps_force",
    "knee_moment",
    "frontal_moment",
}
FULL, TORQUE = Joints(0.4, 0.2, 0.1), STANCE.torque
NO_HIP, NO_ANKLE, ALONE = (
    FULL._replace(hip=NOT_MEASURED),
    FULL._replace(ankle=NOT_MEASURED),
    Joints(0.4, NOT_MEASURED, NOT_MEASURED),
)


@pytest.mark.parametrize(
    ("level", "joints", "torque", "unknown"),
    [
        ("ground_force", FULL, TORQUE, {*ANKLE, "frontal_moment"}),
        ("ground_force", ALONE, NO_TORQUE, {*ANKLE, "frontal_moment"}),
        ("knee_moment", FULL, TORQUE, ANKLE),
        ("knee_moment", NO_ANKLE, TORQUE, ANKLE),
        ("knee_moment", NO_HIP, TORQUE, ANKLE),
        ("knee_moment", FULL, NO_TORQUE, ANKLE | KNEE),
        ("knee_moment", ALONE, TORQUE, {*ANKLE, *KNEE, "resultant_force"}),
        ("ankle_moment", FULL, TORQUE, set()),
        ("ankle_moment", NO_HIP, TORQUE, set()),
        ("ankle_moment", NO_ANKLE, TORQUE, set()),
        ("net_load", ALONE, TORQUE, ANKLE),
    ],
)
def test_what_is_not_known_is_not_a_number(level, joints, torque, unknown):
    estimator = EstimatorWithMotion(level)
    for number in range(100):
        found = estimator.at(EPOCH + number * MS, joints, Ground((20.0, 700.0, -15.0), torque))
        if number in (0, 99):
            assert {
                name for name, value in found._asdict().items() if math.isnan(value)
            } == unknown | {"expected_force"}
    assert (found.gastrocnemius_force > 100.0) == (
        level == "ankle_moment"
    )  # asked for where the ankle is known


@given(draw=draws)
def test_moments_of_joints_that_turn_steadily_quicker_are_those_of_lagrange(draw):
    """Parabolas: the angles of now, the rates of half a window before."""
    curves = np.array(
        [
            [draw.uniform(-0.5, 0.5), draw.uniform(-5.0, 5.0), draw.uniform(-60.0, 60.0)]
            for _ in range(3)
        ]
    )
    sensed, one = ground(draw), EstimatorWithMotion("ankle_moment")
    for number in range(-50, 1):
        time = 1e-3 * number
        hip, flexion, ankle = (curves @ (1.0, time, 0.5 * time * time)).tolist()
        found = one.at(EPOCH + number * MS, Joints(flexion, hip, ankle, 7.0, 4.0), sensed)
    rates = curves[:, 1] - 0.5 * WINDOW * curves[:, 2]
    expected = Chain(LEG).holds(
        curves[:, 0], rates, curves[:, 2], np.array(sensed.force[:2]), sensed.torque[2]
    )
    # Accelerations to 4e-9 rad/s^2 (`test_leg.py`), with inertias of 2 kg m^2 and masses by lengths of 4 kg m
    measured = (found.knee_moment + 7.0, found.ankle_moment + 4.0, found.resultant_force)
    assert measured == pytest.approx(expected, abs=2e-8)


SECOND = 1000 * MS


@pytest.mark.parametrize(
    ("flexion", "force", "marked"),
    [
        (0.3, 1.1, False),  # stance of walking
        (1.1, 0.0, False),  # its swing
        (0.8, 0.2, False),  # its toe-off
        (0.1, 0.5, False),  # standing on both legs
        (1.0, 0.5, True),  # a stair, or a chair
        (0.7, 2.3, True),  # running
    ],
)
def test_movements_without_constants_are_doubtful_for_a_stride(flexion, force, marked):
    weight, one = PERSON.weight, EstimatorWithMotion("ground_force")

    def status(stamp, flexion, force):
        sensed = Ground((0.0, force * weight, 0.0), NO_TORQUE)
        return one.at(EPOCH + stamp, Joints(flexion, NOT_MEASURED, NOT_MEASURED), sensed).status

    assert status(0, flexion, force) == (Status.DOUBTFUL_LOAD if marked else 0)
    assert status(SECOND, 0.1, 0.5) == (Status.DOUBTFUL_LOAD if marked else 0)
    assert status(2 * SECOND, 0.1, 0.5) == 0


def test_a_foot_that_bears_nothing_for_long_is_doubtful_and_a_pause_is_not():
    still, one = Joints(1.2, NOT_MEASURED, NOT_MEASURED), EstimatorWithMotion("ground_force")
    found = [
        one.at(EPOCH + number * SECOND, still, Ground((0.0, 0.0, 0.0), NO_TORQUE)).status
        for number in range(6)
    ]
    assert found == [0] * 4 + [Status.DOUBTFUL_LOAD] * 2
    assert one.at(EPOCH + 20 * SECOND, still, Ground((0.0, 0.0, 0.0), NO_TORQUE)).status == 0
