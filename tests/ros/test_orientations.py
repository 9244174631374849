"""Two inertial sensors, as sensor_msgs/Imu, in a running node: standing, then walking."""

import math

import pytest
from geometry_msgs.msg import WrenchStamped
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Imu

from knee_contact_ros.bags.provenance import read_provenance
from tests.offline.test_orientations import IMU, MS, hip_at, imu, knee_at, shank, thigh
from tests.offline.test_sources import FORCE, STORE
from tests.ros.conftest import trigger


def test_two_sensors_give_the_angle_after_a_second_of_standing(peer, start_node, tmp_path):
    recording = tmp_path / "live.mcap"
    node = start_node(
        "orientations.thigh:=/thigh/imu",
        "orientations.shank:=/shank/imu sensor_msgs/Imu orientation",
        "pairing.wait:=5.0",
        f"record.path:={recording}",
    )
    to = {
        topic: peer.node.create_publisher(kind, topic, qos_profile_sensor_data)
        for topic, kind in (
            ("/thigh/imu", Imu),
            ("/shank/imu", Imu),
            ("/joint_reaction_force", WrenchStamped),
        )
    }
    peer.wait_until(lambda: all(each.get_subscription_count() for each in to.values()))
    peer.wait_until(lambda: peer.node.count_publishers("knee_contact"))

    def send(numbers, moves):
        """The shank's sensor is 4 ms later than the thigh's."""
        for n in numbers:
            stamp = (1000 + 10 * n) * MS
            late = stamp + 4 * MS
            to["/thigh/imu"].publish(
                bytes(STORE.serialize_cdr(imu(stamp, thigh(moves * hip_at(stamp))), IMU))
            )
            pose = shank(moves * hip_at(late), moves * knee_at(late))
            to["/shank/imu"].publish(bytes(STORE.serialize_cdr(imu(late, pose), IMU)))
            force = FORCE[1][1](stamp, 0.0, 800.0)
            to["/joint_reaction_force"].publish(bytes(STORE.serialize_cdr(force, FORCE[1][0])))
            peer.spin(0.005)

    assert not trigger(peer, "zero")[0]
    said = ""

    def zeroed():
        nonlocal said
        send(range(120), 0.0)
        done, said = trigger(peer, "zero")
        return done

    peer.wait_until(zeroed)  # sent again where a busy machine has not taken all
    assert said.startswith("orientations.standing is '")
    before = len(peer.contacts)
    send(range(200, 500), 1.0)
    peer.wait_until(lambda: len(peer.contacts) >= before + 280)
    for contact in peer.contacts[-200:]:
        stamp = contact.header.stamp.sec * 10**9 + contact.header.stamp.nanosec
        assert contact.flexion_angle == pytest.approx(knee_at(stamp), abs=0.01)
    assert max(contact.flexion_angle for contact in peer.contacts) > 0.9
    assert "call ~/zero in standing, or set orientations.standing" in node.stop()
    how = read_provenance(recording)
    assert how is not None
    assert [list(change.values or ()) for change in how.changes] == [["orientations.standing"]]
    assert math.isfinite(peer.contacts[-1].contact_force)
