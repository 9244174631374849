"""What a robot has of its own: frames of its sensors, and joint states of ros2_control."""

import math
import subprocess
import sys

import pytest
from geometry_msgs.msg import WrenchStamped
from knee_contact_ros.msg import KneeContact
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from tf2_msgs.msg import TFMessage

from knee_contact_ros.bags.bag import INPUT_TYPES
from knee_contact_ros.bags.provenance import read_provenance
from knee_contact_ros.bags.recorder import BagWriter
from knee_contact_ros.model.types import Status
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.streams.frames import (
    TF_MESSAGE,
    TF_STATIC,
    Transform,
    decode_transforms,
    encode_transform,
    isb_transform,
)
from tests.helpers.messages import RosMessages, header
from tests.helpers.offline import solve
from tests.helpers.walking import FORCE, walk
from tests.offline.test_sources import DYNAMIC_JOINT_STATE_TYPE, STORE, answers, dynamic
from tests.ros.conftest import trigger

STEP = 5_000_000
LATCHED = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def send_force(peer, stamp, frame, force):
    x, y, z = force
    wrench = RosMessages.Wrench(force=RosMessages.Vector3(x=x, y=y, z=z))
    peer.force.publish(WrenchStamped(header=header(RosMessages, stamp, frame), wrench=wrench))


def refused(peer, reason):
    return int(peer.diagnostics.get("knee_contact: refused samples", {}).get(reason, 0))


def test_sensors_are_turned_as_soon_as_the_robot_says_where_they_are(peer, start_node, tmp_path):
    told: list[Transform] = []
    peer.node.create_subscription(
        TFMessage,
        "/tf_static",
        lambda data: told.extend(decode_transforms(data)),
        LATCHED,
        raw=True,
    )
    recording = tmp_path / "live.mcap"
    node = start_node("frame.tibia:=shank_isb", f"record.path:={recording}")
    peer.wait_for_node()
    peer.wait_until(lambda: told)  # where the tibia frame lies in the robot's own
    assert told == [isb_transform("shank_isb")]
    robot = Node("robot")
    publisher = robot.create_publisher(TFMessage, "/tf_static", LATCHED)
    upside_down = Transform("shank", "load_cell", (0.0, 0.0, -0.3), (1.0, 0.0, 0.0, 0.0))
    mover = robot.create_publisher(TFMessage, "/tf", 10)
    peer.wait_until(mover.get_subscription_count)
    for _ in range(10):  # the node may not know the publisher yet that knows it
        mover.publish(encode_transform(upside_down, 0))
        peer.spin(0.1)
    peer.send_angle(0, 0.1)
    send_force(peer, 0, "load_cell", (0.0, 0.0, 700.0))
    peer.wait_until(lambda: refused(peer, "frame_unknown") == 1)
    publisher.publish(encode_transform(upside_down, 0))
    stamp = STEP
    while not peer.contacts:  # the transform is on its way
        peer.send_angle(stamp, 0.1)
        send_force(peer, stamp, "load_cell", (0.0, 0.0, 700.0))
        peer.spin(0.05)
        stamp += STEP
    assert peer.contacts[0].header.frame_id == peer.wrenches[0].header.frame_id == "shank_isb"
    assert peer.contacts[0].load == pytest.approx(
        350.0, abs=1e-9
    )  # one rotation's rounding of 700 N
    peer.wait_until(lambda: not mover.get_subscription_count())  # it can tell nothing more
    answered, told_before = len(peer.contacts), refused(peer, "frame_changed")
    send_force(peer, stamp, "shank", (0.0, 0.0, -700.0))
    peer.wait_until(lambda: refused(peer, "frame_changed") == told_before + 1)
    publisher.publish(
        encode_transform(upside_down._replace(rotation=(0.0, 0.0, 0.0, 0.0)), 0)
    )  # no rotation
    for _ in range(3):
        peer.send_angle(stamp, 0.1)
        send_force(peer, stamp, "load_cell", (0.0, 0.0, 700.0))
        stamp += STEP
    peer.wait_until(lambda: len(peer.contacts) >= answered + 3)
    robot.destroy_node()
    output = node.stop()
    assert (
        "leads to 'shank_isb'; the way there on /tf moves, and only /tf_static is used" in output
    )
    assert "forces are turned from load_cell to shank_isb" in output
    assert "/tf_static: transform from 'shank' to 'load_cell'" in output
    how = read_provenance(recording)
    assert how is not None
    solve(recording, how, tmp_path / "again.mcap")
    paths = (tmp_path / "again.mcap", recording)
    again, live = (
        [deserialize_message(data, KneeContact) for data in answers(path)] for path in paths
    )
    for one in live:
        one.status &= ~Status.INPUT_REJECTED  # what was refused is not recorded
    assert again == live


def test_forces_in_a_frame_of_the_world_are_told_once(peer, start_node):
    node = start_node()
    peer.wait_for_node()
    for i in range(20):
        peer.send_angle(i * STEP, 0.1)
        send_force(peer, i * STEP, "world", (0.0, -700.0, 0.0))
    peer.wait_until(lambda: len(peer.contacts) == 20)
    peer.spin(0.5)  # several calls of the timer
    assert (
        node.stop().count("forces are in frame 'world', which does not turn with the tibia") == 1
    )


def test_forces_of_an_unknown_frame_are_no_lack_of_angles(peer, start_node):
    node = start_node("frame.tibia:=shank")
    peer.wait_for_node()
    for i in range(20):
        peer.send_angle(i * STEP, 0.1)
        send_force(peer, i * STEP, "load_cell", (0.0, -700.0, 0.0))
    peer.wait_until(lambda: refused(peer, "frame_unknown") == 20)
    assert "20 of 20 forces have no answer (20 x frame_unknown): give a static" in node.stop()


