"""Messages to samples: names, signs, shares, and what is refused."""

from __future__ import annotations

import math

import pytest

from knee_contact_ros.parameters.schema import Knee
from knee_contact_ros.streams.contact_stream import angle_sample, load_sample
from knee_contact_ros.streams.messages import JointState, RefusedSampleError, WrenchStamped

STAMP = 1_500_000_000


def joint_state(**positions: float) -> JointState:
    return JointState(STAMP, "", tuple(positions), tuple(positions.values()), (), ())


def force(y: float, stamp: int = STAMP) -> WrenchStamped:
    return WrenchStamped(stamp, "tibia_r", (1.0, y, 2.0), (0.0, 0.0, 0.0))


def test_the_joint_is_found_by_its_name() -> None:
    sample = angle_sample(joint_state(hip=1.0, knee=0.25, ankle=2.0), Knee())
    assert (sample.stamp, sample.angle) == (1_500_000_000, 0.25)


def test_sign_and_offset_make_the_flexion_angle() -> None:
    knee = Knee(joint_name="knee_angle_r", flexion_sign=-1.0, flexion_offset=0.1)
    assert angle_sample(joint_state(knee_angle_r=-0.5), knee).angle == pytest.approx(0.6)


def test_compression_is_a_positive_load() -> None:
    assert load_sample(force(-1000.0)).axial == 1000.0
    assert load_sample(force(80.0)).axial == -80.0
    assert load_sample(force(1.0)).frame_id == "tibia_r"


@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf")])
def test_numbers_that_are_none_are_refused(value: float) -> None:
    with pytest.raises(RefusedSampleError, match="knee") as caught:
        angle_sample(joint_state(knee=value), Knee())
    assert caught.value.reason == "not_finite"
    with pytest.raises(RefusedSampleError, match="joint_reaction_force"):
        load_sample(force(value))


@pytest.mark.parametrize("value", [1.1e6, -1e300])
def test_numbers_beyond_all_knees_are_refused(value: float) -> None:
    with pytest.raises(RefusedSampleError, match="beyond 10") as caught:
        angle_sample(joint_state(knee=value), Knee())
    assert caught.value.reason == "out_of_range"
    with pytest.raises(RefusedSampleError, match=r"beyond 1e\+06"):
        load_sample(force(value))


def test_a_missing_joint_is_refused_with_those_that_are_there() -> None:
    with pytest.raises(RefusedSampleError, match="no joint 'knee'; it has hip, ankle") as caught:
        angle_sample(joint_state(hip=1.0, ankle=2.0), Knee())
    assert caught.value.reason == "joint_missing"


def test_a_joint_without_position_is_refused() -> None:
    with pytest.raises(RefusedSampleError, match="no position"):
        angle_sample(joint_state(knee=1.0)._replace(position=()), Knee())


def test_with_the_displacement_drive_a_second_joint_gives_the_height() -> None:
    knee = Knee(height_joint_name="knee_ty")
    assert angle_sample(joint_state(knee=0.2, knee_ty=0.034), knee, height_prescribed=True).height == 0.034
    assert angle_sample(joint_state(knee=0.2, knee_ty=0.034), knee).height is None


@pytest.mark.parametrize(
    ("positions", "reason", "words"),
    [
        ({"knee": 0.2}, "joint_missing", "no joint 'knee_height'; it has knee"),
        ({"knee": 0.2, "knee_height": math.nan}, "not_finite", "'knee_height' is nan"),
        ({"knee": 0.2, "knee_height": 34.0}, "out_of_range", "34 m, beyond 10"),
    ],
)
def test_heights_that_cannot_be_used_are_refused(positions: dict[str, float], reason: str, words: str) -> None:
    with pytest.raises(RefusedSampleError, match=words) as caught:
        angle_sample(joint_state(**positions), Knee(), height_prescribed=True)
    assert caught.value.reason == reason


@pytest.mark.parametrize("stamp", [-1, 2**31 * 1_000_000_000])
def test_a_stamp_that_no_recording_can_hold_is_refused(stamp: int) -> None:
    with pytest.raises(RefusedSampleError, match="stamp") as caught:
        load_sample(force(-1.0, stamp))
    assert caught.value.reason == "bad_stamp"
    with pytest.raises(RefusedSampleError, match="stamp"):
        angle_sample(joint_state(knee=1.0)._replace(stamp=stamp), Knee())


def test_an_angle_that_lags_holds_earlier_and_is_recorded_as_it_came() -> None:
    message = joint_state(knee=0.25)._replace(stamp=20_000_000)
    sample = angle_sample(message, Knee(), delay=25_000_000)
    assert (sample.stamp, sample.came_at) == (-5_000_000, 20_000_000)
    with pytest.raises(RefusedSampleError, match="stamp -1 ns"):
        angle_sample(message._replace(stamp=-1), Knee(), delay=-25_000_000)
