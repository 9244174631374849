"""Messages to samples of a knee and of a leg: names, signs, actuators, levers and axes, and what is refused."""

import math
from collections.abc import Callable
from typing import Any

import pytest

from knee_contact_ros.joint_reaction.leg import Joints
from knee_contact_ros.model.knee import LARGEST_LOAD
from knee_contact_ros.parameters.build import load_rule
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.parameters.load_schema import GroundForce, LoadParameters
from knee_contact_ros.parameters.schema import KneeSection, Parameters
from knee_contact_ros.streams.contact_pipeline import angle_sample, load_sample
from knee_contact_ros.streams.load_pipeline import (
    LARGEST_TORQUE,
    ground_of,
    ground_sample,
    joints_of,
    leg_sample,
)
from knee_contact_ros.streams.messages import JointState, RefusedSampleError, WrenchStamped

STAMP = 1_500_000_000
LEG: dict[str, Any] = {"hip.joint_name": "hip", "ankle.joint_name": "ankle"}
ASSISTED = LEG | {"knee.assisted": True, "ankle.assisted": True}
UPRIGHT, FULL = Joints(0.0, 0.0, 0.0), GroundForce(components="full")
WRENCH = WrenchStamped(STAMP, "plate", (10.0, 700.0, -20.0), (3.0, 4.0, 50.0))
POSE = {"knee": 0.1, "hip": 0.1, "ankle": 0.1}


def state(*efforts, **positions):
    return JointState(STAMP, "", tuple(positions), tuple(positions.values()), (), efforts)


def force(y, **parts):
    return WrenchStamped(STAMP, "tibia_r", (1.0, y, 2.0), (0.0, 0.0, 0.0))._replace(**parts)


def leg(values, message):
    """The leg's joints as a message tells them."""
    sample = leg_sample(message, load_parameters(values, LoadParameters), b"", 0)
    return joints_of(sample.angle, sample.others)


def knee(message):
    return angle_sample(message, KneeSection())


def height(message):
    return angle_sample(message, KneeSection(), height_prescribed=True)


def assisted(message):
    return leg(ASSISTED, message)


SPACING = Parameters().load.compartment_spacing
"""[m]"""


def by_moment(message):
    return load_sample(
        message, load_rule(load_parameters({"load.compartment": "moment_balance"}), {})
    )


def vertical(message):
    return ground_sample(message, GroundForce(), b"", 0.0)


def whole(message):
    return ground_sample(message, FULL, b"", 0.0)


def test_joints_are_found_by_their_names_and_signs_make_their_angles():
    sample = knee(state(hip=1.0, knee=0.25, ankle=2.0))
    assert (sample.stamp, sample.angle) == (STAMP, 0.25)
    assert (
        knee(JointState(STAMP, "", ("knee", "knee"), (0.25, 9.0), (), ())).angle == 0.25
    )  # the first one counts
    other = KneeSection(joint_name="knee_angle_r", flexion_sign=-1.0, flexion_offset=0.1)
    assert (
        angle_sample(state(knee_angle_r=-0.5), other).angle == 0.5
    )  # the offset is that of the tick
    for message in (
        state(knee=0.25, hip=0.5, ankle=0.125),
        state(toe=9.0, ankle=0.125, hip=0.5, knee=0.25),
    ):
        assert leg(LEG, message) == Joints(0.25, 0.5, 0.125)
    signs = {f"{joint}.sign": -1.0 for joint in ("knee", "hip", "ankle")}
    values = LEG | signs | {"knee.offset": 0.5, "hip.offset": -0.25, "ankle.offset": 1.5}
    assert leg(values, state(knee=-0.25, hip=-0.5, ankle=1.0)) == Joints(0.75, 0.25, 0.5)


def test_joints_without_a_name_are_not_measured():
    found = leg({}, state(knee=0.25, hip=math.inf, ankle=0.1))
    assert (found.flexion, found.knee_assistance, found.ankle_assistance) == (0.25, 0.0, 0.0)
    assert math.isnan(found.hip)
    assert math.isnan(found.ankle)