def test_angles_may_come_from_ros2_control(peer, start_node, tmp_path):
    messages = pytest.importorskip("control_msgs.msg", reason="needs the ROS package control_msgs")
    try:
        messages.DynamicJointState.__class__.__import_type_support__()
    except Exception as error:  # rosidl's own, where a package that it needs is missing
        pytest.skip(f"control_msgs cannot be used: {error}")
    publisher = peer.node.create_publisher(
        messages.DynamicJointState, "dynamic_joint_states", QoSProfile(depth=1000)
    )
    node = start_node(
        "knee.source:=dynamic_joint_states", f"record.path:={tmp_path / 'live.mcap'}"
    )
    peer.wait_until(publisher.get_subscription_count)
    peer.wait_until(peer.force.get_subscription_count)
    publisher.publish(b"\0\1\0\0\xff")
    for i in range(20):
        publisher.publish(
            bytes(STORE.serialize_cdr(dynamic(i * STEP, 0.01 * i, 0.0), DYNAMIC_JOINT_STATE_TYPE))
        )
        send_force(peer, i * STEP, "tibia_r", (0.0, -700.0, 0.0))
    peer.wait_until(lambda: len(peer.contacts) == 20)
    assert [contact.flexion_angle for contact in peer.contacts] == [0.01 * i for i in range(20)]
    peer.wait_until(
        lambda: (
            peer.diagnostics.get("knee_contact: dynamic_joint_states", {}).get("received") == "21"
        )
    )
    assert refused(peer, "undecodable") == 1
    node.stop()
    assert len(answers(tmp_path / "live.mcap")) == 20


def test_a_replay_says_where_the_bags_frames_are(peer, tmp_path):
    mounted = Transform("tibia", "sensor", (0.0, 0.0, 0.1), (0.5, 0.5, 0.5, 0.5))
    bag, topics = tmp_path / "bag.mcap", INPUT_TYPES | {TF_STATIC: TF_MESSAGE}
    with BagWriter(bag) as writer:
        for topic, kind in topics.items():
            writer.add_topic(topic, kind)
        for one in walk(20):
            writer.write_message(
                one.topic if one.topic != FORCE else "/joint_reaction_force",
                one.log_time,
                one.data,
            )
        writer.write_message(TF_STATIC, 0, encode_transform(mounted, 0))
    told: list[Transform] = []
    peer.node.create_subscription(
        TFMessage,
        "/tf_static",
        lambda data: told.extend(decode_transforms(data)),
        LATCHED,
        raw=True,
    )
    replay = subprocess.Popen(
        [sys.executable, "-m", "knee_contact_ros.commands.main", "replay", str(bag), "--wait", "3"]
    )
    peer.wait_until(lambda: told)
    assert told == [mounted]
    replay.kill()
    replay.wait()


def test_a_number_turns_forces_without_transforms(peer, start_node, tmp_path):
    recording = tmp_path / "live.mcap"
    node = start_node("load.rotation:=-90 0 0 deg", f"record.path:={recording}")
    peer.wait_for_node()
    for i in range(20):
        peer.send_angle(i * STEP, 0.01 * i)
        send_force(peer, i * STEP, "load_cell", (0.0, 0.0, -700.0 - i))
    peer.wait_until(lambda: len(peer.contacts) == 20)
    loads = [350.0 + 0.5 * i for i in range(20)]
    assert [one.load for one in peer.contacts] == pytest.approx(loads, abs=1e-9)
    assert {one.header.frame_id for one in (*peer.contacts, *peer.wrenches)} == {"tibia"}
    node.stop()
    how = read_provenance(recording)
    solve(recording, how, tmp_path / "again.mcap")
    solve(
        recording, load_parameters({"load.rotation": [-math.pi / 2, 0.0, 0.0]}), tmp_path / "new"
    )
    first, again, new = (
        answers(path) for path in (recording, tmp_path / "again.mcap", tmp_path / "new")
    )
    assert first == again == new


def test_a_free_leg_tares_its_sensor(peer, start_node, tmp_path):
    recording = tmp_path / "live.mcap"
    node = start_node(f"record.path:={recording}")
    peer.wait_for_node()
    said = trigger(peer, "tare")
    assert not said[0]
    assert said[1] == "no force comes"

    def send(first, last, axial):
        for i in range(first, last):
            peer.send(i * STEP, 0.2, axial(i))
            peer.spin(0.002)
        peer.wait_until(lambda: len(peer.contacts) == last)

    send(0, 300, lambda i: 800.0 + 600.0 * math.sin(0.1 * i))
    said = trigger(peer, "tare")
    assert not said[0]
    assert "a leg that hangs free has at most 184 N +- 22 N" in said[1]
    send(300, 600, lambda i: 40.0 + (-1.0) ** i)
    assert peer.contacts[-1].load == 19.5
    assert trigger(peer, "tare") == (True, "load.offset is -40.000 N now")
    send(600, 800, lambda i: 40.0 + (-1.0) ** i)
    assert peer.contacts[-1].load == pytest.approx(-0.5, abs=1e-9)  # a mean of 201 numbers
    assert "load.offset is -40.000 N now" in node.stop()
    how = read_provenance(recording)
    assert how is not None
    assert [(change.tick, list(change.values or ())) for change in how.changes] == [
        (600, ["load.offset"])
    ]
    solve(recording, how, tmp_path / "again.mcap")
    assert answers(tmp_path / "again.mcap") == answers(recording)
