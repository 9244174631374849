"""Messages to samples of a leg: names, signs, actuators, levers and axes, and what is refused."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from knee_contact_ros.joint_reaction.leg import Joints
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.parameters.schema import GroundForce, LoadParameters
from knee_contact_ros.streams.load_stream import LARGEST_TORQUE, ground_of, ground_sample, joints_of, leg_sample
from knee_contact_ros.streams.messages import JointState, RefusedSampleError, WrenchStamped

STAMP = 1_500_000_000
LEG: dict[str, Any] = {"hip.joint_name": "hip", "ankle.joint_name": "ankle"}
ASSISTED = LEG | {"knee.assisted": True, "ankle.assisted": True}
UPRIGHT = Joints(0.0, 0.0, 0.0)
FULL = GroundForce(components="full")
WRENCH = WrenchStamped(STAMP, "plate", (10.0, 700.0, -20.0), (3.0, 4.0, 50.0))


def parameters(values: dict[str, Any]) -> LoadParameters:
    return load_parameters(values, LoadParameters)


def state(efforts: tuple[float, ...] = (), **positions: float) -> JointState:
    return JointState(STAMP, "", tuple(positions), tuple(positions.values()), (), efforts)


def joints(values: dict[str, Any], message: JointState) -> Joints:
    """The leg's joints as a message tells them."""
    sample = leg_sample(message, parameters(values), b"", 0)
    return joints_of(sample.angle, sample.others)


def moments(wrench: WrenchStamped, ground: GroundForce, at: Joints = UPRIGHT, inclination: float = 0.0) -> Any:
    """Force, and torque about the ankle, as numbers one after the other."""
    force, torque = ground_of(wrench, ground, at, inclination)
    return pytest.approx([*force, *torque], abs=1e-12)  # rounding of a few hundred N m


def test_the_joints_are_found_by_their_names_in_any_order() -> None:
    for message in (state(knee=0.25, hip=0.5, ankle=0.125), state(toe=9.0, ankle=0.125, hip=0.5, knee=0.25)):
        assert joints(LEG, message) == Joints(0.25, 0.5, 0.125)


def test_what_is_not_named_is_not_measured_whatever_comes() -> None:
    found = joints({}, state(knee=0.25, hip=math.inf, ankle=0.1))
    assert found.flexion == 0.25
    assert math.isnan(found.hip)
    assert math.isnan(found.ankle)
    assert (found.knee_assistance, found.ankle_assistance) == (0.0, 0.0)


def test_sign_and_offset_make_the_angles() -> None:
    signs = {f"{joint}.sign": -1.0 for joint in ("knee", "hip", "ankle")}
    values = LEG | signs | {"knee.offset": 0.5, "hip.offset": -0.25, "ankle.offset": 1.5}
    assert joints(values, state(knee=-0.25, hip=-0.5, ankle=1.0)) == Joints(0.75, 0.25, 0.5)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_efforts_assist_extension_and_plantarflexion(sign: float) -> None:
    """In the sense of the positions: what flexes the knee, or lifts the foot, helps the other muscles."""
    values = ASSISTED | {"knee.sign": sign, "ankle.sign": sign}
    found = joints(values, state((1.0, sign * -12.0, sign * -7.0), hip=0.0, knee=0.0, ankle=0.0))
    assert (found.knee_assistance, found.ankle_assistance) == (12.0, 7.0)
    without = joints(LEG, state((1.0, math.nan, math.inf), hip=0.0, knee=0.0, ankle=0.0))  # of a motor's friction, say
    idle = joints(ASSISTED, state((0.0, 0.0, -0.0), hip=0.0, knee=0.0, ankle=0.0))
    for none in (*without[3:], *idle[3:]):
        assert str(none) == "0.0"  # and not -0.0


@pytest.mark.parametrize(
    ("message", "reason", "words"),
    [
        (state(hip=0.1, ankle=0.2), "joint_missing", "no joint 'knee'; it has hip, ankle"),
        (state(knee=0.1, ankle=0.2), "joint_missing", "no joint 'hip'; it has knee, ankle"),
        (state((0.0, 0.0), knee=0.1, hip=0.2), "joint_missing", "no joint 'ankle'; it has knee, hip"),
        (
            state(hip=0.1, ankle=0.1, knee=0.1)._replace(position=(0.1, 0.1)),
            "joint_missing",
            "no position for joint 'k",
        ),
        (state(knee=0.1, hip=0.1, ankle=0.1), "joint_missing", "gives no effort for joint 'knee'"),
        (state((1.0,), knee=0.1, hip=0.1, ankle=0.1), "joint_missing", "gives no effort for joint 'ankle'"),
        (state((1.0, 0.0, math.nan), knee=0.1, hip=0.1, ankle=0.1), "not_finite", "effort of joint 'ankle' is nan"),
        (state((1.0, 0.0, 0.0), knee=0.1, hip=math.inf, ankle=0.1), "not_finite", "position of joint 'hip' is inf"),
        (state((1.0, 0.0, 0.0), knee=0.1, hip=0.1, ankle=math.nan), "not_finite", "position of joint 'ankle' is nan"),
        (state((1e6, 0.0, 0.0), knee=0.1, hip=0.1, ankle=0.1), "out_of_range", r"'knee' is 1e\+06 N m, beyond 100000"),
        (
            state((1.0, 0.0, 0.0), knee=0.1, hip=-1e300, ankle=0.1),
            "out_of_range",
            r"joint 'hip' is -1e\+300 rad, beyond",
        ),
        (state((1.0, 0.0, 0.0), knee=0.1, hip=0.1, ankle=0.1)._replace(stamp=-1), "bad_stamp", "stamp -1 ns"),
    ],
)
def test_what_cannot_be_used_is_refused(message: JointState, reason: str, words: str) -> None:
    with pytest.raises(RefusedSampleError, match=words) as caught:
        joints(ASSISTED, message)
    assert caught.value.reason == reason


