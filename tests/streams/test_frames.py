"""Forces in their frames: turned by static transforms, refused by name, and held to one frame."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.parameters.sections import rotation_numbers
from knee_contact_ros.streams.frames import (
    FROM_REP_103,
    ForceFrame,
    StaticTransforms,
    Transform,
    decode_transforms,
    encode_transform,
    isb_transform,
    turned_wrench,
)
from knee_contact_ros.streams.messages import (
    WRENCH,
    RefusedSampleError,
    WrenchStamped,
    encode_wrench_stamped,
)
from knee_contact_ros.system.errors import UsageError

NOWHERE = (0.0, 0.0, 0.0)
UPRIGHT = (0.0, 0.0, 0.0, 1.0)
ROUNDING = 1e-12
"""A few products of numbers of order 1: 1e-16 each"""
vectors = arrays(float, 3, elements=st.floats(-1.0, 1.0))
quaternions = arrays(float, 4, elements=st.floats(-1.0, 1.0)).filter(
    lambda q: np.linalg.norm(q) > 0.1
)


def wrench(frame, force, torque=NOWHERE):
    return WrenchStamped(7, frame, force, torque)


def take(frame, given):
    """What comes of a force that is taken; the bytes must be its own."""
    turned, data = frame.turn_wrench(given, encode_wrench_stamped(given))
    assert WRENCH.decode_message(data)[0] == turned
    if not frame.is_held:
        frame.hold_frame(given.frame_id)
    return turned


def told(frame, *transforms):
    assert frame.add_transforms(transforms) == []


def refusal(frame, given):
    with pytest.raises(RefusedSampleError) as refused:
        frame.turn_wrench(given, b"")
    return refused.value


def test_a_changed_frame_is_refused_until_a_reset():
    frame = ForceFrame()
    take(frame, wrench("left", NOWHERE))
    refused = refusal(frame, wrench("right", NOWHERE))
    assert refused.reason == "frame_changed"
    assert str(refused) == (
        "joint_reaction_force is in frame 'right', and was in 'left' before; if the new one is right, ~/reset takes it"
    )
    take(frame, wrench("left", NOWHERE))
    frame.forget_frame()
    take(frame, wrench("right", NOWHERE))


def test_a_frame_without_a_transform_is_refused_by_name():
    frame = ForceFrame("tibia_isb")
    refused = refusal(frame, wrench("sensor", NOWHERE))
    assert refused.reason == "frame_unknown"
    assert "frame 'sensor', and no static transform leads to 'tibia_isb'" in str(refused)
    told(frame, Transform("tibia", "sensor", NOWHERE, UPRIGHT))
    assert take(frame, wrench("sensor", (0.0, 0.0, -700.0))).frame_id == "tibia_isb"


def test_a_way_that_moves_is_named_as_the_reason():
    frame = ForceFrame("tibia")
    told(frame, Transform("foot", "sensor", NOWHERE, UPRIGHT))
    frame.note_moving(
        [Transform("tibia", "foot", NOWHERE, UPRIGHT), Transform("a", "a", NOWHERE, UPRIGHT)]
    )
    refused = str(refusal(frame, wrench("sensor", NOWHERE)))
    assert refused.endswith("; the way there on /tf moves, and only /tf_static is used")
    assert "/tf" not in str(refusal(frame, wrench("elsewhere", NOWHERE)))
    told(frame, Transform("tibia", "foot", NOWHERE, UPRIGHT))
    assert take(frame, wrench("sensor", (1.0, 2.0, 3.0))).force == (1.0, 2.0, 3.0)


@pytest.mark.parametrize("name", ["world", "/odom", "robot/base_link", "MAP"])
def test_a_frame_that_does_not_turn_with_the_tibia_is_doubted(name):
    frame = ForceFrame()
    assert not frame.doubt
    take(frame, wrench(name, NOWHERE))
    assert frame.doubt.startswith(f"the forces are in frame {name!r}, which does not turn")
    turned = ForceFrame(rotation=rotation_numbers("0 0 90 deg"))
    turned.hold_frame(name)
    assert not turned.doubt
    known = ForceFrame("tibia")
    told(known, Transform("tibia", name.removeprefix("/"), NOWHERE, UPRIGHT))
    take(known, wrench(name, NOWHERE))
    assert not known.doubt


@pytest.mark.parametrize("name", ["", "tibia", "world_tibia", "shank/base_link_sensor"])
def test_other_frames_are_not_doubted(name):
    frame = ForceFrame()
    frame.hold_frame(name)
    assert not frame.doubt


def test_a_frame_by_rep_103_is_turned_upright():
    """Up is z there and y here, left is y there and -z here."""
    turned = take(ForceFrame("tibia_isb"), wrench("tibia", (1.0, 2.0, 3.0), (4.0, 5.0, 6.0)))
    assert turned.force == pytest.approx((1.0, 3.0, -2.0), abs=ROUNDING)
    assert turned.torque == pytest.approx((4.0, 6.0, -5.0), abs=ROUNDING)
    assert isb_transform("tibia_isb") == Transform("tibia", "tibia_isb", NOWHERE, FROM_REP_103)
    assert isb_transform("tibia_r") is None


@given(quaternions, vectors, vectors, vectors, vectors)
def test_a_wrench_does_the_same_work_in_every_frame(turn, place, force, torque, twist):
    """Power on a body that turns by `twist` [rad/s] about the old origin, which lies at `place`."""
    rotation = Rotation.from_quat(turn)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation.as_matrix(), place
    turned = turned_wrench(wrench("a", tuple(force), tuple(torque)), pose, "b")
    spin = rotation.apply(twist)
    velocity_of_new_origin = -np.cross(spin, place)
    there = np.dot(turned.torque, spin) + np.dot(turned.force, velocity_of_new_origin)
    assert there == pytest.approx(np.dot(torque, twist), abs=100 * ROUNDING)


@given(quaternions, quaternions, vectors, vectors, vectors)
def test_a_tree_takes_a_point_up_and_down(left, right, up, down, point):
    """From one arm to the other: by SciPy's own rotations."""
    left, right = left / np.linalg.norm(left), right / np.linalg.norm(right)
    tree = StaticTransforms()
    tree.add_transform(Transform("root", "a", tuple(up), tuple(left)))
    tree.add_transform(Transform("root", "b", tuple(down), tuple(right)))
    pose = tree.between("a", "b")
    assert pose is not None
    in_root = Rotation.from_quat(left).apply(point) + up
    expected = Rotation.from_quat(right).inv().apply(in_root - down)
    assert (pose @ [*point, 1.0])[:3] == pytest.approx(expected, abs=100 * ROUNDING)