def test_with_the_displacement_drive_a_second_joint_gives_the_height():
    named = KneeSection(height_joint_name="knee_ty")
    assert (
        angle_sample(state(knee=0.2, knee_ty=0.034), named, height_prescribed=True).height == 0.034
    )
    assert angle_sample(state(knee=0.2, knee_ty=0.034), named).height is None


def test_compression_is_a_positive_load():
    assert [load_sample(force(y)).axial for y in (-1000.0, 80.0)] == [1000.0, -80.0]
    beside = force(-700.0, torque=(math.nan, math.nan, -math.inf))._replace(
        force=(math.inf, -700.0, math.nan)
    )
    assert load_sample(beside).axial == 700.0  # what is not asked for may be anything
    assert load_sample(force(1.0)).frame_id == "tibia_r"


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_efforts_assist_extension_and_plantarflexion(sign):
    """In the sense of the positions: what flexes the knee, or lifts the foot, helps the other muscles."""
    values = ASSISTED | {"knee.sign": sign, "ankle.sign": sign}
    found = leg(values, state(1.0, sign * -12.0, sign * -7.0, hip=0.0, knee=0.0, ankle=0.0))
    assert (found.knee_assistance, found.ankle_assistance) == (12.0, 7.0)
    without = leg(
        LEG, state(1.0, math.nan, math.inf, hip=0.0, knee=0.0, ankle=0.0)
    )  # of a motor's friction, say
    idle = leg(ASSISTED, state(0.0, 0.0, -0.0, hip=0.0, knee=0.0, ankle=0.0))
    assert {str(none) for none in (*without[3:], *idle[3:])} == {"0.0"}  # and not -0.0


REFUSED: list[tuple[Callable[[Any], Any], Any, str, str]] = [
    *((knee, state(knee=value), "not_finite", "'knee' is") for value in (math.nan, -math.inf)),
    *(
        (load_sample, force(value), "not_finite", "reaction_force: force.y is")
        for value in (math.nan, math.inf)
    ),
    *((knee, state(knee=value), "out_of_range", "rad, beyond 10") for value in (1.1e6, -1e300)),
    *(
        (load_sample, force(value), "out_of_range", r"N, beyond 1e\+06")
        for value in (1.1e6, -1e300)
    ),
    (knee, state(hip=1.0, ankle=2.0), "joint_missing", "no joint 'knee'; it has hip, ankle"),
    (knee, state(knee=1.0)._replace(position=()), "joint_missing", "no position"),
    (height, state(knee=0.2), "joint_missing", "no joint 'knee_height'; it has knee"),
    (height, state(knee=0.2, knee_height=34.0), "out_of_range", "34 m, beyond 10"),
    *(
        (load_sample, force(-1.0, stamp=stamp), "bad_stamp", "stamp")
        for stamp in (-1, 2**31 * 10**9)
    ),
    *(
        (knee, state(knee=1.0)._replace(stamp=stamp), "bad_stamp", "stamp")
        for stamp in (-1, 2**31 * 10**9)
    ),
    *(
        (
            by_moment,
            force(-0.8 * LARGEST_LOAD, torque=(sign * 0.7 * LARGEST_LOAD * SPACING, 0.0, 0.0)),
            "out_of_range",
            "makes a load of",
        )
        for sign in (-1, 1)  # beyond the limit is the medial load, or the lateral one
    ),
    (by_moment, force(-10.0, torque=(math.nan, 0.0, 0.0)), "not_finite", "torque.x is nan"),
    (assisted, state(knee=0.1, ankle=0.2), "joint_missing", "no joint 'hip'; it has knee, ankle"),
    (
        assisted,
        state(hip=0.1, ankle=0.1, knee=0.1)._replace(position=(0.1, 0.1)),
        "lengths_differ",
        "2 values",
    ),
    (assisted, state(**POSE), "joint_missing", "gives no effort for joint 'knee'"),
    (assisted, state(1.0, **POSE), "lengths_differ", "3 names and 1 values of effort"),
    (assisted, state(1.0, 0.0, math.nan, **POSE), "not_finite", "effort of joint 'ankle' is nan"),
    (
        assisted,
        state(1.0, 0.0, 0.0, **POSE | {"hip": math.inf}),
        "not_finite",
        "position of joint 'hip' is inf",
    ),
    (
        assisted,
        state(1e6, 0.0, 0.0, **POSE),
        "out_of_range",
        r"'knee' is 1e\+06 N m, beyond 100000",
    ),
    (
        assisted,
        state(1.0, 0.0, 0.0, **POSE | {"hip": -1e300}),
        "out_of_range",
        r"joint 'hip' is -1e\+300 rad, beyond",
    ),
    (vertical, force(math.nan), "not_finite", r"^ground_reaction_force: force\.y: nan$"),
    (
        whole,
        WRENCH._replace(force=(0.0, math.inf, 0.0)),
        "not_finite",
        "force and torque: 0, inf, 0, 3, 4, 50",
    ),
    (vertical, force(-1e6), "out_of_range", r"-1e\+06 N or N m, beyond 100000"),
    (
        vertical,
        force(1.0, stamp=2**31 * 10**9),
        "bad_stamp",
        "ground_reaction_force: stamp 2147483648",
    ),
]