def test_angles_that_lag_hold_earlier() -> None:
    sample = leg_sample(state(knee=0.25), parameters({}), b"as it came", 25_000_000)
    assert (sample.stamp, sample.came_at, sample.data) == (STAMP - 25_000_000, STAMP, b"as it came")


def test_of_an_insole_the_vertical_force_counts_alone() -> None:
    wrench = WRENCH._replace(force=(math.nan, 700.0, math.inf), torque=(math.nan,) * 3)
    sample = ground_sample(wrench, GroundForce(), b"as it came", 3.5)
    assert (sample.stamp, sample.frame_id, sample.data, sample.arrived) == (STAMP, "plate", b"as it came", 3.5)
    force, torque = ground_of(wrench, GroundForce(), UPRIGHT, 0.3)
    assert force == (0.0, 700.0, 0.0)
    assert all(map(math.isnan, torque))


@pytest.mark.parametrize(
    ("wrench", "full", "reason", "words"),
    [
        (WRENCH._replace(force=(0.0, math.nan, 0.0)), False, "not_finite", r"^ground_reaction_force: force\.y: nan$"),
        (WRENCH._replace(force=(0.0, math.inf, 0.0)), True, "not_finite", "force and torque: 0, inf, 0, 3, 4, 50"),
        (WRENCH._replace(torque=(0.0, 0.0, math.nan)), True, "not_finite", "force and torque: .*, nan"),
        (WRENCH._replace(force=(0.0, -1e6, 0.0)), False, "out_of_range", r"-1e\+06 N or N m, beyond 100000"),
        (WRENCH._replace(torque=(0.0, -1e6, 0.0)), True, "out_of_range", r"-1e\+06 N or N m, beyond 100000"),
        (WRENCH._replace(stamp=2**31 * 10**9), False, "bad_stamp", "ground_reaction_force: stamp 2147483648"),
    ],
)
def test_ground_forces_that_cannot_be_used_are_refused(
    wrench: WrenchStamped, full: bool, reason: str, words: str
) -> None:
    with pytest.raises(RefusedSampleError, match=words) as caught:
        ground_sample(wrench, FULL if full else GroundForce(), b"", 0.0)
    assert caught.value.reason == reason


def test_what_a_leg_bears_at_most_is_taken() -> None:
    at_most = WRENCH._replace(force=(LARGEST_TORQUE,) * 3, torque=(-LARGEST_TORQUE,) * 3)
    assert ground_sample(at_most, FULL, b"", 0.0).wrench == at_most


def test_a_wrench_at_the_ankle_stays_as_it_is() -> None:
    assert [*WRENCH.force, *WRENCH.torque] == moments(WRENCH, FULL)


def test_a_force_beside_the_ankle_turns_about_it() -> None:
    """A lever at a time: the ankle 0.1 m ahead of where the torque is told, or above it."""
    ahead, above = FULL.model_copy(update={"ankle_x": 0.1}), FULL.model_copy(update={"ankle_y": 0.08})
    up = WRENCH._replace(force=(0.0, 700.0, 0.0), torque=(0.0, 0.0, 0.0))
    forward, right = up._replace(force=(100.0, 0.0, 0.0)), up._replace(force=(0.0, 0.0, 30.0))
    assert moments(up, ahead) == [0.0, 700.0, 0.0, 0.0, 0.0, -70.0]  # behind the ankle it lifts the heel
    assert moments(up, above) == [0.0, 700.0, 0.0, 0.0, 0.0, 0.0]
    assert moments(forward, above) == [100.0, 0.0, 0.0, 0.0, 0.0, 8.0]
    assert moments(right, ahead) == [0.0, 0.0, 30.0, 0.0, 3.0, 0.0]
    assert moments(right, above) == [0.0, 0.0, 30.0, -2.4, 0.0, 0.0]


def test_axes_that_turn_with_the_foot_are_turned_upright() -> None:
    """Toes up by a right angle: what the sensor calls forward is up."""
    on_foot = FULL.model_copy(update={"axes": "foot"})
    toes_up, quarter = Joints(0.0, 0.0, 0.5), 0.5 * math.pi
    assert moments(WRENCH, on_foot, toes_up, quarter - 0.5) == [-700.0, 10.0, -20.0, -4.0, 3.0, 50.0]
    unknown = Joints(0.0, 0.3, math.nan)
    assert [*WRENCH.force, *WRENCH.torque] == moments(WRENCH, on_foot, unknown, 0.3)


forces, levers = st.floats(-1e3, 1e3), st.floats(-1.0, 1.0)
vectors = st.tuples(forces, forces, forces)


@given(vectors, vectors, levers, levers)
def test_the_moment_about_the_ankle_is_that_of_the_wrench(force: Any, torque: Any, x: float, y: float) -> None:
    """As NumPy's cross product has it."""
    ground = FULL.model_copy(update={"ankle_x": x, "ankle_y": y})
    found = ground_of(WrenchStamped(0, "", force, torque), ground, UPRIGHT, 0.0)
    expected = np.array(torque) - np.cross([x, y, 0.0], force)
    assert found.torque == pytest.approx(expected.tolist(), abs=1e-12)  # rounding of 3e3 N m
