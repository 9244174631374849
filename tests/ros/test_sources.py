"""Robots whose messages are others than the usual ones, each by a parameter file of the package: live as offline."""

import time
from importlib import import_module
from typing import Any

import pytest
from rclpy.qos import QoSProfile, qos_profile_sensor_data

from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.parameters.load_schema import LoadParameters
from tests.helpers.offline import estimate_load, solve
from tests.offline.test_sources import (
    ANGLE,
    ANGLES,
    CASES,
    FORCE,
    KILONEWTONS,
    STAMPS,
    STORE,
    answers,
    bag_of,
    joint_state,
    wrench,
)

VERTICAL = ("/ground_reaction_force", (FORCE[1][0], lambda t, _, load: wrench(t, 0.0, load, 0.0)))
ROBOTS: dict[str, tuple[str, dict[str, Any]]] = {
    "project_march": (
        "load --with-contact",
        {
            "/joint_states": (
                ANGLE[1][0],
                joint_state(["left_knee", "right_knee"], lambda angle: [9.0, angle]),
            ),
            "/state_estimation/ground_reaction_force/right": CASES["a vector's axis"][2][
                "/right_grf"
            ],
        },
    ),
    "ros2_control": (
        "node",
        {
            "/joint_states": (
                ANGLE[1][0],
                joint_state(["hip_joint", "knee_joint"], lambda angle: [9.0, angle]),
            ),
            "/force_torque_sensor_broadcaster/wrench": (
                FORCE[1][0],
                lambda t, _, load: wrench(t, 3.0, 4.0, load),
            ),
        },
    ),
    "harmony": (
        "node",
        {
            "/harmony/right/joint_states": (
                ANGLE[1][0],
                joint_state(["knee_flexion"], lambda angle: [angle]),
            ),
            **dict([FORCE]),
        },
    ),
    "rep155": (
        "load --with-contact",
        {
            "/humans/bodies/ab12/joint_states": (
                ANGLE[1][0],
                joint_state(["l_knee_ab12", "r_knee_ab12"], lambda angle: [9.0, angle]),
            ),
            **dict([VERTICAL]),
        },
    ),
}
"""Command, and topics with their types and what makes their messages, by the name of the parameter file"""


def publishers(peer, topics):
    """As such robots have them: encoders are best effort, forces reliable."""
    found = {}
    for topic, (kind, _) in topics.items():
        package, _, name = kind.split("/")
        qos = qos_profile_sensor_data if topic == "/joint_states" else QoSProfile(depth=10)
        found[topic] = peer.node.create_publisher(
            getattr(import_module(f"{package}.msg"), name), topic, qos
        )
    return found


def send(peer, to, topics):
    """Publish the series as the robot does, at 200 Hz."""
    for stamp, angle, load in zip(STAMPS, ANGLES, KILONEWTONS, strict=True):
        for topic, (kind, make) in topics.items():
            to[topic].publish(bytes(STORE.serialize_cdr(make(stamp, angle, 1e3 * load), kind)))
        peer.spin(0.005)


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_robot_runs_with_a_parameter_file_and_no_glue(robot, peer, start_node, tmp_path):
    kind, topics = ROBOTS[robot]
    live, offline = tmp_path / "live.mcap", tmp_path / "offline.mcap"
    to = publishers(peer, topics)
    wait = ["knee_contact:pairing.wait:=5.0"]
    node = start_node(
        "--params-file",
        f"{robot}.yaml",
        *wait,
        f"knee_contact:record.path:={live}",
        kind=kind,
    )
    peer.wait_until(lambda: all(each.get_subscription_count() for each in to.values()))
    peer.wait_until(lambda: peer.node.count_publishers("knee_contact"))
    send(peer, to, topics)
    peer.wait_until(lambda: len(peer.contacts) == len(STAMPS))
    node.stop()
    bag = bag_of(tmp_path / "bag.mcap", topics)
    if kind != "node":
        estimate_load(bag, load_parameters(robot, LoadParameters), tmp_path / "load.mcap")
        bag = tmp_path / "load.mcap"
    solve(bag, load_parameters(robot), offline)
    assert answers(live) == answers(offline)
    assert len(answers(live)) == len(STAMPS)


def test_messages_without_a_stamp_get_that_of_their_arrival(peer, start_node):
    topics = CASES["a number without a stamp"][2]
    now = time.time_ns()
    topics = {
        "/angle": topics["/angle"],
        FORCE[0]: (FORCE[1][0], lambda t, *rest: FORCE[1][1](time.time_ns(), *rest)),
    }
    to = publishers(peer, topics)
    start_node("knee.source:=/angle std_msgs/Float64 data on arrival")
    peer.wait_until(lambda: all(each.get_subscription_count() for each in to.values()))
    peer.wait_until(lambda: peer.node.count_publishers("knee_contact"))

    def answered():
        send(peer, to, topics)
        return len(peer.contacts) >= len(STAMPS) - 5

    peer.wait_until(answered)  # sent again where a busy machine stamps the angles late
    stamps = [
        contact.header.stamp.sec * 10**9 + contact.header.stamp.nanosec
        for contact in peer.contacts
    ]
    assert now < min(stamps) < max(stamps) < time.time_ns()
    angles = {round(angle, 3) for angle in ANGLES}
    assert min(angles) - 1e-3 <= min(contact.flexion_angle for contact in peer.contacts)
