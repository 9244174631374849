"""Two inertial sensors in place of an encoder: their orientations become the angle that a bag or a node has."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.streams.messages import JOINT_STATE, RefusedSampleError
from knee_contact_ros.streams.orientations import OrientationJoin
from knee_contact_ros.system.errors import UsageError
from tests.helpers.bags import raw_messages
from tests.helpers.offline import solve
from tests.offline.test_sources import (
    FORCE,
    KILONEWTONS,
    STAMPS,
    bag_of,
    head,
    message,
    vector,
)

MS = 1_000_000
IMU = "sensor_msgs/msg/Imu"
THIGH_MOUNT, SHANK_MOUNT = Rotation.from_euler(
    "xyz", [[10, 100, 40], [-30, 60, 170]], degrees=True
)
STANDING = " ".join(map(str, (THIGH_MOUNT.inv() * SHANK_MOUNT).as_quat()))
SENSORS = {"orientations.thigh": "/thigh/imu", "orientations.shank": "/shank/imu"}


def thigh(hip):
    """Orientation x, y, z, w of the thigh's sensor, with the hip at an angle [rad]; y is lateral."""
    return (Rotation.from_euler("y", hip) * THIGH_MOUNT).as_quat()


def shank(hip, knee):
    return (Rotation.from_euler("y", hip - knee) * SHANK_MOUNT).as_quat()


def imu(stamp, numbers):
    covariance = np.zeros(9)
    quaternion = message("geometry_msgs/msg/Quaternion", *numbers)
    rest = vector(0.0, 0.0, 0.0), covariance
    return message(IMU, head(stamp), quaternion, covariance, *rest, *rest)


def hip_at(stamp):
    return 0.4 * math.sin(5e-9 * stamp)


def knee_at(stamp):
    return 0.5 - 0.5 * math.cos(8e-9 * stamp)


def joined(samples, **values):
    """Stamps and angles of the joint states that samples (`t` or `s`, stamp) of walking make, and refusals."""
    join = OrientationJoin(
        load_parameters({**SENSORS, "orientations.standing": STANDING, **values})
    )
    found, refused = [], []
    for kind, stamp in samples:
        hip, knee = hip_at(stamp), knee_at(stamp)
        made = (
            join.add_thigh(stamp, "", list(-thigh(hip)))
            if kind == "t"
            else join.add_shank(stamp, "", list(shank(hip, knee)))
        )
        for each in made:
            try:
                state = JOINT_STATE.read_message(each, "joint_states")[0]
                found.append((state.stamp, state.position[0]))
            except RefusedSampleError as error:
                refused.append(str(error))
    return join, found, refused


def test_sensors_that_measure_at_other_times_are_joined():
    samples = [("t", 10 * n * MS) for n in range(300)] + [
        ("s", (7 * n + 3) * MS) for n in range(420)
    ]
    _, found, refused = joined(sorted(samples, key=lambda each: each[1]))
    assert not refused
    assert [stamp for stamp, _ in found] == [(7 * n + 3) * MS for n in range(len(found))]
    assert len(found) >= 419
    np.testing.assert_allclose(
        [angle for _, angle in found], [knee_at(stamp) for stamp, _ in found], atol=0.004
    )  # lines between samples 10 ms apart, and the whole rotation until the axis is known


@pytest.mark.parametrize(
    ("samples", "refused"),
    [
        ([("s", 0), ("s", 101 * MS)], 1),  # no thigh comes
        ([("t", 0), ("s", 50 * MS), ("t", 120 * MS)], 1),  # a gap
        ([("t", 200 * MS), ("s", 100 * MS)], 1),  # none before
        ([("t", 0), ("t", 900 * MS), ("t", 100 * MS), ("s", 100 * MS)], 0),  # a clock set back
        ([("t", 0), ("s", 20 * MS)], 0),  # it waits
    ],
)
def test_orientations_too_far_apart_are_refused(samples, refused):
    said = "/shank/imu: no orientation of the thigh (/thigh/imu) within 0.1 s (pairing.max_gap)"
    assert joined(samples)[2] == [said] * refused


def test_a_pose_that_is_none_and_a_drift_are_told():
    join, _, refused = joined([("t", 0), ("s", 0)], **{"orientations.standing": ""})
    assert "the zero is not known: call ~/zero in standing" in refused[0]
    with pytest.raises(UsageError, match="1 orientations came in the last second; 10 are needed"):
        join.measured_standing()
    join, _, _ = joined([(kind, 10 * n * MS) for n in range(200) for kind in "ts"])
    with pytest.raises(UsageError, match="a standing one is still for a second"):
        join.measured_standing()
    assert not join.knee.doubt
    with pytest.raises(RefusedSampleError, match="0, 0, 0, 0 is no quaternion"):
        join.add_thigh(0, "", [0.0] * 4)
    heading = Rotation.from_euler("z", 30, degrees=True)
    for n in range(600):
        stamp = (2000 + 10 * n) * MS
        turned = heading * Rotation.from_quat(shank(hip_at(stamp), knee_at(stamp)))
        join.add_thigh(stamp, "", list(thigh(hip_at(stamp))))
        join.add_shank(stamp, "", list(turned.as_quat()))
    assert "have the headings of the two sensors drifted apart" in join.knee.doubt


def test_a_bag_of_two_sensors_is_solved(tmp_path):
    topics = {
        "/thigh/imu": (IMU, lambda t, *_: imu(t, thigh(hip_at(t)))),
        "/shank/imu": (IMU, lambda t, angle, _: imu(t, shank(hip_at(t), angle))),
        **dict([FORCE]),
    }
    bag = bag_of(tmp_path / "bag.mcap", topics)
    for form in ("", " sensor_msgs/Imu orientation"):
        values = {name: topic + form for name, topic in SENSORS.items()}
        how = load_parameters({**values, "orientations.standing": STANDING})
        out = tmp_path / f"out{len(form)}.mcap"
        assert solve(bag, how, out).ticks == len(STAMPS) == len(KILONEWTONS)
        solve(out, how, tmp_path / "again.mcap", overwrite=True)  # it holds the angles
        first, again = (
            [each.data for each in raw_messages(path) if each.topic == "/knee_contact"]
            for path in (out, tmp_path / "again.mcap")
        )
        assert first == again


@pytest.mark.parametrize(
    "values",
    [
        {"orientations.thigh": "/a"},
        {**SENSORS, "drive": "displacement"},
        {**SENSORS, "orientations.shank": "/thigh/imu"},
    ],
)
def test_half_of_the_sensors_is_refused(values):
    with pytest.raises(UsageError, match="thigh and shank, of two sensors, with drive force"):
        load_parameters(values)