@pytest.mark.parametrize(
    "transform",
    [
        Transform("a", "b", (math.nan, 0.0, 0.0), UPRIGHT),
        Transform("a", "b", NOWHERE, (0.0, 0.0, 0.0, 0.0)),
        Transform("a", "b", NOWHERE, (0.0, 0.0, 0.0, math.inf)),
        Transform("a", "b", NOWHERE, (0.0, 0.0, 0.0, 2.0)),
        Transform("a", "b", (0.0, 1e308, 0.0), UPRIGHT),
        Transform("a", "a", NOWHERE, UPRIGHT),
        Transform("", "b", NOWHERE, UPRIGHT),
        Transform("a", "", NOWHERE, UPRIGHT),
    ],
)
def test_an_invalid_transform_is_ignored(transform):
    tree = StaticTransforms()
    tree.add_transform(Transform("a", "b", NOWHERE, UPRIGHT))
    with pytest.raises(ValueError, match="transform"):
        tree.add_transform(transform)
    assert tree.between("b", "a") == pytest.approx(np.eye(4))


def test_a_huge_message_of_transforms_is_not_read():
    """Reading 100 000 of them kept the forces waiting for three seconds."""
    with pytest.raises(ValueError, match="a message of 300092 bytes is not read"):
        decode_transforms(encode_transform(Transform("a", 300_000 * "b", NOWHERE, UPRIGHT), 0))