@pytest.mark.parametrize(("take", "message", "reason", "words"), REFUSED)
def test_what_cannot_be_used_is_refused(take, message, reason, words):
    with pytest.raises(RefusedSampleError, match=words) as caught:
        take(message)
    assert caught.value.reason == reason


def test_an_angle_delay_moves_the_stamp_and_not_the_recording():
    sample = angle_sample(
        state(knee=0.25)._replace(stamp=20_000_000), KneeSection(), delay=25_000_000
    )
    assert (sample.stamp, sample.message_stamp) == (-5_000_000, 20_000_000)
    with pytest.raises(RefusedSampleError, match="stamp -1 ns"):
        angle_sample(state(knee=0.25)._replace(stamp=-1), KneeSection(), delay=-25_000_000)
    of_leg = leg_sample(
        state(knee=0.25), load_parameters({}, LoadParameters), b"as it came", 25_000_000
    )
    assert (of_leg.stamp, of_leg.message_stamp, of_leg.data) == (
        STAMP - 25_000_000,
        STAMP,
        b"as it came",
    )


def test_of_an_insole_the_vertical_force_counts_alone():
    wrench = WRENCH._replace(force=(math.nan, 700.0, math.inf), torque=(math.nan,) * 3)
    sample = ground_sample(wrench, GroundForce(), b"as it came", 3.5)
    assert (sample.stamp, sample.frame_id, sample.data, sample.arrived) == (
        STAMP,
        "plate",
        b"as it came",
        3.5,
    )
    found, torque = ground_of(wrench, GroundForce(), UPRIGHT, 0.3)
    assert found == (0.0, 700.0, 0.0)
    assert all(map(math.isnan, torque))
    at_most = WRENCH._replace(force=(LARGEST_TORQUE,) * 3, torque=(-LARGEST_TORQUE,) * 3)
    assert whole(at_most).wrench == at_most


@pytest.mark.parametrize(
    ("update", "at", "inclination", "expected"),
    [
        ({}, UPRIGHT, 0.0, [10.0, 700.0, -20.0, 3.0, 4.0, 50.0]),
        (
            {"ankle_x": 0.1},
            UPRIGHT,
            0.0,
            [10.0, 700.0, -20.0, 3.0, 2.0, -20.0],
        ),  # behind the ankle it lifts the heel
        ({"ankle_y": 0.08}, UPRIGHT, 0.0, [10.0, 700.0, -20.0, 4.6, 4.0, 50.8]),
        (
            {"axes": "foot"},
            Joints(0.0, 0.0, 0.5),
            0.5 * math.pi - 0.5,
            [-700.0, 10.0, -20.0, -4.0, 3.0, 50.0],
        ),  # toes
        (
            {"axes": "foot"},
            Joints(0.0, 0.3, math.nan),
            0.3,
            [10.0, 700.0, -20.0, 3.0, 4.0, 50.0],
        ),  # not known: upright
    ],
)
def test_lever_and_axes_of_the_sensor(update, at, inclination, expected):
    found, torque = ground_of(WRENCH, FULL.model_copy(update=update), at, inclination)
    assert [*found, *torque] == pytest.approx(expected, abs=1e-12)  # rounding of a few hundred N m