def test_a_changed_transform_holds_and_is_reported_once():
    frame = ForceFrame("tibia")
    told(frame, Transform("tibia", "sensor", NOWHERE, UPRIGHT))
    take(frame, wrench("sensor", (0.0, -1.0, 0.0)))
    assert frame.take_turn_note()["from"] == "sensor"
    told(frame, Transform("tibia", "sensor", NOWHERE, UPRIGHT))  # said again
    told(frame, Transform("tibia", "camera", NOWHERE, UPRIGHT))  # of no concern
    take(frame, wrench("sensor", (0.0, -1.0, 0.0)))
    assert not frame.take_turn_note()
    told(frame, Transform("tibia", "sensor", NOWHERE, (0.0, 0.0, 1.0, 0.0)))
    assert take(frame, wrench("sensor", (0.0, -1.0, 0.0))).force == pytest.approx(
        (0.0, 1.0, 0.0), abs=ROUNDING
    )
    assert frame.take_turn_note()["rotation_xyzw"].split() == ["0.0", "0.0", "1.0", "0.0"]


def test_a_force_refused_for_another_reason_reports_no_frame():
    """Neither a frame that is right as it is, nor one that would have to be turned."""
    for wanted in ("", "tibia_isb"):
        frame = ForceFrame(wanted)
        frame.turn_wrench(wrench("tibia", (math.nan, math.nan, math.nan)), b"")
        take(frame, wrench(wanted or "other", (0.0, -1.0, 0.0)))
        assert refusal(frame, wrench("tibia", NOWHERE)).reason == "frame_changed"
        assert not frame.take_turn_note()


def test_frames_of_a_recording_are_not_checked():
    frame = ForceFrame("tibia")
    frame.is_known = True
    for name in ("a", "b"):
        given = wrench(name, NOWHERE)
        assert take(frame, given) is given


@pytest.mark.parametrize(
    "text", ["-90 0 0 deg", "-1.5707963267948966, 0, 0", f"-{0.5**0.5} 0 0 {0.5**0.5}"]
)
def test_a_rotation_is_angles_or_a_quaternion(text):
    frame = ForceFrame(rotation=rotation_numbers(text))
    given = wrench("cell", (1.0, 2.0, 3.0), (4.0, 5.0, 6.0))
    turned, data = frame.turn_wrench(given, b"as it came")
    assert data == b"as it came"  # a recording is turned again
    assert (turned.frame_id, turned.stamp) == ("tibia", 7)
    assert turned.force == pytest.approx((1.0, 3.0, -2.0), abs=ROUNDING)
    assert turned.torque == pytest.approx((4.0, 6.0, -5.0), abs=ROUNDING)


@given(arrays(float, 3, elements=st.floats(-7.0, 7.0)), vectors)
def test_a_rotation_turns_as_its_sensor_in_a_urdf(angles, force):
    roll, pitch, yaw = (Rotation.from_rotvec(row) for row in np.diag(angles))
    frame = ForceFrame("shank", rotation=rotation_numbers(" ".join(map(repr, angles.tolist()))))
    x, y, z = force.tolist()
    turned, _ = frame.turn_wrench(wrench("cell", (x, y, z)), b"")
    expected = (yaw * pitch * roll).apply(force)  # fixed axes: first about x, last about z
    assert turned.frame_id == "shank"
    assert turned.force == pytest.approx(expected.tolist(), abs=10 * ROUNDING)


@pytest.mark.parametrize(
    "value", ["1 2", "1 2 3 4", "0 0 0 1 deg", "a b c", "nan 0 0", [1.0, 2.0], 3.0]
)
def test_a_text_that_is_no_rotation_is_refused(value):
    with pytest.raises(UsageError, match=r"parameter load.rotation: .* is not allowed"):
        load_parameters({"load.rotation": value})


def test_a_rotated_force_needs_three_numbers():
    values = {"load.rotation": "0 0 0", "load.source": "cell std_msgs/Float64 data on arrival"}
    with pytest.raises(
        UsageError, match=r"load.source: 1 fields are not allowed; load.rotation needs 3"
    ):
        load_parameters(values)
